# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claimed streams through failures of nodelets, nodelet managers, libraries and clients."""

from __future__ import annotations

import contextlib
import itertools
import threading
import uuid
from typing import Any, Iterator
from unittest import mock

import pytest
from unit.manager.field import CHAIN, FIRST_MESSAGE, GOAL, LIBRARY, Field, transformation

from dyknow.errors import Denied, HostError, NoPlanFound, UnknownClaim
from dyknow.guards import Guards
from dyknow.model.streams import ClaimState, StreamRequest


@pytest.fixture
def field() -> Field:
    return Field()


class Killed(BaseException):
    """The manager's process ends here."""


# Nodelet managers


def test_a_nodelet_manager_that_hangs_is_left_and_told_when_it_wakes(field: Field) -> None:
    claim = field.acquire().claim
    field.settle()
    field.host.hang("/fake_0")
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.claim(claim.claim_id).topic == claim.topic
    assert claim.topic in field.moving
    assert {field.manager.graph.get(name).manager for name in field.living()[0].nodelets} == {
        "/fake_1"
    }
    field.host.wake("/fake_0")
    field.settle()
    assert field.host.publishers(claim.topic) == [field.living()[0].goal[0]]
    field.tidy()
    assert field.labels() == CHAIN


@pytest.mark.parametrize("fault", ["hang", "kill"])
def test_one_loss_is_one_repair_however_soon_somebody_looks(field: Field, fault: str) -> None:
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

    field.manager.graph.on_change = lambda: asked.append(True)
    with mock.patch.object(graph, "changing", changing):
        yield
    field.manager.graph.on_change = lambda: None


def test_a_hanging_manager_is_noticed_by_its_silence_first(field: Field) -> None:
    claim = field.acquire(max_silence=0.5).claim
    field.settle(5.0)
    looking = field.manager.look
    field.manager.look = lambda changed=None: None  # type: ignore[method-assign]
    field.host.hang("/fake_0")
    for _ in range(15):  # what has not answered for two seconds hangs
        field.tick()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert claim.topic in field.moving
    field.manager.look = looking  # type: ignore[method-assign]
    field.host.wake("/fake_0")
    field.tidy()
    assert field.labels() == CHAIN


def test_a_nodelet_manager_that_dies_again_and_again_is_given_pauses(field: Field) -> None:
    claim = field.acquire().claim
    field.settle(20.0)
    for _ in range(6):
        field.host.kill("/fake_0")
        field.tick()
    assert field.state(claim.claim_id) is ClaimState.RECOVERING
    assert "failed lately" in field.living()[0].detail
    field.tidy()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert claim.topic in field.moving


def test_parts_made_by_hand_come_back_and_leave_the_topic_to_their_successor(
    field: Field,
) -> None:
    field.acquire("RelativePosition(ball)")
    ball = field.living()[0].topic
    field.spawn("localization", "/mine", config={"ball": ball, "position": "/mine/position"})
    claim = field.acquire().claim
    assert claim.goal == ("/mine", "position")
    field.settle()
    field.host.kill("/fake_0")
    field.settle()
    field.tidy()
    assert len(field.host.publishers("/mine/position")) == 1
    assert field.claim(claim.claim_id).topic == "/mine/position" == claim.topic
    assert "/mine/position" in field.moving
    assert "/mine" in field.host.running


# What is unloaded, connected, protected


def test_what_is_protected_stays(field: Field) -> None:
    claim = field.acquire().claim
    field.manager.set_protection("/subsampler_1", True)
    field.reconciler.release(claim.claim_id)
    field.settle(30.0)
    assert field.host.running == ["/subsampler_1"]
    field.manager.set_protection("/subsampler_1", False)
    field.tidy()
    assert field.host.running == []


def test_a_nodelet_made_by_hand_may_be_taken_away(field: Field) -> None:
    field.spawn("bottom camera", "/camera", config={"image": "/camera/image"})
    claim = field.acquire().claim
    field.settle()
    field.destroy_by_hand("/camera")
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert claim.topic in field.moving
    field.tidy()
    assert field.labels() == CHAIN


def test_the_same_part_unloaded_by_others_again_and_again_comes_back(field: Field) -> None:
    claim = field.acquire().claim
    for _ in range(10):
        field.host.vanish(next(n for n in field.host.running if "localization" in n))
        field.settle(0.5)
        assert field.state(claim.claim_id) is ClaimState.ACTIVE
        assert claim.topic in field.moving
    field.tidy()


# The library


def test_a_part_that_goes_while_another_one_is_replaced_is_replaced_too(field: Field) -> None:
    claim = field.acquire().claim
    field.settle(5.0)

    def goes(operation: str, argument: str) -> None:
        if operation == "load":
            field.host.fail = lambda operation, argument: None
            field.manager.destroy("/detector_1")

    field.manager.destroy("/bottom_camera_1")
    field.host.fail = goes
    field.settle(1.0)
    assert ClaimState.FAILED not in [event.after.state for event in field.events]
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert {"/detector_2", "/subsampler_1", "/localization_1"} <= set(field.host.running)


def test_a_removed_transformation_without_another_way_is_told_and_flows_on(field: Field) -> None:
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
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
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
    field.manager.add_transformation(
        transformation("ghosts", "soccer/Camera", "out image", "image Ghost(field)")
    )
    field.settle()
    assert field.state(waiting[0]) is ClaimState.ACTIVE
    assert field.state(waiting[1]) is ClaimState.PENDING
    field.manager.add_transformation(
        transformation("noise", "soccer/Camera", "out image", "image Sound(field)")
    )
    field.spawn("noise", "/noise", config={"image": "/noise/image"})
    field.settle()
    assert field.state(waiting[1]) is ClaimState.ACTIVE
    field.tidy()


def test_a_pending_claim_costs_no_planning_while_nothing_changes(field: Field) -> None:
    with pytest.raises(NoPlanFound):
        field.acquire("Ghost(field)")
    field.settle()
    planner = field.reconciler._planner._planner
    plans = []
    planning = planner.plan
    planner.plan = lambda *args, **kwds: plans.append(args) or planning(*args, **kwds)  # type: ignore
    field.settle(20.0)
    assert plans == []


def test_a_pending_claim_says_so_while_what_it_needs_is_left_alone(field: Field) -> None:
    field.host.topics.clear()
    with pytest.raises(NoPlanFound) as raised:
        field.acquire()
    claim_id = raised.value.claim_id

    def fail(operation: str, argument: str) -> None:
        if operation == "load" and "detector" in argument:
            raise HostError("out of memory")

    field.host.fail = fail
    field.host.topics.add("/joint_states")
    field.settle(30.0)
    assert field.state(claim_id) is ClaimState.FAILED
    assert len(field.claim(claim_id).detail) < 100
    assert len(field.events) < 4
    field.host.fail = lambda operation, argument: None
    field.settle(70.0)
    assert field.state(claim_id) is ClaimState.ACTIVE
    assert field.reasons()[-2:] == ["it can be made now", FIRST_MESSAGE]


# Several claims


def test_claims_that_share_all_of_a_chain_are_mended_together(field: Field) -> None:
    claims = [field.acquire().claim, field.acquire("FieldPosition(?what)").claim]
    claims.append(field.acquire("RelativePosition(ball)").claim)
    kept = {name for name in field.host.running if "camera" not in name}
    field.manager.remove_transformation("bottom camera")
    field.tidy()
    assert kept <= set(field.host.running)
    for claim in claims:
        assert field.state(claim.claim_id) is ClaimState.ACTIVE
        assert field.claim(claim.claim_id).topic == claim.topic
        assert claim.topic in field.moving
    assert len(field.host.running) == 5, "one of them brings one position to two topics"


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
    for claim in (whole, part):
        assert field.claim(claim.claim_id).topic == claim.topic
        assert claim.topic in field.moving
    assert field.claim(part.claim_id).goal[0] != ""
    assert not [name for name in field.host.running if "relay" in name]


def test_a_variable_is_not_bound_anew_at_the_cost_of_another_claim(field: Field) -> None:
    field.manager.add_transformation(
        transformation("goal finder", "soccer/Camera", "out image", "image FieldPosition(goal)")
    )
    field.manager.remove_transformation("goal finder")
    first = field.acquire("FieldPosition(?what)").claim
    second = field.acquire("FieldPosition(ball)").claim
    assert first.topic != second.topic, "what one gets may change without the other"
    field.manager.add_transformation(
        transformation(
            "goal finder",
            "soccer/Localization",
            "out position",
            "position FieldPosition(goal)",
            cost=0,
        )
    )
    field.settle()
    field.manager.destroy("/localization_1")
    field.tidy()
    for claim in (first, second):
        assert field.state(claim.claim_id) is ClaimState.ACTIVE
        assert field.claim(claim.claim_id).topic == claim.topic
    assert field.host.publishers(first.topic) == ["/goal_finder_1"]
    assert field.claim(second.claim_id).goal[0].startswith("/localization")


def test_what_a_claim_excludes_does_not_come_to_it_through_others(field: Field) -> None:
    picky = field.acquire(exclude=("ceiling camera",)).claim
    easy = field.acquire("RelativePosition(ball)").claim
    field.manager.remove_transformation("bottom camera")
    field.settle()
    assert field.state(easy.claim_id) is ClaimState.ACTIVE
    assert easy.topic in field.moving
    assert field.state(picky.claim_id) is ClaimState.PENDING
    assert "ceiling camera is excluded" in field.claim(picky.claim_id).detail
    field.manager.add_transformation(LIBRARY)
    field.settle()
    assert field.state(picky.claim_id) is ClaimState.ACTIVE
    cameras = [name for name in field.claim(picky.claim_id).nodelets if "camera" in name]
    assert not any("ceiling" in name for name in cameras) and cameras


# Clients


def test_a_client_that_is_gone_ends_its_claim(field: Field) -> None:
    claim = field.acquire(bond_id="b", client_id="c").claim
    field.reconciler.expire(claim.claim_id, "its bond broke")
    field.reconciler.expire(claim.claim_id, "again")
    assert (field.state(claim.claim_id), field.reasons()[-1]) == (
        ClaimState.EXPIRED,
        "its bond broke",
    )
    with pytest.raises(UnknownClaim, match="expired"):
        field.reconciler.replan(claim.claim_id)
    field.tidy()
    assert field.host.running == []


def test_a_claim_that_is_released_while_it_is_mended_stays_released(field: Field) -> None:
    claim = field.acquire(lease=100.0).claim
    field.settle()

    def release(operation: str, argument: str) -> None:
        if operation == "load":
            field.reconciler.release(claim.claim_id)

    field.host.fail = release
    field.manager.destroy("/localization_1")
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.RELEASED
    assert field.store.claims() == {}
    field.tidy()
    assert field.host.running == []


def test_a_lease_that_is_renewed_during_a_mend_stays_renewed(field: Field) -> None:
    claim = field.acquire(lease=5.0).claim
    field.settle()
    field.host.fail = lambda operation, argument: (
        field.reconciler.renew(claim.claim_id, 500.0) and None if operation == "load" else None
    )
    field.manager.destroy("/localization_1")
    field.settle(1.0)
    field.host.fail = lambda operation, argument: None
    field.settle(100.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE


def test_only_so_many_ended_claims_are_remembered(field: Field) -> None:
    for _ in range(120):
        field.reconciler.release(field.acquire().claim.claim_id)
    assert len(field.reconciler.claims()) == 100
    field.tidy()
    assert field.host.running == []


# The manager


@pytest.mark.parametrize("step", [*range(1, 30), 35, 40])
def test_a_manager_that_is_killed_at_any_moment_loses_no_claim(
    field: Field, step: int, tmp_path
) -> None:
    field = Field(str(tmp_path / "state.db"))
    kept = field.acquire("RelativePosition(ball)", lease=1000.0).claim
    field.manager.add_transformation(
        transformation("thermometer", "soccer/Camera", "out image", "image Heat(field)")
    )
    field.settle()
    steps = [0]

    def kill(operation: str, argument: str) -> None:
        steps[0] += 1
        if steps[0] >= step:
            raise Killed

    field.host.fail = kill
    try:
        field.acquire("Heat(field)")
        field.manager.remove_transformation("bottom camera")
        field.settle(0.5)
        field.acquire()
    except Killed:
        pass
    field.host.fail = lambda operation, argument: None
    field.kill_manager()
    field.tidy()
    assert field.state(kept.claim_id) is ClaimState.ACTIVE
    assert field.claim(kept.claim_id).topic == kept.topic
    assert kept.topic in field.moving
    if step < 5:
        assert len(field.living()) == 1


def test_an_end_on_purpose_forgets_claims(field: Field) -> None:
    field.acquire()
    field.reconciler.end()
    assert field.reasons()[-1] == "the manager was stopped"
    field.manager.end()
    field.tick()
    assert (field.host.running, field.store.claims()) == ([], {})


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


def test_read_only_refuses_new_claims_but_not_dry_runs(field: Field) -> None:
    claim = field.acquire().claim
    field.manager.guards = Guards(read_only=True)
    for change in (field.acquire, lambda: field.reconciler.replan(claim.claim_id)):
        with pytest.raises(Denied, match="read-only"):
            change()
    field.reconciler.acquire(StreamRequest(GOAL), dry_run=True)
