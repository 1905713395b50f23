# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers on unreachable hosts: nothing unknown is stated, and work is done later."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Callable

import pytest
from unit.manager.world import World

from dyknow.errors import HostError, HostTimeout
from dyknow.model.graph import State

FAR = "/far"


@pytest.fixture
def world(tmp_path: Path) -> World:
    world = World(str(tmp_path / "state.db"))
    world.host.add(FAR)
    world.spawn("camera", "/a", manager=FAR)
    return world


def test_it_is_known_where_a_nodelet_runs(world: World) -> None:
    process = world.host.processes[FAR]
    process.state = replace(process.state, host="rover")
    world.spawn("camera", "/b", manager=FAR)
    process.nodelets["/theirs"] = process.nodelets["/b"]
    world.manager.look()

    def hosts() -> dict[str, str]:
        return {each.name: each.host for each in world.manager.graph_model().nodelets}

    assert hosts() == {"/a": "", "/b": "rover", "/theirs": "rover"}
    world.host.cut(FAR)
    world.kill_manager()
    assert hosts() == {"/a": "", "/b": "rover"}


def kill_manager(world: World) -> None:
    world.host.cut(FAR, known=False)
    world.kill_manager()


def kill_process(world: World) -> None:
    world.host.kill(FAR)
    world.host.add(FAR)
    world.host.cut(FAR)


def refuse(world: World) -> None:
    world.host.mend(FAR)
    world.host.fail_at("unload", error="not now")
    world.manager.look()
    world.host.recover()
    world.host.cut(FAR)


@pytest.mark.parametrize(
    "happens",
    [World.states, World.open, kill_manager, kill_process, refuse],
    ids=lambda f: f.__name__,
)
def test_a_destroy_that_nobody_can_verify_is_refused_and_made_good(
    world: World, happens: Callable[[World], object]
) -> None:
    world.host.cut(FAR)
    with pytest.raises(HostTimeout, match="'/a' is not destroyed yet: .* as soon as /far answers"):
        world.manager.destroy("/a")
    world.manager.look()
    happens(world)
    assert world.states() == {"/a": "LOST"}
    assert "as soon as /far answers" in world.manager.graph.get("/a").detail
    world.host.mend(FAR)
    before = len(world.host.calls)
    for _ in range(2):
        world.manager.look()
        assert (world.states(), world.host.running) == ({}, [])
    calls = world.host.calls[before:]
    assert [call for call in calls if call[0] in ("load", "unload")] == [("unload", "/a")]


def test_what_is_certainly_gone_is_destroyed_at_once(world: World) -> None:
    world.host.kill(FAR)
    world.manager.destroy("/a")
    assert world.states() == {}


def test_what_nobody_has_looked_for_yet_is_taken_to_be_as_it_was(world: World) -> None:
    world.host.cut(FAR, known=False, unseen=True)
    world.kill_manager()
    assert world.states() == {"/a": "RUNNING"}
    world.host.cut(FAR, known=False)
    world.manager.look()
    assert world.manager.graph.get("/a").state is State.LOST
    world.host.mend(FAR)
    world.manager.look()
    assert world.states() == {"/a": "RUNNING"}


def test_a_nodelet_manager_that_is_away_is_said_to_be(world: World) -> None:
    world.host.cut(FAR, known=False)
    with pytest.raises(HostError, match="'/far' does not answer"):
        world.spawn("camera", "/b", manager=FAR)
