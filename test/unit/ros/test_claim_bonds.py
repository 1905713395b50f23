# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Bonds of claims: one for each id in a claim, under concurrent changes of claims."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any, List, Set

import pytest
from clocks import in_thread, join, wait_for

from dyknow.model.streams import StreamRequest
from dyknow.ros.bonding import claim_bonds
from dyknow.ros.bonding.bond_table import DuplicateBond
from dyknow.ros.bonding.claim_bonds import ClaimBonds


class FakeBonds:
    """Bonds of one topic; adding one can be held up."""

    def __init__(self, topic, clock):
        self.held: Set[str] = set()
        self.adding = threading.Event()
        self.go_on = threading.Event()
        self.go_on.set()
        self.remove = self.held.discard
        self.close = self.held.clear

    def add(self, bond_id, on_broken):
        self.adding.set()
        wait_for(self.go_on)
        if bond_id in self.held:
            raise DuplicateBond(bond_id)
        self.held.add(bond_id)


def claim(claim_id, bond_id, ended=False):
    request = StreamRequest("Tag", bond_id=bond_id)
    return SimpleNamespace(claim_id=claim_id, request=request, state=SimpleNamespace(ended=ended))


class Table:
    """Claims that change, and the bonds that follow them."""

    def __init__(self):
        self.claims: List[Any] = []
        self.expired: List[str] = []
        self.bonds = ClaimBonds(
            lambda: self.claims, lambda name, reason: self.expired.append(name)
        )
        self.fake: Any = self.bonds._bonds

    def follow(self, *claims):
        self.claims = list(claims)
        self.bonds.follow()
        return set(self.fake.held)


@pytest.fixture
def table(monkeypatch):
    monkeypatch.setattr(claim_bonds, "Bonds", FakeBonds)
    monkeypatch.setattr(claim_bonds.rospy, "get_name", lambda: "/manager")
    return Table()


def test_claims_that_name_a_bond_have_it_until_the_last_of_them_ends(table):
    second = claim("2", "b")
    assert table.follow(claim("1", "b"), second, claim("3", ""), claim("4", "c", True)) == {"b"}
    assert table.follow(second) == {"b"}
    assert table.follow() == set()


def test_a_broken_bond_ends_the_claims_that_name_it(table):
    table.follow(claim("2", "b"), claim("1", "b"), claim("3", "c"))
    table.bonds._on_broken("b")
    table.bonds._on_broken("b")
    assert table.expired == ["1", "2"]


def test_a_claim_that_ends_while_its_bond_is_made_leaves_none(table):
    table.fake.go_on.clear()
    making = in_thread(lambda: table.follow(claim("1", "b")))
    wait_for(table.fake.adding)
    ending = in_thread(table.follow)
    ending.join(0.1)  # it may be over at once, or wait for the first
    table.fake.go_on.set()
    join(making, ending)
    assert table.fake.held == set()


def test_claims_of_many_threads_have_their_bonds_in_the_end(table):
    changing = threading.Lock()

    def work(number):
        def change(added, removed):
            with changing:
                kept = [each for each in table.claims if each not in removed]
                table.claims = [*kept, *added]
            table.bonds.follow()

        for _ in range(200):
            mine = claim(str(number), "b")
            change([mine], [])
            change([], [mine])
        change([claim(str(number), f"b{number}")], [])

    join(*[in_thread(lambda n=number: work(n)) for number in range(4)])
    assert table.fake.held == {"b0", "b1", "b2", "b3"}
