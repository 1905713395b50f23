#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ages, rates and silence in real processes: a part that harms a stream is replaced, once."""

from __future__ import annotations

import signal
import time

import rospy
import rostest
from dyknow_msgs.srv import AcquireStream, AcquireStreamRequest, GetCounts
from geometry_msgs.msg import PointStamped
from manager_suite import MANAGER
from processes import DYKNOW, Running, eventually, finished
from std_msgs.msg import Header
from stream_suite import CAMERA, GOAL, SENSOR, StreamCase, transformation

import dyknow
from dyknow.model.streams import NO_MESSAGE, UNKNOWN_AGE, ClaimState, StreamRequest

MAX_AGE = 0.25  # s
MAX_SILENCE = 0.6  # s
#: The cameras of the suite's library send 20 Hz.
RATE = 14.0
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
    #: Seconds in which something that flaps would be replaced again.
    long = 15.0

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

    def test_a_part_that_delays_the_stream_is_replaced_once(self):
        manager = self.tracking()
        with dyknow.acquire("Place(ball)", PointStamped, max_age=MAX_AGE) as stream:
            events = self.events()
            time.sleep(self.long / 2)
            self.assertEqual([each.reason for each in events.all if "old" in each.reason], [])
            late = self.nodelet_of(manager, "lagging")
            others = set(stream.nodelets) - {late}
            self.tell(late, "late")
            events.mended(f"nodelet {late} delays the stream by 0.", 20.0)
            self.become(manager, stream.claim_id, ClaimState.ACTIVE)
            self.assertLessEqual(others, set(stream.nodelets))
            self.assertNotIn(late, stream.nodelets)
            time.sleep(self.long)
            mended = [each.reason for each in events.all if each.reason.startswith("mended")]
            self.assertEqual(len(mended), 1, mended)
            self.assertRegex(mended[0], "it is 0.[34][0-9]* s old, at most 0.25 s was asked for")
        self.settled(manager)

    def test_an_ordinary_topic_is_judged_when_its_messages_arrive(self):
        manager = self.tracking()
        set_age = self.scan()
        claim = manager.client.acquire_stream(StreamRequest("Scan(ball)", max_age=MAX_AGE))
        time.sleep(self.long / 2)
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
            request = AcquireStreamRequest(tag="Number(ball)", datatype=datatype, max_age=MAX_AGE)
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


class RateTest(StreamCase):
    #: Seconds in which something that flaps would be replaced again.
    long = 20.0

    def test_a_part_that_slows_down_is_replaced_once(self):
        manager = self.tracking()
        manager.client.spawn("camera", "/eye", {"out": "/eye/raw"})
        with dyknow.acquire(GOAL, Header, min_rate=RATE, client_id="keen") as stream:
            flow = self.flow(stream.topic)
            flow.wait()
            events = self.events()
            time.sleep(self.long / 2)
            self.assertEqual([each.reason for each in events.all if "Hz" in each.reason], [])
            slow = self.nodelet_of(manager, "filter")
            others = set(stream.nodelets) - {slow}
            self.tell(slow, "slow")
            events.mended(f"nodelet {slow} is too slow", 20.0)
            flow.wait()
            self.become(manager, stream.claim_id, ClaimState.ACTIVE)
            self.assertLessEqual(others, set(stream.nodelets))
            self.assertNotIn(slow, stream.nodelets)
            time.sleep(self.long)
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
    rospy.init_node("stream_quality_test")
    rostest.rosrun("dyknow", "stream_quality", "__main__")
