# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parts of claimed streams that fall silent."""

from __future__ import annotations

import pytest
from unit.manager.field import CHAIN, FIRST_MESSAGE, Field

from dyknow.errors import HostError, HostTimeout
from dyknow.model.streams import ClaimState


@pytest.fixture
def field() -> Field:
    return Field()


def test_silence_is_nobody_s_business_unless_a_claim_says_so(field: Field) -> None:
    field.acquire()
    field.settle(1.0)
    field.host.silent.add("/bottom_camera_1")
    field.host.calls.clear()
    field.settle(20.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]
    assert not [call for call in field.host.calls if call[0] == "counts"]


@pytest.mark.parametrize("label", CHAIN)
def test_a_silent_nodelet_is_replaced_and_only_that_one(field: Field, label: str) -> None:
    claim = field.acquire(max_silence=1.0).claim
    field.settle(5.0)
    victim = f"/{label.replace(' ', '_')}_1"
    others = set(field.host.running) - {victim}
    field.host.silent.add(victim)
    field.settle(1.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.settle(0.6)
    what = f"mended: nodelet {victim} was silent for longer than 1 s"
    assert f"{what}; {victim[:-1]}2 is used now" in field.reasons()
    field.settle(5.0)
    assert others <= set(field.host.running)
    assert victim not in field.host.running, "what is silent does not linger"
    assert field.claim(claim.claim_id).topic == claim.topic
    assert claim.topic in field.moving
    assert sum("silent" in reason for reason in field.reasons()) == 2


@pytest.mark.parametrize("label", CHAIN)
def test_who_is_just_going_says_nothing_of_its_neighbours(field: Field, label: str) -> None:
    field.acquire(max_silence=1.0)
    field.settle(5.0)
    victim = f"/{label.replace(' ', '_')}_1"
    others = set(field.host.running) - {victim}

    def going(operation: str, argument: str) -> None:
        if (operation, argument) == ("counts", victim):
            raise HostError("the service is not offered any more")

    field.host.fail = going
    field.settle(10.0)
    assert victim not in field.host.running
    assert others <= set(field.host.running), "they are re-wired"
    assert sorted(field.labels()) == sorted(CHAIN)


def test_what_is_silent_again_and_again_gives_way_to_another(field: Field) -> None:
    claim = field.acquire(max_silence=1.0).claim
    field.settle(5.0)
    field.host.silent.add("soccer/Camera")
    field.settle(15.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert "ceiling camera" in field.labels()
    assert claim.topic in field.moving


def test_where_there_is_no_other_way_the_pauses_grow(field: Field) -> None:
    claim = field.acquire(max_silence=1.0).claim
    field.settle(5.0)
    field.host.silent.add("soccer/Localization")
    field.host.calls.clear()
    for _ in range(20):
        field.settle(10.0)
    spawned = [call for call in field.host.calls if call[0] == "load"]
    assert 3 <= len(spawned) <= 10
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    assert "was silent for longer" in field.claim(claim.claim_id).detail
    field.host.silent.clear()
    field.settle(70.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert claim.topic in field.moving
    field.tidy()


def test_an_ordinary_topic_can_be_silent_too(field: Field) -> None:
    claim = field.acquire(max_silence=1.0).claim
    field.settle(5.0)
    field.host.silent.add("/joint_states")
    field.settle(3.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    assert "topic /joint_states was silent" in field.claim(claim.claim_id).detail
    assert field.labels() == CHAIN
    field.host.silent.clear()
    field.settle(3.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.labels() == CHAIN


def test_a_silent_nodelet_made_by_hand_is_passed_over_not_destroyed(field: Field) -> None:
    field.spawn("bottom camera", "/camera", config={"image": "/camera/image"})
    claim = field.acquire(max_silence=1.0).claim
    assert "/camera" in claim.nodelets
    field.settle(5.0)
    field.host.silent.add("/camera")
    field.settle(5.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert "/camera" not in field.claim(claim.claim_id).nodelets
    assert claim.topic in field.moving
    field.tidy()
    field.host.silent.clear()
    field.settle(5.0)
    assert "/camera" not in field.claim(claim.claim_id).nodelets, "it is not taken back by itself"


def test_two_claims_with_different_patience_share_a_part(field: Field) -> None:
    patient = field.acquire(max_silence=60.0).claim
    careless = field.acquire("RelativePosition(ball)").claim
    keen = field.acquire("Planes(field)", max_silence=1.0).claim
    field.settle(5.0)
    field.host.silent.add("/bottom_camera_1")
    field.settle(5.0)
    for claim in (patient, careless, keen):
        assert field.state(claim.claim_id) is ClaimState.ACTIVE
        assert field.claim(claim.claim_id).topic == claim.topic
        assert claim.topic in field.moving
    field.tidy()
    assert field.labels() == CHAIN


def without_looks(field: Field) -> None:
    """Let only the watch find out that a nodelet manager hangs."""
    field.manager.look = lambda changed=None: None  # type: ignore[method-assign]


def test_a_slow_network_makes_nobody_silent(field: Field) -> None:
    field.acquire(max_silence=0.5)
    field.settle(5.0)
    before = field.host.running

    def take_long(operation: str, argument: str) -> None:
        if operation == "counts":
            field.sleep(0.3)

    field.host.fail = take_long
    field.settle(20.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]
    assert field.host.running == before


def test_a_count_that_cannot_be_read_is_no_silence(field: Field) -> None:
    field.acquire(max_silence=0.5)
    field.settle(5.0)
    before = field.host.running

    def lose_most(operation: str, argument: str) -> None:
        if operation == "counts" and int(field.now) % 2:
            raise HostTimeout("no answer in time")

    field.host.fail = lose_most
    field.settle(20.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]
    assert field.host.running == before


def test_who_waits_for_a_part_that_hangs_is_not_blamed(field: Field) -> None:
    field.spawn("bottom camera", "/mine", config={"image": "/mine/image"}, isolated=True)
    claim = field.acquire(max_silence=0.5).claim
    field.settle(5.0)
    others = set(claim.nodelets) - {"/mine"}
    without_looks(field)
    field.host.hang(field.manager.graph.get("/mine").manager)
    field.settle(10.0)
    assert others <= set(field.living()[0].nodelets), "they were re-wired"
    assert [reason for reason in field.reasons() if reason.startswith("mended")] == [
        "mended: nodelet /mine does not answer; /bottom_camera_1 is used now"
    ]
    assert claim.topic in field.moving


def test_who_hung_can_be_used_again_when_it_answers(field: Field) -> None:
    field.spawn("ceiling camera", "/mine", config={"image": "/mine/image"}, isolated=True)
    field.acquire(max_silence=0.5)
    field.settle(5.0)
    without_looks(field)
    manager = field.manager.graph.get("/mine").manager
    field.host.hang(manager)
    field.settle(5.0)
    assert "/mine" not in field.living()[0].nodelets
    field.manager.remove_transformation("bottom camera")
    field.manager.remove_transformation("ceiling camera")
    field.settle(5.0)
    assert field.living()[0].state is ClaimState.DEGRADED
    field.host.wake(manager)
    field.settle(5.0)
    assert "/mine" in field.living()[0].nodelets
    assert field.living()[0].state is ClaimState.ACTIVE


def test_what_was_stopped_is_not_silent_when_it_goes_on(field: Field) -> None:
    field.spawn("bottom camera", "/mine", config={"image": "/mine/image"}, isolated=True)
    field.manager.remove_transformation("ceiling camera")
    field.manager.remove_transformation("bottom camera")
    field.acquire(max_silence=0.5)
    field.settle(5.0)
    without_looks(field)
    field.host.hang("/fake_0")
    field.host.hang("/fake_1")
    field.settle(10.0)
    field.host.wake("/fake_0")
    field.host.wake("/fake_1")
    field.settle(10.0)
    assert not [reason for reason in field.reasons() if "silent" in reason]
    assert field.living()[0].state is ClaimState.ACTIVE


@pytest.mark.parametrize("service", [1.0, 3.0, 7.0])
def test_two_that_fall_silent_in_turns_replace_each_other_at_once(
    field: Field, service: float
) -> None:
    """What has served between two failures is not left alone for longer than it has served."""
    claim = field.acquire("YUV(field)", max_silence=1.0).claim
    field.settle(10.0)
    for _ in range(16):
        (camera,) = field.claim(claim.claim_id).nodelets
        field.host.silent.add(camera)
        begin = field.now
        while field.claim(claim.claim_id).nodelets == (camera,):
            field.tick(0.1)
            assert field.now - begin <= 2.0
        field.host.silent.clear()
        for _ in range(int(service / 0.1)):
            field.tick(0.1)
