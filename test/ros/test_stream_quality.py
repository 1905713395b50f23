#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ages, rates and silence in real processes: a part that harms a stream is replaced, once."""

from __future__ import annotations

import signal
import time

import rospy
import rostest
from dyknow_msgs.srv import GetCounts
from geometry_msgs.msg import PointStamped
from processes import eventually
from std_msgs.msg import Header
from stream_suite import CAMERA, GOAL, StreamCase, transformation

import dyknow
from dyknow.model.streams import UNKNOWN_AGE, ClaimState, StreamRequest

MAX_AGE = 0.25  # s
MAX_SILENCE = 0.6  # s
#: The cameras of the suite's library send 20 Hz.
RATE = 14.0
#: Seconds for which a good stream is watched.
CALM = 6.0
#: Seconds in which something that flaps would be replaced again.
FLAPS = 15.0
TOPIC = "/scanner/points"
AGING = (
    "<transformations>"
    + transformation("eye", "Stamped", "Seen(ball)")
    + transformation("lagging", "Lagging", "Smooth(ball)", "Seen(ball)")
    + transformation("last", "Lagging", "Place(ball)", "Smooth(ball)")
    + transformation("counter", "Counter", "Number(ball)")
    + '<transformation type="topic"><label>scanner</label><source>'
    + TOPIC
    + "</source>"
    '<ports><port type="out" datatype="geometry_msgs/PointStamped">out</port></ports>'
    '<tags><tag port="out">Scan(ball)</tag></tags></transformation></transformations>'
)
#: As good as the camera of the suite's library.
TWIN = CAMERA.replace("<label>camera", "<label>twin")
MAP = transformation("map", "Counter", "Map(here)")
SPARE_MAP = transformation("spare map", "Counter", "Map(here)", cost=3)


class AgeTest(StreamCase):
    def tracking(self, **parameters):
        manager = super().tracking(**parameters)
        manager.client.add_transformation(AGING)
        return manager

    def scan(self):
        """Publish points as an ordinary node does; returns a function that sets their age."""
        publisher = rospy.Publisher(TOPIC, PointStamped, queue_size=10)
        self.addCleanup(publisher.unregister)
        age = [0.0]

        def publish(event):
            stamp = rospy.Time.now() - rospy.Duration(age[0]) if age[0] >= 0 else rospy.Time()
            publisher.publish(PointStamped(header=Header(stamp=stamp)))

        timer = rospy.Timer(rospy.Duration(0.05), publish)
        self.addCleanup(timer.shutdown)
        return lambda seconds: age.__setitem__(0, seconds)

    def test_an_ordinary_topic_is_judged_when_its_messages_arrive(self):
        manager = self.tracking()
        set_age = self.scan()
        claim = manager.client.acquire_stream(StreamRequest("Scan(ball)", max_age=MAX_AGE))
        time.sleep(CALM)
        found = self.claim(manager, claim.claim_id)
        self.assertEqual((found.state, found.detail), (ClaimState.ACTIVE, ""))
        set_age(0.5)
        self.become(manager, claim.claim_id, ClaimState.DEGRADED, 20.0)
        detail = self.claim(manager, claim.claim_id).detail
        self.assertRegex(detail, f"topic {TOPIC} delays the stream by 0.5[0-9]* s")
        set_age(0.0)
        self.become(manager, claim.claim_id, ClaimState.ACTIVE, 30.0)
        set_age(-1.0)
        eventually(
            lambda: self.claim(manager, claim.claim_id).detail == UNKNOWN_AGE,
            20.0,
            "messages without a stamp are noticed",
        )
        self.assertIs(self.claim(manager, claim.claim_id).state, ClaimState.ACTIVE)

    def test_a_nodelet_manager_tells_the_age_of_one_message_for_each_question(self):
        manager = self.tracking()
        manager.client.spawn("eye", "/eye", {"out": "/seen"})
        manager.client.spawn("lagging", "/lagging", {"in": "/seen", "out": "/smooth"})
        manager.client.spawn("counter", "/counter", {"out": "/number"})
        place = next(each.manager for each in manager.client.get_model().nodelets)
        proxy = rospy.ServiceProxy(f"{place}/get_counts", GetCounts)

        def ages():
            return {
                each.nodelet: {port.port: port.age for port in each.ports}
                for each in proxy([]).nodelets
            }

        first = ages()
        self.assertNotEqual(first["/eye"]["out"], first["/eye"]["out"], "NaN until then")
        eventually(lambda: 0 <= ages()["/eye"]["out"] < 0.1, 5.0, "the source is measured")
        self.tell("/lagging", "late")
        eventually(lambda: 0.3 < ages()["/lagging"]["out"] < 0.6, 5.0, "the delay is measured")
        found = ages()
        for unknown in (found["/lagging"]["in"], found["/counter"]["out"]):
            self.assertNotEqual(unknown, unknown, "NaN")


class HarmTest(StreamCase):
    """A part that harms a stream is replaced, and the stream is left alone after that."""

    def harm(self, manager, tag, label, order, said, because, **demands):
        """Make one part of a stream misbehave by an order."""
        with dyknow.acquire(tag, client_id="keen", **demands) as stream:
            events = self.events()
            time.sleep(CALM)
            bad = {ClaimState.RECOVERING, ClaimState.DEGRADED}
            self.assertFalse(bad & set(events.states(stream.claim_id)), events.all)
            harmful = self.nodelet_of(manager, label)
            others = set(stream.nodelets) - {harmful}
            self.tell(harmful, order)
            events.mended(f"nodelet {harmful} {said}", 20.0)
            self.become(manager, stream.claim_id, ClaimState.ACTIVE)
            self.assertLessEqual(others, set(stream.nodelets))
            self.assertNotIn(harmful, stream.nodelets)
            time.sleep(FLAPS)
            mended = [each.reason for each in events.all if each.reason.startswith("mended")]
            self.assertEqual(len(mended), 1, mended)
            self.assertRegex(mended[0], because)
        self.settled(manager)

    def test_a_part_that_delays_the_stream(self):
        manager = self.tracking()
        manager.client.add_transformation(AGING)
        because = "it is 0.[34][0-9]* s old, at most 0.25 s was asked for"
        said = "delays the stream by 0."
        self.harm(manager, "Place(ball)", "lagging", "late", said, because, max_age=MAX_AGE)

    def test_a_part_that_slows_down(self):
        manager = self.tracking()
        manager.client.spawn("camera", "/eye", {"out": "/eye/raw"})
        because = f"at least {RATE:g} Hz are demanded"
        self.harm(manager, GOAL, "filter", "slow", "is too slow", because, min_rate=RATE)


class StoppedTest(StreamCase):
    def test_who_hangs_makes_nobody_else_change(self):
        """Two claims; a process that one of them relies on is stopped for ten seconds."""
        manager = self.tracking()
        for text in (TWIN, MAP, SPARE_MAP):
            manager.client.add_transformation(text)
        manager.client.spawn("map", "/atlas", {"out": "/atlas/map"}, isolated=True)
        request = StreamRequest(GOAL, max_silence=MAX_SILENCE)
        near = manager.client.acquire_stream(request)
        far = manager.client.acquire_stream(StreamRequest("Map(here)", max_silence=MAX_SILENCE))
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
        time.sleep(4 * MAX_SILENCE)  # a silent part would be noticed in this time

        self.assertEqual(events.states(near.claim_id), [], [each.reason for each in events.all])
        self.assertEqual(self.claim(manager, near.claim_id), before)
        mended = [each.reason for each in events.all if each.reason.startswith("mended")]
        self.assertEqual(len(mended), 1, mended)
        self.assertIn("/atlas", mended[0])
        self.settled(manager)


if __name__ == "__main__":
    rospy.init_node("stream_quality_test")
    rostest.rosrun("dyknow", "stream_quality", "__main__")
