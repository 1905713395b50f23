#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that crash their process repeatedly: their neighbours are left in peace."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import threading

import rosgraph
import rospkg
import rospy
import rostest
from manager_suite import (
    CHILD,
    ManagerCase,
    ManagerProcess,
    Receiver,
    each_within,
    eventually,
    nodes,
    parameters,
    registrations,
)
from nodelet.srv import NodeletUnload
from std_msgs.msg import String
from stream_suite import CAMERA, GOAL, SPARE_FILTER, TRACKER, StreamCase, transformation

from dyknow.errors import DyKnowError, StreamRefused
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.process.os_process import ProcessId

NEIGHBOURS = ("/counter", "/relay")


class CrashesTest(ManagerCase):
    def setUp(self):
        self.manager = self.started()
        self.client = self.manager.client
        self.client.spawn("counter", "/counter", {"out": "/s0"}, True)
        self.client.spawn("relay", "/relay", {"in": "/s0", "out": "/s1"})
        self.receiver = Receiver("/s1")
        self.addCleanup(self.receiver.close)
        self.receiver.flows()

    def spawn_fatal(self, topic: str = "", **moments: str) -> None:
        """Spawn a nodelet that ends its process at the given moments, but not in the spawn."""
        self.client.spawn("fatal", "/fatal", {"in": topic})
        for moment, way in moments.items():
            rospy.set_param(f"/fatal/{moment}", way)
            self.addCleanup(self.forget, f"/fatal/{moment}")

    def forget(self, parameter: str) -> None:
        if rospy.has_param(parameter):
            rospy.delete_param(parameter)

    def states(self) -> dict[str, State]:
        return {each.name: each.state for each in self.client.get_model().nodelets}

    def neighbours_run(self) -> bool:
        states = self.states()
        return all(states.get(name) is State.RUNNING for name in NEIGHBOURS)

    def assert_left_in_peace(self) -> None:
        """The neighbours' process lives on, without losing a message."""
        eventually(self.neighbours_run, 5.0, "the neighbours run", lambda: self.manager.output)
        self.receiver.flows()
        self.receiver.numbers.clear()
        child = self.manager.child()
        for _ in each_within(2.0):
            self.receiver.flows()
        self.assertEqual(self.manager.child(), child)
        first, last = self.receiver.numbers[0], self.receiver.numbers[-1]
        self.assertEqual(self.receiver.numbers, list(range(first, last + 1)))

    def test_one_that_crashes_on_each_message_is_kept_apart(self):
        for way in ("segfault", "exit"):
            with self.subTest(way):
                self.spawn_fatal("/s0", on_message=way)
                eventually(lambda: self.manager.nodelet("/fatal").isolated, 10.0, "it is alone")
                self.assert_left_in_peace()
                found = self.manager.nodelet("/fatal").detail
                self.assertRegex(found, "alone .* SIGSEGV|alone .* exit code 3")
                self.assertRegex(self.manager.output, "crashed .* while it ran code of .*/fatal")
                self.client.destroy("/fatal")
                self.assertNotIn("/fatal", self.states())

    def test_one_whose_on_init_crashes_is_kept_apart(self):
        self.spawn_fatal()
        rospy.set_param("/fatal/on_init", "abort")
        self.addCleanup(self.forget, "/fatal/on_init")
        self.manager.child().signal(signal.SIGKILL)
        eventually(lambda: self.manager.nodelet("/fatal").isolated, 10.0, "it is alone")
        self.assert_left_in_peace()
        eventually(lambda: self.states()["/fatal"] is State.FAILED, 5.0, "it does not come up")
        self.assertIn("SIGABRT", self.manager.nodelet("/fatal").detail)
        rospy.delete_param("/fatal/on_init")
        eventually(lambda: self.states()["/fatal"] is State.RUNNING, 40.0, "it comes up")

    def test_one_that_crashes_when_it_is_destroyed_or_unloaded_is_gone(self):
        def unload() -> None:
            with self.assertRaises(rospy.ServiceException):
                rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)("/fatal")

        for end in (unload, lambda: self.client.destroy("/fatal")):
            self.spawn_fatal(on_shutdown="segfault")
            end()
            eventually(lambda: "/fatal" not in self.states(), 2.0, "it is gone")
            self.assert_left_in_peace()
            self.assertNotIn("/fatal", self.states())

    def test_one_that_is_killed_by_others_is_no_suspect(self):
        self.spawn_fatal()
        for _ in range(3):
            killed = self.manager.child()
            order = rospy.Publisher("/fatal/order", String, queue_size=1, latch=True)
            order.publish("kill")  # reaches it however late the two connect
            eventually(lambda killed=killed: not killed.alive, 5.0, "it is killed")
            order.unregister()
            eventually(
                lambda killed=killed: self.manager.child() != killed, 10.0, "it is started again"
            )
            eventually(lambda: self.states()["/fatal"] is State.RUNNING, 10.0, "it is back")
        self.assertFalse(self.manager.nodelet("/fatal").isolated)


class ClaimsTest(StreamCase):
    """Claims with a part that crashes its process on its first message."""

    def fatal(self, way: str) -> str:
        parameter = f'<params><param name="on_message" type="string">{way}</param></params>'
        found = transformation("fatal", "Fatal", "Filtered(ball)", "Raw(?camera)")
        return found.replace("<ports>", parameter + "<ports>")

    def begin(self, library: str) -> None:
        self.manager = self.make(linger=1.0)
        self.manager.start()
        self.client = self.manager.client
        self.client.add_transformation(f"<transformations>{CAMERA}{library}</transformations>")

    def crashes(self, which: str) -> int:
        return len(re.findall(rf": {which} crashed \(", self.manager.output))

    def tries_apart(self, times: int) -> bool:
        """Whether it was tried apart; requests a stream that crashed while being made again."""
        if all(each.tag != GOAL or each.state.ended for each in self.client.list_streams()):
            with contextlib.suppress(StreamRefused):
                self.client.acquire_stream(StreamRequest(GOAL))
        return self.crashes(r"/fatal_\d+_nodelet_manager") >= times

    def test_the_only_way_is_tried_apart_from_its_neighbours(self):
        for way in ("segfault", "exit"):
            with self.subTest(way):
                self.begin(self.fatal(way) + TRACKER)
                sure = self.client.acquire_stream(StreamRequest("Raw(own)"))
                self.receiver = Receiver(sure.topic)
                self.addCleanup(self.receiver.close)
                eventually(lambda: self.tries_apart(1), 20.0, "it is tried apart")
                child, crashes = self.manager.child(), self.crashes(CHILD)
                eventually(lambda: self.tries_apart(2), 20.0, "it is tried again")
                self.receiver.flows(10.0)
                self.assertEqual((self.manager.child(), self.crashes(CHILD)), (child, crashes))
                self.assertRegex(self.manager.output, "/fatal_.* alone in its process: 2 crashes")
                self.manager.destroy()

    def test_another_way_is_taken(self):
        self.begin(self.fatal("segfault") + SPARE_FILTER + TRACKER)

        def active() -> bool:
            self.tries_apart(0)
            found = {each.transformation for each in self.client.get_model().nodelets}
            states = {each.tag: each.state for each in self.client.list_streams()}
            return "spare filter" in found and states.get(GOAL) is ClaimState.ACTIVE

        eventually(active, 20.0, "the spare filter is used")
        topic = next(each.topic for each in self.client.list_streams() if each.tag == GOAL)
        self.flow(topic).wait(10.0)


def everything() -> set[str]:
    """All registrations at the master."""
    return {*parameters("/"), *registrations("/"), *nodes()}


def files() -> list[str]:
    """Files of this master's nodelet managers in the log folder."""
    host, port = rosgraph.network.parse_http_host_and_port(rosgraph.get_master_uri())
    return os.listdir(os.path.join(rospkg.get_log_dir(), f"dyknow-{host}-{port}"))


class LeftoversTest(ManagerCase):
    def assert_as(self, before: set[str]) -> None:
        left = "everything at the master is as before"
        eventually(lambda: everything() == before, 20.0, left, lambda: everything() ^ before)

    def begin(self) -> tuple[ManagerProcess, set[str]]:
        """A manager whose child is up, and all that is registered then."""
        manager = self.started()
        eventually(lambda: registrations(f"{CHILD}/list"), 10.0, "it is up")
        return manager, everything()

    def test_what_died_leaves_nothing(self):
        manager, before = self.begin()
        manager.client.spawn("relay", "/alone", {"in": "/a"}, isolated=True)
        for name in ("/alone_nodelet_manager", CHILD):
            manager.kill_child(name)
        eventually(lambda: manager.nodelet("/alone").state is State.RUNNING, 10.0, "it is back")
        self.assertIn("alone_nodelet_manager-running", files())
        manager.client.destroy("/alone")
        self.assert_as(before)
        self.assertNotIn("alone_nodelet_manager-running", files())

    def test_what_dies_before_it_is_up_leaves_nothing(self):
        manager, before = self.begin()
        name = "/alone_nodelet_manager"

        def spawn_in_vain() -> None:
            with contextlib.suppress(DyKnowError):
                manager.client.spawn("hangs", "/alone", isolated=True)
                refused.clear()

        refused = [True]
        spawn = threading.Thread(target=spawn_in_vain)
        spawn.start()
        eventually(lambda: name in nodes(), 10.0, "it begins to register")
        manager.children()[name].signal(signal.SIGKILL)
        spawn.join()
        self.assertTrue(refused)
        self.assert_as(before)

    def test_what_a_nodelet_forked_ends_with_its_process(self):
        manager = self.started()
        manager.client.spawn("forks", "/forks")
        eventually(lambda: rospy.get_param("/forks/pid", 0), 5.0, "it has forked")
        forked = ProcessId.of(rospy.get_param("/forks/pid"))
        rospy.delete_param("/forks/pid")
        self.assertTrue(forked.alive)
        manager.child().signal(signal.SIGKILL)
        eventually(lambda: not forked.alive, 5.0, "it has ended")
        eventually(lambda: rospy.get_param("/forks/pid", 0), 10.0, "it is back, and forks again")
        forked = ProcessId.of(rospy.get_param("/forks/pid"))
        forked.signal(signal.SIGTERM)  # not meant for the nodelet manager
        eventually(lambda: not forked.alive, 5.0, "it has ended")
        eventually(lambda: manager.nodelet("/forks").state is State.RUNNING, 10.0, "it runs")
        rospy.delete_param("/forks/pid")


if __name__ == "__main__":
    rospy.init_node("crashes_test")
    rostest.rosrun("dyknow", "crashes", "__main__")
