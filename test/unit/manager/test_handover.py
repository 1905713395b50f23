# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Replacements: up, and delivering, before the old part goes; undone when a step fails."""

from __future__ import annotations

from typing import List

import pytest
from unit.manager.field import CHAIN, GOAL, IMAGE, LIBRARY, POINT, Field, topic, transformation

from dyknow.errors import HostError, NoPlanFound, SpawnFailed, StreamTypeMismatch
from dyknow.model.streams import ClaimState, StreamRequest

OTHER = transformation(
    "other localization",
    "soccer/Localization",
    "in ball, out position",
    "ball RelativePosition(ball); position FieldPosition(ball)",
    cost=3,
)


def watch(field: Field, topic: str) -> List[str]:
    """Record every operation before which nothing or two nodelets publish on a topic."""
    gaps: List[str] = []

    def look(operation: str, argument: str) -> None:
        if operation in ("loaded", "unload", "connect"):
            if topic not in field.host.flow():
                gaps.append(f"nothing flows at {operation} {argument}")
            if len(field.host.publishers(topic)) > 1 and operation != "connect":
                gaps.append(f"two publish at {operation} {argument}")

    field.host.fail = look
    return gaps


@pytest.mark.parametrize("label", ["bottom camera", "localization"])
def test_a_part_is_replaced_without_a_gap(field: Field, label: str) -> None:
    field.manager.add_transformation(OTHER)
    claim = field.flowing()
    gaps = watch(field, claim.topic)
    kept = set(field.host.running) - {f"/{label.replace(' ', '_')}_1"}
    field.manager.remove_transformation(label)
    field.tidy()
    assert gaps == []
    assert kept <= set(field.host.running)
    assert label not in field.labels()
    field.check_flows(claim)


def test_a_replacement_that_does_not_deliver_takes_over_all_the_same(field: Field) -> None:
    field.manager.add_transformation(OTHER)
    claim = field.flowing()
    field.host.silent.add("/other_localization_1")
    field.manager.remove_transformation("localization")
    before = field.now
    field.tick()
    assert 2.0 <= field.now - before <= 2.5
    assert "took over though it sent nothing within 2 s" in field.reasons()[-1]
    assert field.host.publishers(claim.topic) == ["/other_localization_1"]
    field.tidy()


def test_nobody_waits_where_nothing_flows_anyway(field: Field) -> None:
    claim = field.flowing()
    field.host.silent.add("soccer/Camera")
    field.host.vanish("/localization_1")
    before = field.now
    field.tick()
    assert field.now - before < 0.3
    assert field.state(claim.claim_id) is ClaimState.ACTIVE


@pytest.mark.parametrize(
    ("operation", "part"),
    [("load", "ceiling"), ("loaded", "ceiling"), ("ports", "ceiling"), ("connect", "subsampler")],
)
def test_a_mend_that_fails_leaves_the_stream_as_it_was(
    field: Field, operation: str, part: str
) -> None:
    claim = field.flowing()
    before = {name: dict(field.host.nodelet(name).ports) for name in field.host.running}
    field.host.fail_at(operation, part)
    field.manager.remove_transformation("bottom camera")
    field.settle(5.0)
    assert field.state(claim.claim_id) is ClaimState.FAILED
    assert "it is broken" in field.claim(claim.claim_id).detail
    assert {name: field.host.nodelet(name).ports for name in field.host.running} == before
    assert claim.topic in field.moving, "it flows on as it was"
    field.host.recover()
    field.tidy()
    field.check_flows(claim)
    assert "bottom camera" not in field.labels()


@pytest.mark.parametrize(
    ("operation", "part"),
    [
        (operation, part)
        for operation in ("load", "loaded", "ports", "connect")
        for part in ("bottom_camera", "subsampler", "detector", "localization")
        if (operation, part) != ("connect", "bottom_camera")  # it is loaded connected
    ],
)
def test_a_request_that_fails_leaves_nothing(field: Field, operation: str, part: str) -> None:
    field.host.fail_at(operation, part)
    with pytest.raises((SpawnFailed, HostError), match="it is broken"):
        field.acquire()
    assert (field.host.running, field.reconciler.claims()) == ([], [])
    assert field.host.parameters == {}
    field.host.recover()
    field.flowing()


def test_a_type_that_was_not_stated_is_verified(field: Field) -> None:
    field.host.sources["soccer/Odd"] = [("yuv", "out", POINT)]
    field.manager.add_transformation(
        transformation("odd camera", "soccer/Odd", "out yuv", "yuv YUV(field)", cost=0)
    )
    odd = field.reconciler.acquire(StreamRequest(GOAL), dry_run=True)
    assert "odd camera" in odd.spawned
    acquired = field.acquire()
    assert "odd camera" not in field.labels(), "there is another way"
    assert acquired.claim.state is ClaimState.ACTIVE
    field.reconciler.release(acquired.claim.claim_id)
    field.tidy()
    for _ in range(2):
        with pytest.raises(StreamTypeMismatch, match="port 'yuv' of transformation 'subsampler'"):
            field.acquire(exclude=("bottom camera", "ceiling camera"))
    assert (field.host.running, field.living()) == ([], [])


@pytest.mark.parametrize("cameras", [1, 2])
def test_an_in_port_of_another_type_leaves_its_supplier_to_others(
    field: Field, cameras: int
) -> None:
    if cameras == 1:
        field.manager.remove_transformation("ceiling camera")
    field.host.sources["soccer/Cloud"] = [("yuv", "in", POINT), ("planes", "out", IMAGE)]
    text = "in yuv, out planes", "yuv YUV(?where); planes Planes(field)"
    field.manager.add_transformation(transformation("cloud", "soccer/Cloud", *text, cost=0))
    request = StreamRequest("Planes(field)")
    assert "cloud" in field.reconciler.acquire(request, dry_run=True).spawned
    claim = field.flowing("Planes(field)")
    field.check_flows(claim)
    assert "subsampler" in field.labels() and "cloud" not in field.labels()


def test_a_stream_that_others_listen_to_is_relayed(field: Field) -> None:
    field.manager.add_transformation(OTHER)
    first = field.acquire(exclude=("other localization",)).claim
    second = field.acquire(exclude=("localization",)).claim
    assert first.topic != second.topic
    field.settle()
    field.manager.remove_transformation("localization")
    field.settle()
    assert field.state(first.claim_id) is ClaimState.DEGRADED
    third = field.acquire().claim
    assert third.topic not in (first.topic, second.topic), "it excludes less than the other two"
    assert "relay" in third.goal[0] and second.goal[0] in third.nodelets
    field.settle()
    field.check_flows(third)
    for claim in (first, third):
        field.reconciler.release(claim.claim_id)
    field.tidy()
    assert field.host.publishers(first.topic) == []


def test_an_ordinary_topic_takes_over_through_a_relay(field: Field) -> None:
    claim = field.acquire().claim
    other = field.flowing("FieldPosition(?what)")
    referee = topic("referee", "/referee/ball", GOAL, datatype=POINT)
    field.manager.add_transformation(referee)
    field.host.topics.add("/referee/ball")
    field.manager.remove_transformation("localization")
    field.tidy()
    assert field.host.publishers(claim.topic) == ["/relay_of_referee_ball_1"]
    assert other.topic != claim.topic
    assert field.labels() == ["relay of /localization_1/position", "relay of /referee/ball"]
    field.check_flows(claim, other)
    field.host.topics.discard("/referee/ball")
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.PENDING
    assert field.host.publishers(claim.topic) == field.host.publishers(other.topic) == []
    field.reconciler.release(other.claim_id)
    field.manager.add_transformation(LIBRARY)
    field.tidy()
    assert field.labels() == CHAIN
    field.check_flows(claim)
    with pytest.raises(NoPlanFound):
        field.acquire("FieldPosition(goal)")


@pytest.mark.parametrize("plain", ["Subsampler", "Localization", "Camera", "Ceiling"])
def test_cpp_nodelets_take_part(field: Field, plain: str) -> None:
    field.host.cpp.add(f"soccer/{plain}")
    field.manager.add_transformation(OTHER)
    claim = field.acquire(max_silence=1.0).claim
    for label in ("bottom camera", "localization"):
        field.settle(5.0)
        field.check_flows(claim)
        field.manager.remove_transformation(label)
    field.settle(5.0)
    field.check_flows(claim)
    field.host.silent.add("/subsampler_1")
    field.settle(5.0)
    field.check_flows(claim)
    field.tidy()
