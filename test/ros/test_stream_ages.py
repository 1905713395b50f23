#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ages of messages in real processes: a part that delays a stream is replaced, once."""

from __future__ import annotations

import time

import rospy
import rostest
from dyknow_msgs.srv import AcquireStream, AcquireStreamRequest, GetCounts
from geometry_msgs.msg import PointStamped
from manager_suite import MANAGER
from processes import eventually
from std_msgs.msg import Header
from stream_suite import StreamCase, transformation

import dyknow
from dyknow.model.streams import UNKNOWN_AGE, ClaimState, StreamRequest

LIMIT = 0.25
#: Seconds in which something that flaps would be replaced again.
LONG = 15.0
TOPIC = "/scanner/points"
LIBRARY = (
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


class AgeTest(StreamCase):
    def tracking(self, **parameters):
        manager = super().tracking(**parameters)
        manager.client.add_transformation(LIBRARY)
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

    def test_a_part_that_delays_the_stream_is_replaced_once(self):
        manager = self.tracking()
        with dyknow.acquire("Place(ball)", PointStamped, max_age=LIMIT) as stream:
            events = self.events()
            time.sleep(LONG / 2)
            self.assertEqual([each.reason for each in events.all if "old" in each.reason], [])
            late = self.nodelet_of(manager, "lagging")
            others = set(stream.nodelets) - {late}
            self.tell(late, "late")
            events.mended(f"nodelet {late} delays the stream by 0.", 20.0)
            self.become(manager, stream.claim_id, ClaimState.ACTIVE)
            self.assertLessEqual(others, set(stream.nodelets))
            self.assertNotIn(late, stream.nodelets)
            time.sleep(LONG)
            mended = [each.reason for each in events.all if each.reason.startswith("mended")]
            self.assertEqual(len(mended), 1, mended)
            self.assertRegex(mended[0], "it is 0.[34][0-9]* s old, at most 0.25 s was asked for")
        self.settled(manager)

    def test_an_ordinary_topic_is_judged_when_its_messages_arrive(self):
        manager = self.tracking()
        set_age = self.scan()
        claim = manager.client.acquire_stream(StreamRequest("Scan(ball)", max_age=LIMIT))
        time.sleep(LONG / 2)
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

    def test_types_without_a_header_are_refused(self):
        manager = self.tracking()
        acquire = rospy.ServiceProxy(f"{MANAGER}/acquire_stream", AcquireStream)
        for datatype in ("", "std_msgs/Header"):  # one is known after the spawn, one before
            request = AcquireStreamRequest(tag="Number(ball)", datatype=datatype, max_age=LIMIT)
            answer = acquire(request)
            self.assertFalse(answer.success)
            self.assertEqual(answer.result, answer.TYPE_MISMATCH)
            self.assertIn("carries std_msgs/Header, but a type that begins with", answer.message)
        self.assertEqual(manager.claims(), [])
        self.settled(manager)

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


if __name__ == "__main__":
    rospy.init_node("stream_ages_test")
    rostest.rosrun("dyknow", "stream_ages", "__main__")
