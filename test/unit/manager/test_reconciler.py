# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims on the fake host: made, shared, kept alive through faults, and released."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Callable, Dict, List, Mapping, Optional, Tuple
from unittest import mock

import pytest
from unit.manager.field import (
    CHAIN,
    FIRST_MESSAGE,
    GOAL,
    LIBRARY,
    POINT,
    Field,
    counted_ids,
    library,
    topic,
    transformation,
)
from unit.manager.world import Killed

from dyknow.backoff import SHARE
from dyknow.errors import (
    Denied,
    HostTimeout,
    InvalidTag,
    NoPlanFound,
    StreamTypeMismatch,
    UnknownClaim,
)
from dyknow.guards import Guards
from dyknow.manager.claim import Claim
from dyknow.manager.claims.repair import Fault
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.periodic import attempt

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


def test_replanning_a_stream_that_is_whole_makes_nothing(field: Field) -> None:
    claim = field.flowing("YUV(field)", require="present(it)")
    field.host.calls.clear()
    assert field.reconciler.replan(claim.claim_id).spawned == ()
    assert not {"load", "unload", "connect"} & {operation for operation, _ in field.host.calls}
    field.settle()
    assert field.claim(claim.claim_id).wiring == field.events[0].after.wiring
    field.check_flows(claim)


def test_a_relative_topic_begins_in_the_manager_s_namespace(field: Field) -> None:
    field.manager.add_transformation(topic("weather", "weather", "Weather"))
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
    field.check_flows(claim)
    assert field.mended()
    if "manager" not in fault:
        assert len(set(claim.nodelets) - set(field.claim(claim.claim_id).nodelets)) <= 1
    for manager in list(field.host.processes):
        field.host.wake(manager)
    field.tidy()
    camera = "ceiling camera" if "library" in fault else "bottom camera"
    assert field.labels() == [camera, *CHAIN[1:]]


PAIR = library(
    transformation("left", "soccer/Camera", "out image", "image Raw(left)"),
    transformation("right", "soccer/Camera", "out image", "image Raw(right)"),
    transformation(
        "worker", "soccer/Subsampler", "in yuv,out planes", "yuv Raw(?x);planes Clean(?x)"
    ),
)


@pytest.mark.parametrize("lifetime", [1.4, 15.0])
def test_a_nodelet_manager_that_is_killed_now_and_then_delays_no_repair(lifetime: float) -> None:
    field = Field(library=PAIR)
    claims = [field.acquire(f"Clean({side})").claim for side in ("left", "right")]
    field.settle(20.0)
    for _ in range(10):
        (manager,) = {each.manager for each in field.manager.graph.all()}
        field.host.kill(manager)
        killed = field.now
        field.tick(0.1)
        while not all(field.state(each.claim_id) is ClaimState.ACTIVE for each in claims):
            field.tick(0.1)
        assert field.now - killed < SHARE * lifetime + 0.25
        field.settle(lifetime)


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_part_that_is_back_leaves_its_topic_to_another(field: Field, is_restarted: bool) -> None:
    field.spawn("bottom camera", "/mine", config={"image": "/mine/image"}, isolated=True)
    claim = field.acquire("YUV(field)").claim
    assert claim.topic == "/mine/image"
    manager = field.manager.graph.get("/mine").manager
    field.settle()
    field.host.hang(manager)
    field.settle(5.0)
    field.check_flows(claim)
    assert field.claim(claim.claim_id).nodelets == ("/bottom_camera_1",)
    if is_restarted:
        field.kill_manager()
        field.settle()
    field.host.wake(manager)
    field.tick()
    assert field.host.publishers(claim.topic) == ["/bottom_camera_1"]
    field.check_flows(claim)
    assert field.manager.graph.get("/mine").state is State.RUNNING

    field.reconciler.release(claim.claim_id)
    field.host.hang(manager)
    field.tidy()
    if is_restarted:
        field.kill_manager()
    field.host.wake(manager)
    for _ in range(5):
        field.sleep(1.0)
        field.manager.look()
        field.reconciler.work()
    assert field.host.publishers(claim.topic) == ["/mine"]


def view(field: Field, is_left: bool = True) -> Claim:
    """Make a stream, and the viewer of a user on its topic, which is for the left image."""
    for side in ("left", "right"):
        field.manager.add_transformation(topic(side, f"/{side}", f"Image({side})"))
        if is_left or side == "right":
            field.host.topics.add(f"/{side}")
    field.add("smooth", {"in": ("in", ["Image(?side)"]), "out": ("out", ["Smooth(?side)"])})
    field.add("viewer", {"in": ("in", ["Smooth(left)"])})
    claim = field.flowing("Smooth(?side)")
    field.spawn("viewer", "/viewer", config={"in": claim.topic}, isolated=True)
    return claim


@pytest.mark.parametrize("is_answered", [True, False])
@pytest.mark.parametrize("moves", [(), ("/other", ""), ("",)])
def test_a_port_that_was_cut_comes_back_unless_its_user_has_moved_it(
    field: Field, moves: Tuple[str, ...], is_answered: bool
) -> None:
    claim = view(field)
    field.host.topics.discard("/left")
    connect = field.host.connect

    def do(name: str, config: Mapping[str, str]) -> None:
        connect(name, config)
        if name == "/viewer" and not is_answered:
            raise HostTimeout("it is done, but not answered")

    with mock.patch.object(field.host, "connect", do):
        field.settle()
    field.check_flows(claim)
    assert field.host.nodelet("/viewer").ports["in"].topic == ""
    for moved in moves:
        field.manager.connect([("/viewer", {"in": moved})])
    field.reconciler.release(claim.claim_id)
    field.tidy()
    assert field.host.nodelet("/viewer").ports["in"].topic == ("" if moves else claim.topic)


@pytest.mark.parametrize("end", ["death", "manager killed", "load failed", "restart"])
def test_a_port_that_does_not_fit_when_its_nodelet_comes_back_is_cut(
    tmp_path: Path, end: str
) -> None:
    field = Field(f"{tmp_path}/state")
    claim = view(field, is_left=False)
    manager = field.manager.graph.get("/viewer").manager
    if end == "restart":
        what = f"its connection to {claim.topic} does not fit now"
        assert field.manager.restart("/viewer").remarks == f"port 'in' of /viewer is cut: {what}"
    else:
        field.host.kill(manager)
    if end == "manager killed":
        field.host.fail_at("loaded", error=Killed())
        with pytest.raises(Killed):
            field.manager.look()
        field.host.recover()
        field.kill_manager()
    elif end == "load failed":
        field.host.fail_at("load", "viewer")
        field.settle()
        field.host.recover()
    field.settle(5.0)
    assert field.manager.graph.get("/viewer").state is State.RUNNING
    assert field.host.nodelet("/viewer").ports["in"].topic == ""
    field.reconciler.release(claim.claim_id)
    field.tidy()
    assert field.host.nodelet("/viewer").ports["in"].topic == claim.topic


def test_a_port_that_was_cut_and_is_gone_is_left_alone(field: Field) -> None:
    field.spawn("bottom camera", "/mine", config={"image": "/mine/image"}, isolated=True)
    claim = field.acquire("YUV(field)").claim
    field.settle()
    manager = field.manager.graph.get("/mine").manager
    field.host.hang(manager)
    field.settle()
    field.host.wake(manager)
    field.tick()
    del field.host.nodelet("/mine").ports["image"]
    field.manager.look()
    field.reconciler.release(claim.claim_id)
    field.tidy()
    assert field.reconciler.work() is None


def test_parts_that_users_destroy_or_protect(field: Field) -> None:
    field.spawn("bottom camera", "/camera", config={"image": "/camera/image"})
    claim = field.acquire().claim
    field.destroy_by_hand("/camera")
    field.settle()
    field.check_flows(claim)
    field.manager.set_protection("/subsampler_1", True)
    field.reconciler.release(claim.claim_id)
    field.settle(30.0)
    assert field.host.running == ["/subsampler_1"]
    field.manager.set_protection("/subsampler_1", False)
    field.tidy()


def test_a_protected_part_that_no_claim_needs_is_left_to_its_user(field: Field) -> None:
    claim = field.acquire("YUV(field)").claim
    name, port = claim.goal
    field.manager.set_protection(name, True)
    field.reconciler.release(claim.claim_id)
    field.settle()
    field.manager.connect([(name, {port: "/mine"})])
    field.settle(10.0)
    assert field.manager.graph.get(name).topics[port] == "/mine"
    field.manager.set_protection(name, False)
    field.tidy()


def test_a_protected_part_is_connected_by_its_user_alone(field: Field) -> None:
    field.host.topics |= {"/left", "/right"}
    for side in ("left", "right"):
        field.manager.add_transformation(topic(side, f"/{side}", f"Image({side})"))
    field.add("smooth", {"in": ("in", ["Image(?side)"]), "out": ("out", ["Smooth(?side)"])})
    first = field.acquire("Smooth(left)").claim
    name, _ = first.goal
    field.manager.set_protection(name, True)
    field.reconciler.release(first.claim_id)
    field.settle()
    mine = {"in": "/left", "out": "/mine"}
    field.manager.connect([(name, mine)])
    claim = field.flowing("Smooth(right)")
    assert field.manager.graph.get(name).topics == mine

    mine["in"] = "/right"  # it can be used as it is, where it is
    field.manager.connect([(name, mine)])
    field.host.vanish(claim.goal[0])
    field.settle()
    field.check_flows(claim)
    assert name in field.claim(claim.claim_id).nodelets
    assert field.manager.graph.get(name).topics == mine


def test_a_topic_that_is_not_published_is_named(field: Field) -> None:
    field.host.topics.clear()
    with pytest.raises(NoPlanFound) as refusal:
        field.acquire()
    assert "topic /joint_states is not published" in str(refusal.value)
    assert "did you mean" not in str(refusal.value)


def test_a_part_that_goes_during_a_repair_is_replaced_too(field: Field) -> None:
    field.acquire()
    field.settle(5.0)

    def goes(operation: str, argument: str) -> None:
        if operation == "load":
            field.host.recover()
            field.manager.destroy("/detector_1")

    field.manager.destroy("/bottom_camera_1")
    field.host.fail = goes
    field.settle(1.0)
    assert ClaimState.FAILED not in [event.after.state for event in field.events]
    assert field.living()[0].state is ClaimState.ACTIVE
    assert {"/detector_2", "/subsampler_1", "/localization_1"} <= set(field.host.running)


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
    field.check_flows(claim)
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


# Several claims


def test_claims_that_wait_for_one_stream_share_its_topic() -> None:
    field = Field(library="")
    for _ in range(3):
        with pytest.raises(NoPlanFound):
            field.acquire("YUV(field)")
    field.manager.add_transformation(LIBRARY)
    field.settle()
    assert {each.topic for each in field.living()} == {"/bottom_camera_1/image"}
    field.check_flows(*field.living())


def test_an_excluded_part_does_not_come_to_a_claim_through_others(field: Field) -> None:
    picky = field.acquire(exclude=("ceiling camera",)).claim
    easy = field.acquire("RelativePosition(ball)").claim
    field.manager.remove_transformation("bottom camera")
    field.settle()
    field.check_flows(easy)
    parts = set(field.claim(easy.claim_id).nodelets)
    assert not parts & set(picky.nodelets), "what excludes less does not change a shared part"
    assert field.state(picky.claim_id) is ClaimState.PENDING
    assert "ceiling camera is excluded" in field.claim(picky.claim_id).detail
    field.manager.add_transformation(LIBRARY)
    field.settle()
    assert field.state(picky.claim_id) is ClaimState.ACTIVE


def test_a_claim_waits_no_longer_than_the_claim_that_rules_out_its_plan(field: Field) -> None:
    for label, rate in (("fast", 30), ("slow", 9)):
        text = transformation(label, "soccer/Camera", "out image", "image Eye(field)")
        field.manager.add_transformation(text.replace("<port ", f'<port rate="{rate}" '))
    keen = field.acquire("Eye(field)", min_rate=10.0).claim
    easy = field.acquire("Eye(field)").claim
    assert easy.topic == keen.topic and field.labels() == ["fast"]
    field.manager.remove_transformation("fast")
    field.host.vanish(keen.goal[0])
    field.settle(5.0)
    assert {each.state for each in field.living()} == {ClaimState.PENDING}
    field.reconciler.release(keen.claim_id)
    field.settle(5.0)
    field.check_flows(easy)
    assert field.labels() == ["slow"]


# Clients


def test_leases_end_unless_they_are_renewed_be_it_during_a_repair(field: Field) -> None:
    claim = field.acquire(lease=10.0).claim
    field.settle(9.0)
    field.host.fail = lambda operation, argument: (
        field.reconciler.renew(claim.claim_id, 10.0) and None if operation == "load" else None
    )
    field.manager.destroy("/localization_1")
    field.settle(1.0)
    field.host.recover()
    field.settle(8.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.settle(2.0)
    assert field.state(claim.claim_id) is ClaimState.EXPIRED
    with pytest.raises(UnknownClaim, match="expired"):
        field.reconciler.renew(claim.claim_id, 10.0)
    field.tidy()


def test_a_client_that_is_gone_ends_its_claim(field: Field) -> None:
    claim = field.acquire(bond_id="b", client_id="c").claim
    field.reconciler.expire(claim.claim_id, "its bond broke")
    field.reconciler.expire(claim.claim_id, "again")
    assert field.state(claim.claim_id) is ClaimState.EXPIRED
    assert field.reasons()[-1] == "its bond broke"
    with pytest.raises(UnknownClaim, match="expired"):
        field.reconciler.replan(claim.claim_id)
    field.tidy()


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


def test_only_so_many_ended_claims_are_remembered(field: Field) -> None:
    with mock.patch("dyknow.manager.claims.claim_table._ENDED_KEPT", 4):
        for _ in range(6):
            field.reconciler.release(field.acquire().claim.claim_id)
    assert len(field.reconciler.claims()) == 4
    field.tidy()


@pytest.mark.parametrize("fails", ["judging", "the repair of another"])
def test_a_defect_about_one_stream_leaves_the_others_to_be_repaired(
    field: Field, fails: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("dyknow.manager.claims.reconciler.attempt", attempt)
    good, bad = field.acquire().claim, field.acquire("Joints(nao)").claim
    field.settle()
    repair, monitor = field.reconciler._repair, field.reconciler._monitor
    diagnose = repair.diagnose

    def raise_for_bad(claim: Claim) -> Optional[Fault]:
        if claim.claim_id == bad.claim_id:
            raise KeyError("a defect")
        return diagnose(claim)

    if fails == "judging":
        monkeypatch.setattr(monitor, "read", mock.Mock(side_effect=KeyError("a defect")))
    else:
        monkeypatch.setattr(repair, "diagnose", raise_for_bad)
    field.host.vanish(good.goal[0])
    field.settle()
    field.check_flows(good)
    assert "KeyError: 'a defect'" in caplog.text


# The manager


def test_streams_are_repaired_before_others_are_planned(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    with counted_ids():
        with pytest.raises(NoPlanFound) as refused:
            field.acquire("Weather(field)")
        made = field.acquire().claim
    seen: List[str] = []
    monkeypatch.setattr(field.reconciler._repair, "repair", seen.append)
    field.tick()
    assert seen == [made.claim_id, refused.value.claim_id]


def test_claims_survive_the_manager(field: Field) -> None:
    wishes = StreamRequest(GOAL, prefer=("bottom camera",), avoid=("x",))
    request = replace(wishes, lease=100.0, client_id="c", request_id="r")
    claim = field.reconciler.acquire(request).claim
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
    field.check_flows(claim)


def test_topics_of_claims_count_until_the_master_answers_after_a_restart(tmp_path: Path) -> None:
    field = Field(f"{tmp_path}/state")
    claim = field.acquire().claim
    field.settle()
    assert claim.sources == ("/joint_states",)
    field.kill_manager()
    field.host.fail_at("published")
    field.settle()
    assert field.reasons() == [] and field.state(claim.claim_id) is ClaimState.ACTIVE
    field.host.recover()
    field.host.topics.clear()
    field.settle()
    assert field.reasons() == ["topic /joint_states is not published any more"]


def test_a_manager_that_is_stopped_ends_its_claims(field: Field) -> None:
    claim = field.acquire().claim
    field.reconciler.end()
    field.manager.end()
    field.reconciler.reconcile()
    assert field.state(claim.claim_id) is ClaimState.RELEASED
    assert field.host.running == []
    assert field.store.read("claims", lambda key, text: text) == {}
