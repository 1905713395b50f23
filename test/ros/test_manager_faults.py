#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager survives killed, stopped and hanging processes, including its own."""

from __future__ import annotations

import os
import signal
import tempfile
import threading
import time
from unittest import mock

import rosgraph
import rospy
import rostest
from manager_suite import (
    CHILD,
    ManagerCase,
    ManagerProcess,
    Receiver,
    eventually,
    gaps,
    parameters,
    registrations,
)
from processes import BUSY, HELD_UP, Running, free_port
from std_msgs.msg import Header
from test_boot import BootTest

from dyknow.errors import DyKnowError, Refused
from dyknow.model.graph import State
from dyknow.ros.process.os_process import ProcessId


class NodeletManagerFaultsTest(ManagerCase):
    def test_kill_9_of_a_nodelet_manager_with_twenty_nodelets(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s0"}, is_protected=True)
        for number in range(19):
            config = {"in": f"/s{number}", "out": f"/s{number + 1}"}
            manager.client.spawn("relay", f"/relay{number}", config, number % 2 == 0)
        manager.client.set_config("/relay18", {"out": "/end"})
        eventually(lambda: manager.topics("/relay18")["out"] == "/end", 1.0, "the change is seen")
        rospy.set_param("/relay3/of_others", 1)
        before = {each.name: each for each in manager.client.get_model().nodelets}
        receiver = Receiver("/end")
        self.addCleanup(receiver.close)
        receiver.flows()

        begin = time.monotonic()
        manager.kill_child()
        receiver.numbers.clear()
        receiver.flows(10.0)
        took = time.monotonic() - begin
        print(f"kill -9 of the nodelet manager: all streams back after {took:.2f} s")

        def same():
            now = {each.name: each for each in manager.client.get_model().nodelets}
            return now == before

        eventually(same, 2.0, "everything is as it was")
        self.assertEqual(rospy.get_param("/counter/rate"), 50.0)
        self.assertEqual(rospy.get_param("/relay3/of_others"), 1)
        rospy.delete_param("/relay3")
        self.assertEqual(manager.nodelet("/counter").manager, CHILD)
        with self.assertRaises(Refused):
            manager.client.destroy("/counter")
        self.assertLess(took, HELD_UP)

    def test_a_stopped_nodelet_manager_blocks_nothing(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s"})
        manager.client.spawn("relay", "/healthy", {"in": "/s", "out": "/t"}, isolated=True)
        child = manager.child()
        child.signal(signal.SIGSTOP)
        self.addCleanup(child.signal, signal.SIGCONT)
        eventually(lambda: manager.nodelet("/counter").state is State.LOST, 3.0, "it is missed")
        self.assertRegex(
            manager.nodelet("/counter").detail,
            f"does not answer: .*kill -CONT {child.pid}; .*kill -9 {child.pid}",
        )
        begin = time.monotonic()
        with self.assertRaises(Refused):
            manager.client.spawn("relay", "/late", manager=CHILD)
        with self.assertRaises(Refused):
            manager.client.destroy("/counter")
        self.assertLess(time.monotonic() - begin, HELD_UP)
        times = []
        for _ in range(10):
            begin = time.monotonic()
            manager.client.get_model()
            times.append(time.monotonic() - begin)
        self.assertLess(max(times), HELD_UP)
        manager.client.set_config("/healthy", {"out": "/u"})
        eventually(lambda: manager.topics("/healthy")["out"] == "/u", 1.5, "others are looked at")
        child.signal(signal.SIGCONT)
        gone = "what was to be destroyed is, as soon as its nodelet manager answers"
        eventually(lambda: manager.nodelet("/counter") is None, 3.0, gone)
        time.sleep(0.7)
        self.assertIsNone(manager.nodelet("/late"))
        self.assertEqual(registrations("/late"), [])

    def test_an_isolated_nodelet_that_aborts_takes_nobody_along(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s"})
        manager.client.spawn("relay", "/relay", {"in": "/s", "out": "/t"})
        config = {"in": "/t", "out": "/u", "order": "/order"}
        manager.client.spawn("aborts", "/fragile", config, isolated=True)
        through, beside = Receiver("/u"), Receiver("/t")
        self.addCleanup(through.close)
        self.addCleanup(beside.close)
        through.flows()
        beside.flows()
        process = manager.child("/fragile_nodelet_manager")
        order = rospy.Publisher("/order", Header, queue_size=1)
        self.addCleanup(order.unregister)
        eventually(order.get_num_connections, 5.0, "it listens")
        count = len(beside.numbers)
        order.publish(Header())
        self.assertTrue(process.wait(5.0 * BUSY))
        through.numbers.clear()
        through.flows(10.0)
        self.assertEqual(gaps(beside.numbers), [])
        self.assertGreater(len(beside.numbers), count)
        # Its messages may be there before the manager knows that it is back.
        back = "it is back"
        eventually(lambda: manager.nodelet("/fragile").state is State.RUNNING, 5.0, back)
        self.assertTrue(manager.nodelet("/fragile").isolated)
        self.assertEqual(manager.topics("/fragile"), config)

    def test_a_spawn_that_hangs_fails_in_time_and_leaves_nothing(self):
        manager = self.started(spawn_timeout=1.0)
        manager.client.spawn("relay", "/name")
        manager.client.destroy("/name")
        before = registrations("/"), parameters("/")
        begin = time.monotonic()
        with self.assertRaisesRegex(Refused, "was not up within 1 s"):
            manager.client.spawn("hangs", "/name", {"in": "/a"})
        self.assertLess(time.monotonic() - begin, HELD_UP)
        self.assertEqual((registrations("/"), parameters("/")), before)
        manager.client.spawn("relay", "/name", {"in": "/a"})
        self.assertEqual(manager.nodelet("/name").transformation, "relay")

    def test_kill_9_of_the_nodelet_manager_in_the_middle_of_a_spawn(self):
        manager = self.started()
        answers = []

        def spawn():
            begin = time.monotonic()
            try:
                manager.client.spawn("hangs", "/name", {"in": "/a"})
            except DyKnowError as error:
                answers.append((str(error), time.monotonic() - begin))

        thread = threading.Thread(target=spawn)
        thread.start()
        eventually(lambda: registrations("/name"), 5.0, "on_init has begun")
        begin = time.monotonic()
        manager.child().signal(signal.SIGKILL)
        thread.join()
        self.assertLess(time.monotonic() - begin, HELD_UP)
        self.assertIn("/name", answers[0][0])
        eventually(lambda: registrations("/name") == [], 3.0, "nothing is registered")
        self.assertEqual(parameters("/name"), [])
        self.assertIsNone(manager.nodelet("/name"))
        manager.client.spawn("relay", "/name", {"in": "/a"})


class ManagerFaultsTest(ManagerCase):
    def test_kill_9_of_the_manager_disturbs_no_stream_and_is_recovered_from(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s0"}, is_protected=True)
        manager.client.spawn("relay", "/relay", {"in": "/s0", "out": "/s1"})
        manager.client.spawn("relay", "/alone", {"in": "/s1", "out": "/s2"}, isolated=True)
        before = manager.client.get_model()
        receiver = Receiver("/s2")
        self.addCleanup(receiver.close)
        receiver.flows()
        children = manager.children()
        for _ in range(2):
            manager.kill()
            receiver.flows()
            manager.start()
            self.assertEqual(manager.children(), children)
            self.assertEqual(manager.client.get_model().nodelets, before.nodelets)
            self.assertGreater(manager.client.get_model().revision, before.revision)
        receiver.flows()
        self.assertEqual(gaps(receiver.numbers), [])
        # Changes during its absence are followed; nodelets that died meanwhile are brought back.
        manager.kill()
        manager.client.set_config("/relay", {"out": "/other"})
        children["/alone_nodelet_manager"].signal(signal.SIGKILL)
        children["/alone_nodelet_manager"].wait(2.0 * BUSY)
        manager.start()
        eventually(lambda: manager.nodelet("/alone").state is State.RUNNING, 10.0, "it is back")
        self.assertEqual(manager.topics("/alone"), {"in": "/s1", "out": "/s2"})
        self.assertEqual(manager.topics("/relay"), {"in": "/s0", "out": "/other"})
        self.assertTrue(manager.nodelet("/counter").is_protected)

    def test_a_stopped_nodelet_manager_is_adopted_too(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s"})
        manager.kill()
        child = manager.child()
        child.signal(signal.SIGSTOP)
        self.addCleanup(child.signal, signal.SIGCONT)
        begin = time.monotonic()
        manager.start()
        self.assertLess(time.monotonic() - begin, HELD_UP)
        eventually(lambda: manager.nodelet("/counter").state is State.LOST, 3.0, "it is missed")
        child.signal(signal.SIGCONT)
        eventually(lambda: manager.nodelet("/counter").state is State.RUNNING, 3.0, "it is back")
        self.assertEqual(manager.child(), child)
        self.assertEqual(manager.topics("/counter"), {"out": "/s"})

    def test_children_end_when_nobody_looks_after_them(self):
        manager = self.started(orphan_timeout=1.0)
        manager.client.spawn("relay", "/relay")
        child = manager.child()
        manager.kill()
        self.assertTrue(child.wait(1.0 + 5.0 * BUSY))
        self.assertEqual(registrations("/relay") + registrations(CHILD + "/load"), [])

    def test_children_end_when_the_master_is_gone_as_well(self):
        for moment in ("it is started", "it is up"):
            with self.subTest(moment):
                child, log = self.child_of_the_killed(moment == "it is up")
                self.addCleanup(child.signal, signal.SIGKILL)
                self.assertTrue(child.wait(1.0 + 10.0 * BUSY), log)

    def child_of_the_killed(self, is_up: bool) -> tuple[ProcessId, str]:
        """Kill a manager and its master while its nodelet manager is started, or later."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        port = free_port()
        uri = f"http://localhost:{port}"
        master = rosgraph.Master(rospy.get_name(), uri)
        environment = mock.patch.dict(os.environ, {"ROS_MASTER_URI": uri})
        with environment, Running("rosmaster", "--core", "-p", port) as core:
            eventually(master.is_online, 10.0, "a master")
            manager = ManagerProcess(folder.name)
            settings = (f"_state_dir:={folder.name}", "_orphan_timeout:=1.0")
            with Running(*manager.command, *settings) as running:
                child = manager.child()
                if is_up:
                    eventually(lambda: offers(master, f"{CHILD}/list"), 20.0, "it is up")
                running.stop(signal.SIGKILL)
                core.stop(signal.SIGKILL)
                return child, running.output


__all__ = ["BootTest"]  # is run here for one life, and for many in the long run


def offers(master: rosgraph.Master, service: str) -> bool:
    """Whether a service is registered at a master."""
    return any(name == service for name, _ in master.getSystemState()[2])


if __name__ == "__main__":
    rospy.init_node("manager_faults_test")
    rostest.rosrun("dyknow", "manager_faults", "__main__")
