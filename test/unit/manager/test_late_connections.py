# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A connection that was not confirmed in time may be made later, and is noticed then."""

from __future__ import annotations

import pytest
from unit.manager.field import CHAIN, Field

from dyknow.errors import HostTimeout
from dyknow.model.streams import ClaimState


def topic(field: Field, name: str, port: str) -> str:
    return field.host.nodelet(name).ports[port].topic


def test_a_mend_that_was_not_answered_is_taken_back_when_it_comes(field: Field) -> None:
    claim = field.acquire().claim
    field.settle(3.0)
    field.host.slow.add("/subsampler_1")

    field.host.fail_at("load", "/subsampler_2", "there is no other one")
    field.manager.remove_transformation("bottom camera")
    field.tick()
    assert field.state(claim.claim_id) is ClaimState.FAILED
    assert topic(field, "/subsampler_1", "yuv") == "/bottom_camera_1/image"
    field.host.recover()
    field.manager.add_transformation(CAMERA)  # so that there is nothing else to do
    field.host.arrive()
    assert topic(field, "/subsampler_1", "yuv") == "/ceiling_camera_1/image"
    field.host.slow.clear()
    for _ in range(10):
        field.tick(0.5)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert claim.topic in field.moving
    field.tidy()
    assert field.labels() == CHAIN


CAMERA = """
<transformation><label>bottom camera</label><source>soccer/Camera</source>
  <ports><port type="out">image</port></ports>
  <tags><tag port="image">YUV(field)</tag></tags></transformation>
"""


def test_a_request_that_was_not_answered_leaves_nothing(field: Field) -> None:
    part = field.acquire("RelativePosition(ball)").claim
    planes = field.acquire("Planes(field)").claim
    field.host.fail = lambda what, name: (
        field.host.slow.add("/localization_1") if what == "loaded" else None
    )
    with pytest.raises(HostTimeout):
        field.acquire()
    assert "/localization_1" not in field.host.running
    field.host.recover()
    field.host.slow.clear()
    field.host.arrive()
    field.settle()
    for claim in (part, planes):
        assert field.state(claim.claim_id) is ClaimState.ACTIVE
        assert claim.topic in field.moving


def test_a_claim_waits_only_once_its_parts_are_known_to_be_disconnected(field: Field) -> None:
    claim = field.acquire("RelativePosition(ball)").claim
    field.settle(3.0)
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
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert claim.topic in field.moving


def test_nobody_is_asked_about_connections_that_are_known(field: Field) -> None:
    field.acquire()
    field.settle(3.0)
    before = len(field.host.calls)
    field.settle(3.0)
    asked = {what for what, _ in field.host.calls[before:]}
    assert asked <= {"published"}
