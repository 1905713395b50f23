#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A robot boots: a wiring at the start, ends that keep everything, and roslaunch with respawn."""

from __future__ import annotations

import functools
import os
import signal
from pathlib import Path

import rosnode
import rospy
from graph import Heard
from manager_suite import LIBRARY, MANAGER, ManagerCase, children_in, counted, gaps
from processes import BUSY, NODELET, Done, becomes, eventually, run
from stream_suite import CAMERA

from dyknow.errors import HostError, PeerTimeout, Refused
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.ros.wire.master import Master

WIRED = {"/counter": {"out": "/numbers"}, "/relay": {"in": "/numbers", "out": "/copies"}}


class StartTest(ManagerCase):
    wiring: str

    def setUp(self):
        """Save a wiring, once."""
        self.file = str(self.make_folder() / "robot.xml")
        if not hasattr(StartTest, "wiring"):
            manager = self.started(own=True)
            manager.client.spawn("counter", "/counter", WIRED["/counter"], is_protected=True)
            manager.client.spawn("relay", "/relay", WIRED["/relay"])
            self.assertEqual(Done("save", self.file).code, 0)
            manager.destroy()
            StartTest.wiring = Path(self.file).read_text()
        Path(self.file).write_text(self.wiring)
        self.manager = self.make(wiring=self.file)

    def is_loaded(self):
        done = Done("load", "--wait", "--dry-run", "--within", "200", self.file)
        self.assertEqual(done.code, 0, done.err)

    def test_what_was_restored_comes_before_the_wiring(self):
        self.manager.start()
        self.is_loaded()
        self.assertTrue(self.manager.nodelet("/counter").is_protected)
        before = self.manager.child()
        self.manager.client.connect([("/relay", {"out": "/moved"})])
        self.manager.kill()
        self.manager.start()
        self.manager.becomes("/relay", State.RUNNING)
        self.assertEqual(self.manager.topics("/relay"), {"in": "/numbers", "out": "/moved"})
        self.assertEqual(self.manager.child(), before)
        text = Path(self.file).read_text().replace("/copies", "/others")
        Path(self.file).write_text(text)
        self.manager.kill()
        self.manager.start()
        self.manager.shows("/relay", out="/others")
        self.manager.stop()
        self.assertEqual(rospy.get_param(f"{MANAGER}/wiring"), self.file)
        self.manager.start()
        self.is_loaded()
        self.assertEqual(len(self.manager.client.get_model().nodelets), 2)

    def test_a_wrong_file_is_refused(self):
        Path(self.file).write_text("<wiring version='1'><nodelets><nodelet/></nodelets></wiring>")
        self.manager.start(wait=False)
        output = self.manager.fails()
        self.assertIn("robot.xml:1: <nodelet> has no attribute name", output)
        os.remove(self.file)
        self.manager.start(wait=False)
        self.assertIn("No such file or directory", self.manager.fails())

    def test_what_cannot_be_loaded_yet_is_loaded_later(self):
        text = self.wiring.replace('manager="/dyknow_nodelet_', 'manager="/other_')
        Path(self.file).write_text(text)
        self.manager = self.make(wiring=self.file, nodelet_managers=["other_manager"])
        self.manager.start()
        text = "its nodelet manager '/other_manager' is not running"
        eventually(lambda: text in self.manager.output, 10.0, "the trouble is said")
        self.assertEqual(self.manager.client.get_model().nodelets, ())
        self.run_process(*NODELET, "manager", "__name:=other_manager")
        self.is_loaded()

    def test_an_end_on_purpose_keeps_everything(self):
        manager = self.make(keep=True)
        manager.start()
        client = manager.client
        client.add_transformation(LIBRARY)
        client.add_transformation(CAMERA)
        client.spawn("counter", "/counter", WIRED["/counter"])
        client.spawn("relay", "/alone", WIRED["/relay"], isolated=True)
        claim = client.acquire_stream(StreamRequest("Raw(own)"))
        heard = [self.enter(Heard(t, note=counted)) for t in ("/copies", claim.topic)]
        for end in (signal.SIGINT, signal.SIGTERM):
            rospy.set_param("/given_up", "a node's, until the manager is away")
            before, children = client.get_model().nodelets, manager.children()
            manager.stop(end)
            self.assertEqual(manager.process.wait(20.0 * BUSY), 0, manager.output)
            self.assertIn("its nodelets go on", manager.output)
            self.assertTrue(all(each.alive for each in children.values()))
            for each in heard:
                each.flows(100)  # for longer than a lease
            (mirror,) = Path(manager.state).glob("*.master")
            self.assertIn("given_up", mirror.read_text())
            rospy.delete_param("/given_up")
            manager.start()
            self.assertFalse(rospy.has_param("/given_up"), "this is no new ROS master")
            becomes(lambda before=before: client.get_model().nodelets == before, True)
            self.assertEqual(manager.children(), children)
            (kept,) = manager.claims()
            self.assertEqual((kept.claim_id, kept.state), (claim.claim_id, ClaimState.ACTIVE))
        for each in heard:
            each.flows()
            self.assertEqual(gaps(list(each)), [])

    def test_parameters_of_the_command_line_end_with_it(self):
        """A manager without ``keep`` ends the processes that one with it has left."""
        manager = self.make()
        words = ["_keep:=true", f"_wiring:={self.file}", f"_transformations:={self.file}"]
        manager.command += words
        manager.start()
        self.is_loaded()
        children = manager.children()
        manager.stop()
        self.assertTrue(all(each.alive for each in children.values()))
        for word in words:
            self.assertFalse(rospy.has_param(f"{MANAGER}/{word[1:].partition(':=')[0]}"), word)
        del manager.command[-len(words) :]
        manager.start()
        manager.becomes("/relay", State.RUNNING)
        self.assertEqual(manager.children(), children)
        manager.stop()
        self.assertFalse([name for name, each in children.items() if each.alive])

    def test_a_nodelet_manager_that_is_not_named_any_more_keeps_its_nodelets(self):
        manager = self.make(keep=True, nodelet_managers=["other_manager"])
        self.run_process(*NODELET, "manager", "__name:=other_manager")
        manager.start()
        manager.client.add_transformation(LIBRARY)
        spawn = functools.partial(manager.client.spawn, "counter", "/counter", WIRED["/counter"])
        eventually(lambda: not refused(lambda: spawn(manager="/other_manager")), 20.0, "it is up")
        heard = self.enter(Heard("/numbers", note=counted))
        heard.flows()
        manager.stop()
        del manager.parameters["nodelet_managers"]
        rospy.delete_param(f"{MANAGER}/nodelet_managers")
        manager.start()
        manager.becomes("/counter", State.RUNNING)
        self.assertEqual(manager.nodelet("/counter").manager, "/other_manager")
        self.assertIn("'/other_manager' is used, though ~nodelet_managers", manager.output)
        heard.flows()
        self.assertEqual(gaps(list(heard)), [])
        manager.client.destroy("/counter")

    def test_roslaunch_with_respawn(self):
        state = self.manager.state
        words = (f"wiring:={self.file}", f"state_dir:={state}", "respawn:=true")
        launch = self.run_process("roslaunch", "dyknow", "manager.launch", *words)
        self.is_loaded()
        first = self.pid()
        children = children_in(state)
        os.kill(first, signal.SIGKILL)
        eventually(lambda: self.pid() not in (first, 0), 20.0, "it is back")
        self.is_loaded()
        self.assertEqual(children_in(state), children)
        heard = self.enter(Heard("/copies", note=counted))
        heard.flows()
        second = self.pid()
        rosnode.kill_nodes([MANAGER])
        eventually(lambda: self.pid() not in (second, 0), 20.0, "it is back")
        self.is_loaded()
        children = children_in(state)
        launch.stop()
        launch.exit_code(60.0)
        self.assertFalse([name for name, each in children.items() if each.alive])

    def pid(self):
        """The manager's process; 0 if none answers."""
        master = Master(rospy.get_name())
        try:
            return master.pid(MANAGER, master.node(MANAGER), 1.0)
        except (PeerTimeout, HostError, LookupError, OSError):
            return 0


def refused(change):
    """Whether the manager refuses a change."""
    try:
        change()
    except Refused:
        return True
    return False


run()
