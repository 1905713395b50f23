# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Many bonds of one topic, two tables talking to each other on a clock of the test's."""

from __future__ import annotations

import pytest

from dyknow.ros.bonding.bond_states import BondTimings
from dyknow.ros.bonding.bond_table import BondTable, DuplicateBond

TIMINGS = BondTimings(
    connect_timeout=10.0,
    heartbeat_timeout=4.0,
    disconnect_timeout=2.0,
    heartbeat_period=1.0,
    dead_publish_period=0.5,
)


class Network:
    """Tables on one topic; delivers each message to all of them, including the sender."""

    def __init__(self, *tables):
        self.now = 0.0
        self.tables = list(tables)
        self.spoken = 0

    def carry(self, effects):
        for callback in effects.broken:
            callback()
        for word in effects.words:
            self.spoken += 1
            for table in self.tables:
                self.carry(table.hear(word.bond_id, word.instance_id, word.active, self.now))

    def run(self, until):
        """Let time pass from one due moment to the next."""
        while True:
            due = [t for t in (table.next_due() for table in self.tables) if t is not None]
            if not due or min(due) > until:
                self.now = until
                return
            self.now = max(self.now, min(due))
            for table in self.tables:
                effects = table.tick(self.now)
                self.carry(effects)
                self.carry(table.judge_silence(effects.silent, True, self.now))


@pytest.fixture
def broken():
    return []


@pytest.fixture
def pair(broken):
    """A manager with the bonds a and b, and a client of each."""
    tables = [BondTable(TIMINGS) for _ in range(3)]
    network = Network(*tables)
    for table, name, bond_ids in zip(tables, ("manager", "A", "B"), (("a", "b"), ("a",), ("b",))):
        for bond_id in bond_ids:
            network.carry(table.add(bond_id, lambda n=name, b=bond_id: broken.append((n, b)), 0.0))
    return network


def test_bonds_last(pair, broken):
    pair.run(60.0)
    assert broken == []
    assert [len(table) for table in pair.tables] == [2, 1, 1]


def test_all_bonds_of_a_table_share_a_heartbeat():
    table = BondTable(TIMINGS)
    for number in range(40):
        table.add(f"bond{number}", lambda: None, now=number * 0.01)
    assert table.next_due() == 1.0
    assert len(table.tick(1.0).words) == 40
    assert table.next_due() == 2.0


def test_a_client_that_parts_breaks_its_bond_only(pair, broken):
    pair.run(5.0)
    pair.carry(pair.tables[1].remove("a", 5.0))
    assert broken == [("manager", "a")]
    pair.run(60.0)
    assert broken == [("manager", "a")]
    assert [len(table) for table in pair.tables] == [1, 0, 1]


def test_a_killed_client_is_missed(pair, broken):
    pair.run(5.5)
    del pair.tables[1]
    pair.run(8.9)
    assert broken == []
    pair.run(9.0)
    assert broken == [("manager", "a")]


def test_a_client_that_never_comes_is_missed(broken):
    table = BondTable(TIMINGS)
    network = Network(table)
    network.carry(table.add("a", lambda: broken.append("a"), 0.0))
    network.run(9.9)
    assert broken == []
    network.run(10.0)
    assert broken == ["a"]
    assert len(table) == 0
    assert table.next_due() is None


def test_removing_tells_the_sister_alone(pair, broken):
    pair.run(5.0)
    pair.carry(pair.tables[0].remove("a", 5.0))
    assert broken == [("A", "a")]
    assert not pair.tables[0].is_parting()


def test_an_id_is_unique_while_its_bond_lives(pair):
    with pytest.raises(DuplicateBond) as raised:
        pair.tables[0].add("a", lambda: None, 1.0)
    assert raised.value.bond_id == "a"
    assert len(pair.tables[0]) == 2


def test_an_id_can_be_used_again_at_once(pair, broken):
    pair.run(5.0)
    manager, client = pair.tables[:2]
    effects = manager.remove("a", 5.0)
    again = manager.add("a", lambda: broken.append("again"), 5.0)
    pair.carry(effects)
    pair.carry(again)
    assert broken == [("A", "a")]
    pair.run(8.0)
    pair.carry(client.add("a", lambda: broken.append("client again"), 8.0))
    pair.run(60.0)
    assert broken == [("A", "a")]


def test_an_id_can_be_used_again_for_a_sister_who_does_not_listen(broken):
    table = BondTable(TIMINGS)
    network = Network(table)

    def beat():
        network.run(network.now + 1.0)
        network.carry(table.hear("a", "deaf", True, network.now))

    for _ in range(3):
        network.carry(table.add("a", lambda: broken.append("a"), network.now))
        beat()
        network.carry(table.remove("a", network.now))
    network.carry(table.add("a", lambda: broken.append("a"), network.now))
    for _ in range(30):
        beat()
    assert broken == []
    network.run(network.now + 5.0)
    assert broken == ["a"]


def test_removing_what_is_not_there_does_nothing(pair):
    assert not pair.tables[0].remove("nobody", 1.0)
    assert not pair.tables[0].hear("nobody", "x", True, 1.0)


def test_removing_all(pair, broken):
    pair.run(5.0)
    pair.carry(pair.tables[0].remove_all(5.0))
    assert broken == [("A", "a"), ("B", "b")]
    assert len(pair.tables[0]) == 0


def test_an_intruder_is_reported(pair):
    pair.run(5.0)
    effects = pair.tables[0].hear("a", "intruder", True, 5.0)
    assert effects.intruded == ["a"]
