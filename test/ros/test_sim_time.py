#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets on simulated time: timers follow /clock, statistics and time limits do not."""

from __future__ import annotations

import threading

import graph
import rospy
import rostest
from graph import NodeletManagerCase, call
from processes import BUSY, becomes, eventually
from rosgraph_msgs.msg import Clock

CLOCK = None


class SimTimeTest(NodeletManagerCase):
    def setUp(self):
        eventually(lambda: "/manager" in graph.nodes_on("/clock")[1], 5.0, "it has a clock")
        for name in ("Metronome", "Features"):
            self.manager.load(name, f"/{name.lower()}")
        self.run_clock(100.0, 0.0)

    def run_clock(self, begin, seconds, step=0.01):
        """Let the clock run, much faster than a real one, until the manager has the time."""
        for number in range(round(seconds / step) + 1):
            self.now = round(begin + number * step, 3)
            CLOCK.publish(Clock(rospy.Time.from_sec(self.now)))

        def is_known():
            CLOCK.publish(Clock(rospy.Time.from_sec(self.now)))
            return [round(each, 3) for each in call("/features", "clock")] == [self.now] * 3

        eventually(is_known, 5.0, "the manager knows the time", lambda: call("/features", "clock"))

    def test_timers_follow_the_clock(self):
        call("/metronome", "start", 1.0)
        self.run_clock(100.0, 0.1)
        for number in range(10):  # the clock stands until it was called
            self.run_clock(100.1 + number, 1.0)
            becomes(lambda: call("/metronome", "count"), number + 1)
        for number, at in enumerate(call("/metronome", "times")):
            self.assertAlmostEqual(at, 101.0 + number, delta=0.2)
        # While the clock stands, nothing happens, even after a call that takes real time.
        call("/metronome", "start_once", 0.5)
        self.assertEqual(call("/metronome", "count_shots"), 0)
        self.run_clock(110.1, 0.8)
        becomes(lambda: call("/metronome", "count_shots"), 1)
        self.assertEqual(call("/metronome", "count"), 10)

    def test_sleep_follows_the_clock(self):
        answers = []
        thread = threading.Thread(target=lambda: answers.append(call("/features", "sleep", 1e3)))
        thread.start()
        self.manager.wait_for("/features sleeps")
        for begin in range(100, 3100, 1000):  # once is enough, unless it only begins to sleep
            self.run_clock(begin, 1000.0, step=10.0)
            thread.join(1.0 * BUSY)
        self.assertGreaterEqual(answers[0], 1e3)

    def test_ages_follow_the_clock(self):
        self.manager.load("dyknow_manager_test/Stamped", "/stamped", {"/out": "/points"})
        ages = []

        def measure():
            self.run_clock(100.0, 1.0)
            (counts,) = graph.poll("/manager", "/stamped").counts
            ages.extend(port.age for port in counts.ports if port.age == port.age)
            return len(ages) >= 3

        eventually(measure, 10.0, "ages are measured")
        # Within the second that the clock runs over again and again, not decades of real time.
        self.assertLessEqual(max(map(abs, ages)), 1.01)

    def test_statistics_and_time_limits_do_not(self):
        uptime = graph.get_statistics("/metronome").uptime
        eventually(lambda: graph.get_statistics("/metronome").uptime > uptime, 5.0, "it goes on")
        # These would wait for ever: the clock stands.
        self.manager.load("Listener", "/listener")
        self.assertTrue(graph.set_config("/listener", **{"in": "/nobody"}).success)
        self.manager.unload("/listener")


if __name__ == "__main__":
    rospy.init_node("sim_time_test")
    CLOCK = rospy.Publisher("/clock", Clock, queue_size=1000)
    rostest.rosrun("dyknow", "sim_time", "__main__")
