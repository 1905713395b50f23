# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Bonds on a clock of the test's: one of them, and many in tables that are connected."""

from __future__ import annotations

import pytest

from dyknow.ros.bonding.bond_table import BondTable, BondTimings, DuplicateBond

TIMINGS = BondTimings(
    connect_timeout=10.0,
    heartbeat_timeout=4.0,
    disconnect_timeout=2.0,
    heartbeat_period=1000.0,  # except where a test is about heartbeats
    dead_publish_period=0.5,
)


class OneBond:
    """A table with the bond "id"; each event returns what it brings about, in words."""

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


@pytest.fixture
def formed(bond):
    bond.hear(1.0)
    return bond


def test_the_first_heartbeat_forms_the_bond_and_is_answered_at_once(bond):
    assert bond.hear(3.0) == "alive"
    assert bond.table.next_due() == 7.0
    for now in range(4, 30):
        assert bond.hear(float(now)) == ""
        assert bond.tick(now + 3.9) == ""
    assert not bond.is_over()


def test_a_sister_that_never_comes_breaks_the_bond(bond):
    assert bond.tick(9.9) == ""
    assert bond.tick(10.0) == "dead broken"
    assert bond.is_over()
    assert bond.table.next_due() is None
    assert bond.tick(99.0) == ""


def test_silence_counts_from_the_first_heartbeat(formed):
    assert formed.tick(4.9) == ""
    assert formed.table.silent(4.9) == []
    assert formed.table.silent(5.0) == ["id"]
    assert formed.tick(5.1) == "dead broken"
    assert formed.is_over()


def test_silence_that_does_not_count_is_measured_again(formed):
    assert formed.tick(5.5, silence_counts=False) == ""
    assert formed.table.silent(9.4) == []
    assert formed.table.silent(9.5) == ["id"]


def test_silence_is_left_for_a_later_decision_and_may_end_before(formed):
    assert formed.tick(5.0, silence_counts=None) == ""
    assert formed.table.silent(5.0) == ["id"]
    formed.hear(5.1)
    assert formed.tick(5.2) == ""
    assert not formed.is_over()


def test_parting_before_silence_is_judged_stays_on_purpose(formed):
    assert formed.table.silent(5.0) == ["id"]
    assert formed.part(5.1) == "dead"
    assert formed.tick(5.2) == ""
    assert formed.broken == 0


@pytest.mark.parametrize("heard_before", [True, False])
def test_the_sisters_death_is_acknowledged_each_time_and_reported_once(bond, heard_before):
    if heard_before:
        bond.hear(1.0)
    assert bond.hear(2.0, active=False) == "dead broken"
    assert bond.hear(2.1, active=False) == "dead"
    assert bond.hear(2.2) == ""  # she does not come back
    assert not bond.is_over()
    assert bond.tick(4.0) == ""
    assert bond.is_over()
    assert bond.hear(4.1, active=False) == ""


@pytest.mark.parametrize("heard_before", [True, False])
def test_parting_is_repeated_until_the_sister_acknowledges(bond, heard_before):
    if heard_before:
        bond.hear(1.0)
    assert bond.part(2.0) == "dead"
    assert bond.table.is_parting()
    assert bond.part(2.1) == ""
    assert bond.tick(2.4) == ""
    assert bond.tick(2.5) == "dead"
    assert bond.hear(2.6) == ""
    assert bond.hear(2.7, active=False) == ""
    assert bond.is_over()
    assert bond.part(2.8) == ""
    assert bond.broken == 0


def test_parting_without_acknowledgement_ends_too(formed):
    formed.part(2.0)
    assert [formed.tick(now) for now in (2.5, 3.0, 3.5, 4.0)] == ["dead", "dead", "dead", ""]
    assert formed.is_over()


def test_messages_of_our_own_and_of_third_parties_change_nothing(bond):
    assert bond.hear(1.0, active=False, who=bond.we) == ""
    bond.hear(1.0)
    assert bond.hear(2.0, active=False, who="intruder") == "id"
    assert bond.table.next_due() == 5.0


def test_answers_to_the_end_of_an_earlier_bond_do_not_count(formed):
    formed.part(2.0)
    before = formed.we
    formed.add(2.0)
    assert formed.hear(2.1) == ""
    assert formed.hear(2.1, active=False) == ""
    assert formed.hear(2.1, active=False, who=before) == ""
    assert formed.hear(2.2, who="she again") == "alive"
    assert formed.hear(5.0, active=False) == ""
    assert formed.hear(5.0, who=before) == ""


def test_a_sister_of_an_earlier_bond_who_lives_on_is_taken_up_again(formed):
    formed.part(2.0)
    formed.add(2.5)
    assert formed.hear(4.4) == ""
    assert formed.hear(4.5, active=False) == ""
    assert formed.hear(4.5) == "alive"
    assert formed.hear(5.0, active=False) == "dead broken"


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


def test_bonds_last(pair):
    pair.run(60.0)
    assert pair.broken == []
    assert list(map(len, pair.tables)) == [2, 1, 1]


def test_all_bonds_of_a_table_share_a_heartbeat():
    table = Network().manager
    for number in range(40):
        table.add(f"bond{number}", lambda: None, now=number * 0.01)
    assert table.next_due() == 1.0
    assert len(table.tick(1.0).announcements) == 42
    assert table.next_due() == 2.0


def test_a_client_that_parts_breaks_its_bond_only(pair):
    pair.run(5.0)
    pair.remove(pair.a, "a")
    assert pair.broken == [("manager", "a")]
    pair.run(60.0)
    assert pair.broken == [("manager", "a")]
    assert list(map(len, pair.tables)) == [1, 0, 1]


def test_a_killed_client_is_missed(pair):
    pair.run(5.5)
    pair.tables.remove(pair.a)
    pair.run(8.9)
    assert pair.broken == []
    pair.run(9.0)
    assert pair.broken == [("manager", "a")]


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
