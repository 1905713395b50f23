#!/usr/bin/env python3
"""What claimed streams survive: parts that are destroyed, fail or fall silent, dead processes."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import rospy
import rostest
from manager_suite import CHILD, eventually
from processes import Running
from std_msgs.msg import Header
from stream_suite import CHEAP_FILTER, GOAL, SPARE_FILTER, StreamCase

import dyknow
from dyknow.manager.claim import ClaimState, StreamRequest

CLIENT = [sys.executable, str(Path(__file__).resolve().parent / "stream_client.py")]


class PartsTest(StreamCase):
    """Something happens to a part of a stream; its client keeps listening to the same topic."""

    def begin(self, **request):
        """Acquire a stream that flows; its manager, the stream, its flow and its events."""
        manager = self.tracking()
        manager.client.add_transformation(SPARE_FILTER)
        events = self.events()
        stream = dyknow.acquire(GOAL, Header, **request)
        self.addCleanup(stream.release)
        flow = self.flow(stream.topic)
        flow.wait()
        self.topic = stream.topic
        return manager, stream, flow, events

    def is_whole(self, manager, stream, flow):
        self.become(manager, stream.claim_id, ClaimState.ACTIVE)
        flow.wait()
        self.assertEqual(stream.topic, self.topic)
        self.settled(manager)
        eventually(lambda: stream.state is ClaimState.ACTIVE, 2.0, "the client knows")

    def test_each_part_destroyed(self):
        manager, stream, flow, events = self.begin()
        for label in ("tracker", "filter", "camera"):
            manager.client.destroy(self.nodelet_of(manager, label))
            count = len(events.all)
            eventually(lambda: len(events.all) > count + 1, 10.0, "it is mended")  # noqa: B023
            self.is_whole(manager, stream, flow)
            self.assertIn("gone", events.all[-1].reason)

    def test_a_part_unloaded_by_others(self):
        from nodelet.srv import NodeletUnload

        manager, stream, flow, events = self.begin()
        count = len(events.all)
        rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)("/filter_1")
        eventually(lambda: len(events.all) > count + 1, 10.0, "it is mended")
        self.is_whole(manager, stream, flow)

    def test_a_part_that_raises(self):
        self.falls_silent("raise")

    def test_a_part_that_is_silent(self):
        self.falls_silent("silent")

    def falls_silent(self, order):
        manager, stream, flow, events = self.begin(max_silence=0.5)
        victim = self.nodelet_of(manager, "filter")
        self.tell(victim, order)
        flow.ceases()
        flow.wait(8.0)
        self.is_whole(manager, stream, flow)
        self.assertTrue(
            any(victim in event.reason for event in events.all), [e.reason for e in events.all]
        )

    def test_its_nodelet_manager_killed(self):
        manager, stream, flow, events = self.begin()
        manager.child().signal(signal.SIGKILL)
        flow.ceases()
        took = flow.wait(8.0)
        print(f"kill -9 of the nodelet manager: messages again {took:.2f} s after they ceased")
        self.is_whole(manager, stream, flow)

    def test_its_nodelet_manager_stopped(self):
        manager, stream, flow, events = self.begin()
        child = manager.child()
        child.signal(signal.SIGSTOP)
        self.addCleanup(child.signal, signal.SIGCONT)
        self.addCleanup(lambda: print([e.reason for e in events.all]))
        flow.ceases()
        flow.wait(20.0)
        eventually(lambda: stream.state is ClaimState.ACTIVE, 5.0, "the client knows")
        child.signal(signal.SIGCONT)
        self.is_whole(manager, stream, flow)

    def test_its_transformation_removed(self):
        manager, stream, flow, events = self.begin()
        manager.client.remove_transformation("filter")
        eventually(
            lambda: "/spare_filter_1" in self.claim(manager, stream.claim_id).nodelets,
            10.0,
            "the spare filter takes over",
        )
        self.is_whole(manager, stream, flow)
        self.assertTrue(any("removed" in event.reason for event in events.all))

    def test_a_cheaper_one_added(self):
        manager, stream, flow, events = self.begin()
        manager.client.add_transformation(CHEAP_FILTER)
        eventually(lambda: len(events.all) > 1, 5.0, "it is told of")
        self.assertIn("cheaper", events.all[-1].reason)
        self.nodelet_of(manager, "filter")
        before = len(flow.arrivals)
        manager.client.replan_stream(stream.claim_id)
        self.is_whole(manager, stream, flow)
        self.nodelet_of(manager, "cheap filter")
        pauses = [b - a for a, b in zip(flow.arrivals[before:], flow.arrivals[before + 1 :])]
        print(f"taken over within {max(pauses) * 1000:.0f} ms")
        self.assertLess(max(pauses), 2.0)

    def test_two_claims_share_a_part(self):
        manager, stream, flow, events = self.begin()
        with dyknow.acquire("Filtered(ball)") as other:
            self.assertEqual(other.spawned, ())
            manager.client.destroy(self.nodelet_of(manager, "filter"))
            self.become(manager, other.claim_id, ClaimState.ACTIVE)
            self.is_whole(manager, stream, flow)
            self.flow(other.topic).wait()
            stream.release()
            eventually(
                lambda: len(manager.client.get_model().nodelets) == 2, 8.0, "the rest is collected"
            )
            self.flow(other.topic).wait()
            self.settled(manager)
        eventually(lambda: not manager.client.get_model().nodelets, 8.0, "all is collected")

    def test_protected_and_hand_spawned_parts_stay(self):
        manager = self.tracking()
        manager.client.spawn("camera", "/mine", {"out": "/mine/out"}, is_protected=True)
        with dyknow.acquire(GOAL) as stream:
            self.assertEqual(stream.reused, ("/mine",))
            manager.client.set_protection("/filter_1", True)
        eventually(
            lambda: [each.name for each in manager.client.get_model().nodelets]
            == ["/filter_1", "/mine"],
            8.0,
            "the unprotected tracker is collected",
        )
        time.sleep(1.0)
        self.assertEqual(len(manager.client.get_model().nodelets), 2)


class ProcessesTest(StreamCase):
    def test_its_client_dies(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            (claim,) = manager.client.list_streams()
            self.settled(manager)
            client.stop(signal.SIGKILL)
        took = self.become(manager, claim.claim_id, ClaimState.EXPIRED)
        print(f"a dead client is missed after {took:.1f} s")
        self.assertIn("bond", manager.output)
        eventually(lambda: not manager.client.get_model().nodelets, 8.0, "all is collected")

    def test_its_client_ends(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            (claim,) = manager.client.list_streams()
            client.stop()
            self.assertEqual(client.exit_code(20.0), 0)
        self.assertIs(self.claim(manager, claim.claim_id).state, ClaimState.RELEASED)

    def test_kill_9_of_the_manager(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            (before,) = manager.client.list_streams()
            leased = manager.client.acquire_stream(StreamRequest("Filtered(ball)", lease=600.0))
            flow = self.flow(before.topic)
            flow.wait()
            for pause in (0.0, 6.0):
                manager.kill()
                time.sleep(pause)
                flow.wait()  # nobody needs the manager for messages to flow
                manager.start()
                flow.wait()
                self.become(manager, before.claim_id, ClaimState.ACTIVE)
                after = self.claim(manager, before.claim_id)
                self.assertEqual(
                    (after.topic, after.nodelets, after.tag),
                    (before.topic, before.nodelets, before.tag),
                )
                self.assertIs(self.claim(manager, leased.claim_id).state, ClaimState.ACTIVE)
                self.settled(manager)
            # What dies while nobody looks is mended by the next life.
            manager.kill()
            manager.child().signal(signal.SIGKILL)
            manager.start()
            flow.wait(20.0)
            self.become(manager, before.claim_id, ClaimState.ACTIVE)
            time.sleep(11.0)  # longer than bonds wait for a client that does not come
            self.assertIs(self.claim(manager, before.claim_id).state, ClaimState.ACTIVE)
            self.settled(manager)
            client.stop(signal.SIGKILL)
        self.become(manager, before.claim_id, ClaimState.EXPIRED)

    def test_the_client_died_while_the_manager_was_away(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            (claim,) = manager.client.list_streams()
            manager.kill()
            client.stop(signal.SIGKILL)
            manager.start()
        self.become(manager, claim.claim_id, ClaimState.EXPIRED, 15.0)
        eventually(lambda: not manager.client.get_model().nodelets, 8.0, "all is collected")

    def test_an_end_on_purpose_ends_claims(self):
        manager = self.tracking()
        with Running(*CLIENT, GOAL) as client:
            client.wait_for("ACTIVE")
            manager.stop()
            manager.start()
            self.assertEqual(manager.client.list_streams(), ())
            self.assertEqual(manager.client.get_model().nodelets, ())
            client.wait_for("EXPIRED", 40.0)


if __name__ == "__main__":
    rospy.init_node("stream_faults_test")
    rostest.rosrun("dyknow", "stream_faults", "__main__")
