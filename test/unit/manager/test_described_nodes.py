# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodes that users start, and that the library describes: they supply and demand."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Dict, Mapping

import pytest
from unit.manager.field import IMAGE, POINT, Field, library, topic, transformation

from dyknow.errors import (
    DyKnowError,
    HostError,
    NoPlanFound,
    NotSpawnable,
    SpecificationError,
)
from dyknow.manager.record import Record
from dyknow.model.graph import NodeletKind, SpawnRequest
from dyknow.model.streams import ClaimState, StreamRequest

CAMERA = """<transformation type="node" node="/robot/camera"><label>driver</label>
  <ports><port type="out">image</port></ports>
  <tags><tag port="image">YUV(field)</tag></tags></transformation>"""
LOCALIZATION = """<transformation type="node" node="/robot/where"><label>where</label>
  <ports><port type="in">ball</port><port type="out">position</port></ports>
  <tags><tag port="ball">RelativePosition(ball)</tag>
  <tag port="position">FieldPosition(ball)</tag></tags></transformation>"""
PROGRAMS = {
    "robot/camera": [("image", "out", IMAGE), ("camera_info", "out", "sensor_msgs/CameraInfo")],
    "robot/where": [("ball", "in", POINT), ("position", "out", POINT)],
    "robot/smooth": [("in", "in", IMAGE), ("out", "out", IMAGE)],
    "robot/stereo": [("left", "in", IMAGE), ("right", "in", IMAGE), ("depth", "out", IMAGE)],
}
SMOOTH = transformation("smooth", "x", "in in,out out", "in Image(?camera);out Smooth(?camera)")
STEREO = library(
    SMOOTH.replace('cost="1"', 'type="node" node="/smooth"').replace("<source>x</source>", ""),
    transformation("left", "soccer/Camera", "out image", "image Image(left)"),
    transformation("right", "soccer/Ceiling", "out image", "image Image(right)"),
    transformation(
        "stereo",
        "robot/stereo",
        "in left,in right,out depth",
        "left Smooth(left);right Smooth(right);depth Depth(field)",
    ),
)


class Robot(Field):
    """The field, beside nodes that users start."""

    def run(self, name: str, program: str, topics: Mapping[str, str]) -> None:
        kind = NodeletKind.CPP_NODE if program == "robot/camera" else NodeletKind.NODE
        self.host.run_node(name, program, topics, kind)
        self.by_hand[name] = True
        self.manager.look()

    def run_camera(self) -> None:
        self.run("/robot/camera", "robot/camera", {"image": "/image", "camera_info": "/info"})

    def end(self, name: str) -> None:
        self.host.kill(name)
        del self.by_hand[name]

    def topics(self, name: str) -> Dict[str, str]:
        return self.manager.graph.get(name).status.connections


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    robot = Robot(str(tmp_path / "state.db"))
    robot.host.sources.update(PROGRAMS)
    return robot


def test_a_node_bears_the_label_and_tags_that_describe_it(robot: Robot) -> None:
    robot.run_camera()
    assert robot.manager.graph.get("/robot/camera").label == ""

    robot.manager.add_transformation(CAMERA)
    robot.manager.look()
    status = robot.manager.graph.get("/robot/camera").status
    shown = status.transformation, status.kind, status.manager
    assert shown == ("driver", NodeletKind.CPP_NODE, "")
    tags = {port.name: port.tags for port in status.ports}
    assert tags == {"image": ("YUV(field)",), "camera_info": ()}

    robot.manager.add_transformation(CAMERA.replace("YUV(field)", "Raw(field)"))
    robot.manager.look()
    port = robot.manager.graph.get("/robot/camera").status.port("image")
    assert port is not None and port.tags == ("Raw(field)",)

    robot.manager.remove_transformation("driver")
    robot.manager.look()
    assert robot.manager.graph.get("/robot/camera").label == ""
    robot.end("/robot/camera")
    robot.manager.look()
    assert robot.manager.graph.find("/robot/camera") is None


def test_it_is_neither_spawned_nor_destroyed_nor_kept_on_disk(robot: Robot) -> None:
    robot.manager.add_transformation(CAMERA)
    with pytest.raises(NotSpawnable, match="'driver' is the existing node '/robot/camera'"):
        robot.manager.spawn(SpawnRequest("driver", "/mine"))
    robot.run_camera()
    with pytest.raises(HostError, match="runs in a process of its own"):
        robot.manager.destroy("/robot/camera")
    with pytest.raises(HostError, match="was not spawned by this manager"):
        robot.manager.set_protection("/robot/camera", True)
    assert robot.store.read("nodelets", Record.from_body) == {}
    robot.manager.end()
    assert robot.host.running == ["/robot/camera"]


def test_a_node_is_described_once(robot: Robot) -> None:
    robot.manager.add_transformation(CAMERA)
    with pytest.raises(SpecificationError, match="is described by 'driver' already; remove"):
        robot.manager.add_transformation(CAMERA.replace("driver", "other"))
    robot.manager.add_transformation(CAMERA.replace("YUV", "Raw"))
    assert robot.manager.library.nodes()["/robot/camera"] == robot.manager.library.get("driver")


def test_it_supplies_while_it_runs_and_is_replaced_when_it_ends(robot: Robot) -> None:
    robot.manager.add_transformation(CAMERA)
    robot.run_camera()
    claim = robot.flowing("YUV(field)")
    assert (claim.nodelets, claim.topic) == (("/robot/camera",), "/image")
    assert robot.host.running == ["/robot/camera"]

    robot.end("/robot/camera")
    robot.settle()
    robot.check_flows(claim)
    assert robot.labels() == ["bottom camera"]

    robot.run_camera()  # a user starts it again, on the topic that was taken over
    robot.settle()
    assert robot.topics("/robot/camera") == {"camera_info": "/info"}

    robot.kill_manager()
    robot.reconciler.release(claim.claim_id)
    robot.tidy()
    assert robot.topics("/robot/camera") == {"camera_info": "/info", "image": "/image"}


@pytest.mark.parametrize("user_topic", ["/image", ""])
@pytest.mark.parametrize("is_loaded", [True, False])
def test_a_port_that_a_claim_used_comes_back_to_where_its_user_had_it(
    robot: Robot, user_topic: str, is_loaded: bool
) -> None:
    robot.manager.add_transformation(CAMERA)
    robot.run("/robot/camera", "robot/camera", {"image": user_topic, "camera_info": "/info"})
    claims = []
    if user_topic:
        claims.append(robot.flowing("YUV(field)"))
        robot.end("/robot/camera")
        robot.settle()
        robot.run_camera()
        robot.settle()
        assert "image" not in robot.topics("/robot/camera")
    late = transformation("late", "robot/smooth", "in in,out out", "in YUV(field);out Late(field)")
    robot.manager.add_transformation(late)
    if not is_loaded:
        robot.host.fail_at("load", "late")
    request = StreamRequest("Late(field)", exclude=("bottom camera", "ceiling camera"))
    with contextlib.nullcontext() if is_loaded else pytest.raises(DyKnowError):
        claims.append(robot.reconciler.acquire(request).claim)
    robot.settle()
    assert bool(robot.topics("/robot/camera").get("image")) is is_loaded
    for claim in claims:
        robot.reconciler.release(claim.claim_id)
    robot.tidy()
    assert robot.topics("/robot/camera").get("image", "") == user_topic
    assert robot.manager.graph.get("/robot/camera").owed == {}


@pytest.mark.parametrize("trouble", ["killed manager", "hang"])
def test_a_port_of_a_node_without_a_description_comes_back_too(robot: Robot, trouble: str) -> None:
    claim = robot.flowing("YUV(field)")
    robot.run("/stray", "robot/camera", {"image": claim.topic, "camera_info": "/info"})
    robot.settle()
    assert robot.topics("/stray") == {"camera_info": "/info"}
    if trouble == "hang":
        robot.host.hang("/stray")
        robot.tick()
        assert robot.manager.graph.get("/stray").detail == "it does not answer"
        robot.host.wake("/stray")
    else:
        robot.kill_manager()
    robot.settle()
    robot.reconciler.release(claim.claim_id)
    robot.tidy()
    assert robot.topics("/stray") == {"camera_info": "/info", "image": claim.topic}
    assert robot.store.read("nodelets", Record.from_body) == {}
    robot.end("/stray")
    robot.settle()
    assert robot.manager.graph.find("/stray") is None


def test_a_port_that_a_claim_used_comes_back_when_the_manager_is_stopped(robot: Robot) -> None:
    robot.manager.add_transformation(CAMERA)
    robot.run_camera()
    robot.flowing("YUV(field)")
    robot.end("/robot/camera")
    robot.settle()
    robot.run_camera()
    robot.settle()
    assert robot.topics("/robot/camera") == {"camera_info": "/info"}
    robot.reconciler.end()
    robot.manager.end()
    assert robot.host.nodelet("/robot/camera").ports["image"].topic == "/image"
    assert robot.store.read("nodelets", Record.from_body) == {}


def test_a_port_that_was_in_the_way_comes_back_when_the_manager_is_stopped(robot: Robot) -> None:
    robot.flowing("Planes(field)")
    topic = robot.host.nodelet("/subsampler_1").ports["yuv"].topic
    robot.manager.add_transformation(CAMERA.replace("YUV(field)", "Other(field)"))
    robot.run("/robot/camera", "robot/camera", {"image": topic, "camera_info": "/info"})
    robot.settle()
    assert robot.topics("/robot/camera") == {"camera_info": "/info"}
    robot.reconciler.end()
    robot.manager.end()
    assert robot.host.nodelet("/robot/camera").ports["image"].topic == topic


def test_a_node_that_does_not_run_is_named(robot: Robot) -> None:
    robot.manager.add_transformation(LOCALIZATION.replace("FieldPosition", "Place"))
    with pytest.raises(NoPlanFound, match="node /robot/where does not run"):
        robot.acquire("Place(ball)")


def test_claims_keep_it_when_the_manager_is_killed(robot: Robot) -> None:
    robot.manager.remove_transformation("localization")
    robot.manager.add_transformation(LOCALIZATION)
    robot.run("/robot/where", "robot/where", {"position": "/position"})
    claim = robot.flowing()
    robot.host.calls.clear()
    robot.kill_manager()
    robot.settle()
    robot.check_flows(claim)
    assert robot.claim(claim.claim_id).wiring == claim.wiring
    assert not {"load", "unload", "connect"} & {operation for operation, _ in robot.host.calls}


def test_it_is_one_thing_at_a_time(robot: Robot) -> None:
    robot.manager.add_transformation(STEREO)
    robot.run("/smooth", "robot/smooth", {"out": "/smoothed"})
    with pytest.raises(NoPlanFound):
        robot.acquire("Depth(field)")
    assert robot.host.running == ["/smooth"]

    first = robot.acquire("Smooth(left)").claim
    with pytest.raises(NoPlanFound):
        robot.acquire("Smooth(right)")
    robot.reconciler.release(first.claim_id)
    assert robot.acquire("Smooth(right)").reused == ("/smooth",)


def test_it_is_used_for_one_thing_beside_something_else(robot: Robot) -> None:
    robot.manager.add_transformation(STEREO)
    robot.run("/smooth", "robot/smooth", {"out": "/smoothed"})
    for side in ("left", "right"):
        robot.manager.add_transformation(
            transformation(f"own {side}", "soccer/Camera", "out image", f"image Smooth({side})", 7)
        )
    got = robot.acquire("Depth(field)")
    assert (got.reused, got.cost) == (("/smooth",), 9)
    assert got.plan is not None and got.plan.least_cost == 9
    robot.settle()


@pytest.mark.parametrize("is_node", [True, False])
def test_it_is_used_elsewhere_if_that_is_the_only_or_the_cheapest_plan(
    robot: Robot, is_node: bool
) -> None:
    """It smooths the left image already, which can be had without it; the right one cannot."""
    robot.manager.add_transformation(STEREO)
    if is_node:
        robot.spawn("left", "/left", config={"image": "/seen"})
        robot.run("/smooth", "robot/smooth", {"in": "/seen", "out": "/smoothed"})
    else:  # a nodelet that lingers, beside which there may be others
        robot.manager.remove_transformation("smooth")
        robot.manager.add_transformation(
            SMOOTH.replace("x<", "robot/smooth<").replace('"1"', '"10"')
        )
        robot.reconciler.release(robot.acquire("Smooth(left)").claim.claim_id)
    robot.manager.add_transformation(
        transformation("own left", "soccer/Camera", "out image", "image Smooth(left)", 7)
    )
    got = robot.acquire("Depth(field)")
    assert got.cost == 9
    assert any("smooth" in name for name in got.reused)
    robot.settle()
    robot.check_flows(got.claim)


def test_it_stays_on_its_topic_and_a_relay_brings_it_to_the_client(robot: Robot) -> None:
    robot.manager.add_transformation(CAMERA)
    claim = robot.flowing("YUV(field)")
    robot.run_camera()
    robot.settle()
    robot.manager.remove_transformation("bottom camera")
    robot.manager.remove_transformation("ceiling camera")
    robot.settle(5.0)
    robot.check_flows(claim)
    assert "/robot/camera" in robot.claim(claim.claim_id).nodelets
    assert robot.topics("/robot/camera")["image"] == "/image"


def test_it_is_used_once_all_of_its_ports_are_there(robot: Robot) -> None:
    robot.manager.remove_transformation("localization")
    robot.manager.add_transformation(LOCALIZATION)
    robot.host.lazy["robot/where"] = {"position"}
    robot.run("/robot/where", "robot/where", {"position": "/position"})
    assert [port.name for port in robot.manager.graph.get("/robot/where").ports] == ["ball"]
    with pytest.raises(NoPlanFound):
        robot.acquire()
    robot.host.lazy.clear()
    robot.manager.look()
    assert robot.acquire().reused == ("/robot/where",)


def test_a_second_plan_of_a_request_may_use_it(robot: Robot) -> None:
    robot.host.sources["robot/wrong"] = [("out", "out", POINT)]
    wrong = transformation("wrong", "robot/wrong", "out out", "out Image(left)", cost=0)
    robot.manager.add_transformation(STEREO)
    robot.manager.add_transformation(wrong)
    robot.run("/smooth", "robot/smooth", {"out": "/smoothed"})
    got = robot.acquire("Smooth(left)")
    assert (got.spawned, got.reused) == (("/left_1",), ("/smooth",))


def add_topics(robot: Robot, *labels: str) -> None:
    """Let the node that smooths images run, beside topics of ordinary nodes with images."""
    robot.manager.add_transformation(STEREO)
    for label in labels:
        text = topic(f"{label} topic", f"/{label}", f"Image({label})", datatype=IMAGE)
        robot.manager.remove_transformation(label)
        robot.manager.add_transformation(text)
        robot.host.topics.add(f"/{label}")
    robot.run("/smooth", "robot/smooth", {"out": "/smoothed"})


@pytest.mark.parametrize("clients", [1, 2])
def test_all_clients_of_one_stream_follow_it_to_another_individual(
    robot: Robot, clients: int
) -> None:
    add_topics(robot, "left", "right")
    claims = [robot.acquire("Smooth(?camera)").claim for _ in range(clients)]
    robot.settle()
    robot.host.topics.discard("/left")
    robot.settle()
    robot.check_flows(*claims)
    assert [each.bindings for each in robot.living()] == clients * [(("?camera", "right"),)]


@pytest.mark.parametrize("tag", ["Smooth(left)", "View(left)"])
@pytest.mark.parametrize("is_there", [True, False])
def test_a_claim_waits_no_longer_than_another_one_needs_it(
    robot: Robot, tag: str, is_there: bool
) -> None:
    add_topics(robot, "left", "right")
    robot.add("view", {"in": ("in", ["Smooth(left)"]), "out": ("out", ["View(left)"])})
    first = robot.flowing(tag)
    with pytest.raises(NoPlanFound, match="no nodelet of smooth is free") as refused:
        robot.acquire("Smooth(right)")
    if not is_there:
        robot.host.topics.discard("/left")
    robot.settle()
    is_left = not is_there and tag == "View(left)"  # not to a client that listens to it
    assert (robot.state(refused.value.claim_id) is ClaimState.ACTIVE) == is_left
    robot.reconciler.release(first.claim_id)
    robot.settle()
    robot.check_flows(robot.claim(refused.value.claim_id))
