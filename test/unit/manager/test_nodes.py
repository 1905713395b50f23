# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodes and scripts that the manager makes: spawned, restored, isolated, destroyed."""

from __future__ import annotations

from pathlib import Path

import pytest
from clocks import HandClock
from unit.manager.field import library
from unit.manager.world import World

from dyknow.errors import Denied, HostError, NameTaken, SpawnFailed
from dyknow.guards import Guards
from dyknow.model.graph import NodeletKind

COPIER = "topic_tools/relay words copy"
SCRIPT = "pkg/filter.py"
PORTS = [("words", "in", "std_msgs/String"), ("copy", "out", "std_msgs/String")]
RATE = '<params><param name="rate">5</param></params>'
BOTH = '<ports><port type="in">words</port><port type="out">copy</port></ports>'
OTHER = '<ports><port type="in">sentences</port></ports>'


def described(label: str, source: str, ports: str = "", kind: str = 'type="node"') -> str:
    parts = f"<label>{label}</label><source>{source}</source>{ports}"
    return f"<transformation {kind}>{parts}</transformation>"


NODES = library(
    described("copier", COPIER, RATE + BOTH),
    described("script", SCRIPT, BOTH),
    described("lone script", SCRIPT, BOTH, 'type="node" isolated="true"'),
    described("lone camera", "pkg/Camera", kind='isolated="true"'),
    described("absent", "pkg/absent"),
    described("ending", "pkg/ending"),
    described("misnamed", COPIER, OTHER),
)


@pytest.fixture
def world(tmp_path: Path) -> World:
    world = World(str(tmp_path / "state.sqlite3"), clock=HandClock())
    world.host.sources.update({COPIER: PORTS, SCRIPT: PORTS})
    world.host.scripts.add(SCRIPT)
    world.manager.add_transformation(NODES)
    return world


def test_a_node_is_a_process_of_its_own(world: World) -> None:
    made = world.spawn("copier", "/robot/copier", config={"words": "/a"})

    status = made.status
    assert (status.kind, status.manager, status.isolated) == (NodeletKind.CPP_NODE, "", True)
    assert world.host.nodelet("/robot/copier").request.remappings == {
        "/robot/words": "/a",
        "/robot/copy": "/robot/copier/disconnected/copy",
    }
    assert status.connections == {"words": "/a"}
    assert world.host.parameters == {"/robot/copier/rate": 5}
    assert world.spawn("copier", "/second").manager == "/second"
    world.manager.destroy("/robot/copier")
    assert world.host.running == ["/second"]
    assert world.host.parameters == {"/second/rate": 5}


def test_a_script_runs_beside_nodelets(world: World) -> None:
    camera = world.spawn("camera", "/camera")
    made = world.spawn("script", "/filter", config={"words": "/a"})

    assert (made.kind, made.manager, made.isolated) == (NodeletKind.SCRIPT, camera.manager, False)
    request = world.host.nodelet("/filter").request
    assert (request.source, request.kind) == (SCRIPT, NodeletKind.SCRIPT)
    assert request.remappings == {"/words": "/a", "/copy": "/filter/disconnected/copy"}

    world.host.kill(made.manager)
    world.manager.look()
    assert world.states() == {"/camera": "RUNNING", "/filter": "RUNNING"}
    assert world.manager.graph.get("/filter").kind is NodeletKind.SCRIPT


@pytest.mark.parametrize("label", ["lone script", "lone camera"])
def test_a_transformation_may_ask_for_a_process_of_its_own(world: World, label: str) -> None:
    shared = world.spawn("camera", "/camera").manager
    alone = world.spawn(label, "/alone")
    told = world.spawn(label, "/told", manager=shared)

    assert alone.isolated
    assert world.host.processes[alone.manager].state.isolated_for == "/alone"
    assert (told.isolated, told.manager) == (False, shared)


def test_the_name_of_another_node_is_taken(world: World) -> None:
    world.host.run_node("/copier", COPIER, {}, NodeletKind.CPP_NODE)
    with pytest.raises(NameTaken):
        world.spawn("copier", "/copier")
    assert world.host.running == ["/copier"]
    world.manager.look()
    assert world.manager.graph.get("/copier").label == ""


@pytest.mark.parametrize("end", ["destroyed", "ended", "gone"])
def test_another_node_that_takes_over_a_name_is_let_alone(world: World, end: str) -> None:
    manager, host = world.manager, world.host
    world.spawn("copier", "/copier", config={"words": "/mine"})
    host.kill("/copier")
    host.run_node("/copier", COPIER, {"words": "/theirs"}, NodeletKind.CPP_NODE)
    host.parameters["/copier/rate"] = 7
    theirs = host.nodelet("/copier")
    for _ in range(3):
        manager.look()
        assert manager.graph.get("/copier").detail == "another node named '/copier' is running"
    if end == "destroyed":
        manager.destroy("/copier")
        manager.look()
        assert manager.graph.get("/copier").owner == "/copier"
    elif end == "ended":
        manager.end()
    assert host.nodelet("/copier") is theirs
    assert theirs.ports["words"].topic == "/theirs"
    assert host.parameters == {"/copier/rate": 7}
    if end == "gone":
        host.kill("/copier")
        assert isinstance(world.clock, HandClock)
        world.clock.time += 10.0
        manager.look()
        assert manager.graph.get("/copier").status.connections == {"words": "/mine"}


@pytest.mark.parametrize(
    ("guards", "words", "label"),
    [
        (
            Guards(allowed_programs=(("topic_tools/*",),)),
            "'pkg/filter.py'.*allowed_programs",
            "script",
        ),
        (Guards(remote_programs=False), "remote_programs", ""),
    ],
)
def test_guards_say_which_programs_are_started(guards: Guards, words: str, label: str) -> None:
    world = World(guards=guards)
    world.host.sources.update({COPIER: PORTS, SCRIPT: PORTS})
    with pytest.raises(Denied, match=words):
        world.manager.add_transformation(NODES)
    # The manager's own files are not checked before the spawn.
    world.manager.library.add(NODES)
    if label:
        with pytest.raises(Denied, match="allowed_programs"):
            world.spawn(label, "/script")
    world.spawn("copier", "/copier")
    assert world.host.running == ["/copier"]


@pytest.mark.parametrize(
    ("label", "manager", "words"),
    [
        ("absent", "", "package 'pkg' has no program 'absent'"),
        ("copier", "/shared", r"a C\+\+ node has a process of its own"),
        (
            "misnamed",
            "",
            "none of the declared ports sentences within 10 s; its ports: copy, words",
        ),
        ("ending", "", "it ended at its start"),
    ],
)
def test_a_node_that_cannot_be_made_leaves_nothing(
    world: World, label: str, manager: str, words: str
) -> None:
    world.host.sources["pkg/ending"] = PORTS
    world.host.ending.add("pkg/ending")
    with pytest.raises((HostError, SpawnFailed), match=words):
        world.spawn(label, "/x", manager=manager)
    assert (world.states(), world.host.running, world.host.parameters) == ({}, [], {})


@pytest.mark.parametrize(
    ("lazy", "until", "least", "most"),
    [({"words", "copy"}, 4.0, 4.0, 4.5), ({"copy"}, 99.0, 1.0, 2.0)],
    ids=["late", "lazy"],
)
def test_ports_are_waited_for_until_the_first_ones_are_there(
    world: World, lazy: set[str], until: float, least: float, most: float
) -> None:
    world.host.lazy[COPIER] = lazy

    def appear(operation: str, _: str) -> None:
        if operation == "ports" and world.clock.now() >= until:
            world.host.lazy[COPIER] = set()

    world.host.fail = appear
    made = world.spawn("copier", "/copier", config={"words": "/a", "copy": "/b"})
    assert least <= world.clock.now() < most
    assert made.status.connections == {"words": "/a", "copy": "/b"}
