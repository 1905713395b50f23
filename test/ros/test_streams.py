#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams on request: acquired, and kept while parts are lost or do harm, and processes die.

Limits are far beyond the delays of a busy machine: 5 s of age or silence, a tenth of a rate.
"""

from __future__ import annotations

import signal
import time

import rospy
from geometry_msgs.msg import PointStamped
from graph import Heard, peer, poll
from manager_suite import CHILD, library, specification
from nodelet.srv import NodeletUnload
from processes import DYKNOW, Done, Running, eventually, run
from std_msgs.msg import Header
from stream_suite import GOAL, SPARE_FILTER, StreamCase, transformation
from test_signed_streams import SignedTest

import dyknow
from dyknow.errors import Refused
from dyknow.model.streams import NO_MESSAGE, UNKNOWN_AGE, ClaimState, StreamRequest
from dyknow.model.transformation import Port, Transformation

__all__ = ["SignedTest"]  # is run here once, and often in the long run

LIMIT = 5.0  # s, of an age or a silence; late messages are twice as old
TOPIC = "/scanner/points"
SCAN = Port("out", "out", "geometry_msgs/PointStamped", ("Scan(ball)",))
SCANNER = Transformation("scanner", TOPIC, "topic", ports=(SCAN,)).to_xml()
AGING = library(
    transformation("eye", "Stamped", "Seen(ball)"),
    transformation("lagging", "Lagging", "Smooth(ball)", "Seen(ball)"),
    transformation("last", "Lagging", "Place(ball)", "Smooth(ball)"),
    transformation("lens", "Moody", "Sharp(ball)", "Raw(?camera)"),
    transformation("spare lens", "Moody", "Sharp(ball)", "Raw(?camera)", 5),
)
CLIENT = specification("client", "dyknow_manager_test/Client", "out>", tag="Filtered(ball)")
MAPS = library(
    transformation("map", "Counter", "Map(here)"),
    transformation("spare map", "Counter", "Map(here)", cost=3),
    transformation("twin", "Counter", "Raw(own)"),  # as good as the camera
)


class AcquireTest(StreamCase):
    def test_a_stream_is_made_and_lives_as_long_as_the_block(self):
        manager = self.tracking()
        events = self.events()
        with dyknow.acquire(GOAL, Header) as stream:
            self.assertEqual(stream.state, ClaimState.ACTIVE)
            self.assertEqual(stream.datatype, "std_msgs/Header")
            self.assertEqual(stream.spawned, ("/camera_1", "/filter_1", "/tracker_1"))
            self.enter(Heard(stream.topic)).flows()
            self.settled(manager)
            shown = self.claim(manager, stream.claim_id)
            self.assertEqual(shown.client_id, rospy.get_name())
            self.assertEqual(shown.nodelets, stream.spawned)
            self.assertGreater(shown.expires, rospy.get_time())
            eventually(lambda: stream.detail == "", 5.0, "the first message has come")
        self.assertEqual(stream.state, ClaimState.RELEASED)
        self.is_cleared(manager)
        eventually(lambda: len(events) > 2, 5.0, "the last event is heard")
        self.assertEqual(
            [(event.after.state, event.after.detail) for event in events],
            [
                (ClaimState.ACTIVE, NO_MESSAGE),
                (ClaimState.ACTIVE, ""),
                (ClaimState.RELEASED, "released"),
            ],
        )
        self.assertIsNone(events[0].before)

    def test_a_nodelet_acquires_streams_too(self):
        manager = self.tracking()
        manager.client.add_transformation(CLIENT)
        manager.client.spawn("client", "/client", {"out": "/seen"})
        self.enter(Heard("/seen")).flows()
        self.assertEqual([each.tag for each in manager.claims()], ["Filtered(ball)"])
        manager.client.destroy("/client")
        self.is_cleared(manager)

    def test_a_topic_that_appears_ages_and_disappears(self):
        manager = self.tracking()
        manager.client.add_transformation(SCANNER)
        age = 0.0

        def publish(event):
            stamp = rospy.Time.now() - rospy.Duration(age) if age >= 0 else rospy.Time()
            scanner.publish(PointStamped(header=Header(stamp=stamp)))

        def becomes(state, detail):
            self.become(manager, stream.claim_id, state)
            eventually(
                lambda: detail in self.claim(manager, stream.claim_id).detail,
                20.0,
                detail,
                lambda: self.claim(manager, stream.claim_id),
            )
            eventually(lambda: stream.state is state, 5.0, "the client is told")

        news = []
        request = {"pending": True, "max_age": LIMIT, "on_event": news.append}
        with dyknow.acquire("Scan(ball)", PointStamped, **request) as stream:
            self.assertEqual((stream.state, stream.topic), (ClaimState.PENDING, ""))
            self.assertIn("Scan(ball)", stream.detail)
            scanner = rospy.Publisher(TOPIC, PointStamped, queue_size=10)
            timer = rospy.Timer(rospy.Duration(0.05), publish)
            self.addCleanup(timer.shutdown)
            self.assertTrue(stream.wait_until_active(400.0))
            self.enter(Heard(stream.topic, PointStamped)).flows()
            self.delivers(manager, stream.claim_id)
            states = lambda: [each.after.state for each in news]  # noqa: E731
            eventually(lambda: states()[-1:] == [ClaimState.ACTIVE], 5.0, "it is told", states)
            age = 2 * LIMIT
            becomes(ClaimState.DEGRADED, f"topic {TOPIC} delays the stream by 1")
            age = 0.0
            becomes(ClaimState.ACTIVE, "")
            age = -1.0
            becomes(ClaimState.ACTIVE, UNKNOWN_AGE)
            timer.shutdown()
            timer.join()
            scanner.unregister()
            becomes(ClaimState.PENDING, "Scan(ball)")

    def test_a_nodelet_manager_tells_the_age_of_one_message_for_each_question(self):
        manager = self.tracking()
        manager.client.add_transformation(AGING)
        manager.client.spawn("eye", "/eye", {"out": "/seen"})
        manager.client.spawn("lagging", "/lagging", {"in": "/seen", "out": "/smooth"})
        manager.client.spawn("camera", "/camera", {"out": "/number"})

        def age(nodelet, port):
            (counts,) = poll(CHILD, nodelet).counts
            return next(each.age for each in counts.ports if each.port == port)

        first = age("/eye", "out")
        self.assertNotEqual(first, first, "NaN until the first question")
        eventually(lambda: 0 <= age("/eye", "out") < LIMIT, 5.0, "the source is measured")
        self.tell("/lagging", "late")
        late = lambda: 2 * LIMIT <= age("/lagging", "out") < 3 * LIMIT  # noqa: E731
        eventually(late, 5.0, "the delay is measured")
        for unknown in (age("/lagging", "in"), age("/camera", "out")):
            self.assertNotEqual(unknown, unknown, "NaN")


class PartsTest(StreamCase):
    """Something happens to a part of a stream; its client keeps listening to the same topic."""

    def test_parts_that_are_destroyed_unloaded_or_killed(self):
        manager = self.tracking()
        events = self.events()
        with dyknow.acquire(GOAL, Header) as stream:
            topic, flow = stream.topic, self.enter(Heard(stream.topic))
            flow.flows()

            def loses(label, cause, lose):
                since, victim = len(events), self.nodelet_of(manager, label)
                lose(victim)
                events.mended(cause.format(victim), since)
                self.become(manager, stream.claim_id, ClaimState.ACTIVE)
                flow.flows()
                self.settled(manager)
                self.assertEqual(stream.topic, topic)
                eventually(lambda: stream.state is ClaimState.ACTIVE, 2.0, "the client knows")
                events.is_one_loss(since)

            unload = rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)
            loses("tracker", "{} is gone", manager.client.destroy)
            loses("filter", "{} is gone", unload)
            loses("camera", "", lambda victim: manager.kill_child())

    def test_a_process_that_hangs_makes_no_other_part_change(self):
        manager = self.tracking()
        manager.client.add_transformation(MAPS)
        manager.client.spawn("map", "/atlas", {"out": "/atlas/map"}, isolated=True)
        near, far = (
            manager.client.acquire_stream(StreamRequest(tag, max_silence=LIMIT))
            for tag in (GOAL, "Map(here)")
        )
        self.assertEqual(far.topic, "/atlas/map")
        for claim in (near, far):
            self.delivers(manager, claim.claim_id)
        before, events = self.claim(manager, near.claim_id), self.events()
        flow = self.enter(Heard(far.topic))
        with manager.child_stopped("/atlas_nodelet_manager"):
            stopped = time.monotonic()
            self.assertIn("/atlas", events.mended().reason)
            flow.flows()  # another node publishes there
            self.become(manager, far.claim_id, ClaimState.ACTIVE)
            # For longer than a stream may be silent.
            eventually(lambda: time.monotonic() > stopped + LIMIT + 2.0, 10.0, "time passes")
        self.settled(manager)
        self.assertEqual(self.claim(manager, near.claim_id), before)
        self.assertEqual(events.changes(claim_id=near.claim_id), [])
        events.is_one_loss(claim_id=far.claim_id)


class HarmTest(StreamCase):
    def test_a_part_that_harms_a_stream_is_replaced_once_and_no_other_part(self):
        manager = self.tracking(own=True)  # it remembers harmful parts for a while
        manager.client.add_transformation(AGING)
        manager.client.add_transformation(SPARE_FILTER)
        late = "delays the stream by 1.* s old, at most 5 s is demanded"
        slow = "is too slow.*at least 3 Hz are demanded"
        for tag, label, order, said, limit in (
            ("Place(ball)", "lagging", "late", late, {"max_age": LIMIT}),
            (GOAL, "filter", "slow", slow, {"min_rate": 3.0}),
            ("Sharp(ball)", "lens", "raise", "", {"max_silence": LIMIT}),
        ):
            with self.subTest(label), dyknow.acquire(tag, client_id="keen", **limit) as stream:
                self.delivers(manager, stream.claim_id)
                events = self.events()
                harmful = self.nodelet_of(manager, label)
                others = set(stream.nodelets) - {harmful}
                self.tell(harmful, order)
                self.assertRegex(events.mended().reason, f"{harmful} {said}")
                self.delivers(manager, stream.claim_id)
                self.assertLessEqual(others, set(stream.nodelets))
                self.assertNotIn(harmful, stream.nodelets)
                self.settled(manager)
                events.is_one_loss()
                events.close()
            self.is_cleared(manager)


class ProcessesTest(StreamCase):
    """Clients and the manager end, die, and come back."""

    def test_clients_that_end_and_die_and_a_manager_that_ends(self):
        manager = self.tracking()
        for number, state in ((signal.SIGINT, "RELEASED"), (signal.SIGKILL, "EXPIRED")):
            with Running(*peer("claim", GOAL)) as client:
                client.wait_for("ACTIVE")
                (claim,) = manager.claims()
                self.settled(manager)
                client.stop(number)
                client.exit_code(20.0)
            self.become(manager, claim.claim_id, ClaimState[state])
            self.is_cleared(manager)
        self.assertIn("bond", manager.output)
        with Running(*peer("claim", GOAL)) as client:
            client.wait_for("ACTIVE")
            manager.stop()
            client.wait_for("the manager was stopped")
            manager.start()
            self.assertEqual(manager.claims(), [])
            self.assertEqual(manager.client.get_model().nodelets, ())

    def test_kill_9_of_the_manager(self):
        manager = self.tracking()
        found = manager.client.find_bindings("Raw(?camera)", "std_msgs/Header")
        self.assertEqual(found, ("?camera=ceiling", "?camera=own"))
        with self.assertRaisesRegex(Refused, "expected Functor"):
            manager.client.find_bindings("Raw(")
        with Running(*peer("claim", GOAL)) as client, Running(*DYKNOW, "acquire", GOAL) as shell:
            client.wait_for("ACTIVE")
            shell.wait_for("held until Ctrl-C")
            request = StreamRequest("Filtered(ball)", lease=600.0)
            leased = manager.client.acquire_stream(request).claim_id
            before = {each.claim_id: each for each in manager.claims()}
            (own,) = (key for key, each in before.items() if "peer" in each.client_id)
            (held,) = before.keys() - {own, leased}
            self.assertIn(before[held].topic, shell.output)
            flow = self.enter(Heard(before[own].topic))

            def goes_on():
                for claim_id, claim in before.items():
                    self.become(manager, claim_id, ClaimState.ACTIVE)
                    after = self.claim(manager, claim_id)
                    self.assertEqual((after.topic, after.tag), (claim.topic, claim.tag))
                flow.flows()
                self.settled(manager)

            nodelets = before[own].nodelets
            goes_on()
            manager.kill()
            shell.wait_for("waiting for it")
            flow.flows()  # messages flow without the manager
            manager.start()
            shell.wait_for("the manager is back")
            goes_on()
            self.assertEqual(self.claim(manager, own).nodelets, nodelets)
            # Parts that die while the manager is dead are replaced after its restart.
            manager.kill()
            manager.child().signal(signal.SIGKILL)
            manager.start()
            goes_on()
            time.sleep(11.0)  # longer than a lease, and than bonds wait for a client
            goes_on()
            # A client that dies while the manager is dead is missed too.
            manager.kill()
            client.stop(signal.SIGKILL)
            manager.start()
            self.become(manager, own, ClaimState.EXPIRED)
            manager.client.destroy(self.nodelet_of(manager, "tracker"))
            shell.wait_for("active: mended")
            self.assertIn(held, Done("streams").out)
            shell.stop()
            self.assertEqual(shell.exit_code(20.0), 0)
            self.assertIn(f"released {held}", shell.output)
        manager.client.release_stream(leased)
        self.is_cleared(manager)


if __name__ == "__main__":
    run()
