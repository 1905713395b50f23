# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Bonds on a clock of the test's, in tables that are connected, and those of claims."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any, List, Set

import pytest
from clocks import in_thread, join, wait_for

from dyknow.model.streams import StreamRequest
from dyknow.ros.bonding import bonded
from dyknow.ros.bonding.bond_table import BondTable, BondTimings, DuplicateBond
from dyknow.ros.bonding.bonded import ClaimBonds

TIMINGS = BondTimings(
    connect_timeout=10.0,
    heartbeat_timeout=4.0,
    disconnect_timeout=2.0,
    heartbeat_period=1000.0,  # except where a test is about heartbeats
    dead_publish_period=0.5,
)


class OneBond:
    """A table with the bond "id"; each event returns its effects, in words."""

    def __init__(self):
        self.table = BondTable(TIMINGS)
        self.broken = 0
        self.add(0.0)

    def add(self, now):
        (word,) = self.table.add("id", self._break, now).announcements
        self.we = word.instance_id

    def hear(self, now, active=True, who="she"):
        return self._words(self.table.receive("id", who, active, now))

    def tick(self, now, silence_counts=True):
        return self._words(self.table.tick(now, silence_counts))

    def part(self, now):
        return self._words(self.table.remove("id", now))

    def is_over(self):
        return len(self.table) == 0

    def _break(self):
        self.broken += 1

    def _words(self, effects):
        for callback in effects.broken:
            callback()
        said = ["alive" if each.active else "dead" for each in effects.announcements]
        return " ".join([*said, *("broken" for _ in effects.broken), *effects.intruded])


@pytest.fixture
def bond():
    return OneBond()


#: Steps: a time (s), an event, and its effects. "over": the bond is forgotten.
SCRIPTS = {
    "the first heartbeat is answered at once, and silence counts from it": (
        "1 hear alive | 4.9 tick | 5.1 tick dead broken | over"
    ),
    "a sister that never comes breaks the bond": "9.9 tick | 10 tick dead broken | 99 tick | over",
    "silence that does not count is measured again": (
        "1 hear alive | 5.5 no-silence | 9.4 tick | 9.5 tick dead broken | over"
    ),
    "silence that is judged later may end before": (
        "1 hear alive | 5 judged-later | 5.1 hear | 5.2 tick | 9.0 tick | 9.1 tick dead broken"
    ),
    "messages of our own and of third parties change nothing": (
        "1 death-of-us | 1 hear alive | 2 other-death id | 4.9 tick | 5.1 tick dead broken"
    ),
    "parting before silence is judged stays on purpose": (
        "1 hear alive | 5.1 part dead | 5.2 tick | 5.6 tick dead"
    ),
    "her death is acknowledged each time and reported once": (
        "1 hear alive | 2 death dead broken | 2.1 death dead | 2.2 hear | 4 tick | over | 5 death"
    ),
    "so it is of one that was never heard": (
        "2 death dead broken | 2.1 death dead | 2.2 hear | 4 tick | over | 4.1 death"
    ),
    "parting is repeated until she acknowledges": (
        "1 hear alive | 2 part dead | 2.1 part | 2.4 tick | 2.5 tick dead | 2.6 hear | "
        "2.7 death | over | 2.8 part"
    ),
    "so it is for one that was never heard": (
        "2 part dead | 2.1 part | 2.4 tick | 2.5 tick dead | 2.6 hear | 2.7 death | over"
    ),
    "parting without acknowledgement ends too": (
        "1 hear alive | 2 part dead | 2.5 tick dead | 3 tick dead | 3.5 tick dead | 4 tick | over"
    ),
    "answers to the end of an earlier bond do not count": (
        "1 hear alive | 2 part dead | 2 again | 2.1 hear | 2.1 death | 2.1 death-of-us | "
        "2.2 other alive | 5 death | 5 hear"
    ),
    "a sister of an earlier bond who lives on is taken up again": (
        "1 hear alive | 2 part dead | 2.5 again | 4.4 hear | 4.5 death | 4.5 hear alive | "
        "5 death dead broken"
    ),
}


@pytest.mark.parametrize("name", SCRIPTS)
def test_one_bond(bond, name):
    first = bond.we
    events = {
        "hear": bond.hear,
        "death": lambda now: bond.hear(now, active=False),
        "tick": bond.tick,
        "judged-later": lambda now: bond.tick(now, silence_counts=None),
        "no-silence": lambda now: bond.tick(now, silence_counts=False),
        "part": bond.part,
        "again": bond.add,
        "death-of-us": lambda now: bond.hear(now, active=False, who=first),
        "other": lambda now: bond.hear(now, who="another she"),
        "other-death": lambda now: bond.hear(now, active=False, who="another she"),
    }
    for step in SCRIPTS[name].split(" | "):
        if step == "over":
            assert bond.is_over() and bond.table.next_due() is None
            continue
        now, event, *expected = step.split()
        assert (events[event](float(now)) or "") == " ".join(expected), step
    assert bond.broken == SCRIPTS[name].count("broken")


def test_heartbeats_keep_a_bond(bond):
    assert bond.hear(3.0) == "alive"
    assert bond.table.next_due() == 7.0
    for now in range(4, 30):
        assert bond.hear(float(now)) == ""
        assert bond.tick(now + 3.9) == ""
    assert bond.table.silent(32.9) == []
    assert bond.table.silent(33.0) == ["id"]


def test_a_sister_who_ignores_the_end_of_each_bond_has_the_next_one(bond):
    now = 0.0
    for _ in range(3):
        bond.hear(now + 1.0, who="deaf")
        bond.part(now + 1.0)
        bond.add(now + 1.0)
        now += 1.0
    for second in range(30):
        bond.hear(now + second, who="deaf")
        bond.tick(now + second)
    assert bond.broken == 0
    assert bond.tick(now + 29 + 4.0) == "dead broken"


class Network:
    """Tables on one topic; delivers each message to all of them, including the sender."""

    def __init__(self):
        timings = BondTimings(10.0, 4.0, 2.0, 1.0, 0.5)
        self.now = 0.0
        self.broken = []
        self.tables = [BondTable(timings) for _ in range(3)]
        self.manager, self.a, self.b = self.tables
        for table, name, ids in zip(self.tables, ("manager", "A", "B"), ("ab", "a", "b")):
            for bond_id in ids:
                self.add(table, bond_id, (name, bond_id))

    def add(self, table, bond_id, entry):
        self.carry(table.add(bond_id, lambda: self.broken.append(entry), self.now))

    def remove(self, table, bond_id):
        self.carry(table.remove(bond_id, self.now))

    def carry(self, effects):
        for callback in effects.broken:
            callback()
        for each in effects.announcements:
            for table in self.tables:
                self.carry(table.receive(each.bond_id, each.instance_id, each.active, self.now))

    def run(self, until):
        """Let time pass from one due moment to the next."""
        while True:
            due = [t for t in (table.next_due() for table in self.tables) if t is not None]
            if not due or min(due) > until:
                self.now = until
                return
            self.now = max(self.now, min(due))
            for table in self.tables:
                self.carry(table.tick(self.now, True))


@pytest.fixture
def pair():
    """A manager with the bonds a and b, and a client of each."""
    return Network()


def test_a_client_that_parts_or_is_killed_breaks_its_own_bond(pair):
    pair.run(5.5)
    assert pair.broken == []
    assert list(map(len, pair.tables)) == [2, 1, 1]
    pair.tables.remove(pair.a)
    pair.run(8.9)
    assert pair.broken == []
    pair.run(9.0)
    assert pair.broken == [("manager", "a")]
    pair.remove(pair.b, "b")
    assert pair.broken == [("manager", "a"), ("manager", "b")]
    pair.run(60.0)
    assert len(pair.broken) == 2
    assert list(map(len, pair.tables)) == [0, 0]


def test_all_bonds_of_a_table_share_a_heartbeat():
    table = Network().manager
    for number in range(40):
        table.add(f"bond{number}", lambda: None, now=number * 0.01)
    assert table.next_due() == 1.0
    assert len(table.tick(1.0).announcements) == 42
    assert table.next_due() == 2.0


def test_the_manager_removes_its_ends(pair):
    pair.run(5.0)
    pair.remove(pair.manager, "a")
    assert pair.broken == [("A", "a")]
    assert not pair.manager.is_parting()
    pair.carry(pair.manager.remove_all(5.0))
    assert pair.broken == [("A", "a"), ("B", "b")]
    assert len(pair.manager) == 0
    assert not pair.manager.remove("unknown", 5.0)
    assert not pair.manager.receive("unknown", "x", True, 5.0)


def test_an_id_is_unique_while_its_bond_lives_and_can_be_used_again_at_once(pair):
    pair.run(5.0)
    with pytest.raises(DuplicateBond) as raised:
        pair.manager.add("a", lambda: None, 5.0)
    assert raised.value.bond_id == "a"
    effects = pair.manager.remove("a", 5.0)
    again = pair.manager.add("a", lambda: pair.broken.append("again"), 5.0)
    pair.carry(effects)
    pair.carry(again)
    assert pair.broken == [("A", "a")]
    pair.run(8.0)
    pair.add(pair.a, "a", "client again")
    pair.run(60.0)
    assert pair.broken == [("A", "a")]


# Bonds of claims: one for each id in a claim, under concurrent changes of claims


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
    monkeypatch.setattr(bonded, "Bonds", FakeBonds)
    monkeypatch.setattr(bonded.rospy, "get_name", lambda: "/manager")
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
