#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A topic of a claim has one publisher at a time, whichever links are cut.

The DyKnow manager is on a host of its own, and the client, this process, hears every host.
"""

from __future__ import annotations

import contextlib
import time
from typing import ContextManager

import hosts_suite
import rospy
from cpp_suite import OURS, start
from graph import Heard
from hosts_suite import NOTICED, HostsCase
from manager_suite import CHILD, library, listed, specification
from processes import HELD_UP, Running, eventually, suspended
from std_msgs.msg import Header
from stream_suite import CAMERA, LIBRARY

from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.wire.master import Master

CPP_CAMERA = specification(
    "cpp camera", "dyknow_cpp_test/Source", "out>=Raw(own)", count=1000000, rate=50.0
)
#: Seconds for which two nodes may send on a topic of a claim, side by side.
MOST_TOGETHER = 1.0
#: Seconds for other work of the machine.
SLACK = 2.0


def sender(message: Header) -> str:
    return message._connection_header["callerid"]


class Fencing:
    """A claim whose stream comes from a nodelet on another host than the manager's."""

    tag = "Filtered(ball)"
    specifications = LIBRARY
    camera = "camera"

    def setUp(self) -> None:
        super().setUp()
        self.robot, self.far = self.host(), self.host()
        self.far_process = self.far_manager()
        self.manager = self.make(nodelet_managers=["/far"])
        self.manager.command = self.robot.command(*self.manager.command)
        self.manager.start()
        self.manager.client.add_transformation(self.specifications)
        self.claim_of(self.tag, "/far")

    def claim_of(self, tag: str, manager: str) -> None:
        """Acquire a stream that is made in a nodelet manager."""
        eventually(lambda: self.is_spawned(manager), 30.0, f"{manager} is used", self.reasons)
        self.claim_id = self.manager.client.acquire_stream(StreamRequest(tag)).claim_id
        topic = self.claim(self.manager, self.claim_id).topic
        self.senders, self.place = self.enter(Heard(topic, note=sender)), manager
        eventually(lambda: self.senders[-1:] == [manager], NOTICED, "messages come", self.reasons)
        time.sleep(3.0)  # the lease, which takes half a second, is confirmed

    def far_manager(self) -> Running:
        return self.nodelet_manager(self.far, "far")

    def is_spawned(self, manager: str) -> bool:
        with contextlib.suppress(Exception):
            self.manager.client.spawn(self.camera, f"{manager}_camera", manager=manager)
            return True
        return False

    def reasons(self) -> str:
        return self.manager.output[-4000:] + self.far_process.output[-2000:]

    def since(self, moment: float) -> set[str]:
        """The senders of the messages that came after a moment."""
        pairs = list(zip(self.senders.times, list(self.senders)))
        return {each for when, each in pairs if when >= moment}

    def together(self) -> float:
        """The longest time (s) for which messages of two senders alternated."""
        longest, begin, previous = 0.0, None, None
        for moment, each in list(zip(self.senders.times, list(self.senders))):
            if previous is not None and each != previous[1] and moment - previous[0] < 0.5:
                begin = previous[0] if begin is None else begin
                longest = max(longest, moment - begin)
            elif begin is not None and moment - begin > longest + 0.5:
                begin = None  # one of them has been alone for a while
            previous = (moment, each)
        return longest

    def one_sends(self, seconds: float = 5.0) -> None:
        self.stays(seconds, lambda: self.together() <= MOST_TOGETHER, self.reasons)

    def is_replaced(self) -> None:
        """Wait until messages come from elsewhere."""
        eventually(lambda: self.senders[-1] != self.place, 5.0, "it is replaced", self.reasons)

    def replaces_it(self, fault: ContextManager[None], seconds: float) -> None:
        """The part on /far is replaced, and sends nothing beside its replacement."""
        began = time.monotonic()
        with fault:
            self.is_replaced()
            replaced = time.monotonic()
            print(f"replaced after {replaced - began:.2f} s")
            self.one_sends(seconds)
        self.one_sends()
        print(f"two senders for {self.together():.2f} s")
        self.assertNotIn("/far", self.since(replaced + SLACK))
        self.is_whole()

    def is_whole(self) -> None:
        self.become(self.manager, self.claim_id, ClaimState.ACTIVE)
        topic = self.claim(self.manager, self.claim_id).topic
        publishers = Master(rospy.get_name()).publishers
        eventually(lambda: len(publishers(topic)) == 1, 15.0, "one publishes", self.reasons)

    def stays_away(self, pid: int) -> None:
        """Its process is stopped, and replaced; it sends nothing when it goes on."""
        with suspended(pid):
            self.is_replaced()
            time.sleep(8.0)
            went_on = time.monotonic()
        self.one_sends()
        # Messages in its sockets at that moment have arrived before.
        self.assertNotIn(self.place, self.since(went_on), self.reasons())
        self.is_whole()

    def test_a_split_between_the_manager_and_a_part(self):
        ways = ((self.robot, self.far), (self.far, self.robot))
        self.replaces_it(self.network.without(*ways), 6.0)

    def test_a_nodelet_manager_that_is_stopped(self):
        self.stays_away(self.far_process.pid)

    def test_a_manager_that_is_stopped_disturbs_nothing(self):
        with suspended(self.manager.process.pid):
            time.sleep(10.0)
        self.disturbs_nothing()

    def disturbs_nothing(self, longest_pause: float = 5.0) -> None:
        """No other part is used, nor is there a pause of half as long as the manager was away."""
        went_on = time.monotonic()
        eventually(lambda: self.since(went_on), NOTICED, "it goes on", self.reasons)
        self.one_sends()
        self.assertEqual({*self.senders}, {"/far"}, self.reasons())
        self.assertLess(self.senders.longest_pause(0.0), longest_pause)
        self.is_whole()


class FencingTest(Fencing, HostsCase):
    def test_a_way_that_is_cut_towards_the_manager(self):
        self.replaces_it(self.network.without((self.far, self.robot)), 6.0)

    def test_a_way_that_is_cut_towards_the_part(self):
        self.replaces_it(self.network.without((self.robot, self.far)), 6.0)

    def test_a_round_trip_of_two_seconds(self):
        self.replaces_it(self.network.far(self.far, 1.0), 10.0)

    def test_what_is_stopped_together_goes_on_together(self):
        with suspended(self.manager.process.pid, self.far_process.pid):
            time.sleep(10.0)
        self.disturbs_nothing(longest_pause=HELD_UP)

    def test_a_child_of_the_manager_that_is_stopped(self):
        self.manager.client.release_stream(self.claim_id)
        self.manager.client.destroy("/far_camera")
        self.claim_of("Raw(own)", CHILD)
        self.stays_away(self.manager.child().pid)

    def test_a_manager_that_is_killed_disturbs_nothing(self):
        self.manager.kill()
        time.sleep(6.0)
        self.manager.start()
        self.disturbs_nothing()


class CppFencingTest(Fencing, HostsCase):
    """The same of a nodelet in C++ that knows nothing of DyKnow."""

    tag = "Raw(own)"
    camera = "cpp camera"
    specifications = library(CAMERA, CPP_CAMERA)

    def far_manager(self) -> Running:
        process = self.far.run(*OURS, "__name:=far")
        self.addCleanup(process.__exit__)
        eventually(lambda: listed("/far") is not None, 2 * NOTICED, "/far is up")
        return process

    def is_spawned(self, manager: str) -> bool:
        if not super().is_spawned(manager):
            return False
        start(f"{manager}_camera")
        return True


if __name__ == "__main__":
    hosts_suite.run()
