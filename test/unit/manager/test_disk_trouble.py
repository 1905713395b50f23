# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A manager whose disk is full: it goes on, and shows the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Iterator

import pytest
from clocks import HandClock
from faulty_disk import full, small_disk
from unit.manager.world import World

from dyknow.errors import HostError, NameTaken, SpawnFailed
from dyknow.manager.record import Record


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    with small_disk(tmp_path / "disk") as disk:
        yield disk


def written(world: World) -> dict[str, str]:
    """The states in the file once the disk has room again."""
    world.store.close()
    assert world.store.trouble == ""
    world.open()
    assert world.store.complaint == ""
    found = world.store.read("nodelets", Record.from_body)
    return {name: record.state.name for name, record in found.items()}


def test_a_manager_goes_on_while_its_disk_is_full(disk: Path) -> None:
    world = World(str(disk / "state"))
    world.spawn("camera", "a", config={"image": "/i"})
    world.spawn("relay", "b", config={"in": "/i"}, isolated=True)
    with full(disk):
        world.spawn("relay", "c", config={"in": "/i"})
        while not world.store.trouble:  # there may be room for a few more
            world.manager.set_protection("c", not world.manager.graph.get("/c").is_protected)
        assert "disk is full" in world.store.remark

        world.manager.set_protection("c", False)
        world.manager.destroy("c")
        world.manager.destroy("b")
        assert world.host.running == ["/a"]
        assert world.states() == {"/a": "RUNNING"}
        assert not [each for each in world.host.states().values() if each.isolated_for]

        world.spawn("relay", "d", isolated=True)
        world.host.kill("/fake_0")
        world.manager.look()
        world.manager.look()
        assert world.states() == {"/a": "RUNNING", "/d": "RUNNING"}
        assert world.host.nodelet("/a").ports["image"].topic == "/i"
        world.manager.add_transformation(
            "<transformation><label>late</label><source>pkg/Camera</source></transformation>"
        )
    assert written(world) == {"/a": "RUNNING", "/d": "RUNNING"}
    assert world.manager.library.get("late").source == "pkg/Camera"


@pytest.mark.parametrize("error", [HostError("it does not load"), NameTaken("/x")])
def test_an_isolated_spawn_that_fails_leaves_no_process(disk: Path, error: Exception) -> None:
    world = World(str(disk / "state"))

    world.host.fail_at("load", error=error)
    with full(disk), pytest.raises((SpawnFailed, NameTaken)):
        world.spawn("camera", "x", isolated=True)
    assert world.host.states() == {}
    assert world.states() == {}
    assert written(world) == {}


def test_the_disk_is_tried_again_by_looks(disk: Path) -> None:
    clock = HandClock()
    world = World(str(disk / "state"), clock=clock)
    with full(disk):
        for number in range(200):
            world.spawn("camera", f"n{number}")
            if world.store.trouble:
                break
        assert world.store.trouble
    clock.time += 10.0
    world.manager.look()
    assert world.store.trouble == "" and world.store.remark == ""
    assert written(world) == world.states()
