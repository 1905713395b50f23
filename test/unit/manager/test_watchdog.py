# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The watchdog restarts processes beyond a limit: one at a time, ours alone, reported once."""

from __future__ import annotations

import pytest
from clocks import HandClock
from unit.manager.world import RELAY, World

from dyknow.errors import Denied, HostTimeout
from dyknow.guards import Guards
from dyknow.manager.supervision.watchdog import Watchdog, WatchdogLimits
from dyknow.model.graph import STUCK

LIMITS = WatchdogLimits(hung=10.0, stuck=20.0, memory=500.0)


class Watched:
    """A world with two nodelets in one nodelet manager, an isolated one, and a watchdog."""

    def __init__(self, limits=LIMITS):
        self.clock = HandClock()
        self.world = World(clock=self.clock)
        self.host = self.world.host
        for name in ("/a", "/b"):
            self.world.spawn("camera", name)
        self.world.spawn("camera", "/c", isolated=True)
        manager = self.world.manager
        self.shared = manager.graph.get("/a").manager
        self.alone = manager.graph.get("/c").manager
        self.told = []
        self.restarted = []

        def restart(name):
            self.restarted.append(name)
            manager.renew(name)

        self.watchdog = Watchdog(
            self.host, manager.graph, restart, limits, self.told.append, self.clock.now
        )

    def pass_time(self, seconds):
        for _ in range(int(seconds)):
            self.clock.time += 1.0
            self.world.manager.look()
            self.watchdog.look()

    def incarnation(self, name):
        return self.host.states()[name].incarnation

    @property
    def all_run(self):
        return set(self.world.states().values()) == {"RUNNING"}


@pytest.fixture
def watched():
    return Watched()


def take_less_than_the_limit(watched):
    watched.host.taken = {watched.shared: 499_000_000}
    watched.pass_time(100)


def answer_again_in_time(watched):
    for _ in range(3):
        watched.host.hang(watched.shared)
        watched.pass_time(9)
        watched.host.wake(watched.shared)
        watched.pass_time(1)


def be_external(watched):
    for name, is_foreign in (("/external", False), ("/theirs", True)):
        watched.host.add(name, foreign=is_foreign)
        watched.host.taken[name] = 10**9
    watched.host.hang("/external")
    watched.pass_time(60)


@pytest.mark.parametrize("do", [take_less_than_the_limit, answer_again_in_time, be_external])
def test_what_is_well_or_external_is_left_alone(watched, do):
    do(watched)
    assert watched.restarted == watched.told == []


def test_a_nodelet_manager_that_hangs_is_restarted_with_its_nodelets(watched):
    before = watched.incarnation(watched.shared)
    watched.host.hang(watched.shared)
    watched.pass_time(9)
    assert watched.restarted == []
    watched.pass_time(5)
    assert watched.restarted == [watched.shared]
    assert watched.told == [
        f"the watchdog restarts {watched.shared}: it has not answered for 10 s"
    ]
    assert watched.incarnation(watched.shared) != before
    assert watched.all_run


def test_a_callback_that_does_not_return_ends_with_its_process(watched):
    watched.host.details["/c"] = f"{STUCK}12 s"
    watched.pass_time(19)
    assert watched.restarted == []
    watched.pass_time(3)
    assert watched.restarted == [watched.alone]
    assert f"{watched.alone}: /c: {STUCK}12 s" in watched.told[0]


def test_a_process_that_grows_is_restarted_and_then_has_a_pause(watched):
    watched.host.taken = {watched.shared: 501_000_000}
    watched.pass_time(1)
    why = "it takes 501 MB of memory; expected at most 500 MB"
    assert watched.told == [f"the watchdog restarts {watched.shared}: {why}"]
    watched.pass_time(29)
    assert len(watched.restarted) == 1
    watched.pass_time(2)
    assert len(watched.restarted) == 2
    watched.pass_time(55)
    assert len(watched.restarted) == 2
    assert watched.all_run


def test_one_at_a_time(watched):
    watched.host.taken = dict.fromkeys((watched.shared, watched.alone), 10**9)
    watched.clock.time += 1.0
    watched.watchdog.look()
    assert len(watched.restarted) == 1
    watched.watchdog.look()
    assert sorted(watched.restarted) == sorted((watched.shared, watched.alone))


def test_what_cannot_be_restarted_is_logged_and_tried_later(watched, caplog):
    watched.host.taken = {watched.shared: 10**9}
    watched.host.fail_at("renew", watched.shared)
    watched.pass_time(5)
    assert len(watched.restarted) == 1
    assert f"could not restart {watched.shared}: it is broken" in caplog.text


@pytest.mark.parametrize("limits", [WatchdogLimits(hung=10.0), WatchdogLimits(memory=500.0)])
def test_a_limit_of_zero_is_none(limits):
    watched = Watched(limits)
    watched.host.details["/c"] = f"{STUCK}12 s"
    watched.host.taken = {} if limits.memory else {watched.shared: 10**9}
    if limits.memory:
        watched.host.hang(watched.shared)
    watched.pass_time(60)
    assert watched.restarted == []
    assert not WatchdogLimits()


def test_a_nodelet_that_was_to_be_destroyed_does_not_keep_a_hung_process(watched):
    watched.host.hang(watched.shared)
    watched.pass_time(3)
    with pytest.raises(HostTimeout):
        watched.world.manager.destroy("/a")
    watched.pass_time(20)
    assert watched.restarted == [watched.shared]
    assert watched.world.states() == {"/b": "RUNNING", "/c": "RUNNING"}


def test_a_read_only_manager_has_a_watchdog(tmp_path):
    clock = HandClock()
    world = World(str(tmp_path / "state"), clock=clock)
    world.spawn("camera", "/a")
    world.guards = Guards(read_only=True)
    world.open()
    manager = world.manager
    watchdog = Watchdog(world.host, manager.graph, manager.renew, LIMITS, list, clock.now)
    world.host.hang(manager.graph.get("/a").manager)
    for _ in range(20):
        clock.time += 1.0
        manager.look()
        watchdog.look()
    assert world.states() == {"/a": "RUNNING"}
    with pytest.raises(Denied, match="read-only"):
        manager.restart("/a")


@pytest.mark.parametrize("fault", ["code", "type"])
def test_a_nodelet_that_could_not_be_made_today_holds_up_no_neighbours(watched, fault):
    world, host = watched.world, watched.host
    world.spawn("relay", "/r")
    if fault == "code":
        host.broken.add("pkg/Relay")
    else:
        world.manager.add_transformation(RELAY.replace("pkg/Relay", "pkg/Unknown"))
    before = watched.incarnation(watched.shared)
    host.hang(watched.shared)
    watched.pass_time(60)
    assert watched.incarnation(watched.shared) != before
    assert {world.states()[name] for name in ("/a", "/b")} == {"RUNNING"}
