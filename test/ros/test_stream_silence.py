#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Silence in real processes: a process that hangs makes no other part count as silent."""

from __future__ import annotations

import signal
import time

import rospy
import rostest
from manager_suite import eventually
from processes import DYKNOW, Running, finished
from std_msgs.msg import Header
from stream_suite import CAMERA, GOAL, SENSOR, StreamCase, transformation

import dyknow
from dyknow.model.streams import NO_MESSAGE, ClaimState, StreamRequest

#: As good as the camera of the suite's library.
TWIN = CAMERA.replace("<label>camera", "<label>twin")
MAP = transformation("map", "Counter", "Map(here)")
SPARE_MAP = transformation("spare map", "Counter", "Map(here)", cost=3)
LIMIT = 0.6  # s


class StoppedTest(StreamCase):
    def test_who_hangs_makes_nobody_else_change(self):
        """Two claims; a process that one of them relies on is stopped for ten seconds."""
        manager = self.tracking()
        for text in (TWIN, MAP, SPARE_MAP):
            manager.client.add_transformation(text)
        manager.client.spawn("map", "/atlas", {"out": "/atlas/map"}, isolated=True)
        request = StreamRequest(GOAL, max_silence=LIMIT)
        near = manager.client.acquire_stream(request)
        far = manager.client.acquire_stream(StreamRequest("Map(here)", max_silence=LIMIT))
        self.assertEqual(far.topic, "/atlas/map")
        flow, others = self.flow(near.topic), self.flow(far.topic)
        flow.wait()
        others.wait()
        for claim in (near, far):
            eventually(
                lambda claim=claim: not self.claim(manager, claim.claim_id).detail,
                10.0,
                "a message has come",
            )
        before = self.claim(manager, near.claim_id)
        events = self.events()

        process = manager.child("/atlas_nodelet_manager")
        process.signal(signal.SIGSTOP)
        self.addCleanup(process.signal, signal.SIGCONT)
        stopped = time.monotonic()
        others.wait(15.0)  # another node publishes there
        self.become(manager, far.claim_id, ClaimState.ACTIVE)
        time.sleep(max(0.0, stopped + 10.0 - time.monotonic()))
        process.signal(signal.SIGCONT)
        self.settled(manager)
        time.sleep(4 * LIMIT)  # a silent part would be noticed in this time

        self.assertEqual(events.states(near.claim_id), [], [each.reason for each in events.all])
        self.assertEqual(self.claim(manager, near.claim_id), before)
        mended = [each.reason for each in events.all if each.reason.startswith("mended")]
        self.assertEqual(len(mended), 1, mended)
        self.assertIn("/atlas", mended[0])
        self.settled(manager)


class FirstMessageTest(StreamCase):
    def test_no_message_yet_is_seen_by_everybody(self):
        manager = self.tracking()
        manager.client.spawn("camera", "/dark", {"out": "/dark/raw"})
        manager.client.spawn("filter", "/mood", {"in": "/dark/raw", "out": "/mood/filtered"})
        self.tell("/mood", "silent")
        events = self.events()
        with dyknow.acquire(GOAL, Header) as stream:
            self.assertEqual((stream.state, stream.detail), (ClaimState.ACTIVE, NO_MESSAGE))
            with Running(*DYKNOW, "acquire", GOAL) as shell:
                shell.wait_for("held until Ctrl-C")
                self.assertIn(NO_MESSAGE, shell.output)
                code, output = finished([*DYKNOW, "streams"])
                self.assertEqual((code, output.count(NO_MESSAGE)), (0, 2), output)
                time.sleep(2.0)  # several rounds
                self.assertEqual(stream.detail, NO_MESSAGE)
                self.tell("/mood", "work")
                shell.wait_for("its first message has come")
                eventually(lambda: stream.detail == "", 5.0, "the client is told")
                code, output = finished([*DYKNOW, "streams"])
                self.assertEqual((code, output.count(NO_MESSAGE)), (0, 0), output)
        told = [each.reason for each in events.all if each.after.claim_id == stream.claim_id]
        self.assertEqual(told, ["requested", "its first message has come", "released"])

    def test_nobody_listens_merely_to_find_out(self):
        manager = self.tracking()
        manager.client.add_transformation(SENSOR)
        sensor = rospy.Publisher("/sensor/raw", Header, queue_size=1)
        self.addCleanup(sensor.unregister)
        eventually(
            lambda: ["/sensor/raw", "std_msgs/Header"] in rospy.get_published_topics(),
            5.0,
            "the sensor is there",
        )
        with dyknow.acquire("Raw(sensor)", Header) as stream:
            self.assertEqual(stream.topic, "/sensor/raw")
            self.assertIn("not known whether messages come", stream.detail)
            time.sleep(1.0)  # two rounds
            self.assertEqual(sensor.get_num_connections(), 0)
        with dyknow.acquire("Raw(sensor)", Header, max_silence=5.0) as stream:
            self.assertEqual(stream.detail, NO_MESSAGE)
            eventually(sensor.get_num_connections, 5.0, "it is listened to")
            timer = rospy.Timer(rospy.Duration(0.05), lambda event: sensor.publish(Header()))
            self.addCleanup(timer.shutdown)
            eventually(lambda: stream.detail == "", 5.0, "the client is told")
        eventually(lambda: not sensor.get_num_connections(), 5.0, "nobody listens any more")


if __name__ == "__main__":
    rospy.init_node("stream_silence_test")
    rostest.rosrun("dyknow", "stream_silence", "__main__")
