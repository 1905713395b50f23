# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Bonds of claims: one for each id in a claim, under concurrent changes of claims."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any, List, Set

import pytest

from dyknow.model.streams import StreamRequest
from dyknow.ros.bonding import claim_bonds
from dyknow.ros.bonding.bond_table import DuplicateBond
from dyknow.ros.bonding.claim_bonds import ClaimBonds

PATIENCE = 10.0


class FakeBonds:
    """Bonds of one topic; adding one can be held up."""

    def __init__(self, topic: str, clock: Any) -> None:
        self.held: Set[str] = set()
        self.adding = threading.Event()
        self.go_on = threading.Event()
        self.go_on.set()

    def add(self, bond_id: str, on_broken: Any) -> None:
        self.adding.set()
        assert self.go_on.wait(PATIENCE)
        if bond_id in self.held:
            raise DuplicateBond(bond_id)
        self.held.add(bond_id)

    def remove(self, bond_id: str) -> None:
        self.held.discard(bond_id)

    def close(self) -> None:
        self.held.clear()


def claim(claim_id: str, bond_id: str, ended: bool = False) -> Any:
    request = StreamRequest("Tag", bond_id=bond_id)
    return SimpleNamespace(claim_id=claim_id, request=request, state=SimpleNamespace(ended=ended))


class Table:
    """Claims that change, and the bonds that follow them."""

    def __init__(self) -> None:
        self.claims: List[Any] = []
        self.expired: List[str] = []
        self.bonds = ClaimBonds(
            lambda: self.claims, lambda name, reason: self.expired.append(name)
        )
        self.held: Any = self.bonds._bonds


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch) -> Table:
    monkeypatch.setattr(claim_bonds, "Bonds", FakeBonds)
    monkeypatch.setattr(claim_bonds.rospy, "get_name", lambda: "/manager")
    return Table()


def test_claims_that_name_a_bond_have_it_until_the_last_of_them_ends(table: Table) -> None:
    table.claims = [claim("1", "b"), claim("2", "b"), claim("3", ""), claim("4", "c", ended=True)]
    table.bonds.follow()
    assert table.held.held == {"b"}
    table.claims = table.claims[1:]
    table.bonds.follow()
    assert table.held.held == {"b"}
    table.claims = []
    table.bonds.follow()
    assert table.held.held == set()


def test_a_broken_bond_ends_the_claims_that_hang_on_it(table: Table) -> None:
    table.claims = [claim("2", "b"), claim("1", "b"), claim("3", "c")]
    table.bonds.follow()
    table.bonds._on_broken("b")
    table.bonds._on_broken("b")
    assert table.expired == ["1", "2"]


def test_a_claim_that_ends_while_its_bond_is_made_leaves_none(table: Table) -> None:
    table.claims = [claim("1", "b")]
    table.held.go_on.clear()
    making = threading.Thread(target=table.bonds.follow)
    making.start()
    assert table.held.adding.wait(PATIENCE)
    table.claims = []
    ending = threading.Thread(target=table.bonds.follow)
    ending.start()
    ending.join(0.1)  # it may be over at once, or wait for the other
    table.held.go_on.set()
    for thread in (making, ending):
        thread.join(PATIENCE)
        assert not thread.is_alive()
    assert table.held.held == set()


def test_claims_of_many_threads_have_their_bonds_in_the_end(table: Table) -> None:
    changing = threading.Lock()

    def work(number: int) -> None:
        for _ in range(200):
            mine = claim(str(number), "b")
            with changing:
                table.claims = [*table.claims, mine]
            table.bonds.follow()
            with changing:
                table.claims = [each for each in table.claims if each is not mine]
            table.bonds.follow()
        with changing:
            table.claims = [*table.claims, claim(str(number), f"b{number}")]
        table.bonds.follow()

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert table.held.held == {"b0", "b1", "b2", "b3"}
