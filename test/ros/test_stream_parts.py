#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claimed streams survive parts that are destroyed, fail, fall silent, die or hang."""

from __future__ import annotations

import itertools
import signal
import threading
import time

import rospy
import rostest
from manager_suite import CHILD, eventually
from std_msgs.msg import Header
from stream_suite import CHEAP_FILTER, GOAL, SPARE_FILTER, StreamCase, transformation

import dyknow
from dyknow.errors import DyKnowError
from dyknow.model.streams import ClaimState, StreamRequest

HANGING = transformation("hanging", "HangsInInit", "Hanging(ball)", "Raw(?camera)")


class PartsTest(StreamCase):
    """Something happens to a part of a stream; its client keeps listening to the same topic."""

    def begin(self, own=False, **request):
        """Acquire a stream that flows; returns the manager, the stream, flow and events."""
        manager = self.tracking(own=own)
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

    def is_one_loss(self, events):
        """All three parts were lost at once: the claim was planned again only once."""
        states = [state for state, _ in itertools.groupby(each.after.state for each in events.all)]
        reasons = [each.reason for each in events.all]
        self.assertEqual(states.count(ClaimState.RECOVERING), 1, reasons)

    def test_each_part_destroyed(self):
        manager, stream, flow, events = self.begin()
        for label in ("tracker", "filter", "camera"):
            victim = self.nodelet_of(manager, label)
            manager.client.destroy(victim)
            events.mended(f"{victim} is gone")
            self.is_whole(manager, stream, flow)

    def test_a_part_unloaded_by_others(self):
        from nodelet.srv import NodeletUnload

        manager, stream, flow, events = self.begin()
        victim = self.nodelet_of(manager, "filter")
        rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)(victim)
        events.mended(f"{victim} is gone")
        self.is_whole(manager, stream, flow)

    def test_a_part_that_raises(self):
        self.falls_silent("raise")

    def test_a_part_that_is_silent(self):
        self.falls_silent("silent")

    def falls_silent(self, order):
        # A manager remembers for a while which transformations were silent.
        manager, stream, flow, events = self.begin(own=True, max_silence=0.5)
        victim = self.nodelet_of(manager, "filter")
        self.addCleanup(lambda: print([each.reason for each in events.all]))
        self.tell(victim, order)
        events.mended(victim)
        self.is_whole(manager, stream, flow)

    def test_its_nodelet_manager_killed(self):
        manager, stream, flow, events = self.begin()
        since = time.monotonic()
        manager.kill_child()
        self.is_whole(manager, stream, flow)
        self.is_one_loss(events)
        pause = flow.longest_pause(since)
        print(f"kill -9 of the nodelet manager: {pause:.2f} s without a message")

    def test_its_nodelet_manager_stopped(self):
        manager, stream, flow, events = self.begin()
        child = manager.child()
        child.signal(signal.SIGSTOP)
        self.addCleanup(child.signal, signal.SIGCONT)
        self.addCleanup(lambda: print([e.reason for e in events.all]))
        events.mended("does not answer", 20.0)
        flow.wait()
        eventually(lambda: stream.state is ClaimState.ACTIVE, 5.0, "the client knows")
        child.signal(signal.SIGCONT)
        self.is_whole(manager, stream, flow)
        self.is_one_loss(events)

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
        eventually(
            lambda: any("cheaper" in each.reason for each in list(events.all)),
            5.0,
            "it is told of",
        )
        self.nodelet_of(manager, "filter")
        manager.client.replan_stream(stream.claim_id)
        self.is_whole(manager, stream, flow)
        self.nodelet_of(manager, "cheap filter")

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

    def test_a_part_lost_while_another_stream_takes_long_to_be_made(self):
        manager, stream, flow, events = self.begin()
        manager.client.add_transformation(HANGING)
        answers = []

        def acquire():
            try:
                manager.client.acquire_stream(StreamRequest("Hanging(ball)"))
            except DyKnowError as error:
                answers.append(str(error))

        thread = threading.Thread(target=acquire)
        thread.start()
        self.addCleanup(thread.join)
        eventually(
            lambda: manager.nodelet("/hanging_1") is not None, 5.0, "the other is being made"
        )
        lost = self.nodelet_of(manager, "filter")
        manager.client.destroy(lost)
        events.mended(f"{lost} is gone")
        flow.wait()
        self.assertTrue(thread.is_alive(), "the other still takes its time")
        thread.join()
        self.assertIn("was not up within", answers[0])
        self.is_whole(manager, stream, flow)

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


if __name__ == "__main__":
    rospy.init_node("stream_parts_test")
    rostest.rosrun("dyknow", "stream_parts", "__main__")
