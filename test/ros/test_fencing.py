#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A topic of a claim has one publisher at a time, whoever cannot hear whom.

The DyKnow manager is on a host of its own, and the client, this process, hears everybody.
"""

from __future__ import annotations

import contextlib
import signal
import time
from typing import ContextManager, Iterator

import hosts_suite
import rospy
from cpp_suite import OURS, start
from hosts_suite import NOTICED, HostsCase
from manager_suite import CHILD, ManagerProcess, eventually, listed
from processes import Running
from std_msgs.msg import Header
from stream_suite import CAMERA, LIBRARY

from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.wire.master import Master

CPP_CAMERA = (
    "<transformation><label>cpp camera</label><source>dyknow_cpp_test/Source</source>"
    '<params><param name="count" type="int">1000000</param>'
    '<param name="rate" type="double">50.0</param></params>'
    '<ports><port type="out">out</port></ports>'
    '<tags><tag port="out">Raw(own)</tag></tags></transformation>'
)
#: Seconds for which two nodes may send on a topic of a claim, side by side.
MOST_TOGETHER = 1.0
#: Seconds from a fault to the first message of the replacement.
REPLACED = 3.0
#: Seconds for other work of the machine.
SLACK = 2.0


class Senders:
    """Which nodes' messages arrive on a topic, and when."""

    def __init__(self, topic: str) -> None:
        self.arrivals: list[tuple[float, str]] = []
        self._subscriber = rospy.Subscriber(topic, Header, self._note, queue_size=10000)
        self.close = self._subscriber.unregister

    def _note(self, message: Header) -> None:
        sender = message._connection_header["callerid"]
        self.arrivals.append((time.monotonic(), sender))

    def since(self, moment: float) -> list[tuple[float, str]]:
        return [each for each in self.arrivals if each[0] >= moment]

    def last(self) -> str:
        return self.arrivals[-1][1] if self.arrivals else ""

    def together(self) -> float:
        """The longest time (s) for which messages of two senders alternated."""
        longest, begin = 0.0, None
        previous = None
        for moment, sender in list(self.arrivals):
            if previous is not None and sender != previous[1] and moment - previous[0] < 0.5:
                begin = previous[0] if begin is None else begin
                longest = max(longest, moment - begin)
            elif begin is not None and moment - begin > longest + 0.5:
                begin = None  # one of them has been alone for a while
            previous = (moment, sender)
        return longest


class Fencing:
    """A claim whose stream comes from a nodelet on another host than the manager's."""

    tag = "Filtered(ball)"
    library = LIBRARY
    camera = "camera"

    def setUp(self) -> None:
        super().setUp()
        self.robot, self.far = self.host(), self.host()
        self.far_process = self.far_manager()
        self.manager = self.make(nodelet_managers=["/far"])
        self.manager.command = self.robot.command(*self.manager.command)
        self.manager.start()
        self.manager.client.add_transformation(self.library)
        eventually(self.is_spawned, 2 * NOTICED, "/far is used", lambda: self.manager.output)
        request = StreamRequest(self.tag)
        self.claim_id = self.manager.client.acquire_stream(request).claim_id
        topic = self.claim(self.manager, self.claim_id).topic
        self.senders = Senders(topic)
        self.addCleanup(self.senders.close)
        eventually(lambda: self.senders.last() == "/far", NOTICED, "messages come from /far")
        time.sleep(3.0)  # the lease, which takes half a second, is confirmed

    def far_manager(self) -> Running:
        return self.nodelet_manager(self.far, "far")

    def is_spawned(self, name: str = "/far_camera", manager: str = "/far") -> bool:
        with contextlib.suppress(Exception):
            self.manager.client.spawn(self.camera, name, manager=manager)
            return True
        return False

    def reasons(self) -> str:
        return self.manager.output[-4000:] + self.far_process.output[-2000:]

    def is_replaced(self) -> bool:
        return self.senders.last() not in ("", "/far")

    def has_one_sender(self) -> bool:
        return self.senders.together() <= MOST_TOGETHER

    def replaces_it(self, fault: ContextManager[None], seconds: float) -> None:
        """The part on /far is replaced, and sends nothing beside its replacement."""
        began = time.monotonic()
        with fault:
            eventually(self.is_replaced, REPLACED + SLACK, "it is replaced", self.reasons)
            print(f"replaced after {self.senders.arrivals[-1][0] - began:.2f} s")
            self.stays(seconds, self.has_one_sender, self.reasons)
        self.stays(5.0, self.has_one_sender, self.reasons)
        print(f"two senders for {self.senders.together():.2f} s")
        self.assertNotIn(
            "/far", {sender for _, sender in self.senders.since(began + REPLACED + SLACK)}
        )
        self.is_whole()

    def is_whole(self) -> None:
        eventually(
            lambda: self.claim(self.manager, self.claim_id).state is ClaimState.ACTIVE,
            NOTICED,
            "the claim is met",
            self.reasons,
        )
        topic = self.claim(self.manager, self.claim_id).topic
        eventually(
            lambda: len(Master(rospy.get_name()).publishers(topic)) == 1,
            3 * NOTICED,
            "one node publishes",
            self.reasons,
        )

    @contextlib.contextmanager
    def stopped(self, *processes: Running | ManagerProcess) -> Iterator[None]:
        for process in processes:
            _send(process, signal.SIGSTOP)
        try:
            yield
        finally:
            for process in processes:
                _send(process, signal.SIGCONT)

    def test_a_split_between_the_manager_and_a_part(self):
        ways = ((self.robot, self.far), (self.far, self.robot))
        self.replaces_it(self.network.without(*ways), 6.0)

    def test_a_nodelet_manager_that_is_stopped(self):
        with self.stopped(self.far_process):
            eventually(self.is_replaced, REPLACED + SLACK, "it is replaced", self.reasons)
            time.sleep(8.0)
            went_on = time.monotonic()
        self.stays(5.0, self.has_one_sender, self.reasons)
        late = [each for each in self.senders.since(went_on) if each[1] == "/far"]
        # Messages in its sockets at that moment have arrived before.
        self.assertEqual(late, [], self.reasons())
        self.is_whole()

    def test_a_manager_that_is_stopped_disturbs_nothing(self):
        with self.stopped(self.manager):
            time.sleep(10.0)
        self.disturbs_nothing()

    def disturbs_nothing(self) -> None:
        self.stays(5.0, self.has_one_sender, self.reasons)
        self.assertEqual({sender for _, sender in self.senders.arrivals}, {"/far"}, self.reasons())
        times = [moment for moment, _ in self.senders.arrivals]
        self.assertLess(
            max(b - a for a, b in zip(times, times[1:])), 5.0
        )  # s; the manager is away for longer
        self.is_whole()


class FencingTest(Fencing, HostsCase):
    def test_a_way_that_is_cut_towards_the_manager(self):
        self.replaces_it(self.network.without((self.far, self.robot)), 6.0)

    def test_a_way_that_is_cut_towards_the_part(self):
        self.replaces_it(self.network.without((self.robot, self.far)), 6.0)

    def test_a_round_trip_of_two_seconds(self):
        self.replaces_it(self.network.far(self.far, 1.0), 10.0)

    def test_what_is_stopped_together_goes_on_together(self):
        with self.stopped(self.manager, self.far_process):
            time.sleep(10.0)
        went_on = time.monotonic()
        eventually(lambda: self.senders.since(went_on), NOTICED, "it goes on", self.reasons)
        self.stays(5.0, self.has_one_sender, self.reasons)
        self.assertEqual({sender for _, sender in self.senders.arrivals}, {"/far"}, self.reasons())
        self.is_whole()

    def test_a_child_of_the_manager_that_is_stopped(self):
        self.manager.client.release_stream(self.claim_id)
        self.manager.client.destroy("/far_camera")
        eventually(
            lambda: self.is_spawned("/near_camera", CHILD), 30.0, "the child is up", self.reasons
        )
        claim = self.manager.client.acquire_stream(StreamRequest("Raw(own)"))
        senders = self.senders = Senders(claim.topic)
        self.addCleanup(senders.close)
        eventually(lambda: senders.last() == CHILD, NOTICED, "messages come", self.reasons)
        time.sleep(3.0)
        child = self.manager.child()
        child.signal(signal.SIGSTOP)
        try:
            replaced = REPLACED + SLACK
            eventually(lambda: senders.last() != CHILD, replaced, "it is replaced", self.reasons)
            time.sleep(8.0)
        finally:
            child.signal(signal.SIGCONT)
        went_on = time.monotonic()
        self.stays(5.0, self.has_one_sender, self.reasons)
        self.assertEqual([each for each in senders.since(went_on) if each[1] == CHILD], [])

    def test_a_manager_that_is_killed_disturbs_nothing(self):
        self.manager.kill()
        time.sleep(6.0)
        self.manager.start()
        self.disturbs_nothing()


class CppFencingTest(Fencing, HostsCase):
    """The same of a nodelet in C++ that knows nothing of DyKnow."""

    tag = "Raw(own)"
    camera = "cpp camera"
    library = f"<transformations>{CAMERA}{CPP_CAMERA}</transformations>"

    def far_manager(self) -> Running:
        process = self.far.run(*OURS, "__name:=far")
        self.addCleanup(process.__exit__)
        eventually(lambda: listed("/far") is not None, 2 * NOTICED, "/far is up")
        return process

    def is_spawned(self, name: str = "/far_camera", manager: str = "/far") -> bool:
        if not super().is_spawned(name, manager):
            return False
        start(name)
        return True


def _send(process: Running | ManagerProcess, number: int) -> None:
    if isinstance(process, Running):
        process.stop(number)
    else:
        process.process.send_signal(number)


if __name__ == "__main__":
    hosts_suite.run("fencing")
