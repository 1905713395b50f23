# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Services of nodelets: called on any thread, answered on the nodelet's queue."""

from __future__ import annotations

import logging
import threading

import pytest
from unit.nodelet.fakes import (
    PATIENCE,
    Message,
    in_thread,
    join,
    pool_world,
    wait_for,
    wait_until,
)

from dyknow.errors import DyKnowError
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle

world = pool_world(4)


class Caller:
    """A call on a thread of its own, with its outcome."""

    def __init__(self, world, service, request=None):
        self.response, self.error = None, None
        self._call = lambda: world.services.call(service, request)
        self.thread = in_thread(self._run)

    def _run(self):
        try:
            self.response = self._call()
        except BaseException as error:
            self.error = error


def test_a_service_answers_under_its_resolved_name(world):
    nh = PlainNodeHandle(world.context("/ns/nodelet"), "/ns")
    service = nh.Service("~double", object, lambda request: request * 2)
    assert service.resolved_name == "/ns/nodelet/double"
    assert world.services.call("/ns/nodelet/double", 21) == 42


def test_calls_and_callbacks_of_one_nodelet_never_overlap(world):
    nh = world.handle()
    inside, overlaps, count = [0], [], [0]

    def exclusive(_):
        inside[0] += 1
        if inside[0] > 1:
            overlaps.append(1)
        count[0] += 1
        threading.Event().wait(0.0001)
        inside[0] -= 1
        return "done"

    nh.Service("s", object, exclusive)
    nh.Service("s2", object, exclusive)
    nh.Subscriber("t", Message, exclusive)
    publisher = nh.Publisher("t", Message)

    def call(service):
        for _ in range(100):
            assert world.services.call(service, None) == "done"

    threads = [in_thread(lambda s=s: call(s)) for s in ("/s", "/s", "/s2")]
    for _ in range(300):
        publisher.publish()
    join(*threads)
    world.drain()
    assert overlaps == []
    assert count == [600]


def test_what_a_handler_raises_is_raised_to_the_caller_and_counted(world):
    nh = world.handle()

    def fail(request):
        raise ValueError(f"no {request}")

    nh.Service("s", object, fail)
    with pytest.raises(ValueError, match="no luck"):
        world.services.call("/s", "luck")
    assert nh.context.callback_errors == 1


@pytest.mark.parametrize("concurrent", [False, True])
def test_a_handler_that_exits_answers_its_caller_all_the_same(world, concurrent):
    nh = world.handle(concurrent=concurrent)

    def leave(request):
        raise SystemExit(3)

    nh.Service("s", object, leave)
    caller = Caller(world, "/s")
    join(caller.thread)
    assert isinstance(caller.error, Exception), "the caller must hear of it, and live on"
    assert nh.context.callback_errors == 1


def test_a_call_during_on_init_is_answered_after_it(world):
    context = Context(world.runtime, "/starting")
    PlainNodeHandle(context, "/").Service("s", object, lambda request: "up")
    caller = Caller(world, "/s")
    caller.thread.join(0.05)
    assert caller.response is None
    context.start()
    join(caller.thread)
    assert caller.response == "up"


@pytest.mark.parametrize("concurrent", [False, True])
def test_an_unload_ends_the_waits_of_callers(world, concurrent):
    nh = world.handle("/going", concurrent)
    started, release = threading.Event(), threading.Event()

    def hang(request):
        started.set()
        wait_for(release)

    nh.Service("s", object, hang)
    running = Caller(world, "/s")
    wait_for(started)
    waiting = [Caller(world, "/s") for _ in range(3)]
    wait_until(lambda: sum(caller.thread.is_alive() for caller in waiting) == 3)
    nh.context.close()
    for caller in (running, *waiting):
        join(caller.thread)
        assert isinstance(caller.error, DyKnowError)
        assert "/going was unloaded" in str(caller.error)
    assert world.services.handlers == {}
    release.set()


def test_a_call_that_comes_too_late_is_refused(world):
    nh = world.handle("/gone")
    nh.Service("s", object, lambda request: "answer")
    handler = world.services.handlers["/s"]
    nh.context.close()
    outcome = []

    def call():
        with pytest.raises(DyKnowError, match="/gone was unloaded"):
            handler(None)
        outcome.append("refused")

    join(in_thread(call))
    assert outcome == ["refused"]


def test_a_call_between_stop_and_close_is_refused_too(world):
    # on_shutdown runs there: the strand is dead, the registration is not yet withdrawn.
    nh = world.handle("/going")
    nh.Service("s", object, lambda request: "answer")
    nh.context.stop()
    caller = Caller(world, "/s")
    caller.thread.join(0.05)
    nh.context.close()
    join(caller.thread)
    assert isinstance(caller.error, DyKnowError)


def test_shutdown_withdraws_one_service(world):
    nh = world.handle()
    first = nh.Service("a", object, lambda request: "a")
    nh.Service("b", object, lambda request: "b")
    first.shutdown("enough")
    assert sorted(world.services.handlers) == ["/b"]
    assert world.services.call("/b", None) == "b"
    nh.context.close()
    assert world.services.handlers == {}


def test_a_handler_may_unload_its_own_nodelet(world):
    nh = world.handle("/own")
    nh.Service("s", object, lambda request: nh.context.close())
    caller = Caller(world, "/s")
    join(caller.thread)
    assert isinstance(caller.error, DyKnowError)


def test_calls_of_a_concurrent_handle_overlap(world):
    nh = world.handle(concurrent=True)
    both = threading.Barrier(2)
    nh.Service("s", object, lambda request: both.wait(PATIENCE) is not None)
    callers = [Caller(world, "/s") for _ in range(2)]
    join(*[caller.thread for caller in callers])
    assert [caller.response for caller in callers] == [True, True]


def test_calls_of_a_concurrent_handle_leave_nothing_behind(world, caplog):
    caplog.set_level(logging.INFO)
    nh = world.handle(concurrent=True)
    nh.Service("s", object, lambda request: request)
    before = len(nh.context._strands)
    for number in range(200):
        assert world.services.call("/s", number) == number
    world.drain()
    assert len(nh.context._strands) == before
    assert "unload" not in caplog.text, "nothing was unloaded"
