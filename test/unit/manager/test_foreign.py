# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets in nodelet managers of other clients: shown and connected, never ended or used."""

from __future__ import annotations

from typing import Any

import pytest
from unit.manager.field import CHAIN, Field
from unit.manager.world import World

from dyknow.errors import HostError, LimitExceeded, NameTaken, NotOurs
from dyknow.guards import Guards
from dyknow.manager.host import LoadRequest
from dyknow.manager.record import Record
from dyknow.model.graph import NodeletKind, State
from dyknow.model.streams import ClaimState

THEIRS = "/my_manager"


def load(world: World, name: str, loader: str = "", source: str = "pkg/Relay") -> None:
    """Let another client load a nodelet into a nodelet manager of its own."""
    if THEIRS not in world.host.processes:
        world.host.add(THEIRS, foreign=True)
    world.host.loaders[name] = loader
    world.host.load(THEIRS, LoadRequest(name, source), 1.0)
    world.manager.look()


def test_it_is_in_the_model_with_its_owner(world: World) -> None:
    load(world, "/a")
    load(world, "/b", "/robot/dyknow_manager")
    shown = {each.name: each for each in world.manager.get_model().nodelets}
    assert {name: each.owner for name, each in shown.items()} == {
        "/a": THEIRS,
        "/b": "/robot/dyknow_manager",
    }
    assert {each.manager for each in shown.values()} == {THEIRS}
    assert {each.state for each in shown.values()} == {State.RUNNING}
    assert shown["/b"].origin == "(by /robot/dyknow_manager)"
    assert [port.name for port in shown["/a"].ports] == ["in", "out"]
    world.manager.connect([("/a", {"in": "/image"})])
    assert world.host.nodelet("/a").ports["in"].topic == "/image"
    world.spawn("relay", "mine")
    assert world.manager.graph.get("/mine").owner == ""
    world.host.loaders["/b"] = "/who_loaded_it_last"
    world.manager.look()
    assert world.manager.graph.get("/b").owner == "/who_loaded_it_last"


def test_it_is_neither_destroyed_nor_restarted_nor_set_nor_protected(world: World) -> None:
    load(world, "/a", "/loader")
    manager = world.manager
    cure = f"rosrun nodelet nodelet unload /a {THEIRS}"
    with pytest.raises(NotOurs, match=f"nodelet manager '{THEIRS}' of /loader; .* {cure}"):
        manager.destroy("a")
    with pytest.raises(HostError, match="restart it where it was started"):
        manager.restart("a")
    with pytest.raises(HostError, match="restart it where it was started"):
        manager.restart(THEIRS)
    with pytest.raises(HostError, match="was not spawned by this manager"):
        manager.set_protection("a", True)
    world.host.run_node("/driver", "pkg/Camera", {}, NodeletKind.NODE)
    manager.look()
    with pytest.raises(NotOurs, match="a process of its own; end it with: rosnode kill /driver"):
        manager.destroy("driver")
    assert world.host.running == ["/a", "/driver"]
    manager.end()
    assert world.host.running == ["/a", "/driver"]


def test_nothing_is_loaded_beside_it(world: World) -> None:
    load(world, "/a")
    assert world.spawn("relay", "mine").manager == "/fake_0"
    with pytest.raises(HostError, match=f"'{THEIRS}'; known: /fake_0; .*~nodelet_managers"):
        world.spawn("relay", "b", manager=THEIRS)
    with pytest.raises(NameTaken):
        world.spawn("relay", "a")
    world.host.kill("/fake_0")
    world.manager.look()
    assert world.manager.graph.get("/mine").manager == "/fake_0"


def test_it_goes_with_its_nodelet_manager_and_nothing_is_kept_of_it(world: World) -> None:
    load(world, "/a")
    assert world.store.read("nodelets", Record.from_body) == {}
    world.kill_manager()
    assert world.states() == {"/a": "RUNNING"}  # it is found again
    world.host.hang(THEIRS)
    world.manager.look()
    assert world.states() == {}
    world.host.wake(THEIRS)
    world.manager.look()
    assert world.states() == {"/a": "RUNNING"}
    world.host.kill(THEIRS)
    world.manager.look()
    assert world.states() == {}
    assert THEIRS not in world.host.processes


def test_those_that_are_being_made_count_for_the_limit_and_it_does_not(monkeypatch) -> None:
    world = World(guards=Guards(nodelets=1))
    load(world, "/a")
    ensure, refused = world.host.ensure, []

    def ensure_during_another_spawn(*words: Any) -> str:
        monkeypatch.undo()
        with pytest.raises(LimitExceeded):
            world.spawn("relay", "another")
        refused.append("another")
        return ensure(*words)

    monkeypatch.setattr(world.host, "ensure", ensure_during_another_spawn)
    world.spawn("relay", "mine")
    assert refused == ["another"]
    assert world.states() == {"/a": "RUNNING", "/mine": "RUNNING"}


def test_claims_do_not_use_it(field: Field) -> None:
    field.host.add(THEIRS, foreign=True)
    field.acquire()
    parts = {each: field.host.nodelet(each).request.source for each in field.host.running}
    for name, source in parts.items():
        field.host.load(THEIRS, LoadRequest(f"/their{name}", source), 1.0)
    before = {f"/their{name}": field.host.nodelet(f"/their{name}").ports for name in parts}
    field.host.kill("/fake_0")
    field.settle()
    assert field.living()[0].state is ClaimState.ACTIVE
    claimed = [each for each in field.manager.graph.all() if each.claimed]
    assert len(claimed) == len(CHAIN) and {each.manager for each in claimed} == {"/fake_0"}
    assert {name: field.host.nodelet(name).ports for name in before} == before
