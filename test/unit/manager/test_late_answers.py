# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets and nodelet managers that answer late, or not at all."""

from __future__ import annotations

from dataclasses import replace

import pytest
from unit.manager.field import CHAIN, GOAL, IMAGE, Field, transformation

from dyknow.model.streams import ClaimState

# A nodelet manager that does not answer makes no request fail that can do without it


def hang(field: Field, manager: str) -> None:
    """Stop a nodelet manager; that shows when it is called."""
    field.host.hang(manager)
    field.host.unnoticed.add(manager)


def managers(field: Field) -> set[str]:
    return {record.manager for record in field.manager.graph.all()}


def test_a_stream_is_made_elsewhere(field: Field) -> None:
    hung = {"/a", "/b", "/c"}
    for name in hung:
        field.host.add(name)
        hang(field, name)
    got = field.acquire(GOAL)
    assert got.claim.state is ClaimState.ACTIVE
    assert not hung & managers(field)
    assert "bottom camera" not in field.reconciler._monitor.paused(()), "it is not blamed"
    field.settle()


def test_a_stream_is_made_without_parts_that_do_not_answer(field: Field) -> None:
    camera = field.acquire("YUV(field)").claim
    place = field.manager.graph.get(camera.goal[0]).manager
    hang(field, place)
    got = field.acquire(GOAL)
    assert got.claim.state is ClaimState.ACTIVE
    assert camera.goal[0] not in got.claim.nodelets
    assert place not in {field.manager.graph.get(name).manager for name in got.claim.nodelets}


def test_a_stream_is_made_without_a_nodelet_that_does_not_answer(field: Field) -> None:
    field.spawn("bottom camera", "/mine")
    field.host.slow.add("/mine")
    got = field.acquire("YUV(field)")
    assert got.claim.state is ClaimState.ACTIVE
    assert got.claim.goal[0] != "/mine"


# A connection that was not confirmed in time may be made later, and is noticed then


def topic(field: Field, name: str, port: str) -> str:
    return field.host.nodelet(name).ports[port].topic


def test_a_mend_that_was_not_answered_is_taken_back_when_it_comes(field: Field) -> None:
    claim = field.flowing()
    field.host.slow.add("/subsampler_1")

    field.host.fail_at("load", "/subsampler_2", "there is no other one")
    field.manager.remove_transformation("bottom camera")
    field.tick()
    assert field.state(claim.claim_id) is ClaimState.FAILED
    assert topic(field, "/subsampler_1", "yuv") == "/bottom_camera_1/image"
    field.host.recover()
    camera = transformation("bottom camera", "soccer/Camera", "out image", "image YUV(field)")
    field.manager.add_transformation(camera)  # so that there is nothing else to do
    field.host.arrive()
    assert topic(field, "/subsampler_1", "yuv") == "/ceiling_camera_1/image"
    field.host.slow.clear()
    for _ in range(10):
        field.tick(0.5)
    field.check_flows(claim)
    field.tidy()
    assert field.labels() == CHAIN


def test_a_claim_waits_only_once_its_parts_are_known_to_be_disconnected(field: Field) -> None:
    claim = field.flowing("RelativePosition(ball)")
    field.host.slow.add("/detector_1")
    field.host.topics.clear()
    field.settle(3.0)
    assert field.state(claim.claim_id) is ClaimState.FAILED
    assert "cannot be disconnected yet" in field.claim(claim.claim_id).detail
    field.host.slow.clear()
    field.host.arrive()
    field.settle(10.0)
    assert field.state(claim.claim_id) is ClaimState.PENDING
    assert topic(field, "/detector_1", "ball") == "" == topic(field, "/detector_1", "planes")
    field.host.topics.add("/joint_states")
    field.settle(3.0)
    field.check_flows(claim)


# A lazy C++ nodelet makes in-ports when a subscriber comes, which no user connected elsewhere


RECTIFY = transformation(
    "rectify",
    "image_proc/rectify",
    "in image, in camera_info, out image_rect",
    "image YUV(?c); camera_info Info(?c); image_rect Rect(?c)",
)
INFO = transformation("info", "lab/Info", "out info", "info Info(field)")


@pytest.fixture
def field() -> Field:
    field = Field()
    field.host.sources["image_proc/rectify"] = [
        ("image", "in", IMAGE),
        ("camera_info", "in", "sensor_msgs/CameraInfo"),
        ("image_rect", "out", IMAGE),
    ]
    field.host.sources["lab/Info"] = [("info", "out", "sensor_msgs/CameraInfo")]
    field.host.cpp.add("image_proc/rectify")
    field.host.lazy["image_proc/rectify"] = ("image", "camera_info")
    field.manager.add_transformation(RECTIFY)
    field.manager.add_transformation(INFO)
    return field


def make_ports(field: Field, name: str) -> None:
    """Let a subscriber come: one in-port is where the nodelet puts it."""
    field.host.lazy.clear()
    ports = field.host.nodelet(name).ports
    ports["camera_info"] = replace(ports["camera_info"], topic="/beside/camera_info")
    field.manager.look()


@pytest.mark.parametrize("fails_at_first", [False, True])
def test_ports_that_are_made_late_are_connected_as_planned(
    field: Field, fails_at_first: bool
) -> None:
    claim = field.acquire("Rect(field)").claim
    (name, _) = claim.goal
    if fails_at_first:
        field.host.fail_at("connect", name, "not now")
    make_ports(field, name)
    if fails_at_first:
        field.host.recover()
        field.settle()
    assert topic(field, name, "camera_info") == "/info_1/info"
    field.settle()
    assert field.claim(claim.claim_id).wiring == claim.wiring
    field.check_flows(claim)
    assert not [each for each in field.reasons() if "elsewhere" in each]


@pytest.mark.parametrize("is_noticed", [True, False])
def test_what_people_connect_is_their_will(field: Field, is_noticed: bool) -> None:
    field.spawn("rectify", "/mine", config={"image": "/image", "camera_info": "/other"})
    field.host.connect("/mine", {"camera_info": "/info"})
    if is_noticed:
        field.manager.look()
        assert field.manager.graph.get("/mine").topics["camera_info"] == "/info"
    field.host.lazy.clear()
    field.manager.look()
    assert field.manager.graph.get("/mine").topics["camera_info"] == "/info"
    assert field.host.nodelet("/mine").ports["camera_info"].topic == "/info"
    assert field.host.nodelet("/mine").ports["image"].topic == "/image"
    field.host.connect("/mine", {"camera_info": "/elsewhere"})
    field.manager.look()
    assert field.manager.graph.get("/mine").topics["camera_info"] == "/elsewhere"
    assert field.host.nodelet("/mine").ports["camera_info"].topic == "/elsewhere"
