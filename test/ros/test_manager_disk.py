#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager on a disk that is full or read-only."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import rospy
from dyknow_msgs.srv import Spawn
from faulty_disk import full, kept_aside, read_only, small_disk
from graph import Heard
from manager_suite import CHILD, MANAGER, ManagerCase, specification
from processes import Running, becomes, eventually, run

from dyknow import __version__
from dyknow.model.graph import State
from dyknow.ros.process.signals import FAILED

SOURCE = specification("numbers", "dyknow_manager_test/Counter", "out>")


class ManagerDiskTest(ManagerCase):
    def setUp(self):
        self.disk = self.enter(small_disk(self.make_folder() / "disk"))
        self.manager = self.make(state_dir=str(self.disk))
        self.manager.state = str(self.disk)

    def begin(self):
        self.manager.start()
        self.manager.client.add_transformation(SOURCE)
        self.manager.client.spawn("numbers", "/a", {"out": "/s"})

    def all_run(self, *names):
        wanted = dict.fromkeys(names, State.RUNNING)

        def states():
            return {each.name: each.state for each in self.manager.client.get_model().nodelets}

        eventually(lambda: states() == wanted, 30.0, f"{names} run", lambda: self.manager.output)

    def is_written_again(self, *names):
        """Wait until the disk has everything; a manager that is killed then knows it again."""
        said = lambda: "is written again" in self.manager.output  # noqa: E731
        eventually(said, 15.0, "the disk is tried again")
        self.manager.kill()
        with full(self.disk):
            self.manager.start()
            self.all_run(*names)
        self.manager.kill()
        self.manager.start()
        self.all_run(*names)
        (state,) = self.disk.glob("*-dyknow-manager.sqlite3")
        self.assertEqual(kept_aside(str(state)), [])

    def test_a_full_disk_stops_nothing_and_takes_what_it_missed_later(self):
        self.begin()
        manager, receiver = self.manager, self.enter(Heard("/s"))
        child = manager.child()
        spawn = rospy.ServiceProxy(f"{MANAGER}/spawn", Spawn)
        with full(self.disk):
            message, count = "", 0
            while not message:  # there may be room for a few more
                answer = spawn(label="numbers", name=f"/n{count}")
                self.assertTrue(answer.success, answer.message)
                message, count = answer.message, count + 1
            self.assertIn("not on disk yet", message)
            for said in (message, manager.output):
                self.assertIn("the disk is full; free some space", said)
            self.assertNotIn("rollback", manager.output)
            with self.assertLogs("rosout.dyknow", "WARNING") as told:
                manager.client.spawn("numbers", "/alone", isolated=True)
            self.assertIn("not on disk yet", told.output[0])
            for number in range(count):
                manager.client.destroy(f"/n{number}")
            self.all_run("/a", "/alone")
            child.signal(9)
            eventually(lambda: not child.alive, 5.0, "it is dead")
            receiver.flows()
            self.all_run("/a", "/alone")
        becomes(lambda: {*manager.children()}, {CHILD, "/alone_nodelet_manager"})
        eventually(lambda: manager.child() != child, 15.0, "the list of processes is written")
        self.is_written_again("/a", "/alone")

    def test_a_read_only_state_is_read_and_what_runs_is_adopted(self):
        self.begin()
        manager, process = self.manager, self.manager.child()
        manager.kill()
        with read_only(self.disk):
            manager.start()
            self.all_run("/a")
            self.assertEqual(manager.topics("/a"), {"out": "/s"})
            self.assertEqual(manager.child(CHILD), process)
            self.assertIn("it is read-only", manager.output)
            said = re.findall("DyKnow manager.*", manager.output)[-1]
            for part in (f"manager {MANAGER}, version {__version__}", manager.state, "1 nodelets"):
                self.assertIn(part, said)  # its identity, and its restored state
            labels = [each.label for each in manager.client.get_model().transformations]
            self.assertEqual(labels, ["numbers"])
            manager.client.spawn("numbers", "/b")
            self.all_run("/a", "/b")
        self.is_written_again("/a", "/b")

    def test_a_folder_that_cannot_be_written_is_named(self):
        advice = "~state_dir"
        for variables, argument, folder, cure in (
            ({}, "_state_dir:=/proc/none", "/proc/none", advice),
            ({}, f"_state_dir:={__file__}", __file__, advice),
            ({"ROS_LOG_DIR": "/proc/none"}, "_language:=en", "/proc/none", "ROS_LOG_DIR"),
            ({"ROS_HOME": "/proc/none"}, "_language:=en", "/proc/none", advice),
        ):
            with self.subTest(folder, **variables), mock.patch.dict(os.environ, variables):
                if "ROS_HOME" in variables:
                    os.environ.pop("ROS_LOG_DIR", None)
                with Running(*self.manager.command, argument) as running:
                    self.assertEqual(running.exit_code(60.0), FAILED, running.output)
                fatal = [each for each in running.output.splitlines() if "FATAL" in each]
                self.assertIn(f"'{folder}", fatal[0])
                self.assertIn(cure, fatal[0])


if __name__ == "__main__":
    run()
