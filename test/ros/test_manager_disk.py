#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager on a disk that is full or read-only, and leases across its death."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import rospy
import rostest
from faulty_disk import full, kept_aside, read_only, small_disk
from manager_suite import CHILD, MANAGER, ManagerCase, ManagerProcess, Receiver, eventually
from processes import BUSY, Running
from rosservice import get_service_class_by_name

from dyknow import __version__
from dyknow.model.graph import State
from dyknow.model.streams import StreamRequest
from dyknow.ros.process.signals import FAILED

SOURCE = """<transformation><label>numbers</label><source>dyknow_manager_test/Counter</source>
<ports><port type="out">out</port></ports><tags><tag port="out">Numbers(test)</tag></tags>
</transformation>"""


class ManagerDiskTest(ManagerCase):
    def on_a_small_disk(self) -> tuple[ManagerProcess, Path]:
        parent = tempfile.TemporaryDirectory()
        self.addCleanup(parent.cleanup)
        stack = contextlib.ExitStack()
        self.addCleanup(stack.close)
        disk = stack.enter_context(small_disk(Path(parent.name) / "disk"))
        manager = self.make(state_dir=str(disk))
        manager.state = str(disk)
        return manager, disk

    def state_file(self, disk: Path) -> str:
        (found,) = disk.glob("*-dyknow-manager.sqlite3")
        return str(found)

    def states(self, manager: ManagerProcess) -> dict[str, State]:
        return {each.name: each.state for each in manager.client.get_model().nodelets}

    def all_run(self, manager: ManagerProcess, *names: str) -> None:
        wanted = dict.fromkeys(names, State.RUNNING)
        eventually(
            lambda: self.states(manager) == wanted, 30.0, f"{names} run", lambda: manager.output
        )

    def test_a_full_disk_stops_nothing_and_takes_what_it_missed_later(self):
        manager, disk = self.on_a_small_disk()
        manager.start()
        manager.client.add_transformation(SOURCE)
        manager.client.spawn("numbers", "/a", {"out": "/s"})
        spawn = rospy.ServiceProxy(
            f"{MANAGER}/spawn", get_service_class_by_name(f"{MANAGER}/spawn")
        )
        receiver, child = Receiver("/s"), manager.child()
        self.addCleanup(receiver.close)
        with full(disk):
            message, count = "", 0
            while not message:  # there may be room for a few more
                answer = spawn(label="numbers", name=f"/n{count}")
                self.assertTrue(answer.success, answer.message)
                message, count = answer.message, count + 1
            self.assertIn("not on disk yet", message)
            self.assertIn("the disk is full; free some space", message)
            self.assertIn("the disk is full; free some space", manager.output)
            self.assertNotIn("rollback", manager.output)
            with self.assertLogs("rosout.dyknow", "WARNING") as told:
                manager.client.spawn("numbers", "/alone", isolated=True)
            self.assertIn("not on disk yet", told.output[0])
            for number in range(count):
                manager.client.destroy(f"/n{number}")
            self.all_run(manager, "/a", "/alone")
            child.signal(signal.SIGKILL)
            child.wait(5.0 * BUSY)
            receiver.numbers.clear()
            receiver.flows(30.0)
            self.all_run(manager, "/a", "/alone")
        eventually(lambda: "is written again" in manager.output, 15.0, "the disk is tried again")
        eventually(
            lambda: {CHILD, "/alone_nodelet_manager"} == set(manager.children())
            and manager.child() != child,
            15.0,
            "so is the list of processes",
        )
        manager.kill()
        with full(disk):
            manager.start()
            self.all_run(manager, "/a", "/alone")
        manager.kill()
        manager.start()
        self.all_run(manager, "/a", "/alone")
        self.assertEqual(kept_aside(self.state_file(disk)), [])

    def test_a_read_only_state_is_read_and_what_runs_is_adopted(self):
        manager, disk = self.on_a_small_disk()
        manager.start()
        manager.client.add_transformation(SOURCE)
        manager.client.spawn("numbers", "/a", {"out": "/s"})
        process = manager.child()
        manager.kill()
        with read_only(disk):
            manager.start()
            self.all_run(manager, "/a")
            self.assertEqual(manager.topics("/a"), {"out": "/s"})
            self.assertEqual(manager.child(CHILD), process)
            self.assertIn("it is read-only", manager.output)
            labels = [each.label for each in manager.client.get_model().transformations]
            self.assertEqual(labels, ["numbers"])
            manager.client.spawn("numbers", "/b")
            self.all_run(manager, "/a", "/b")
        eventually(lambda: "is written again" in manager.output, 15.0, "the disk is tried again")
        manager.kill()
        manager.start()
        self.all_run(manager, "/a", "/b")
        self.assertEqual(kept_aside(self.state_file(disk)), [])

    def test_a_folder_that_cannot_be_written_is_named(self):
        manager = self.make()
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
                with Running(*manager.command, argument) as running:
                    self.assertEqual(running.exit_code(60.0), FAILED, running.output)
                fatal = [each for each in running.output.splitlines() if "FATAL" in each]
                self.assertIn(f"'{folder}", fatal[0])
                self.assertIn(cure, fatal[0])

    def test_a_lease_goes_on_while_the_manager_is_dead(self):
        manager = self.make()
        manager.start()
        manager.client.add_transformation(SOURCE)
        claim_id = manager.client.acquire_stream(
            StreamRequest("Numbers(test)", lease=30.0)
        ).claim_id
        (before,) = manager.client.list_streams()
        manager.kill()
        time.sleep(2.0)  # time that counts
        manager.start()
        (after,) = manager.client.list_streams()
        self.assertEqual(after.claim_id, claim_id)
        said = re.findall("DyKnow manager.*", manager.output)[-1]
        for part in (f"manager {MANAGER}, version {__version__}", manager.state, "1 nodelets"):
            self.assertIn(part, said)  # its identity, and its restored state
        self.assertAlmostEqual(after.expires, before.expires, delta=0.5)
        manager.client.renew_stream(claim_id, 3.0)
        manager.kill()
        manager.start()
        eventually(
            lambda: [each.state.name for each in manager.client.list_streams()] == ["EXPIRED"],
            15.0,
            "it ends",
        )


if __name__ == "__main__":
    rospy.init_node("test_manager_disk")
    rostest.rosrun("dyknow", "manager_disk", ManagerDiskTest)
