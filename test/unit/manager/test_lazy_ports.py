# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A lazy C++ nodelet makes in-ports when a subscriber comes, which nobody connected elsewhere."""

from __future__ import annotations

from dataclasses import replace

import pytest
from unit.manager.field import IMAGE, Field, transformation

from dyknow.model.streams import ClaimState

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
    field.manager.look({name})


def test_ports_that_are_made_late_are_connected_as_planned(field: Field) -> None:
    claim = field.acquire("Rect(field)").claim
    (name, _) = claim.goal
    wanted = dict(claim.wiring[name])
    make_ports(field, name)
    assert field.host.nodelet(name).ports["camera_info"].topic == wanted["camera_info"]
    field.settle()
    assert field.claim(claim.claim_id).wiring[name] == wanted
    assert not [each for each in field.reasons() if "elsewhere" in each]


def test_it_is_tried_again(field: Field) -> None:
    claim = field.acquire("Rect(field)").claim
    (name, _) = claim.goal

    field.host.fail_at("connect", name, "not now")
    make_ports(field, name)
    field.host.recover()
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.host.nodelet(name).ports["camera_info"].topic == "/info_1/info"
    assert not [each for each in field.reasons() if "elsewhere" in each]


@pytest.mark.parametrize("is_noticed", [True, False])
def test_what_people_connect_before_it_is_made_is_their_will(
    field: Field, is_noticed: bool
) -> None:
    field.spawn("rectify", "/mine", config={"image": "/image", "camera_info": "/other"})
    field.host.connect("/mine", {"camera_info": "/info"})
    if is_noticed:
        field.manager.look({"/mine"})
        assert field.manager.graph.get("/mine").topics["camera_info"] == "/info"
    field.host.lazy.clear()
    field.manager.look({"/mine"})
    assert field.manager.graph.get("/mine").topics["camera_info"] == "/info"
    assert field.host.nodelet("/mine").ports["camera_info"].topic == "/info"
    assert field.host.nodelet("/mine").ports["image"].topic == "/image"


def test_what_people_connect_afterwards_is_their_will(field: Field) -> None:
    field.spawn("rectify", "/mine", config={"image": "/image", "camera_info": "/info"})
    field.host.lazy.clear()
    field.manager.look({"/mine"})
    field.host.connect("/mine", {"camera_info": "/elsewhere"})
    field.manager.look({"/mine"})
    assert field.manager.graph.get("/mine").topics["camera_info"] == "/elsewhere"
    assert field.host.nodelet("/mine").ports["camera_info"].topic == "/elsewhere"
