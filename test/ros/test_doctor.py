#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`dyknow doctor`: a healthy system has no findings, and each defect is named with its cure."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from pathlib import Path

import psutil
import rospy
from manager_suite import CHILD, MANAGER, ManagerCase, specification
from nodelet.srv import NodeletList, NodeletLoad
from processes import Running, becomes, eventually, run
from roslib.packages import find_node
from std_msgs.msg import String
from test_dyknow_command import Done

from dyknow.model.transformation import Parameter
from dyknow.ros.shell.doctor import Doctor
from dyknow.ros.shell.shell_client import ShellClient
from dyknow.ros.wire.master import Master

MOODY = "dyknow_manager_test/Moody"


class DoctorTest(ManagerCase):
    #: Of a manager for two tests.
    parameters = {"denied_topics": ["/e_stop"], "ontolgies": "/x.owl"}

    def findings(self, check: str, **options: object) -> list[tuple[str, str, str]]:
        """The findings of one check: subject, problem and cure."""
        checks = dict(Doctor(ShellClient(MANAGER), **options).checks())
        return [(each.subject, each.problem, each.cure) for each in checks[check]()]

    def found(self, check: str, subject: str, said: str, cure: str, **options: object) -> None:
        """Wait until a check finds a defect: the system changes while it is examined."""
        eventually(
            lambda: any(
                each[0] == subject and said in each[1] and cure in each[2]
                for each in self.findings(check, **options)
            ),
            30.0,
            f"{check}: {subject}: {said}",
            lambda: self.findings(check, **options),
        )

    def nothing_found(self, check: str, **options: object) -> None:
        becomes(lambda: self.findings(check, **options), [])

    def test_a_healthy_system_has_no_findings(self):
        manager = self.started()
        manager.client.remove_transformation("unknown")  # its source is not installed
        manager.client.spawn("counter", "c")
        done: list[Done] = []

        def is_healthy() -> bool:
            done[:] = [Done("doctor", "--json")]
            return (done[0].code, done[0].json["findings"]) == (0, [])

        eventually(is_healthy, 30.0, "nothing is found", lambda: done[0].out + done[0].err)
        self.assertEqual(len(done[0].json["checks"]), 13)

    def test_mistakes_in_the_library_and_in_parameters(self):
        manager = self.started(**self.parameters)
        manager.client.add_transformation(specification("lost", "dyknow/Sourse", ">out"))
        manager.client.spawn("counter", "c", parameters=[Parameter("rte", "", "5")])
        done = Done("doctor", "--quiet")
        self.assertEqual(done.code, 1, done.out)
        for said in (
            "transformation 'lost': no package declares",
            "did you mean dyknow/Source",
            f"{MANAGER}/ontolgies: the DyKnow manager has no such parameter",
            f"cure: rosparam delete {MANAGER}/ontolgies",
            "declares no parameter 'rte'",
        ):
            self.assertIn(said, done.out)
        self.assertNotIn("\nok ", done.out)

    def test_a_node_that_was_killed(self):
        with Running(*find_node("topic_tools", "relay"), "/a", "/b", "__name:=gone") as relay:
            eventually(lambda: Master("/test").node("/gone"), 20.0, "the node is up")
            relay.stop(signal.SIGKILL)
            self.found("nodes", "/gone", "no process answers", "rosnode cleanup")

    def test_a_nodelet_manager_that_is_suspended_or_not_known_to_the_master(self):
        manager = self.started(own=True)
        manager.client.spawn("counter", "c")
        with manager.child_stopped() as child:
            self.found("nodes", CHILD, "does not answer", "kill -CONT")
            self.found("nodelets", "/c", "is LOST", "dyknow info /c")
        master = Master("/test")
        master.purge(CHILD, master.node(CHILD))
        pid = child.pid
        self.found("processes of an earlier master", CHILD, f"process {pid} runs", f"kill {pid}")

    def test_a_callback_that_does_not_return(self):
        self.end_idle()
        rospy.set_param(f"{CHILD}/stuck_after", 0.5)
        self.addCleanup(rospy.set_param, "/let_go", False)
        manager = self.started(own=True)
        manager.client.add_transformation(specification("moody", MOODY, ">in out>"))
        manager.client.spawn("counter", "c", {"out": "/s"})
        manager.client.spawn("moody", "/moody", {"in": "/s"})
        mood = self.publisher("/moody/order", String, latch=True)
        mood.publish("hang")
        running = "a callback has been running for"
        self.found("nodelets", "/moody", running, "dyknow info /moody")
        self.assertIn(f"/moody: {running}", Done("list", "-l").out)
        self.assertIn(f"/moody: {running}", Done("stats").out)
        manager.client.destroy("/moody")
        self.found("remains of nodelets", CHILD, "/moody was unloaded", f"rosnode kill {CHILD}")
        manager.client.spawn("moody", "/moody", {"in": "/t"})
        becomes(lambda: manager.nodelet("/moody").detail, "")
        rospy.set_param("/let_go", True)
        self.nothing_found("remains of nodelets")

    def test_a_process_of_another_version(self):
        self.started()
        self.nothing_found("versions")
        for name, service_class in (("list", NodeletList), ("load_nodelet", NodeletLoad)):
            service = rospy.Service(f"~{name}", service_class, lambda request: None)
            self.addCleanup(service.shutdown)
        node = rospy.get_name()
        self.found("versions", node, "was started with another version", "restart it")

    def test_a_nodelet_has_the_name_of_the_node_that_loads_it(self):
        self.started()
        words = ("load", "dyknow/Source", CHILD, "__name:=loaded")
        with Running("rosrun", "dyknow", "nodelet", *words):
            rospy.wait_for_service("/loaded/get_config", 20.0)
            eventually(lambda: Master("/test").node("/loaded"), 20.0, "the loader is up")
            self.assertEqual(self.findings("versions"), [])

    def test_a_manager_that_does_not_run(self):
        self.end_idle()
        self.found("DyKnow manager", MANAGER, "is not running", "rosrun dyknow manager")
        self.assertEqual(Done("doctor", ROS_MASTER_URI="http://localhost:1").code, 3)

    def test_resources_of_a_process(self):
        manager = self.started()
        process = psutil.Process(manager.process.pid)
        self.nothing_found("descriptors")
        soft, hard = process.rlimit(psutil.RLIMIT_NOFILE)
        try:
            process.rlimit(psutil.RLIMIT_NOFILE, (process.num_fds() + 8, hard))
            self.found("descriptors", MANAGER, "file descriptors", f"ulimit -n {hard}")
        finally:
            process.rlimit(psutil.RLIMIT_NOFILE, (soft, hard))
        with tempfile.TemporaryDirectory() as folder:
            code = Path(folder, "changed.py")
            code.touch()
            os.utime(code, (time.time() + 3600.0,) * 2)  # clocks may differ by some
            self.found("versions", MANAGER, "", "", code=Path(folder))
        full = self.findings("disks", disk_usage=lambda path: (2**40, 2**40 - 2**20, 2**20))
        self.assertIn("1 MiB left", full[0][1])
        self.assertTrue(manager.state.startswith(full[0][0]), full)
        self.nothing_found("disks", disk_usage=lambda path: (2**40, 2**39, 2**39))


if __name__ == "__main__":
    run()
