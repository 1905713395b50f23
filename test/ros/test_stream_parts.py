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
from nodelet.srv import NodeletUnload
from std_msgs.msg import Header
from stream_suite import GOAL, SPARE_FILTER, StreamCase, transformation

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

    def test_each_part_destroyed_and_one_unloaded_by_others(self):
        manager, stream, flow, events = self.begin()
        for label in ("tracker", "filter", "camera"):
            victim = self.nodelet_of(manager, label)
            manager.client.destroy(victim)
            events.mended(f"{victim} is gone")
            self.is_whole(manager, stream, flow)
        victim = self.nodelet_of(manager, "filter")
        rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)(victim)
        events.mended(f"{victim} is gone")
        self.is_whole(manager, stream, flow)

    def test_a_part_whose_callback_raises_is_silent(self):
        # A manager remembers for a while which transformations were silent.
        manager, stream, flow, events = self.begin(own=True, max_silence=0.5)
        victim = self.nodelet_of(manager, "filter")
        self.tell(victim, "raise")
        events.mended(victim, 20.0)
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


if __name__ == "__main__":
    rospy.init_node("stream_parts_test")
    rostest.rosrun("dyknow", "stream_parts", "__main__")
