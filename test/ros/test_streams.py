#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams on request: the services, the Python client, the command line."""

from __future__ import annotations

import time

import rospy
import rostest
from manager_suite import eventually
from processes import DYKNOW, Running, finished
from std_msgs.msg import Header
from stream_suite import GOAL, SENSOR, StreamCase

import dyknow
from dyknow.errors import Refused
from dyknow.model.streams import NO_MESSAGE, ClaimState


class AcquireTest(StreamCase):
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


if __name__ == "__main__":
    rospy.init_node("streams_test")
    rostest.rosrun("dyknow", "streams", "__main__")
