#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager survives killed, stopped and hanging processes, including its own."""

from __future__ import annotations

import signal
import threading
import time

import rosgraph
import rospy
from dyknow_msgs.msg import Model
from graph import Heard
from manager_suite import (
    CHILD,
    ManagerCase,
    MasterCase,
    children_in,
    counted,
    gaps,
    parameters,
    registrations,
)
from processes import BUSY, HELD_UP, becomes, eventually, run
from std_msgs.msg import String
from test_boot import BootTest

from dyknow.errors import DyKnowError, Refused
from dyknow.model.graph import State
from dyknow.model.transformation import Parameter

__all__ = ["BootTest"]  # is run here for one life, and for many in the long run


class NodeletManagerFaultsTest(ManagerCase):
    def test_kill_9_of_a_nodelet_manager_with_twenty_nodelets(self):
        manager = self.started()
        given = (Parameter("rate", "double", "10.0"),)
        manager.client.spawn("counter", "/counter", {"out": "/s0"}, True, parameters=given)
        for number in range(19):
            config = {"in": f"/s{number}", "out": f"/s{number + 1}"}
            manager.client.spawn("relay", f"/relay{number}", config, number % 2 == 0)
        manager.client.set_config("/relay18", {"out": "/end"})
        manager.shows("/relay18", out="/end")
        self.parameter("/relay3/of_others", 1)
        receiver = self.enter(Heard("/end"))
        receiver.flows()
        before = nodelets(manager)

        begin = time.monotonic()
        manager.kill_child()
        receiver.flows()
        print(f"kill -9 of the nodelet manager: all back after {time.monotonic() - begin:.2f} s")
        becomes(lambda: nodelets(manager), before)
        self.assertEqual(rospy.get_param("/counter/rate"), 10.0)
        self.assertEqual(rospy.get_param("/relay3/of_others"), 1)
        with self.assertRaises(Refused):
            manager.client.destroy("/counter")

    def test_a_stopped_nodelet_manager_blocks_nothing(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s"})
        manager.client.spawn("relay", "/healthy", {"in": "/s", "out": "/t"}, isolated=True)
        with manager.child_stopped() as child:
            lost = manager.becomes("/counter", State.LOST)
            advice = f"does not answer: .*kill -CONT {child.pid}; .*kill -9 {child.pid}"
            self.assertRegex(lost.detail, advice)
            begin = time.monotonic()
            with self.assertRaises(Refused):
                manager.client.spawn("relay", "/late", manager=CHILD)
            with self.assertRaises(Refused):
                manager.client.destroy("/counter")
            manager.client.set_config("/healthy", {"out": "/u"})
            manager.shows("/healthy", out="/u")
            self.assertLess(time.monotonic() - begin, HELD_UP)
        manager.is_gone("/counter")  # is destroyed as soon as its nodelet manager answers
        self.assertIsNone(manager.nodelet("/late"))
        self.assertEqual(registrations("/late"), [])

    def test_a_restart_is_completed_when_a_stopped_nodelet_manager_goes_on(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s"})
        receiver = self.enter(Heard("/s", note=counted))
        receiver.flows()
        self.parameter("/counter/start", 1_000_000)
        with manager.child_stopped(), self.assertRaises(Refused):
            manager.client.restart("/counter")
        receiver.has(lambda number: number > 1_000_000)
        self.assertEqual(manager.becomes("/counter", State.RUNNING).manager, CHILD)
        self.assertEqual(manager.topics("/counter"), {"out": "/s"})

    def test_the_watchdog_restarts_what_hangs(self):
        manager = self.started(**{"watchdog/hung": 3.0})
        manager.client.spawn("counter", "/counter", {"out": "/s0"})
        manager.client.spawn("relay", "/relay", {"in": "/s0", "out": "/end"})
        receiver = self.enter(Heard("/end"))
        receiver.flows()
        (stopped,) = manager.children().values()
        before = nodelets(manager)
        stopped.signal(signal.SIGSTOP)
        becomes(lambda: stopped.alive, False)
        receiver.flows()
        becomes(lambda: nodelets(manager), before)
        self.assertEqual(manager.output.count("the watchdog restarts"), 1)
        self.assertIn(f"the watchdog restarts {CHILD}: it has not answered for", manager.output)

    def test_an_isolated_nodelet_that_aborts_takes_nobody_along(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s"})
        manager.client.spawn("relay", "/relay", {"in": "/s", "out": "/t"})
        config = {"in": "/t", "out": "/u"}
        manager.client.spawn("fatal", "/fragile", config, isolated=True)
        through, beside = self.enter(Heard("/u")), self.enter(Heard("/t", note=counted))
        through.flows()
        beside.flows()
        process = manager.child("/fragile_nodelet_manager")
        order = self.publisher("/fragile/order", String)
        eventually(order.get_num_connections, 5.0, "it listens")
        order.publish("abort")
        self.assertTrue(process.wait(5.0 * BUSY))
        through.flows()
        beside.flows()
        self.assertEqual(gaps(beside), [])
        # Its messages may be there before the manager knows that it is back.
        self.assertTrue(manager.becomes("/fragile", State.RUNNING).isolated)
        self.assertEqual(manager.topics("/fragile"), config)

    def test_a_spawn_that_hangs_fails_in_time_and_leaves_nothing(self):
        manager = self.started(spawn_timeout=5.0)
        manager.client.spawn("relay", "/name")
        manager.client.destroy("/name")
        before = registrations("/"), parameters("/")
        with self.assertRaisesRegex(Refused, "was not up within 5 s"):
            manager.client.spawn("hangs", "/name", {"in": "/a"})
        self.assertEqual((registrations("/"), parameters("/")), before)
        self.spawned(manager, "/name")

    def test_kill_9_of_the_nodelet_manager_in_the_middle_of_a_spawn(self):
        manager = self.started()
        answers = []

        def spawn():
            with self.assertRaises(Refused) as caught:
                manager.client.spawn("hangs", "/name", {"in": "/a"})
            answers.append(str(caught.exception))

        thread = threading.Thread(target=spawn)
        thread.start()
        eventually(lambda: registrations("/name"), 5.0, "on_init has begun")
        manager.child().signal(signal.SIGKILL)
        thread.join()
        self.assertIn("/name", answers[0])
        for kind in (registrations, parameters):
            becomes(lambda kind=kind: kind("/name"), [])
        self.assertIsNone(manager.nodelet("/name"))
        self.spawned(manager, "/name")


class ManagerFaultsTest(ManagerCase):
    def test_kill_9_of_the_manager_disturbs_no_stream_and_is_recovered_from(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s0"}, is_protected=True)
        manager.client.spawn("relay", "/relay", {"in": "/s0", "out": "/s1"})
        manager.client.spawn("relay", "/alone", {"in": "/s1", "out": "/s2"}, isolated=True)
        receiver = self.enter(Heard("/s2", note=counted))
        receiver.flows()
        before, children = manager.client.get_model(), manager.children()
        for _ in range(2):
            manager.kill()
            receiver.flows()
            manager.start()
            self.assertEqual(manager.children(), children)
            becomes(lambda: nodelets(manager), before.nodelets)
            self.assertGreater(manager.client.get_model().revision, before.revision)
        receiver.flows()
        self.assertEqual(gaps(receiver), [])
        # Changes during its absence are followed; nodelets that died meanwhile are brought back.
        manager.kill()
        manager.client.set_config("/relay", {"out": "/other"})
        children["/alone_nodelet_manager"].signal(signal.SIGKILL)
        children["/alone_nodelet_manager"].wait(2.0 * BUSY)
        manager.start()
        manager.becomes("/alone", State.RUNNING)
        manager.shows("/alone", **{"in": "/s1", "out": "/s2"})
        manager.shows("/relay", **{"in": "/s0", "out": "/other"})
        self.assertTrue(manager.nodelet("/counter").is_protected)

    def test_its_model_comes_when_it_answers(self):
        """A reader of the model may ask for a change at once."""
        manager = self.started()
        for number in range(10):
            manager.client.spawn("relay", f"/relay_{number}")
        child = manager.child()
        manager.kill()
        child.signal(signal.SIGKILL)  # it begins with many changes
        answers = []

        def ask(model: Model) -> None:
            try:
                answers.append(manager.client.get_model().revision >= model.revision)
            except DyKnowError as error:
                answers.append(error)

        subscriber = rospy.Subscriber(f"{manager.client.manager}/model", Model, ask)
        self.addCleanup(subscriber.unregister)
        manager.start()
        eventually(lambda: answers, 10.0, "the model comes")
        self.assertIs(answers[0], True)

    def test_a_stopped_nodelet_manager_is_adopted_too(self):
        manager = self.started()
        manager.client.spawn("counter", "/counter", {"out": "/s"})
        manager.kill()
        with manager.child_stopped() as child:
            begin = time.monotonic()
            manager.start()
            self.assertLess(time.monotonic() - begin, HELD_UP)
            manager.becomes("/counter", State.LOST)
        manager.becomes("/counter", State.RUNNING)
        self.assertEqual(manager.child(), child)
        self.assertEqual(manager.topics("/counter"), {"out": "/s"})

    def test_children_end_when_nobody_looks_after_them(self):
        manager = self.started(orphan_timeout=1.0)
        manager.client.spawn("relay", "/relay")
        child = manager.child()
        manager.kill()
        self.assertTrue(child.wait(1.0 + 5.0 * BUSY))
        self.assertEqual(registrations("/relay") + registrations(CHILD + "/load"), [])


class OrphansTest(MasterCase):
    def test_children_end_when_the_master_is_gone_as_well(self):
        for moment in ("it is started", "it is up"):
            with self.subTest(moment):
                core = self.roscore()
                manager = self.manager("_orphan_timeout:=1.0")
                eventually(lambda: CHILD in children_in(self.state), 20.0, "it is started")
                child = children_in(self.state)[CHILD]
                self.addCleanup(child.signal, signal.SIGKILL)
                if moment == "it is up":
                    eventually(self.offers_list, 20.0, "it is up")
                self.kill(manager, core)
                self.assertTrue(child.wait(1.0 + 10.0 * BUSY), manager.output)

    def offers_list(self):
        services = rosgraph.Master(rospy.get_name(), self.uri).getSystemState()[2]
        return any(name == f"{CHILD}/list" for name, _ in services)


def nodelets(manager):
    return manager.client.get_model().nodelets


if __name__ == "__main__":
    run()
