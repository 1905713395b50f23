# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Hosts: nodelets that are pinned to one, the choice of one, and those that come and go."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from clocks import HandClock
from unit.manager.field import Field
from unit.manager.world import World

from dyknow.errors import DyKnowError
from dyknow.manager.record import Record
from dyknow.manager.supervision.hosts import HostTable
from dyknow.model.graph import NodeletKind
from dyknow.model.hosts import ClockOffset, HostStatus, Machine, pins
from dyknow.simulated.host import FakeHost

ROVER, SCOUT = "/rover_manager", "/scout_manager"


def equip(host: FakeHost) -> None:
    """Let there be a desk with the manager, a rover and a scout."""
    host.machine = "desk"
    host.add(ROVER, machine="rover")
    host.add(SCOUT, machine="scout")


@pytest.fixture
def world(tmp_path: Path) -> World:
    world = World(str(tmp_path / "state.db"))
    equip(world.host)
    world.manager.look()
    return world


def host_of(world: World, name: str) -> str:
    return str(world.manager.graph.get(name).host)


def hosts(world: World) -> dict[str, HostStatus]:
    return {each.name: each for each in world.manager.hosts()}


# Pinned


def test_a_spawn_may_name_a_host(world: World) -> None:
    for name in ("rover", "scout", "desk"):
        world.spawn("camera", f"/on_{name}", manager=f"@{name}", isolated=name == "desk")
        assert host_of(world, f"/on_{name}") == name
    world.spawn("relay", "/free", config={"in": "/x"})
    assert pins(world.manager.hosts()) == {f"/on_{n}": n for n in ("desk", "rover", "scout")}
    world.kill_manager()
    assert pins(world.manager.hosts()) == {f"/on_{n}": n for n in ("desk", "rover", "scout")}
    assert Record.from_body("/a", world.manager.graph.get("/free").body()).pinned == ""


def test_another_nodelet_manager_of_its_host_takes_what_is_pinned(world: World) -> None:
    world.spawn("camera", "/a", manager="@rover")
    world.host.kill(ROVER)
    world.host.add("/rover_spare", machine="rover")
    assert world.manager.restart("/a").names == ("/a",)
    record = world.manager.graph.get("/a")
    assert (record.manager, record.host, record.pinned) == ("/rover_spare", "rover", "rover")


@pytest.mark.parametrize(
    ("place", "isolated", "label", "why"),
    [
        ("@rovr", False, "camera", "unknown host 'rovr'; known: desk, rover, scout"),
        ("@scout", False, "camera", "host 'scout' does not answer"),
        ("@rover", False, "native", "no nodelet manager on host 'rover' hosts C.. nodelets"),
        ("@rover", True, "camera", "a process of its own, which is started on host 'desk' alone"),
    ],
)
def test_what_a_host_cannot_run_is_refused(
    world: World, place: str, isolated: bool, label: str, why: str
) -> None:
    world.host.cut(SCOUT)
    world.manager.look()
    with pytest.raises(DyKnowError, match=why):
        world.spawn(label, "/a", manager=place, isolated=isolated)
    assert world.states() == {}


# Free


def test_a_host_with_a_stock_nodelet_manager_alone_says_so(world: World) -> None:
    world.host.add("/stock", NodeletKind.CPP, "rover")
    process = world.host.processes["/stock"]
    process.state = replace(process.state, rewirable=False)
    world.manager.look()
    with pytest.raises(DyKnowError, match="for C.. nodelets have no live ports"):
        world.spawn("native", "/a", manager="@rover")


def spawned_on(world: World, topic: str, name: str = "/r") -> str:
    world.spawn("relay", name, config={"in": topic})
    place = host_of(world, name)
    world.manager.destroy(name)
    return place


def test_a_nodelet_is_placed_near_its_sources(world: World) -> None:
    world.spawn("camera", "/c", config={"image": "/raw"}, manager="@rover")
    assert spawned_on(world, "/raw") == "rover"
    world.host.run_node("/driver", "pkg/Camera", {"image": "/driven"}, NodeletKind.NODE)
    process = world.host.processes["/driver"]
    process.state = replace(process.state, host="scout")
    world.manager.look()
    assert spawned_on(world, "/driven") == "scout"
    world.host.publishing["/ordinary"] = "scout"
    assert spawned_on(world, "/ordinary") == "scout"


def test_a_nodelet_without_neighbours_goes_where_there_is_least(world: World) -> None:
    world.spawn("camera", "/one", manager="@rover")
    assert spawned_on(world, "/x") == "scout"
    busy = Machine(4, 1.5, 0.2)
    process = world.host.processes[SCOUT]
    process.state = replace(process.state, machine=busy)
    assert spawned_on(world, "/x") == "rover"


# Away, and back


class Flapping:
    """A table of hosts, one of which comes and goes."""

    def __init__(self) -> None:
        self.clock = HandClock()
        self.host = FakeHost({}, self.clock.now)
        equip(self.host)
        self.table = HostTable(self.host, self.clock.now)
        self.look()

    def look(self) -> None:
        self.table.look(self.host.states())

    def status(self) -> HostStatus:
        return {each.name: each for each in self.table.all([])}["rover"]

    def absence(self, seconds: float = 3.0) -> float:
        """Be away for some seconds; returns for how long it is left alone then (s)."""
        self.host.cut(ROVER)
        self.look()
        self.clock.time += seconds
        assert self.status().is_away and self.status().lasts == seconds
        self.host.mend(ROVER)
        self.look()
        assert not self.status().is_away
        return self.status().pause


def test_a_host_that_flaps_is_left_alone_for_a_growing_time() -> None:
    life = Flapping()
    pauses = [life.absence() for _ in range(9)]
    assert pauses == [0.0, 15.0, 30.0, 60.0, 120.0, 240.0, 480.0, 600.0, 600.0]
    assert life.table.paused == {"rover"}
    for seconds, paused in ((599.0, {"rover"}), (1.0, set())):
        life.clock.time += seconds
        life.look()
        assert life.table.paused == paused
    assert life.absence() == 0.0, "it was there for long enough"


def test_a_host_is_not_away_while_it_may_publish() -> None:
    life = Flapping()
    life.host.leased.add(ROVER)
    life.host.cut(ROVER)
    life.look()
    assert not life.status().is_away
    life.host.leased.clear()
    life.look()
    assert life.status().is_away


def test_a_host_whose_nodelet_manager_ended_is_remembered() -> None:
    life = Flapping()
    life.host.kill(ROVER)
    process = life.host.processes[ROVER]
    process.state = replace(process.state, host="", responsive=False)
    life.look()
    assert (life.status().is_away, life.status().managers) == (True, ())


def test_the_surest_clock_of_a_host_counts() -> None:
    life = Flapping()
    life.host.add("/second", machine="rover")
    for name, clock in ((ROVER, ClockOffset(0.3, 0.2)), ("/second", ClockOffset(0.21, 0.01))):
        process = life.host.processes[name]
        process.state = replace(process.state, clock=clock, machine=Machine(2, 0.5, 0.25))
    life.look()
    found = life.status()
    assert (found.clock, found.cores, found.load) == (ClockOffset(0.21, 0.01), 2, 0.5)
    assert found.clock.exceeds(0.19) and not found.clock.exceeds(0.2)
    assert not ClockOffset().exceeds(0.0)


def test_a_paused_host_is_used_where_there_is_no_other(world: World) -> None:
    world.host.fail_at("ensure", error="no process can be started")
    world.host.cut(SCOUT)
    for _ in range(3):
        world.host.cut(ROVER)
        world.manager.look()
        world.host.mend(ROVER)
        world.manager.look()
    assert world.manager.lifecycle.hosts.paused == {"rover"}
    assert spawned_on(world, "/x") == "rover"
    world.host.mend(SCOUT)
    assert spawned_on(world, "/x") == "scout"


# Claims


def test_new_parts_of_a_claim_leave_a_host_that_flaps(field: Field) -> None:
    equip(field.host)
    field.settle()
    field.spawn("detector", "/busy", manager="@scout")
    places = []
    for _ in range(3):
        claim_id = field.acquire("YUV(field)").claim.claim_id
        (name,) = field.claim(claim_id).nodelets
        places.append(field.manager.graph.get(name).host)
        field.reconciler.release(claim_id)
        field.tidy()
        field.host.cut(ROVER)
        field.tick()
        field.host.mend(ROVER)
        field.tick()
    assert places == ["rover", "rover", "scout"]
