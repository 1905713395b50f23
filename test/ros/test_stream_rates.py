#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rates in real processes: a part that slows down is replaced, once."""

from __future__ import annotations

import time

import rospy
import rostest
from dyknow_msgs.srv import AcquireStream, AcquireStreamRequest
from manager_suite import MANAGER
from std_msgs.msg import Header
from stream_suite import GOAL, StreamCase, transformation

import dyknow
from dyknow.model.streams import ClaimState, StreamRequest

#: The cameras of the suite's library send 20 Hz.
RATE = 14.0
#: Seconds in which something that flaps would be replaced again.
LONG = 20.0


class RateTest(StreamCase):
    def test_a_part_that_slows_down_is_replaced_once(self):
        manager = self.tracking()
        manager.client.spawn("camera", "/eye", {"out": "/eye/raw"})
        with dyknow.acquire(GOAL, Header, min_rate=RATE, client_id="keen") as stream:
            flow = self.flow(stream.topic)
            flow.wait()
            events = self.events()
            time.sleep(LONG / 2)
            self.assertEqual([each.reason for each in events.all if "Hz" in each.reason], [])
            slow = self.nodelet_of(manager, "filter")
            others = set(stream.nodelets) - {slow}
            self.tell(slow, "slow")
            events.mended(f"nodelet {slow} is too slow", 20.0)
            flow.wait()
            self.become(manager, stream.claim_id, ClaimState.ACTIVE)
            self.assertLessEqual(others, set(stream.nodelets))
            self.assertNotIn(slow, stream.nodelets)
            time.sleep(LONG)
            mended = [each.reason for each in events.all if each.reason.startswith("mended")]
            self.assertEqual(len(mended), 1, mended)
            self.assertIn(f"at least {RATE:g} Hz are demanded", mended[0])
        self.settled(manager)

    def test_what_is_not_fast_enough_anywhere_is_degraded(self):
        manager = self.tracking()
        claim = manager.client.acquire_stream(StreamRequest("Raw(own)", min_rate=60.0))
        self.become(manager, claim.claim_id, ClaimState.DEGRADED, 40.0)
        detail = self.claim(manager, claim.claim_id).detail
        self.assertIn("is too slow: it sends", detail)
        self.assertIn("at least 60 Hz are demanded", detail)
        self.flow(claim.topic).wait()

    def test_stated_rates_are_believed_and_bad_values_refused(self):
        manager = self.tracking()
        for label, rate, cost in (("lazy", 5, 1), ("eager", 50, 2)):
            text = transformation(label, "Counter", "Scan(here)", cost=cost)
            stated = text.replace('<port type="out">', f'<port type="out" rate="{rate}">')
            manager.client.add_transformation(stated)
        wanted = StreamRequest("Scan(here)", min_rate=30.0)
        plan = manager.client.acquire_stream(wanted, dry_run=True)
        self.assertEqual(plan.spawned, ("eager",))
        self.assertTrue(plan.plan.startswith("Scan(here) [at least 30 Hz]: cost 2"), plan.plan)
        (eager,) = [
            each for each in manager.client.get_model().transformations if each.label == "eager"
        ]
        self.assertEqual(eager.ports[0].rate, 50.0)
        acquire = rospy.ServiceProxy(f"{MANAGER}/acquire_stream", AcquireStream)
        for name, value in (("min_rate", -1.0), ("min_rate", float("nan")), ("budget", 61.0)):
            answer = acquire(AcquireStreamRequest(tag="Scan(here)", **{name: value}))
            self.assertFalse(answer.success)
            self.assertIn(f"parameter '{name}' is {value}", answer.message)


if __name__ == "__main__":
    rospy.init_node("stream_rates_test")
    rostest.rosrun("dyknow", "stream_rates", "__main__")
