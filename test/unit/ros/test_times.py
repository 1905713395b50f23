# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Timers with /use_sim_time, and the offsets of the clocks of machines."""

from __future__ import annotations

import gc
import itertools
import time
import weakref
from typing import List

import genpy
import pytest
import rospy
from clocks import eventually
from genpy import Time
from unit.nodelet.fakes import World

from dyknow.nodelet.timers import TimerQueue
from dyknow.ros.nodelets.peer_services import machine_message
from dyknow.ros.transport.node import ClockTicker, RospyNode, SteadyTicker, make_ticker
from dyknow.ros.wire import poll_client
from dyknow.ros.wire.poll_client import OffsetMeter


def test_an_unloaded_nodelet_waits_no_longer_for_simulated_time(monkeypatch):
    now = itertools.count(1)
    monkeypatch.setattr(rospy.rostime, "is_wallclock", lambda: False)
    monkeypatch.setattr(rospy.rostime, "get_rostime", lambda: Time(next(now)))
    world = World()
    world.runtime.node = RospyNode()
    handle = world.handle()
    rate, context = handle.Rate(0.1), weakref.ref(handle.context)
    assert isinstance(rate, rospy.Rate) and isinstance(rate, handle.Rate)
    handle.context.close()
    for wait, *seconds in ((handle.sleep, 9.0), (rate.sleep,)):
        with pytest.raises(rospy.ROSInterruptException, match="shutdown"):
            wait(*seconds)
    del handle
    gc.collect()
    assert context() is None


# Timers with /use_sim_time, from before the first message on /clock


#: A time that /clock may say first, of a bag.
FIRST = 1.6e9


class StillQueue(TimerQueue):
    """A timer queue without its thread: the test ticks."""

    def _run(self):
        pass


class SimulatedWorld(World):
    """A world on ROS time, which is 0 at first."""

    def __init__(self, queue):
        super().__init__()
        vars(self).update(ticker=make_ticker())
        object.__setattr__(self.runtime, "timers", queue(self.ticker))

    def clock(self, seconds):
        """Receive a message on /clock, and have the due timers called."""
        set_clock(seconds)
        self.runtime.timers.tick()
        self.drain()

    def timer(self, period, **options) -> List[float]:
        """The moments at which a timer has fired."""
        fired: List[float] = []
        duration = rospy.Duration.from_sec(period)
        self.handle().Timer(
            duration, lambda event: fired.append(event.current_real.to_sec()), **options
        )
        return fired


def set_clock(seconds):
    rospy.rostime._set_rostime(genpy.Time.from_sec(seconds))


@pytest.fixture(autouse=True)
def _simulated(monkeypatch):
    monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
    monkeypatch.setattr(rospy.rostime, "_rostime_current", rospy.Time(0))


@pytest.fixture(name="world")
def _world():
    return SimulatedWorld(StillQueue)


def test_which_time_is_chosen(monkeypatch):
    assert isinstance(make_ticker(), ClockTicker)
    monkeypatch.setattr(rospy.rostime, "_rostime_current", None)
    ticker = make_ticker()
    assert isinstance(ticker, SteadyTicker)
    assert ticker.has_begun(0.0)


def test_a_period_begins_at_the_first_time(world):
    once, each = world.timer(60.0, oneshot=True), world.timer(10.0)
    for seconds in (0.0, FIRST, FIRST + 9.0):
        world.clock(seconds)
        assert once == each == []
    late = world.timer(1.0, oneshot=True)
    for seconds in range(10, 80):
        world.clock(FIRST + seconds)
    assert once == [FIRST + 60.0]
    assert each == [FIRST + seconds for seconds in range(10, 80, 10)]
    assert late == [FIRST + 10.0]


def test_where_the_clock_is_reset_a_period_begins_at_the_next_time(world):
    world.clock(FIRST)
    each = world.timer(10.0)
    world.clock(FIRST + 10.0)
    world.clock(0.0)
    world.clock(FIRST + 100.0)
    assert each == [FIRST + 10.0]
    world.clock(FIRST + 110.0)
    assert each == [FIRST + 10.0, FIRST + 110.0]


def test_a_timer_that_is_made_while_time_begins_waits_its_period(world, monkeypatch):
    now = world.ticker.now

    def before_the_first():
        monkeypatch.setattr(world.ticker, "now", now)
        world.clock(FIRST)  # comes just after the timer looked
        return 0.0

    monkeypatch.setattr(world.ticker, "now", before_the_first)
    each = world.timer(10.0)
    for seconds in (1.0, 10.0, 11.0):
        world.clock(FIRST + seconds)
    assert each == [FIRST + 11.0]


class HastyQueue(TimerQueue):
    """Time begins just after its thread has looked, and before it sleeps."""

    def tick(self):
        due = super().tick()
        if self._heap and not self.ticker.now():
            set_clock(FIRST)
        return due


def test_the_thread_of_the_timers_does_not_miss_the_first_time():
    world = SimulatedWorld(HastyQueue)
    fired = world.timer(10.0)
    eventually(lambda: world.runtime.timers._latest == FIRST)
    set_clock(FIRST + 9.0)
    set_clock(FIRST + 12.0)
    eventually(lambda: world.executor.drain() and fired)
    assert fired == [FIRST + 12.0]
    world.close()


# The machine of a process, and the offset of its clock, from answers to polls


class Answers:
    """Answers of a process whose clock is ahead, over a way that takes its time."""

    def __init__(self, patch, ahead):
        self.now, self.ahead = 1000.0, ahead
        patch.setattr(poll_client.time, "time", lambda: 5e5 + self.now)
        patch.setattr(poll_client.time, "monotonic", lambda: self.now)
        self.meter = OffsetMeter()

    def take(self, there: float, back: float) -> None:
        began = self.meter.begin()
        self.now += there
        stamp = Time.from_sec(5e5 + self.now + self.ahead)
        self.now += back
        self.meter.add(began, stamp)


def test_the_quickest_of_the_latest_answers_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = Answers(monkeypatch, 2.5)
    assert answers.meter.offset.offset != answers.meter.offset.offset, "it is not a number yet"
    answers.take(0.3, 0.1)
    assert answers.meter.offset.offset == pytest.approx(2.6, abs=1e-6)
    assert answers.meter.offset.error == pytest.approx(0.2)
    answers.take(0.001, 0.003)
    for _ in range(7):
        answers.take(0.2, 0.2)
        found = answers.meter.offset
        assert found.offset == pytest.approx(2.499, abs=1e-6)
        assert abs(found.offset - 2.5) <= found.error + 1e-9
    answers.take(0.2, 0.2)
    assert answers.meter.offset.error == pytest.approx(0.2), "a clock drifts: old ones go"


def test_a_machine_describes_itself() -> None:
    found = machine_message()
    assert found.cores >= 1 and found.load >= 0.0 and 0.0 < found.memory < 1.0
    assert abs(found.stamp.to_sec() - time.time()) < 60.0
