# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams without messages: before the first one, and after the last one."""

from __future__ import annotations

from typing import List

import pytest
from unit.manager.field import CHAIN, FIRST_MESSAGE, GOAL, IMAGE, POINT, Field, Ports, topic

from dyknow.errors import HostTimeout
from dyknow.model.streams import NO_MESSAGE, ClaimState

UNKNOWN = "not known whether messages come: the publisher of {} cannot be queried"


def called(field: Field, operation: str) -> bool:
    return operation in {each for each, _ in field.host.calls}


# A part falls silent


def test_silence_is_no_fault_unless_a_claim_says_so(field: Field) -> None:
    field.acquire()
    field.settle(1.0)
    field.host.silent.add("/bottom_camera_1")
    field.host.calls.clear()
    field.settle(20.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]
    assert not called(field, "counts")


@pytest.mark.parametrize("label", CHAIN)
def test_a_nodelet_that_is_going_discredits_no_neighbour(field: Field, label: str) -> None:
    field.acquire(max_silence=1.0)
    field.settle(5.0)
    victim = f"/{label.replace(' ', '_')}_1"
    others = set(field.host.running) - {victim}

    field.host.fail_at("counts", victim, "the service is not offered any more")
    field.settle(10.0)
    assert victim not in field.host.running
    assert others <= set(field.host.running), "they are re-wired"
    assert sorted(field.labels()) == sorted(CHAIN)


@pytest.mark.parametrize("is_lossy", [False, True])
def test_a_bad_network_makes_no_part_silent(field: Field, is_lossy: bool) -> None:
    field.acquire(max_silence=0.5)
    field.settle(5.0)
    before = field.host.running

    def network(operation: str, argument: str) -> None:
        if operation == "counts" and not is_lossy:
            field.sleep(0.3)
        elif operation == "counts" and int(field.now) % 2:
            raise HostTimeout("no answer in time")

    field.host.fail = network
    field.settle(20.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]
    assert field.host.running == before


@pytest.mark.parametrize("service", [1.0, 7.0])
def test_two_silent_in_turns_replace_each_other_at_once(field: Field, service: float) -> None:
    """A part that has served between two failures is paused no longer than it has served."""
    claim = field.acquire("YUV(field)", max_silence=1.0).claim
    field.settle(10.0)
    for _ in range(8):
        (camera,) = field.claim(claim.claim_id).nodelets
        field.host.silent.add(camera)
        begin = field.now
        while field.claim(claim.claim_id).nodelets == (camera,):
            field.tick(0.1)
            assert field.now - begin <= 2.0
        field.host.silent.clear()
        for _ in range(int(service / 0.1)):
            field.tick(0.1)


def test_topics_that_stay_silent_leave_the_stream_degraded(field: Field) -> None:
    for side in ("left", "right"):
        field.manager.add_transformation(topic(side, f"/{side}", "Image(x)", datatype=IMAGE))
        field.host.topics.add(f"/{side}")
    claim = field.flowing("Image(x)", max_silence=1.0)
    field.host.silent |= {"/left", "/right"}
    for _ in range(50):
        field.tick()
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    begin = len(field.events)
    for _ in range(300):
        field.tick()
    assert field.reasons()[begin:] == []
    field.host.silent.clear()
    field.settle(10.0)
    field.check_flows(claim)
    field.reconciler.release(claim.claim_id)
    field.tidy()
    assert field.host.listeners == []


# A process hangs, and only the counts show it


def without_looks(field: Field) -> None:
    field.manager.look = lambda changed=(): 0.0  # type: ignore[method-assign]


def test_a_part_that_waits_for_one_that_hangs_is_not_blamed(field: Field) -> None:
    field.spawn("bottom camera", "/mine", config={"image": "/mine/image"}, isolated=True)
    claim = field.acquire(max_silence=0.5).claim
    field.settle(5.0)
    others = set(claim.nodelets) - {"/mine"}
    without_looks(field)
    field.host.hang(field.manager.graph.get("/mine").manager)
    field.settle(10.0)
    assert others <= set(field.living()[0].nodelets), "they were re-wired"
    assert field.mended() == [
        "mended: nodelet /mine does not answer; /bottom_camera_1 is used now"
    ]
    assert claim.topic in field.moving


def test_a_nodelet_that_hung_can_be_used_again_when_it_answers(field: Field) -> None:
    field.spawn("ceiling camera", "/mine", config={"image": "/mine/image"}, isolated=True)
    field.acquire(max_silence=0.5)
    field.settle(5.0)
    without_looks(field)
    manager = field.manager.graph.get("/mine").manager
    field.host.hang(manager)
    field.settle(5.0)
    assert "/mine" not in field.living()[0].nodelets
    for label in ("bottom camera", "ceiling camera"):
        field.manager.remove_transformation(label)
    field.settle(5.0)
    assert field.living()[0].state is ClaimState.DEGRADED
    field.host.wake(manager)
    field.settle(5.0)
    assert "/mine" in field.living()[0].nodelets
    assert field.living()[0].state is ClaimState.ACTIVE


def test_a_nodelet_that_was_stopped_is_not_silent_when_it_goes_on(field: Field) -> None:
    field.spawn("bottom camera", "/mine", config={"image": "/mine/image"}, isolated=True)
    for label in ("bottom camera", "ceiling camera"):
        field.manager.remove_transformation(label)
    field.acquire(max_silence=0.5)
    field.settle(5.0)
    without_looks(field)
    for change in (field.host.hang, field.host.wake):
        for manager in ("/fake_0", "/fake_1"):
            change(manager)
        field.settle(10.0)
    assert not [reason for reason in field.reasons() if "silent" in reason]
    assert field.living()[0].state is ClaimState.ACTIVE


def test_no_silence_is_counted_while_everything_stands_still(field: Field) -> None:
    field.host.dividers["soccer/Camera"] = 5  # one message a second
    claim = field.flowing("YUV(field)", max_silence=2.5)
    for _ in range(5):
        field.settle(1.3)
        field.pause(10.0)
    assert not field.mended()
    field.host.silent.add("/bottom_camera_1")
    for _ in range(4):
        field.settle(1.3)
        field.pause(10.0)
    assert field.claim(claim.claim_id).nodelets == ("/bottom_camera_2",)


# The first message


def details(field: Field) -> List[str]:
    assert all(claim.state is ClaimState.ACTIVE for claim in field.living())
    return sorted(claim.detail for claim in field.living())


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_new_stream_says_so_until_the_first_message(field: Field, is_restarted: bool) -> None:
    field.host.silent.add("/localization_1")
    assert field.acquire().claim.detail == NO_MESSAGE
    field.settle(20.0)
    assert field.reasons() == ["requested"]
    if is_restarted:
        field.kill_manager()
        field.settle(2.0)
    assert details(field) == [NO_MESSAGE]
    field.host.silent.clear()
    field.settle(2.0)
    assert details(field) == [""]
    last = field.events[-1]
    assert (last.reason, last.before.detail, last.after.detail) == (FIRST_MESSAGE, NO_MESSAGE, "")
    field.host.calls.clear()
    field.settle(10.0)
    assert not called(field, "counts"), "nothing is counted any longer than need be"


def test_a_repaired_or_replanned_stream_says_so_again(field: Field) -> None:
    claim = field.acquire().claim
    field.settle(2.0)
    assert field.reconciler.replan(claim.claim_id).claim.detail == NO_MESSAGE
    field.settle(2.0)
    assert details(field) == [""]
    field.host.silent.add("soccer/Localization")
    field.host.vanish("/localization_1")
    field.settle(5.0)
    assert details(field) == [NO_MESSAGE]
    field.host.silent.clear()
    field.settle(2.0)
    assert sum(reason == FIRST_MESSAGE for reason in field.reasons()) == 3


def test_messages_before_the_request_do_not_count_but_a_latched_one_does(field: Field) -> None:
    field.acquire()
    field.settle(2.0)
    field.host.silent.add("/localization_1")
    assert field.acquire(request_id="another", client_id="me").claim.detail == NO_MESSAGE
    field.settle(5.0)
    assert details(field) == ["", NO_MESSAGE]
    field.host.nodelet("/localization_1").latched.add("position")
    field.settle(2.0)
    assert details(field) == ["", ""]


def test_a_publisher_that_cannot_be_polled_is_listened_to_only_for_a_limit(field: Field) -> None:
    referee = topic("referee", "/referee/ball", GOAL, datatype=POINT)
    field.manager.add_transformation(referee)
    field.host.topics.add("/referee/ball")
    claim = field.acquire().claim
    field.host.cpp.add("soccer/Camera")
    field.host.stock = True
    field.spawn("bottom camera", "/mine", config={"image": "/mine/image"})
    fixed = field.acquire("YUV(field)").claim
    field.settle(5.0)
    assert fixed.topic == "/mine/image"
    assert details(field) == sorted(UNKNOWN.format(each.topic) for each in (claim, fixed))
    assert not called(field, "listen")
    assert field.acquire(max_silence=2.0).claim.detail == NO_MESSAGE
    field.settle(2.0)
    assert "" in details(field)
    assert [each.topic for each in field.host.listeners] == ["/referee/ball"]


def test_a_latched_input_may_be_silent_while_the_stream_flows(field: Field) -> None:
    field.add("map", {"map": ("out", ["Map(floor)"])})
    field.add("scan", {"scan": ("out", ["Scan(floor)"])})
    inputs: Ports = {"map": ("in", ["Map(floor)"]), "scan": ("in", ["Scan(floor)"])}
    field.add("place", {**inputs, "pose": ("out", ["Pose(robot)"])})
    field.spawn("map", "/map_1", config={"map": "/map_1/map"})
    field.host.nodelet("/map_1").latched.add("map")
    field.tick()
    field.host.silent |= {"/map_1", "/place_1"}
    field.host.topics.add("/map_1/map")  # the messages that are there
    field.acquire("Pose(robot)", max_silence=1.0)
    field.settle(2.0)
    field.host.silent.remove("/place_1")  # it has been slow to start
    field.settle(12.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]
    field.host.silent.add("/place_1")
    field.settle(12.0)
    assert "/place_1 was silent for longer than 1 s" in "".join(field.reasons())
    assert {"/map_1", "/scan_1"} <= set(field.host.running)
    assert "/place_1" not in field.host.running
