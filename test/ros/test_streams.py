#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams on request: the services, the Python client, the command line."""

from __future__ import annotations

import json
import signal
import time

import rospy
import rostest
from manager_suite import eventually
from processes import DYKNOW, Running, finished
from std_msgs.msg import Header
from stream_suite import FILTER, GOAL, SENSOR, SPARE_FILTER, StreamCase

import dyknow
from dyknow.errors import Refused, Result, StreamRefused
from dyknow.model.streams import NO_MESSAGE, ClaimState, StreamRequest


class AcquireTest(StreamCase):
    def test_what_variables_stand_for(self):
        self.tracking()
        with dyknow.acquire("Raw(?camera)") as raw, dyknow.acquire(GOAL) as ground:
            self.assertEqual((raw.bindings, ground.bindings), ({"?camera": "own"}, {}))

    def test_a_stream_is_made_and_lives_as_long_as_the_block(self):
        manager = self.tracking()
        events = self.events()
        with dyknow.acquire(GOAL, Header) as stream:
            self.assertEqual(stream.state, ClaimState.ACTIVE)
            self.assertEqual(stream.datatype, "std_msgs/Header")
            self.assertEqual(stream.spawned, ("/camera_1", "/filter_1", "/tracker_1"))
            flow = self.flow(stream.topic)
            flow.wait()
            self.settled(manager)
            shown = self.claim(manager, stream.claim_id)
            self.assertEqual(shown.client_id, rospy.get_name())
            self.assertEqual(shown.nodelets, stream.spawned)
            self.assertGreater(shown.expires, rospy.get_time())
            eventually(lambda: stream.detail == "", 5.0, "the first message has come")
        self.assertEqual(stream.state, ClaimState.RELEASED)
        eventually(lambda: not manager.client.get_model().nodelets, 8.0, "all is collected")
        self.assertEqual(
            [(event.after.state, event.after.detail) for event in events.all],
            [
                (ClaimState.ACTIVE, NO_MESSAGE),
                (ClaimState.ACTIVE, ""),
                (ClaimState.RELEASED, "released"),
            ],
        )
        self.assertIsNone(events.all[0].before)

    def test_what_cannot_be_made_is_refused_with_the_cause(self):
        manager = self.tracking()
        for tag, datatype, result in (
            ("Position(", "", Result.INVALID_TAG),
            ("Position(cat)", "", Result.NO_PLAN),
            (GOAL, "sensor_msgs/Image", Result.TYPE_MISMATCH),
        ):
            with self.assertRaises(StreamRefused) as caught:
                dyknow.acquire(tag, datatype)
            self.assertEqual(caught.exception.result, result, str(caught.exception))
        with self.assertRaisesRegex(
            StreamRefused, r"nothing supplies Position\(cat\); did you mean Position\(ball\)\?$"
        ):
            dyknow.acquire("Position(cat)")
        answer = manager.client.acquire_stream(StreamRequest(GOAL), dry_run=True)
        self.assertEqual((answer.claim_id, answer.spawned), ("", ("camera", "filter", "tracker")))
        self.assertEqual(answer.cost, 3.0)
        self.assertIn("filter", answer.plan)
        self.assertEqual(manager.client.get_model().nodelets, ())
        self.assertEqual(manager.claims(), [])

    def test_what_is_excluded_is_not_used(self):
        manager = self.tracking()
        with dyknow.acquire(GOAL, exclude="camera") as stream:
            self.assertEqual(stream.spawned, ("/ceiling_1", "/filter_1", "/tracker_1"))
            with dyknow.acquire("Filtered(ball)", exclude=["ceiling", "no such"]) as other:
                self.assertEqual(other.spawned, ("/camera_1", "/filter_2"))
                self.flow(other.topic).wait()
            self.flow(stream.topic).wait()
            self.settled(manager)
        with self.assertRaisesRegex(StreamRefused, r"camera, ceiling are excluded"):
            dyknow.acquire(GOAL, exclude=("camera", "ceiling"))

    def test_a_nodelet_acquires_streams_too(self):
        manager = self.tracking()
        manager.client.add_transformation(
            "<transformation><label>client</label><source>dyknow_manager_test/Client</source>"
            '<params><param name="tag" type="string">Filtered(ball)</param></params>'
            '<ports><port type="out">out</port></ports></transformation>'
        )
        manager.client.spawn("client", "/client", {"out": "/seen"})
        self.flow("/seen").wait()
        claims = manager.claims()
        self.assertEqual([each.tag for each in claims], ["Filtered(ball)"])
        manager.client.destroy("/client")
        eventually(lambda: not manager.client.get_model().nodelets, 8.0, "all is collected")

    def test_a_claim_is_pending_until_a_sensor_appears(self):
        manager = self.tracking()
        for label in ("camera", "ceiling"):
            manager.client.remove_transformation(label)
        manager.client.add_transformation(SENSOR)
        news = []
        with dyknow.acquire(GOAL, pending=True, on_event=news.append) as stream:
            self.assertEqual((stream.state, stream.topic), (ClaimState.PENDING, ""))
            self.assertIn("Raw(?camera)", stream.detail)
            self.assertFalse(stream.wait_until_active(0.3))
            sensor = rospy.Publisher("/sensor/raw", Header, queue_size=1)
            timer = rospy.Timer(rospy.Duration(0.05), lambda event: sensor.publish(Header()))
            self.addCleanup(timer.shutdown)
            self.assertTrue(stream.wait_until_active(20.0))
            self.flow(stream.topic).wait()
            self.settled(manager)
            self.assertIs(news[-1].after.state, ClaimState.ACTIVE)
            timer.shutdown()
            timer.join()
            sensor.unregister()
            self.become(manager, stream.claim_id, ClaimState.PENDING)
            eventually(lambda: stream.state is ClaimState.PENDING, 2.0, "the client is told")

    def test_a_lease_ends_unless_it_is_renewed(self):
        manager = self.tracking()
        client = manager.client
        answer = client.acquire_stream(StreamRequest(GOAL, client_id="me", lease=2.0))
        for _ in range(4):
            rospy.sleep(0.8)
            client.renew_stream(answer.claim_id, 2.0)
        self.assertIs(self.claim(manager, answer.claim_id).state, ClaimState.ACTIVE)
        self.become(manager, answer.claim_id, ClaimState.EXPIRED, 5.0)
        with self.assertRaisesRegex(Refused, answer.claim_id):
            client.renew_stream(answer.claim_id, 2.0)
        client.release_stream(answer.claim_id)
        client.release_stream("nonesuch")
        eventually(lambda: not client.get_model().nodelets, 8.0, "all is collected")

    def test_the_same_request_is_the_same_claim(self):
        manager = self.tracking()
        request = StreamRequest(GOAL, client_id="me", request_id="1", lease=30.0)
        first = manager.client.acquire_stream(request)
        second = manager.client.acquire_stream(request)
        self.assertEqual((first.claim_id, first.topic), (second.claim_id, second.topic))
        self.assertEqual(second.reused, first.spawned)

    def test_a_way_that_has_become_cheaper_is_taken_on_request(self):
        manager = self.tracking()
        manager.client.add_transformation(SPARE_FILTER)
        manager.client.remove_transformation("filter")
        with dyknow.acquire(GOAL, Header) as stream:
            topic = stream.topic
            flow = self.flow(topic)
            events = self.events()
            manager.client.add_transformation(FILTER)
            told = []

            def is_told():
                told[:] = [each for each in list(events.all) if "cheaper" in each.reason]
                return told

            eventually(is_told, 30.0, "the cheaper way is told of")
            self.assertIs(told[0].after.state, ClaimState.ACTIVE)
            self.assertEqual(self.nodelet_of(manager, "spare filter"), "/spare_filter_1")
            planned = manager.client.replan_stream(stream.claim_id, dry_run=True)
            self.assertIn("filter", planned.plan)
            manager.client.replan_stream(stream.claim_id)
            flow.wait()
            self.nodelet_of(manager, "filter")
            self.assertEqual(stream.topic, topic)
            self.settled(manager)


class CommandTest(StreamCase):
    """``dyknow`` in a shell, without a node."""

    def run_it(self, *words):
        code, output = finished([*DYKNOW, *words])
        self.assertEqual(code, 0, output)
        return output

    def test_a_stream_held_by_a_shell(self):
        manager = self.tracking()
        self.assertIn("filter.out [?camera=own] (new, cost 1)", self.run_it("plan", GOAL))
        self.assertIn("digraph", self.run_it("plan", GOAL, "--dot"))
        found = manager.client.find_bindings("Raw(?camera)", "std_msgs/Header")
        self.assertEqual(found, ("?camera=ceiling", "?camera=own"))
        with self.assertRaisesRegex(Refused, "expected Functor"):
            manager.client.find_bindings("Raw(")
        with Running(*DYKNOW, "acquire", GOAL) as shell:
            shell.wait_for("held until Ctrl-C")
            (claim,) = manager.claims()
            self.assertIn(claim.topic, shell.output)
            manager.client.destroy("/filter_1")
            shell.wait_for("active: mended")
            self.assertIn(claim.claim_id, self.run_it("streams"))
            manager.kill()
            shell.wait_for("waiting for it")
            manager.start()
            shell.wait_for("the manager is back")
            time.sleep(11.0)  # longer than the lease
            self.become(manager, claim.claim_id, ClaimState.ACTIVE)
            shell.stop()
            self.assertEqual(shell.exit_code(10.0), 0)
            self.assertIn(f"released {claim.claim_id}", shell.output)
        self.assertEqual(manager.claims(), [])

    def test_a_shell_that_is_killed_holds_nothing(self):
        manager = self.tracking()
        with Running(*DYKNOW, "acquire", GOAL, "--json") as shell:
            shell.wait_for('"state": "active"')
            (claim,) = manager.claims()
            shell.stop(signal.SIGKILL)
        self.become(manager, claim.claim_id, ClaimState.EXPIRED, 15.0)

    def test_a_claim_that_is_left_behind(self):
        manager = self.tracking()
        claim = json.loads(self.run_it("acquire", GOAL, "--lease", "0", "--json"))["claim"]
        self.assertEqual(
            json.loads(self.run_it("streams", "--json"))["streams"][0]["expires"], None
        )
        self.run_it("replan", claim)
        self.run_it("release", claim)
        self.become(manager, claim, ClaimState.RELEASED)
        code, output = finished([*DYKNOW, "acquire", "Position(cat)"])
        self.assertEqual(code, 1)
        self.assertIn("nothing supplies Position(cat)", output)


if __name__ == "__main__":
    rospy.init_node("streams_test")
    rostest.rosrun("dyknow", "streams", "__main__")
