# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Services of nodelets: called on any thread, answered on the nodelet's queue."""

from __future__ import annotations

import logging
import threading

import pytest
from clocks import PATIENCE, eventually, in_thread, join, wait_for
from unit.nodelet.fakes import ExitWithoutText, FakeClock, WithoutText, make_pool_world, pool_world

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

    def outcome(self):
        join(self.thread)
        return self.error or self.response


def test_a_service_answers_under_its_resolved_name_until_it_is_shut_down(world):
    nh = PlainNodeHandle(world.context("/ns/nodelet"), "/ns")
    service = nh.Service("~double", object, lambda request: request * 2)
    nh.Service("other", object, lambda request: request)
    assert service.resolved_name == "/ns/nodelet/double"
    assert world.services.call("/ns/nodelet/double", 21) == 42
    service.shutdown("enough")
    assert sorted(world.services.handlers) == ["/ns/other"]
    assert world.services.call("/ns/other", 1) == 1


def test_the_time_of_a_service_is_that_of_its_nodelet():
    clock = FakeClock()
    world = make_pool_world(1, clock=clock)
    context = world.context("/n")

    def take(seconds):
        clock.seconds += seconds
        return context.busy(), context.busy(with_running=True)

    PlainNodeHandle(context, "/").Service("s", object, take)
    assert world.services.call("/s", 2.0) == (0.0, 2.0)
    assert context.busy() == 2.0
    world.close()


@pytest.mark.parametrize("concurrent", [False, True])
@pytest.mark.parametrize(
    "error", [ValueError("no luck"), SystemExit(3), WithoutText(), ExitWithoutText()]
)
def test_the_error_of_a_handler_is_raised_to_the_caller_and_counted(world, concurrent, error):
    nh = world.handle(concurrent=concurrent)

    def fail(request):
        raise error

    nh.Service("s", object, fail)
    outcome = Caller(world, "/s").outcome()
    assert isinstance(outcome, Exception), "the caller must hear of it, and live on"
    assert (outcome is error) is isinstance(error, Exception)
    assert nh.context.callback_errors == 1


def test_a_call_during_on_init_is_answered_after_it(world):
    context = Context(world.runtime, "/starting")
    PlainNodeHandle(context, "/").Service("s", object, lambda request: "up")
    caller = Caller(world, "/s")
    caller.thread.join(0.05)
    assert caller.response is None
    context.start()
    assert caller.outcome() == "up"


@pytest.mark.parametrize("concurrent", [False, True])
def test_an_unload_ends_the_waits_of_callers(world, gate, concurrent):
    nh = world.handle("/going", concurrent)
    nh.Service("s", object, gate)
    handler = world.services.handlers["/s"]
    callers = [Caller(world, "/s")]
    wait_for(gate.begun)
    callers += [Caller(world, "/s") for _ in range(3)]
    nh.context.stop()
    callers.append(Caller(world, "/s"))  # while on_shutdown runs: the strand is dead
    nh.context.close()
    assert world.services.handlers == {}
    world.services.handlers["/late"] = handler
    for caller in (*callers, Caller(world, "/late")):
        outcome = caller.outcome()
        if not isinstance(outcome, KeyError):  # it came after the service was withdrawn
            assert isinstance(outcome, DyKnowError)
            assert "/going was unloaded" in str(outcome)


@pytest.mark.parametrize("concurrent", [False, True])
@pytest.mark.parametrize("end", ["nodelet", "service"])
def test_a_handler_that_ends_its_nodelet_or_service_still_answers(world, concurrent, end):
    nh = world.handle("/going", concurrent)

    def leave(request):
        (nh.context.close if end == "nodelet" else service.shutdown)()
        return "bye"

    service = nh.Service("s", object, leave)
    assert Caller(world, "/s").outcome() == "bye"


def test_a_shutdown_of_a_service_ends_the_waits_of_callers(world, gate):
    service = world.handle("/staying").Service("s", object, gate)
    caller = Caller(world, "/s")
    wait_for(gate.begun)
    service.shutdown()
    assert str(caller.outcome()) == "service '/s': it was shut down"


def test_calls_of_a_concurrent_handle_overlap(world):
    nh = world.handle(concurrent=True)
    both = threading.Barrier(2)
    nh.Service("s", object, lambda request: both.wait(PATIENCE) is not None)
    callers = [Caller(world, "/s") for _ in range(2)]
    assert [caller.outcome() for caller in callers] == [True, True]


def test_calls_of_a_concurrent_handle_leave_nothing_behind(world, caplog):
    caplog.set_level(logging.INFO)
    nh = world.handle(concurrent=True)
    nh.Service("s", object, lambda request: request)
    before = len(nh.context._strands)
    for number in range(200):
        assert world.services.call("/s", number) == number
    eventually(lambda: not nh.context.is_busy())
    world.services.call("/s", 0)
    assert len(nh.context._strands) <= before + 1, "that of the last call may run yet"
    assert "unload" not in caplog.text, "nothing was unloaded"
