# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodes and scripts that the manager makes: spawned, restored, isolated, destroyed."""

from __future__ import annotations

from pathlib import Path

import pytest
from clocks import HandClock
from unit.manager.field import Field
from unit.manager.world import World

from dyknow.errors import Denied, HostError, NameTaken, SpawnFailed
from dyknow.guards import Guards
from dyknow.model.graph import NodeletKind
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import Parameter

COPIER = "topic_tools/relay words copy"
SCRIPT = "pkg/filter.py"
PORTS = [("words", "in", "std_msgs/String"), ("copy", "out", "std_msgs/String")]
NODES = f"""
<transformations>
  <transformation type="node">
    <label>copier</label>
    <source>{COPIER}</source>
    <params><param name="rate">5</param></params>
    <ports><port type="in">words</port><port type="out">copy</port></ports>
  </transformation>
  <transformation type="node">
    <label>script</label>
    <source>{SCRIPT}</source>
    <ports><port type="in">words</port><port type="out">copy</port></ports>
  </transformation>
  <transformation type="node" isolated="true">
    <label>lone script</label>
    <source>{SCRIPT}</source>
    <ports><port type="in">words</port><port type="out">copy</port></ports>
  </transformation>
  <transformation isolated="true">
    <label>lone camera</label>
    <source>pkg/Camera</source>
  </transformation>
  <transformation type="node">
    <label>absent</label>
    <source>pkg/absent</source>
  </transformation>
  <transformation type="node">
    <label>ending</label>
    <source>pkg/ending</source>
  </transformation>
  <transformation type="node">
    <label>misnamed</label>
    <source>{COPIER}</source>
    <ports><port type="in">sentences</port></ports>
  </transformation>
</transformations>
"""


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


def rate(value: int) -> Parameter:
    return Parameter("rate", "int", str(value))


def test_a_script_runs_beside_nodelets(world: World) -> None:
    camera = world.spawn("camera", "/camera")
    made = world.spawn("script", "/filter", config={"words": "/a"})

    assert (made.kind, made.manager, made.isolated) == (
        NodeletKind.SCRIPT,
        camera.manager,
        False,
    )
    request = world.host.nodelet("/filter").request
    assert (request.source, request.kind) == (SCRIPT, NodeletKind.SCRIPT)
    assert request.remappings == {"/words": "/a", "/copy": "/filter/disconnected/copy"}

    world.host.kill(made.manager)
    world.manager.look()
    assert world.states() == {"/camera": "RUNNING", "/filter": "RUNNING"}
    assert world.manager.graph.get("/filter").kind is NodeletKind.SCRIPT


def test_a_script_in_a_process_of_its_own_is_a_node(world: World) -> None:
    made = world.spawn("lone script", "/alone", config={"words": "/a"})
    assert (made.kind, made.manager, made.status.manager) == (NodeletKind.NODE, "/alone", "")

    world.host.kill("/alone")
    world.manager.look()
    assert world.states() == {"/alone": "RUNNING"}
    assert world.manager.graph.get("/alone").status.connections == {"words": "/a"}
    world.manager.destroy("/alone")
    assert "/alone" not in world.host.processes


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


SEEN = """<transformations>
  <transformation type="node"><label>grabber</label><source>robot/grabber --fast</source>
    <ports><port type="out">image</port></ports>
    <tags><tag port="image">Raw(field)</tag></tags></transformation>
  <transformation type="node"><label>filter</label><source>robot/filter.py</source>
    <ports><port type="in">image</port><port type="out">edges</port></ports>
    <tags><tag port="image">Raw(field)</tag><tag port="edges">Edges(field)</tag></tags>
  </transformation>
</transformations>"""


def test_claims_are_made_and_mended_with_nodes_and_scripts(tmp_path: Path) -> None:
    field = Field(str(tmp_path / "state.db"))
    image = "sensor_msgs/Image"
    field.host.sources["robot/grabber --fast"] = [("image", "out", image)]
    field.host.sources["robot/filter.py"] = [("image", "in", image), ("edges", "out", image)]
    field.host.scripts.add("robot/filter.py")
    field.manager.add_transformation(SEEN)

    claim_id = field.acquire("Edges(field)").claim.claim_id
    kinds = {record.label: record.kind for record in field.manager.graph.all()}
    assert kinds == {"grabber": NodeletKind.CPP_NODE, "filter": NodeletKind.SCRIPT}
    grabber = field.host.nodelet("/grabber_1").request
    assert grabber.remappings == {"/image": "/grabber_1/image"}  # connected from its start
    field.settle()

    field.host.kill("/grabber_1")
    field.settle(5.0)
    assert field.state(claim_id) is ClaimState.ACTIVE
    assert field.labels() == ["filter", "grabber"]
    field.host.kill(field.manager.graph.get("/filter_1").manager)
    field.settle(5.0)
    assert field.state(claim_id) is ClaimState.ACTIVE

    field.reconciler.release(claim_id)
    field.tidy()
    assert field.host.running == []
