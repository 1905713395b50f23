# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims on the fake host: made, shared, kept alive through faults, and released."""

from __future__ import annotations

import contextlib
import itertools
import threading
import uuid
from dataclasses import replace
from typing import Any, Callable, Dict, Iterator, List
from unittest import mock

import pytest
from unit.manager.field import CHAIN, FIRST_MESSAGE, GOAL, LIBRARY, POINT, Field, transformation

from dyknow.errors import (
    Denied,
    HostError,
    InvalidTag,
    NoPlanFound,
    StreamTypeMismatch,
    UnknownClaim,
)
from dyknow.guards import Guards
from dyknow.manager.claim import Claim
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest


def check_flows(field: Field, *claims: Claim) -> None:
    """Each claim is whole, and its client listens where it did."""
    for claim in claims:
        assert field.state(claim.claim_id) is ClaimState.ACTIVE, field.reasons()
        assert field.claim(claim.claim_id).topic == claim.topic in field.moving


def fail_at(field: Field, operation: str, part: str) -> None:
    def fail(what: str, name: str) -> None:
        if what == operation and part in name:
            raise HostError("out of memory")

    field.host.fail = fail


def mend_host(field: Field) -> None:
    field.host.recover()


# Requests


def test_a_stream_is_made_from_the_library(field: Field) -> None:
    intended = field.reconciler.acquire(StreamRequest(GOAL), dry_run=True)
    assert sorted(intended.spawned) == CHAIN
    assert (field.host.running, field.reconciler.claims()) == ([], [])
    acquired = field.acquire()
    claim = acquired.claim
    assert (claim.state, claim.datatype) == (ClaimState.ACTIVE, POINT)
    assert (field.labels(), len(acquired.spawned), acquired.cost) == (CHAIN, 4, 4)
    assert claim.topic == field.host.nodelet(claim.goal[0]).ports["position"].topic
    assert field.host.nodelet("/detector_1").ports["joints"].topic == "/joint_states"
    field.settle()
    assert field.reasons() == ["requested", FIRST_MESSAGE]


def test_two_claims_share_and_the_last_one_clears(field: Field) -> None:
    first = field.acquire().claim
    second = field.acquire("RelativePosition(ball)")
    assert second.spawned == ()
    field.reconciler.release(first.claim_id)
    field.settle(60.0)
    assert field.labels() == ["bottom camera", "detector", "subsampler"]
    assert field.state(second.claim.claim_id) is ClaimState.ACTIVE
    for _ in range(2):
        field.reconciler.release(second.claim.claim_id)
    field.settle(4.0)
    assert field.host.running != []
    field.settle(3.0)
    assert field.host.running == []


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
    text = transformation("weather", "weather", "out out", "out Weather")
    field.manager.add_transformation(
        text.replace("<transformation", '<transformation type="topic"')
    )
    field.host.topics.add("/weather")
    claim = field.acquire("Weather").claim
    assert (claim.topic, claim.sources) == ("/weather", ("/weather",))


def test_bad_requests_are_refused(field: Field) -> None:
    with pytest.raises(InvalidTag):
        field.acquire("FieldPosition(")
    with pytest.raises(StreamTypeMismatch, match="geometry_msgs/PointStamped.*std_msgs/Header"):
        field.acquire(datatype="std_msgs/Header")
    with pytest.raises(NoPlanFound, match="nothing supplies Nothing"):
        field.reconciler.acquire(StreamRequest("Nothing(x)"), dry_run=True)
    assert (field.host.running, field.reconciler.claims()) == ([], [])


def test_read_only_refuses_new_claims_but_not_dry_runs(field: Field) -> None:
    claim = field.acquire().claim
    field.manager.guards = Guards(read_only=True)
    for change in (field.acquire, lambda: field.reconciler.replan(claim.claim_id)):
        with pytest.raises(Denied, match="read-only"):
            change()
    field.reconciler.acquire(StreamRequest(GOAL), dry_run=True)


# Faults

FAULTS: Dict[str, Callable[[Field], object]] = {
    "camera destroyed": lambda field: field.manager.destroy("/bottom_camera_1"),
    "subsampler destroyed": lambda field: field.manager.destroy("/subsampler_1"),
    "localization destroyed": lambda field: field.manager.destroy("/localization_1"),
    "unloaded by others": lambda field: field.host.vanish("/detector_1"),
    "manager killed": lambda field: field.host.kill("/fake_0"),
    "manager hangs": lambda field: field.host.hang("/fake_0"),
    "connected elsewhere": lambda field: (
        field.host.connect("/subsampler_1", {"yuv": "/somewhere"}),
        field.manager.look(),
    ),
    "camera removed from the library": lambda field: (
        field.manager.remove_transformation("bottom camera")
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_repaired_behind_the_same_topic(field: Field, fault: str) -> None:
    claim = field.acquire().claim
    field.settle()
    FAULTS[fault](field)
    field.settle()
    check_flows(field, claim)
    assert [each for each in field.reasons() if each.startswith("mended: ")]
    if "manager" not in fault:
        assert len(set(claim.nodelets) - set(field.claim(claim.claim_id).nodelets)) <= 1
    for manager in list(field.host.processes):
        field.host.wake(manager)
    field.tidy()
    camera = "ceiling camera" if "library" in fault else "bottom camera"
    assert field.labels() == sorted({*CHAIN, camera} - {"bottom camera"} | {camera})


@pytest.mark.parametrize("fault", ["hang", "kill"])
def test_one_loss_is_one_repair_however_soon_a_round_follows(field: Field, fault: str) -> None:
    field.acquire()
    field.settle()
    del field.events[:]
    getattr(field.host, fault)("/fake_0")
    with reconciling_at_once(field):
        field.manager.look()
    field.settle()
    states = [each.after.state for each in field.events]
    changes = [state for state, _ in itertools.groupby(states)]
    assert changes == [ClaimState.RECOVERING, ClaimState.ACTIVE], field.reasons()


@contextlib.contextmanager
def reconciling_at_once(field: Field) -> Iterator[None]:
    """Reconcile after each change, as soon as no work on a nodelet is under way."""
    graph, asked, at_work = field.manager.graph, [], []
    real = graph.changing

    @contextlib.contextmanager
    def changing(name: str, *args: Any, **kwds: Any) -> Iterator[Any]:
        at_work.append(name)
        try:
            with real(name, *args, **kwds) as record:
                yield record
        finally:
            at_work.remove(name)
        if asked and not at_work:
            at_work.append("the reconciler")
            asked.clear()
            reconciling = threading.Thread(target=field.reconciler.reconcile)  # as in the node
            reconciling.start()
            reconciling.join()
            at_work.remove("the reconciler")

    with mock.patch.object(graph, "changing", changing), mock.patch.object(
        graph, "on_change", lambda: asked.append(True)
    ):
        yield


def test_a_nodelet_manager_that_dies_again_and_again_is_given_pauses(field: Field) -> None:
    claim = field.acquire().claim
    field.settle(20.0)
    for _ in range(6):
        field.host.kill("/fake_0")
        field.tick()
    assert field.state(claim.claim_id) is ClaimState.RECOVERING
    assert "failed lately" in field.living()[0].detail
    field.tidy()
    check_flows(field, claim)


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_part_that_answers_again_leaves_the_topic_to_its_successor(
    field: Field, is_restarted: bool
) -> None:
    field.spawn("bottom camera", "/mine", config={"image": "/mine/image"}, isolated=True)
    claim = field.acquire("YUV(field)").claim
    assert claim.topic == "/mine/image"
    manager = field.manager.graph.get("/mine").manager
    field.settle()
    field.host.hang(manager)
    field.settle(5.0)
    check_flows(field, claim)
    assert field.claim(claim.claim_id).nodelets == ("/bottom_camera_1",)
    if is_restarted:
        field.kill_manager()
        field.settle()
    field.host.wake(manager)
    field.tick()
    assert field.host.publishers(claim.topic) == ["/bottom_camera_1"]
    check_flows(field, claim)
    assert field.manager.graph.get("/mine").state is State.RUNNING


def test_parts_that_users_destroy_or_protect(field: Field) -> None:
    field.spawn("bottom camera", "/camera", config={"image": "/camera/image"})
    claim = field.acquire().claim
    field.destroy_by_hand("/camera")
    field.settle()
    check_flows(field, claim)
    field.manager.set_protection("/subsampler_1", True)
    field.reconciler.release(claim.claim_id)
    field.settle(30.0)
    assert field.host.running == ["/subsampler_1"]
    field.manager.set_protection("/subsampler_1", False)
    field.tidy()
    assert field.host.running == []


def test_a_part_that_goes_during_a_repair_is_replaced_too(field: Field) -> None:
    field.acquire()
    field.settle(5.0)

    def goes(operation: str, argument: str) -> None:
        if operation == "load":
            mend_host(field)
            field.manager.destroy("/detector_1")

    field.manager.destroy("/bottom_camera_1")
    field.host.fail = goes
    field.settle(1.0)
    assert ClaimState.FAILED not in [event.after.state for event in field.events]
    assert field.living()[0].state is ClaimState.ACTIVE
    assert {"/detector_2", "/subsampler_1", "/localization_1"} <= set(field.host.running)


def test_a_repair_that_fails_is_tried_again_after_pauses(field: Field) -> None:
    claim = field.acquire().claim
    fail_at(field, "load", "localization")
    field.manager.destroy("/localization_1")
    attempts: List[bool] = []
    for _ in range(100):
        before = len(field.host.calls)
        field.settle(1.0)
        attempts.append(("load", "/localization_2") in field.host.calls[before:])
    assert field.state(claim.claim_id) is ClaimState.FAILED
    assert "out of memory" in field.reconciler.claims()[0].detail
    assert 2 <= attempts.count(True) < 12
    mend_host(field)
    field.settle(100.0)
    check_flows(field, claim)


# The library


def test_a_removed_transformation_without_another_way_flows_on_degraded(field: Field) -> None:
    claim = field.acquire().claim
    field.manager.remove_transformation("localization")
    field.settle(20.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    detail = field.living()[0].detail
    assert "localization was removed" in detail and f"nothing supplies {GOAL}" in detail
    assert claim.topic in field.moving
    assert len(field.events) == 2
    field.manager.add_transformation(LIBRARY)
    field.settle()
    check_flows(field, claim)
    assert field.labels() == CHAIN


def test_a_claim_waits_for_a_transformation_and_for_a_nodelet_made_by_hand(field: Field) -> None:
    waiting = []
    for tag in ("Ghost(field)", "Sound(field)"):
        with pytest.raises(NoPlanFound, match="waits until it can be made") as raised:
            field.acquire(tag, request_id=tag)
        waiting.append(raised.value.claim_id)
        with pytest.raises(NoPlanFound) as again:
            field.acquire(tag, request_id=tag)
        assert again.value.claim_id == raised.value.claim_id
    field.settle()
    planner, plans = field.reconciler._planner._planner, []
    with mock.patch.object(planner, "plan", lambda *args, **kwds: plans.append(args)):
        field.settle(20.0)
    assert plans == [], "nothing has changed"
    for label, tag in (("ghosts", "Ghost(field)"), ("noise", "Sound(field)")):
        text = transformation(label, "soccer/Camera", "out image", f"image {tag}")
        field.manager.add_transformation(text)
        if label == "noise":
            field.spawn(label, "/noise", config={"image": "/noise/image"})
        field.settle()
        states = [field.state(each) is ClaimState.ACTIVE for each in waiting]
        assert states == [True, label == "noise"]
    field.tidy()


def test_a_pending_claim_says_so_while_what_it_needs_is_left_alone(field: Field) -> None:
    field.host.topics.clear()
    with pytest.raises(NoPlanFound, match=r"nothing supplies Joints\(\?robot\)") as raised:
        field.acquire()
    claim_id = raised.value.claim_id
    fail_at(field, "load", "detector")
    field.host.topics.add("/joint_states")
    field.settle(30.0)
    assert field.state(claim_id) is ClaimState.FAILED
    assert len(field.claim(claim_id).detail) < 100
    assert len(field.events) < 4
    mend_host(field)
    field.settle(70.0)
    assert field.state(claim_id) is ClaimState.ACTIVE
    assert field.reasons()[-2:] == ["it can be made now", FIRST_MESSAGE]


# Several claims


def test_claims_that_share_all_of_a_chain_are_mended_together(field: Field) -> None:
    tags = (GOAL, "FieldPosition(?what)", "RelativePosition(ball)")
    claims = [field.acquire(tag).claim for tag in tags]
    kept = {name for name in field.host.running if "camera" not in name}
    field.manager.remove_transformation("bottom camera")
    field.tidy()
    assert kept <= set(field.host.running)
    check_flows(field, *claims)
    assert len(field.host.running) == 5, "a relay brings one position to two topics"


@pytest.mark.parametrize("ids", ["01", "10"])
def test_a_part_that_a_client_listens_to_is_replaced_on_its_topic(
    field: Field, monkeypatch: pytest.MonkeyPatch, ids: str
) -> None:
    each_id = (uuid.UUID(int=int(number) << 127) for number in ids)
    monkeypatch.setattr("dyknow.manager.claims.reconciler.uuid.uuid4", lambda: next(each_id))
    whole = field.acquire().claim
    part = field.acquire("RelativePosition(ball)").claim
    field.destroy_by_hand(part.goal[0])
    field.tidy()
    check_flows(field, whole, part)
    assert not [name for name in field.host.running if "relay" in name]


def test_an_excluded_part_does_not_come_to_a_claim_through_others(field: Field) -> None:
    picky = field.acquire(exclude=("ceiling camera",)).claim
    easy = field.acquire("RelativePosition(ball)").claim
    field.manager.remove_transformation("bottom camera")
    field.settle()
    check_flows(field, easy)
    parts = set(field.claim(easy.claim_id).nodelets)
    assert not parts & set(picky.nodelets), "what excludes less does not change a shared part"
    assert field.state(picky.claim_id) is ClaimState.PENDING
    assert "ceiling camera is excluded" in field.claim(picky.claim_id).detail
    field.manager.add_transformation(LIBRARY)
    field.settle()
    assert field.state(picky.claim_id) is ClaimState.ACTIVE
    cameras = [name for name in field.claim(picky.claim_id).nodelets if "camera" in name]
    assert not any("ceiling" in name for name in cameras) and cameras


# Clients


def test_leases_end_unless_they_are_renewed_be_it_during_a_repair(field: Field) -> None:
    claim = field.acquire(lease=10.0).claim
    field.settle(9.0)
    field.host.fail = lambda operation, argument: (
        field.reconciler.renew(claim.claim_id, 10.0) and None if operation == "load" else None
    )
    field.manager.destroy("/localization_1")
    field.settle(1.0)
    mend_host(field)
    field.settle(8.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.settle(2.0)
    assert field.state(claim.claim_id) is ClaimState.EXPIRED
    with pytest.raises(UnknownClaim, match="expired"):
        field.reconciler.renew(claim.claim_id, 10.0)
    field.tidy()
    assert field.host.running == []


def test_a_client_that_is_gone_ends_its_claim(field: Field) -> None:
    claim = field.acquire(bond_id="b", client_id="c").claim
    field.reconciler.expire(claim.claim_id, "its bond broke")
    field.reconciler.expire(claim.claim_id, "again")
    assert field.state(claim.claim_id) is ClaimState.EXPIRED
    assert field.reasons()[-1] == "its bond broke"
    with pytest.raises(UnknownClaim, match="expired"):
        field.reconciler.replan(claim.claim_id)
    field.tidy()
    assert field.host.running == []


def test_a_claim_that_is_released_during_a_repair_stays_released(field: Field) -> None:
    claim = field.acquire(lease=100.0).claim
    field.settle()

    def release(operation: str, argument: str) -> None:
        if operation == "load":
            field.reconciler.release(claim.claim_id)

    field.host.fail = release
    field.manager.destroy("/localization_1")
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.RELEASED
    assert field.store.read("claims", lambda key, text: text) == {}
    field.tidy()
    assert field.host.running == []


def test_only_so_many_ended_claims_are_remembered(field: Field) -> None:
    for _ in range(120):
        field.reconciler.release(field.acquire().claim.claim_id)
    assert len(field.reconciler.claims()) == 100
    field.tidy()
    assert field.host.running == []


# The manager


def test_claims_survive_the_manager(field: Field) -> None:
    claim = field.acquire(lease=100.0, client_id="c", request_id="r").claim
    running = field.host.running
    field.host.calls.clear()
    field.kill_manager()
    field.settle(1.0)
    assert field.reconciler.claims() == [replace(claim, detail="")]
    assert field.host.running == running
    assert "load" not in {operation for operation, _ in field.host.calls}
    assert field.acquire(client_id="c", request_id="r").claim.claim_id == claim.claim_id
    field.host.kill("/fake_0")
    field.kill_manager()
    field.settle()
    check_flows(field, claim)


def test_a_manager_that_is_stopped_ends_its_claims(field: Field) -> None:
    claim = field.acquire().claim
    field.reconciler.end()
    field.manager.end()
    field.reconciler.reconcile()
    assert field.state(claim.claim_id) is ClaimState.RELEASED
    assert field.host.running == []
    assert field.store.read("claims", lambda key, text: text) == {}


def test_while_the_master_is_away_streams_flow_on(field: Field) -> None:
    claim = field.acquire().claim
    field.settle()

    def away(operation: str, argument: str) -> None:
        if operation in ("published", "load", "connect"):
            raise HostError("no ROS master")

    field.host.fail = away
    events = len(field.events)
    field.settle(30.0)
    assert len(field.events) == events
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
