#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets on simulated time: timers follow /clock, statistics and time limits do not."""

from __future__ import annotations

import threading
import time

import graph
import rospy
import rostest
from dyknow_msgs.srv import GetCounts
from graph import NodeletManagerCase, call, set_config
from processes import HELD_UP, eventually
from rosgraph_msgs.msg import Clock

CLOCK = None


class SimTimeTest(NodeletManagerCase):
    def setUp(self):
        eventually(
            lambda: "/manager" in graph.nodes_on("/clock")[1], 5.0, "the manager has a clock"
        )
        self.manager.load("Metronome", "/n")
        self.manager.load("Features", "/features")
        eventually(
            lambda: self.set(100.0) or call("/features", "clock") == [100.0] * 3,
            5.0,
            "the manager knows the time",
        )

    @staticmethod
    def set(seconds):
        CLOCK.publish(Clock(rospy.Time.from_sec(seconds)))

    def run_clock(self, begin, seconds, step=0.01):
        for number in range(round(seconds / step) + 1):
            self.set(begin + number * step)
            time.sleep(0.0005)  # ten or twenty times real time

    def wait_for(self, count):
        eventually(lambda: call("/n", "count") >= count, 5.0, f"{count} calls")

    def test_timers_follow_the_clock(self):
        call("/n", "start", 1.0)
        self.run_clock(100.0, 0.1)
        for number in range(10):  # the clock stands until it was called
            self.run_clock(100.1 + number, 1.0)
            self.wait_for(number + 1)
        times = call("/n", "times")
        self.assertEqual(len(times), 10)
        for number, at in enumerate(times):
            self.assertAlmostEqual(at, 101.0 + number, delta=0.2)
        # While the clock stands, nothing happens, even after a call that takes real time.
        call("/n", "start_once", 0.5)
        self.assertEqual(call("/n", "count_shots"), 0)
        self.run_clock(110.1, 0.8)
        eventually(lambda: call("/n", "count_shots") == 1, 5.0, "the shot")
        self.assertEqual(call("/n", "count"), 10)

    def test_sleep_and_rate_follow_the_clock(self):
        answers = []
        thread = threading.Thread(target=lambda: answers.append(call("/features", "sleep", 5.0)))
        thread.start()
        now = 100.0
        while thread.is_alive():
            self.set(now)
            now += 0.05
            thread.join(0.005)
        self.assertGreater(answers[0], 4.9)
        self.assertLess(answers[0], 25.0)  # after five seconds of real time it would be 50

    def test_ages_follow_the_clock(self):
        self.manager.load("dyknow_manager_test/Stamped", "/stamped", {"/out": "/points"})
        proxy = rospy.ServiceProxy("/manager/get_counts", GetCounts)
        ages = []

        def measure():
            self.run_clock(100.0, 1.0)
            (counts,) = proxy(["/stamped"]).nodelets
            ages.extend(port.age for port in counts.ports if port.age == port.age)
            return len(ages) >= 3

        eventually(measure, 10.0, "ages are measured")
        # Within the second that the clock runs over again and again, not decades of real time.
        self.assertLessEqual(max(map(abs, ages)), 1.0)

    def test_statistics_and_time_limits_do_not(self):
        uptime = graph.get_statistics("/n").uptime
        eventually(lambda: graph.get_statistics("/n").uptime > uptime, 2.0, "it goes on")
        self.manager.load("Listener", "/listener")
        begin = time.monotonic()
        self.assertTrue(set_config("/listener", **{"in": "/nobody"}).success)
        self.manager.unload("/n")
        self.assertLess(time.monotonic() - begin, HELD_UP)


if __name__ == "__main__":
    rospy.init_node("sim_time_test")
    CLOCK = rospy.Publisher("/clock", Clock, queue_size=100)
    rostest.rosrun("dyknow", "sim_time", "__main__")
