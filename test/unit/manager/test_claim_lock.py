# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams while a request waits for a plan, or for a nodelet that takes long to start."""

from __future__ import annotations

import contextlib
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Callable, Dict, Iterator, List

import pytest
from clocks import PATIENCE, in_thread, join, wait_for
from unit.manager.field import CHAIN, GOAL, LIBRARY, LINGER, Field, topic, transformation

from dyknow.errors import DyKnowError, HostError, NoPlanFound
from dyknow.manager.claims.assembly import Acquired
from dyknow.manager.claims.claim_table import ClaimLock
from dyknow.manager.claims.world import World
from dyknow.manager.planning.planner import Planner
from dyknow.model.streams import ClaimState, StreamRequest

# Streams while a request waits for a nodelet that takes long to start


BALL = "RelativePosition(ball)"
CHEAP = transformation(
    "cheap localization",
    "soccer/Localization",
    "in ball, out position",
    f"ball {BALL}; position {GOAL}",
    cost=0,
)


@contextlib.contextmanager
def meanwhile(field: Field, name: str, happens: Callable[[], None]) -> Iterator[None]:
    """Run something once while a nodelet is loaded, which has to come."""
    done: List[str] = []

    def fail(operation: str, argument: str) -> None:
        if (operation, argument) == ("load", name) and not done:
            done.append(name)
            happens()

    field.host.fail = fail
    yield
    assert done


def test_a_stream_is_mended_while_another_one_is_being_made(field: Field) -> None:
    first = field.acquire(BALL).claim

    def lose_a_part() -> None:
        field.destroy_by_hand(first.goal[0])
        field.tick()
        assert field.state(first.claim_id) is ClaimState.ACTIVE
        assert field.claim(first.claim_id).goal != first.goal
        assert field.host.publishers(first.topic) == [field.claim(first.claim_id).goal[0]]

    with meanwhile(field, "/localization_1", lose_a_part):
        second = field.acquire(GOAL).claim
    field.settle()
    field.check_flows(first, second)
    assert field.labels() == CHAIN


@pytest.mark.parametrize("is_idle", [False, True])
def test_a_waiting_request_loses_no_part_by_time(field: Field, is_idle: bool) -> None:
    """Neither those that it has made so far, nor an idle one that it counts on."""
    camera = field.acquire("YUV(field)").claim if is_idle else None
    if camera is not None:
        field.reconciler.release(camera.claim_id)

    def time_passes() -> None:
        request = StreamRequest("YUV(field)")
        explained = field.reconciler.acquire(request, dry_run=True)
        assert explained.reused == ("/bottom_camera_1",), "a dry run waits for no request"
        for _ in range(int(4 * LINGER)):
            field.tick(1.0)

    with meanwhile(field, "/localization_1", time_passes):
        acquired = field.acquire(GOAL)
    assert len(acquired.spawned) == (3 if is_idle else 4)
    assert ("/bottom_camera_1" in acquired.reused) is is_idle
    field.settle()
    field.check_flows(acquired.claim)


def test_an_idle_part_goes_although_requests_keep_coming(field: Field) -> None:
    idle = field.acquire("YUV(field)").claim
    field.reconciler.release(idle.claim_id)
    for number in range(int(LINGER) + 1):
        field.add(f"view {number}", {"out": ("out", [f"View(v{number})"])})
        with meanwhile(field, f"/view_{number}_1", field.tick):
            field.acquire(f"View(v{number})")
        field.tick(1.0)
    assert "/bottom_camera_1" not in field.host.running


def test_the_claim_of_a_request_is_left_to_the_request(field: Field) -> None:
    claim = field.acquire(GOAL).claim
    field.manager.add_transformation(CHEAP)
    reasons: List[str] = []

    def lose_a_part() -> None:
        field.destroy_by_hand(claim.goal[0])
        before = len(field.events)
        field.tick()
        reasons.extend(event.reason for event in field.events[before:])

    with meanwhile(field, "/cheap_localization_1", lose_a_part):
        field.reconciler.replan(claim.claim_id)
    assert not [reason for reason in reasons if "gone" in reason]
    field.settle()
    field.check_flows(claim)
    assert field.claim(claim.claim_id).goal[0] == "/cheap_localization_1"


def test_a_replanned_stream_keeps_its_publisher_while_its_monitor_is_made(field: Field) -> None:
    claim = field.acquire(GOAL, require="it.point.x < 3").claim
    field.manager.add_transformation(CHEAP)
    with meanwhile(field, "/monitor_of_localization_1_position_2", field.tick):
        goal = field.reconciler.replan(claim.claim_id).claim.goal
    assert field.host.publishers(claim.topic) == [goal[0]]
    field.settle()
    assert not [each for each in field.reasons() if each.startswith("mended")]


def test_a_request_whose_claim_ends_meanwhile_gets_another_one(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = field.acquire(GOAL, client_id="/client", request_id="1").claim.claim_id
    lock = field.reconciler._lock
    begin = lock.request

    def late(claim_id: str = "") -> Any:
        monkeypatch.setattr(lock, "request", begin)
        field.reconciler.release(first)
        return begin(claim_id)

    monkeypatch.setattr(lock, "request", late)
    assert field.acquire(GOAL, client_id="/client", request_id="1").claim.claim_id != first
    field.check()


def test_a_request_that_is_repeated_while_it_is_worked_on_gets_the_same_answer(
    field: Field,
) -> None:
    request = StreamRequest(GOAL, client_id="/client", request_id="1")
    again: List[Acquired] = []
    threads: List[threading.Thread] = []

    def repeat() -> None:
        threads.append(in_thread(lambda: again.append(field.reconciler.acquire(request))))
        field.tick()
        assert threads[0].is_alive()

    with meanwhile(field, "/localization_1", repeat):
        first = field.reconciler.acquire(request)
    join(*threads)
    assert again[0].claim.claim_id == first.claim.claim_id
    assert len(field.living()) == 1


def test_a_lost_part_that_is_being_made_for_another_stream_gets_a_name_of_its_own(
    field: Field,
) -> None:
    field.manager.remove_transformation("bottom camera")
    first = field.acquire("YUV(field)").claim

    def lose_it() -> None:
        field.destroy_by_hand("/ceiling_camera_1")
        field.tick()
        assert field.state(first.claim_id) is ClaimState.ACTIVE

    field.manager.add_transformation(
        transformation("second view", "soccer/Ceiling", "out image", "image Planes(field)")
    )
    with meanwhile(field, "/second_view_1", lose_it):
        field.acquire("Planes(field)", exclude=("subsampler",))
    field.tidy()


def test_a_request_that_fails_leaves_what_a_mended_stream_uses_by_now(field: Field) -> None:
    planes = field.acquire("Planes(field)").claim

    def lose_the_camera() -> None:
        field.manager.remove_transformation("bottom camera")
        field.destroy_by_hand("/bottom_camera_1")
        field.tick()
        assert field.state(planes.claim_id) is ClaimState.ACTIVE
        assert "/ceiling_camera_1" in field.claim(planes.claim_id).nodelets
        raise HostError("the localization does not start")

    with meanwhile(field, "/localization_1", lose_the_camera), pytest.raises(
        DyKnowError, match="does not start"
    ):
        field.acquire(GOAL, exclude=("bottom camera",))
    field.settle()
    field.check_flows(planes)
    assert "/ceiling_camera_1" in field.claim(planes.claim_id).nodelets
    field.tidy()
    assert not {"detector", "localization"} & set(field.labels())


def test_requests_come_one_at_a_time_and_rounds_in_between() -> None:
    claim_lock = ClaimLock()
    order: List[str] = []

    def ask() -> None:
        with claim_lock.request("second"):
            order.append(claim_lock.claim_id)

    with claim_lock.request("first"):
        claim_lock.reserve(["/nodelet"])
        thread = in_thread(ask)
        with claim_lock.pause():
            thread.join(0.05)
            with claim_lock.round():
                order.append(claim_lock.claim_id)
        assert claim_lock.reserved
        order.append("end")
    join(thread)
    assert order == ["first", "end", "second"]
    assert (claim_lock.claim_id, claim_lock.reserved) == ("", set())


# While a client's request is planned, streams are repaired; its plan is checked before use


class Slow:
    """A request on a thread of its own, whose planner waits before it answers."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, request: Callable[[], Any], method: str = "plan"
    ) -> None:
        self.calls = 0
        self._may_answer = threading.Event()
        is_planning = threading.Event()
        asking: List[threading.Thread] = []
        plan = getattr(Planner, method)

        def ask() -> Any:
            asking.append(threading.current_thread())
            return request()

        def slowly(*args: Any, **kwds: Any) -> Any:
            answer = plan(*args, **kwds)
            if threading.current_thread() in asking:
                self.calls += 1
                is_planning.set()
                wait_for(self._may_answer)
            return answer

        monkeypatch.setattr(Planner, method, slowly)
        self._answer = ThreadPoolExecutor(1).submit(ask)
        wait_for(is_planning)

    def result(self) -> Any:
        self._may_answer.set()
        return self._answer.result(PATIENCE)


ASKS: Dict[str, Callable[[Field, str], Any]] = {
    "acquire": lambda field, _: field.acquire(GOAL, budget=60.0),
    "dry run": lambda field, _: field.reconciler.acquire(StreamRequest(GOAL), dry_run=True),
    "replan": lambda field, claim_id: field.reconciler.replan(claim_id),
    "dry replan": lambda field, claim_id: field.reconciler.replan(claim_id, dry_run=True),
    "find bindings": lambda field, _: field.reconciler.find_bindings("YUV(?where)"),
}


@pytest.mark.parametrize("ask", ASKS)
def test_a_stream_is_repaired_while_a_client_waits_for_a_plan(
    field: Field, monkeypatch: pytest.MonkeyPatch, ask: str
) -> None:
    lost = field.acquire("YUV(field)").claim
    other = field.acquire("Planes(field)", exclude=("ceiling camera",)).claim
    method = "bindings" if ask == "find bindings" else "plan"
    slow = Slow(monkeypatch, lambda: ASKS[ask](field, other.claim_id), method)
    field.host.vanish(lost.goal[0])
    field.tick()
    assert field.state(lost.claim_id) is ClaimState.ACTIVE
    assert field.claim(lost.claim_id).goal[0] in field.host.running
    slow.result()
    field.settle()


def test_a_plan_is_made_again_if_what_it_uses_has_gone(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = field.acquire("YUV(field)").claim
    slow = Slow(monkeypatch, field.acquire)
    field.manager.remove_transformation("bottom camera")
    field.host.vanish(camera.goal[0])
    field.tick()
    got = slow.result()
    assert slow.calls == 2
    assert "ceiling camera" in {field.manager.graph.get(name).label for name in got.claim.nodelets}
    field.settle()
    assert "it is whole again" not in field.reasons()


def test_a_refusal_is_checked_too(field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    field.manager.remove_transformation("localization")
    slow = Slow(monkeypatch, field.acquire)
    field.manager.add_transformation(LIBRARY)
    assert slow.result().claim.state is ClaimState.ACTIVE


def test_a_plan_without_a_transformation_keeps_the_claims_own_limits(field: Field) -> None:
    claim_id = field.acquire("Planes(field)", exclude=("ceiling camera",)).claim.claim_id
    before = list(field.host.running)
    with pytest.raises(NoPlanFound, match="bottom camera, ceiling camera are excluded$"):
        field.reconciler.plan(claim_id, ("bottom camera",))
    assert field.host.running == before
    assert field.state(claim_id) is ClaimState.ACTIVE


# The world is read by any thread, without the lock


def test_a_slow_reader_of_the_world_hides_no_change_of_the_library(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, world = World.read, field.reconciler._context.connector.world
    field.host.topics.add("/scan")
    field.spawn("bottom camera", "/camera", config={"image": "/image"})

    def read_late(self: World, *args: Any) -> World:
        """Another thread adds a topic, and reads the world of it, in between."""
        monkeypatch.setattr(World, "read", read)
        field.manager.add_transformation(topic("scan", "/scan", "Scan(here)"))
        assert "/scan" in world().described
        return read(self, *args)

    monkeypatch.setattr(World, "read", read_late)
    assert "/scan" not in world().described, "it is as at the beginning"
    assert "/scan" in world().described
    assert field.acquire("Scan(here)").claim.topic == "/scan"
