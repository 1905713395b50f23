# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Busy nodelets are moved apart: the right one, one at a time, and never back."""

from __future__ import annotations

import logging
from dataclasses import replace

import pytest
from clocks import HandClock
from hypothesis import given
from hypothesis import strategies as st
from unit.manager.world import World

from dyknow.errors import HostTimeout
from dyknow.manager.host import Usage
from dyknow.manager.supervision.spread import WINDOW, Spread
from dyknow.model.graph import NodeletKind

LIMIT = 0.7


class Robot:
    """A world with nodelet managers, and nodelets that want parts of a core."""

    def __init__(self, managers=2, most=2, path=":memory:", **wanted):
        self.clock = HandClock()
        self.world = World(str(path), clock=self.clock)
        self.host, self.manager = self.world.host, self.world.manager
        self.host.ensure(NodeletKind.PYTHON)
        while len(self.host.processes) < managers:
            self.host.widen(NodeletKind.PYTHON)
        self.first, *self.others = sorted(self.host.processes)
        #: Cores by nodelet.
        self.wanted = {}
        self.told = []
        #: Whether they take processor time.
        self.computes = True
        #: Where each nodelet was, in order.
        self.ways = {}
        for name, cores in wanted.items():
            self.spawn(f"/{name}", cores)
        graph = self.manager.graph
        self.spread = Spread(
            self.host, graph, self.manager.move, self.told.append, LIMIT, most, self.clock.now
        )

    def spawn(self, name, cores, label="relay", **options):
        self.wanted[name] = cores
        place = "" if options.get("isolated") else self.first
        self.world.spawn(label, name, manager=place, **options)
        self.follow()

    def run(self, seconds):
        for _ in range(round(seconds)):
            self.clock.time += 1.0
            self.use(1.0)
            self.world.manager.look()
            before = self.places()
            self.spread.look()
            assert len(self.places().items() - before.items()) <= 1
            self.follow()

    def use(self, seconds):
        """Let time pass in which one interpreter runs one nodelet at a time."""
        for manager, process in self.host.processes.items():
            wants = {name: self.wanted[name] for name in process.nodelets}
            total = sum(wants.values())
            slower = max(1.0, total)
            known = self.host.used.get(manager, Usage(0.0, 0.01, {}))
            busy = {
                name: known.busy.get(name, 0.0) + min(1.0, want * slower) * seconds
                for name, want in wants.items()
            }
            cpu = known.cpu + min(1.0, total) * seconds * self.computes
            self.host.used[manager] = Usage(self.clock.time, cpu, busy)

    def places(self):
        return {n: m for m, process in self.host.processes.items() for n in process.nodelets}

    def follow(self):
        for name, place in self.places().items():
            way = self.ways.setdefault(name, [])
            if way[-1:] != [place]:
                way.append(place)


def test_one_of_two_that_share_a_core_moves_and_then_both_stay():
    robot = Robot(a=0.8, b=0.8, c=0.05)
    robot.run(WINDOW)
    assert robot.told == []
    robot.run(1.0)
    (second,) = robot.others
    assert robot.places() == {"/a": second, "/b": robot.first, "/c": robot.first}
    text = f"/a is moved from {robot.first} to {second}: it takes "
    assert robot.told == [f"{text}0.48 of the 1.00 cores that {robot.first} takes"]
    robot.run(600)
    assert len(robot.told) == 1
    assert set(robot.world.states().values()) == {"RUNNING"}


def only_wait(robot):
    robot.computes = False


def be_elsewhere(robot):
    process = robot.host.processes[robot.others[0]]
    process.state = replace(process.state, host="elsewhere")


def not_answer(robot):
    robot.host.hang(robot.others[0])


def do_nothing(robot):
    pass


@pytest.mark.parametrize(
    ("managers", "wanted", "happens"),
    [
        (2, {"a": 0.3, "b": 0.3}, do_nothing),  # below the limit
        (2, {"a": 1.0}, do_nothing),  # alone
        (2, {"a": 0.95, "b": 0.05}, do_nothing),  # nothing to gain
        (1, {"a": 0.95, "b": 0.05}, do_nothing),  # by another nodelet manager either
        (2, {"a": 0.9, "b": 0.9}, only_wait),
        (2, {"a": 0.8, "b": 0.8}, be_elsewhere),
        (2, {"a": 0.8, "b": 0.8}, not_answer),
    ],
)
def test_what_would_gain_nothing_stays(managers, wanted, happens):
    robot = Robot(managers, **wanted)
    happens(robot)
    robot.run(300)
    assert robot.told == []
    assert len(robot.host.processes) == managers


@pytest.mark.parametrize("protected", [True, False])
def test_what_may_not_move_stays(protected):
    robot = Robot()
    robot.spawn("/isolated", 0.9, isolated=True)
    robot.spawn("/a", 0.9, is_protected=protected)
    robot.spawn("/b", 0.9, is_protected=protected)
    robot.host.processes[robot.first].nodelets["/theirs"] = replace(
        robot.host.nodelet("/a"), ports={}
    )
    robot.wanted["/theirs"] = 0.9
    robot.run(60)
    moved = [name for name, way in robot.ways.items() if len(way) > 1]
    assert moved == ([] if protected else ["/a"])


def test_one_whose_code_has_changed_stays_as_it_is():
    robot = Robot(b=0.8)
    robot.host.code["pkg/Camera"] = "old"
    robot.spawn("/a", 0.8, label="camera")
    robot.host.code["pkg/Camera"] = "new"
    robot.run(60)
    assert [name for name, way in robot.ways.items() if len(way) > 1] == ["/b"]


def test_nodelet_managers_are_started_up_to_the_number_of_cores():
    robot = Robot(managers=1, most=3, a=0.9, b=0.9, c=0.9, d=0.9)
    robot.run(300)
    assert len(robot.host.processes) == 3
    assert sorted(len(p.nodelets) for p in robot.host.processes.values()) == [1, 1, 2]


@pytest.mark.parametrize("step", ["note", "park", "give"])
def test_one_that_cannot_move_runs_on_and_is_tried_after_a_pause_that_doubles(step, caplog):
    caplog.set_level(logging.INFO)
    robot = Robot(a=0.8, b=0.8)
    robot.host.fail_at(step)
    for seconds, attempts in ((20, 2), (60, 4), (60, 4), (60, 6), (180, 6)):
        robot.run(seconds)
        assert caplog.text.count(" is moved from ") == attempts
        assert robot.told == []
        assert robot.world.states() == {"/a": "RUNNING", "/b": "RUNNING"}
    assert "'/a' is not moved: it is broken" in caplog.text
    assert set(robot.places().values()) == {robot.first}
    robot.host.recover()
    robot.run(120)
    assert set(robot.places().values()) == {robot.first, *robot.others}


@pytest.mark.parametrize("step", ["load", "connect"])
def test_one_that_does_not_come_up_is_back_where_it_was(step, caplog):
    robot = Robot(a=0.8, b=0.8)
    fails = iter([True])

    def fail(operation, argument):
        if operation == step and argument == "/a" and next(fails, False):
            raise HostTimeout("no answer")

    robot.manager.connect([("/a", {"in": "/images"})])
    robot.host.fail = fail
    robot.run(WINDOW + 1)
    assert "'/a' did not come up in" in caplog.text
    assert "it runs where it was again" in caplog.text
    assert robot.places()["/a"] == robot.first
    assert robot.world.states() == {"/a": "RUNNING", "/b": "RUNNING"}
    assert robot.host.nodelet("/a").ports["in"].topic == "/images"


@pytest.mark.parametrize("step", ["give", "load"])
def test_a_manager_that_is_killed_in_the_middle_brings_it_back(step, tmp_path):
    robot = Robot(path=tmp_path / "state", a=0.8, b=0.8)

    def fail(operation, argument):
        if operation == step and argument.startswith("/a"):
            raise KeyboardInterrupt

    robot.host.fail = fail
    with pytest.raises(KeyboardInterrupt):
        robot.run(WINDOW + 1)
    robot.host.recover()
    robot.world.kill_manager()
    robot.world.manager.look()
    assert robot.host.running == ["/a", "/b"]
    assert robot.world.states() == {"/a": "RUNNING", "/b": "RUNNING"}


LOADS = st.lists(st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5), min_size=1, max_size=12)


@given(loads=LOADS, managers=st.integers(1, 3))
def test_none_ever_goes_back_whatever_the_loads_do(loads, managers):
    names = [f"/n{number}" for number in range(5)]
    robot = Robot(managers, 3, **{name[1:]: 0.0 for name in names})
    for load in loads:
        robot.wanted.update(zip(names, load))
        robot.run(40)
    assert len(robot.host.processes) <= max(managers, 3)
    for way in robot.ways.values():
        assert len(way) == len(set(way))
    assert len(robot.told) == sum(len(way) - 1 for way in robot.ways.values())
    assert set(robot.world.states().values()) == {"RUNNING"}
