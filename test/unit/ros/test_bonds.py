# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Bonds: one end, tables of several, those of nodelets and those of claims."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, List

import pytest
from clocks import in_thread, join, wait_for
from unit.nodelet.fakes import Idle, make_pool_world

from dyknow.model.streams import StreamRequest
from dyknow.nodelet.loading.loader import Loader
from dyknow.ros.bonding import bonded
from dyknow.ros.bonding.bond_table import BondTable, BondTimings, DuplicateBond
from dyknow.ros.bonding.bonded import BondedNodelets, ClaimBonds

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
        self.broken = []
        self.add(0.0)

    def add(self, now):
        (word,) = self.table.add("id", lambda: self.broken.append(now), now).announcements
        self.we = word.instance_id

    def hear(self, now, active=True, who="she"):
        return self._words(self.table.receive("id", who, active, now))

    def tick(self, now, silence_counts=True):
        return self._words(self.table.tick(now, silence_counts))

    def part(self, now):
        return self._words(self.table.remove("id", now))

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
            assert not bond.table._ends and bond.table.next_due() is None
            continue
        now, event, *expected = step.split()
        assert (events[event](float(now)) or "") == " ".join(expected), step
    assert len(bond.broken) == SCRIPTS[name].count("broken")


def test_heartbeats_keep_a_bond(bond):
    assert bond.hear(3.0) == "alive"
    assert bond.table.next_due() == 7.0
    for now in range(4, 30):
        assert bond.hear(float(now)) == ""
        assert bond.tick(now + 3.9) == ""
    assert bond.table.silent(32.9) == []
    assert bond.table.silent(33.0) == ["id"]


def test_a_sister_who_ignores_the_end_of_each_bond_has_the_next_one(bond):
    for now in (1.0, 2.0, 3.0):
        bond.hear(now, who="deaf")
        bond.part(now)
        bond.add(now)
    for second in range(3, 33):
        bond.hear(float(second), who="deaf")
        bond.tick(float(second))
    assert bond.broken == []
    assert bond.tick(32 + 4.0) == "dead broken"


def test_all_bonds_of_a_table_share_a_heartbeat_and_end_together():
    table = BondTable(replace(TIMINGS, heartbeat_period=1.0))
    for number in range(40):
        table.add(f"bond{number}", lambda: None, now=number * 0.01)
    assert table.next_due() == 1.0
    assert len(table.tick(1.0).announcements) == 40
    assert table.next_due() == 2.0
    assert not table.is_parting()
    assert not any(each.active for each in table.remove_all(1.0).announcements)
    assert table.is_parting()
    assert table.next_due() == 1.5


def test_an_id_is_unique_while_its_bond_lives_and_can_be_used_again_at_once(bond):
    bond.hear(1.0)
    with pytest.raises(DuplicateBond) as raised:
        bond.add(5.0)
    assert raised.value.bond_id == "id"
    bond.part(5.0)
    bond.add(5.0)
    assert not bond.table.is_parting()
    assert not bond.table.remove("unknown", 5.0)
    assert not bond.table.receive("unknown", "x", True, 5.0)


# Bonds of claims: one for each id in a claim, under concurrent changes of claims


class FakeBonds:
    """Bonds that a test breaks; broken ones can be reported later, and adding one held up."""

    def __init__(self, topic="", clock=None):
        self.living = {}
        self.adding, self.go_on = threading.Event(), threading.Event()
        self.go_on.set()
        self.close = self.living.clear

    def add(self, bond_id, on_broken):
        self.adding.set()
        wait_for(self.go_on)
        if bond_id in self.living:
            raise DuplicateBond(bond_id)
        self.living[bond_id] = on_broken

    def remove(self, bond_id):
        self.living.pop(bond_id, None)


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
        return {*self.fake.living}


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
    assert not table.fake.living


# Bonds of nodelets: each is that of one nodelet, and not of the next one under its name


class Place:
    """A loader of nodelets with bonds."""

    def __init__(self, runtime):
        self.loader = Loader(runtime, lambda name, _: Idle, on_unloaded=self.unloaded)
        self.bonds: Any = FakeBonds()
        self.bonded = BondedNodelets(
            self.bonds, lambda context: self.loader.unload(context.name, context)
        )
        self.meanwhile = lambda: None

    def unloaded(self, context):
        meanwhile, self.meanwhile = self.meanwhile, lambda: None
        meanwhile()
        self.bonded.ended(context)

    def load(self):
        return self.loader.load("/n", "idle").context

    def load_bonded(self, bond_id):
        self.bonded.add(self.load(), bond_id)


@pytest.fixture
def place():
    world = make_pool_world(1)
    yield Place(world.runtime)
    world.close()


def test_a_broken_bond_unloads_and_an_unload_breaks_the_bond(place):
    place.load_bonded("one")
    place.bonds.living.pop("one")()
    assert place.loader.list() == []
    place.load_bonded("two")
    place.loader.unload("/n")
    assert not place.bonds.living
    place.bonded.wait(10.0)  # returns at once


def test_a_nodelet_that_cannot_be_bonded_is_unloaded(place):
    place.bonds.add("one", None)
    with pytest.raises(DuplicateBond):
        place.load_bonded("one")
    assert place.loader.list() == []


def test_the_end_of_one_leaves_the_bond_of_the_next_alone(place):
    place.load_bonded("first")
    place.meanwhile = lambda: place.load_bonded("second")
    place.loader.unload("/n")
    assert list(place.bonds.living) == ["second"]
    place.bonds.living.pop("second")()
    assert place.loader.list() == []


def test_a_bond_that_breaks_late_leaves_the_next_one_alone(place):
    place.load_bonded("first")
    broken = place.bonds.living["first"]
    place.loader.unload("/n")
    place.load_bonded("second")
    broken()
    assert place.loader.list() == ["/n"]


def test_one_that_is_gone_before_it_is_bonded_leaves_the_next_one_alone(place):
    first = place.load()
    place.loader.unload("/n")
    place.load_bonded("second")
    place.bonded.add(first, "first")
    assert list(place.bonds.living) == ["second"]
