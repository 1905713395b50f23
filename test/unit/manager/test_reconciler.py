# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims on the fake host: made, shared, mended, released, and durable."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from unit.manager.field import CHAIN, FIRST_MESSAGE, GOAL, LIBRARY, POINT, Field

from dyknow.errors import InvalidTag, NoPlanFound, SpawnFailed, StreamTypeMismatch, UnknownClaim
from dyknow.model.graph import SpawnRequest
from dyknow.model.streams import ClaimState, StreamRequest


@pytest.fixture
def field(tmp_path: Path) -> Field:
    return Field(str(tmp_path / "state.db"))


def test_a_stream_is_made_from_what_there_is(field: Field) -> None:
    acquired = field.acquire()
    claim = acquired.claim
    assert (claim.state, claim.datatype) == (ClaimState.ACTIVE, POINT)
    assert field.labels() == CHAIN
    assert len(acquired.spawned) == 4
    assert acquired.plan.cost == 4
    assert claim.topic == field.host.nodelet(claim.goal[0]).ports["position"].topic
    detector = field.host.nodelet("/detector_1")
    assert detector.ports["joints"].topic == "/joint_states"
    field.settle()
    assert field.reasons() == ["requested", FIRST_MESSAGE]


def test_what_runs_is_reused_and_not_collected(field: Field) -> None:
    field.manager.spawn(SpawnRequest("bottom camera", "mine", config={"image": "/mine/image"}))
    acquired = field.acquire()
    assert acquired.reused == ("/mine",)
    assert len(acquired.spawned) == 3
    field.reconciler.release(acquired.claim.claim_id)
    field.settle()
    field.settle(60.0)
    assert field.host.running == ["/mine"]


def test_two_claims_share_and_the_last_one_clears(field: Field) -> None:
    first = field.acquire().claim
    second = field.acquire("RelativePosition(ball)")
    assert second.spawned == ()
    field.reconciler.release(first.claim_id)
    field.settle()
    field.settle(60.0)
    assert field.labels() == ["bottom camera", "detector", "subsampler"]
    assert field.state(second.claim.claim_id) is ClaimState.ACTIVE
    field.reconciler.release(second.claim.claim_id)
    field.reconciler.release(second.claim.claim_id)
    field.settle()
    field.settle(4.0)
    assert field.host.running != []
    field.settle(2.0)
    assert field.host.running == []


def test_a_dry_run_changes_nothing(field: Field) -> None:
    answer = field.reconciler.acquire(StreamRequest(GOAL), dry_run=True)
    assert sorted(answer.spawned) == CHAIN
    assert (field.host.running, field.reconciler.claims()) == ([], [])
    with pytest.raises(NoPlanFound, match="nothing supplies Nothing"):
        field.reconciler.acquire(StreamRequest("Nothing(x)"), dry_run=True)
    assert field.reconciler.claims() == []


def test_the_same_request_is_the_same_claim(field: Field) -> None:
    first = field.acquire(client_id="c", request_id="r")
    again = field.acquire(client_id="c", request_id="r")
    other = field.acquire(client_id="d", request_id="r")
    assert first.claim.claim_id == again.claim.claim_id != other.claim.claim_id
    assert again.spawned == other.spawned == ()
    request = StreamRequest(GOAL, client_id="c", request_id="r")
    explained = field.reconciler.acquire(request, dry_run=True)
    assert explained.claim.claim_id == ""
    assert explained.plan is not None


def test_a_relative_topic_begins_in_the_manager_s_namespace(field: Field) -> None:
    field.manager.add_transformation(
        '<transformation type="topic"><label>weather</label><source>weather</source>'
        '<ports><port type="out">out</port></ports>'
        '<tags><tag port="out">Weather</tag></tags></transformation>'
    )
    field.host.topics.add("/weather")
    claim = field.acquire("Weather").claim
    assert (claim.topic, claim.sources) == ("/weather", ("/weather",))


def test_bad_tags_and_types_are_refused(field: Field) -> None:
    with pytest.raises(InvalidTag):
        field.acquire("FieldPosition(")
    with pytest.raises(StreamTypeMismatch, match="geometry_msgs/PointStamped.*std_msgs/Header"):
        field.acquire(datatype="std_msgs/Header")
    assert field.host.running == []
    assert field.reconciler.claims() == []


@pytest.mark.parametrize("victim", ["/bottom_camera_1", "/subsampler_1", "/localization_1"])
def test_a_nodelet_that_is_destroyed_is_replaced_behind_the_same_topic(
    field: Field, victim: str
) -> None:
    claim = field.acquire().claim
    field.manager.destroy(victim)
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.labels() == CHAIN
    assert field.reconciler.claims()[0].topic == claim.topic
    reasons = [event.reason for event in field.events]
    assert any("gone" in reason for reason in reasons)


def test_a_dead_nodelet_manager_takes_nothing_for_long(field: Field) -> None:
    claim = field.acquire().claim
    field.host.kill("/fake_0")
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.labels() == CHAIN
    assert field.reconciler.claims()[0].topic == claim.topic


def test_the_case_study_the_ceiling_camera_takes_over(field: Field) -> None:
    claim = field.acquire().claim
    kept = {name for name in field.host.running if "camera" not in name}
    field.manager.remove_transformation("bottom camera")
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert kept <= set(field.host.running), "the robot's own tracking goes on, re-wired"
    camera = field.host.nodelet("/ceiling_camera_1").ports["image"].topic
    assert field.host.nodelet("/subsampler_1").ports["yuv"].topic == camera
    field.settle(60.0)
    assert "/bottom_camera_1" not in field.host.running
    assert field.reconciler.claims()[0].topic == claim.topic


def test_a_cheaper_way_is_taken_on_request_only(field: Field) -> None:
    field.manager.remove_transformation("bottom camera")
    claim = field.acquire().claim
    assert "ceiling camera" in field.labels()
    field.manager.add_transformation(LIBRARY)
    field.settle(60.0)
    assert "bottom camera" not in field.labels()
    replanned = field.reconciler.replan(claim.claim_id)
    assert replanned.plan is not None
    field.settle(60.0)
    assert field.labels() == CHAIN
    assert field.reconciler.claims()[0].topic == claim.topic


def test_a_claim_waits_for_what_is_missing(field: Field) -> None:
    field.host.topics.clear()
    with pytest.raises(NoPlanFound, match=r"nothing supplies Joints\(\?robot\)") as raised:
        field.acquire()
    claim_id = raised.value.claim_id
    assert field.state(claim_id) is ClaimState.PENDING
    field.settle()
    assert field.host.running == []
    field.host.topics.add("/joint_states")
    field.settle()
    assert field.state(claim_id) is ClaimState.ACTIVE
    field.host.topics.clear()
    field.settle()
    assert field.state(claim_id) is ClaimState.PENDING
    assert "Joints" in field.reconciler.claims()[0].detail


def test_connecting_a_part_elsewhere_is_mended_where_a_claim_needs_it(field: Field) -> None:
    claim = field.acquire().claim
    field.host.connect("/subsampler_1", {"yuv": "/somewhere"})
    field.manager.look({"/subsampler_1"})
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.labels() == CHAIN


def test_a_failing_step_undoes_the_others_and_is_tried_again_later(field: Field) -> None:
    from dyknow.errors import HostError

    def fail(operation: str, argument: str) -> None:
        if operation == "load" and "localization" in argument:
            raise HostError("out of memory")

    field.host.fail = fail
    with pytest.raises(SpawnFailed, match="out of memory"):
        field.acquire()
    assert (field.host.running, field.reconciler.claims()) == ([], [])
    field.host.fail = lambda operation, argument: None
    claim = field.acquire().claim
    field.host.fail = fail
    field.manager.destroy("/localization_1")
    attempts = []
    for _ in range(100):
        before = len(field.host.calls)
        field.settle(1.0)
        attempts.append(
            any(call == ("load", "/localization_2") for call in field.host.calls[before:])
        )
    assert field.state(claim.claim_id) is ClaimState.FAILED
    assert "out of memory" in field.reconciler.claims()[0].detail
    assert 2 <= attempts.count(True) < 12
    field.host.fail = lambda operation, argument: None
    field.settle(100.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE


def test_leases_end_unless_they_are_renewed(field: Field) -> None:
    claim = field.acquire(lease=10.0).claim
    field.settle(9.0)
    field.reconciler.renew(claim.claim_id, 10.0)
    field.settle(9.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.settle(2.0)
    assert field.state(claim.claim_id) is ClaimState.EXPIRED
    with pytest.raises(UnknownClaim, match="expired"):
        field.reconciler.renew(claim.claim_id, 10.0)
    field.settle(60.0)
    assert field.host.running == []


def test_claims_survive_the_manager(field: Field) -> None:
    claim = field.acquire(lease=100.0, client_id="c", request_id="r").claim
    running = field.host.running
    loads = [call for call in field.host.calls if call[0] == "load"]
    field.store.close()
    field.open()
    field.settle(1.0)
    assert field.reconciler.claims() == [replace(claim, detail="")]
    assert field.host.running == running
    assert [call for call in field.host.calls if call[0] == "load"] == loads
    assert field.acquire(client_id="c", request_id="r").claim.claim_id == claim.claim_id
    field.store.close()
    field.host.kill("/fake_0")
    field.open()
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.reconciler.claims()[0].topic == claim.topic
