#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Scripts as distributions ship them, at their work: in one process, and each in its own."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import tempfile
from pathlib import Path
from typing import Callable, Iterator

import graph  # first: it makes the test package known
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, TransformStamped
from graph import NodeletManagerCase, Talker, comes, connect, topics_of_ports
from processes import BUSY, DYKNOW, becomes, eventually, run
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Header, Int32, String
from tf2_msgs.msg import TFMessage

RUN = [*DYKNOW, "run"]
#: A robot with one joint.
ROBOT = """<robot name="r"><link name="base"/><link name="arm"/>
<joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def transform(parent: str, child: str, x: float) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp = rospy.Time(1)
    message.transform.translation.x = x
    message.transform.rotation.w = 1.0
    return message


class Scripts:
    """Their behaviour in either way: `start` and `stop` them, what each `prints`, and `ends`."""

    def has_ports(self, name: str, **topics: str) -> None:
        """Wait until it has ports on these topics."""
        rospy.wait_for_service(f"{name}/get_config", 40.0 * BUSY)

        def found():
            present = topics_of_ports(name)
            return {port: present.get(port) for port in topics}

        becomes(found, topics)

    def test_transforms(self):
        rospy.set_param("/renamed/mappings", [{"old": "tool", "new": "gripper"}])
        with Talker("/tf_old", TFMessage([transform("base", "tool", 2.0)])):
            self.start("tf/tf_remap", "/renamed")
            renamed = comes("/tf", TFMessage).transforms[0]
            self.assertEqual(renamed.child_frame_id, "gripper")
            self.start("tf2_tools/echo.py", "/echo", "base", "gripper", "-r", "20")
            self.prints("/echo", "Translation: [2.000, 0.000, 0.000]")
            self.has_ports("/renamed", **{"/tf": "/tf", "/tf_old": "/tf_old"})
            self.start("tf2_tools/echo.py", "/thrice", "base", "gripper", "-r", "20", "-l", "3")
            self.ends("/thrice")

            def is_drawn():  # what comes in 5 s, in which a busy machine may connect nothing
                Path("frames.gv").unlink(missing_ok=True)
                self.start("tf2_tools/view_frames.py", "/view")
                self.ends("/view")
                return '"base" -> "gripper"' in Path("frames.gv").read_text()

            eventually(is_drawn, 10.0, "the frames are drawn")
            connect("/renamed", **{"/tf": "/tf_new"})
            comes("/tf_new", TFMessage)
        self.stop("/echo")
        self.stop("/renamed")

    def test_parameters_that_change(self):
        def has_size(number):
            comes("/server/size", Int32, lambda size: size.data == number)

        self.start("dyknow_test/reconfigured.py", "/server")
        comes("/server/size", Int32)
        self.start("dynamic_reconfigure/dynparam", "/set", "set", "/server", "int_", "5")
        has_size(5)
        self.ends("/set")
        self.start("dyknow_test/reconfigured.py", "/client", "/server")
        has_size(7)
        self.stop("/client")
        self.stop("/server")
        becomes(lambda: graph.nodes_on("/server/parameter_updates")[0], set())
        self.start("dyknow_test/reconfigured.py", "/server")
        has_size(7)

    @staticmethod
    def tells(pattern: str) -> Callable[[DiagnosticArray], bool]:
        return lambda array: any(re.search(pattern, status.name) for status in array.status)


class SharedTest(Scripts, NodeletManagerCase):
    """In one nodelet manager, beside a neighbour that is not to notice."""

    def setUp(self):
        self.start("dyknow_test/talker.py", "/neighbour")

    def tearDown(self):
        self.assertIn("/neighbour", self.manager.list())
        comes("/words", String)
        super().tearDown()

    def start(self, script: str, name: str, *arguments: str, **names: str) -> None:
        global_names = {
            source if source[0] == "/" else f"/{source}": names[source] for source in names
        }
        self.manager.load("dyknow/Script", name, global_names, [script, *arguments])

    def stop(self, name: str) -> None:
        self.manager.unload(name)

    def prints(self, name: str, text: str) -> None:
        self.manager.wait_for(text)

    def ends(self, name: str) -> None:
        eventually(lambda: name not in self.manager.list(), 10.0, f"{name} has ended")

    def test_joint_state_publisher(self):
        rospy.set_param("robot_description", ROBOT)
        rospy.set_param("/left/source_list", ["moved"])
        self.start("joint_state_publisher/joint_state_publisher", "/left")
        self.start(
            "joint_state_publisher/joint_state_publisher", "/right", joint_states="/right_states"
        )
        for topic in ("/joint_states", "/right_states"):
            state = comes(topic, JointState)
            self.assertEqual((state.name, state.position), (["elbow"], (0.0,)))
        self.has_ports("/left", joint_states="/joint_states", moved="/moved")
        connect("/left", joint_states="/l", moved="/m")
        with Talker("/m", JointState(name=["elbow"], position=[0.5])):
            comes("/l", JointState, lambda state: state.position == (0.5,))
        self.stop("/left")
        self.start("joint_state_publisher/joint_state_publisher", "/left", joint_states="/l")
        self.assertEqual(comes("/l", JointState).position, (0.0,))

    def test_monitors(self):
        scripts = {"/cpu": "cpu_monitor.py", "/ram": "ram_monitor.py", "/ntp": "ntp_monitor.py"}
        for name, script in scripts.items():
            rospy.set_param(f"{name}/rate", 20)
            rospy.set_param(f"{name}/diagnostic_period", 0.1)
            arguments = ["127.0.0.1", "--no-self-test"] if name == "/ntp" else []
            self.start(f"diagnostic_common_diagnostics/{script}", name, *arguments)
        for said in ("CPU Information", "RAM Information", "NTP offset from .* to 127.0.0.1"):
            comes("/diagnostics", DiagnosticArray, self.tells(said))
        self.has_ports("/cpu", **{"/diagnostics": "/diagnostics"})
        connect("/cpu", **{"/diagnostics": "/health"})
        status = comes("/health", DiagnosticArray, self.tells("CPU Information")).status[0]
        self.assertTrue(any(pair.key == "CPU 0 Load" for pair in status.values))
        for name in scripts:
            self.stop(name)

    def test_fields_of_topics(self):
        point = PointStamped()
        point.point.x = 2.0
        with Talker("/point", point), Talker("/names", String("camera")):
            eventually(
                lambda: all(graph.nodes_on(topic)[0] for topic in ("/point", "/names")),
                5.0,
                "the inputs are there",
            )
            expression = ["std_msgs/Float64", "math.sqrt(2 * m)", "--import", "math"]
            self.start("topic_tools/transform", "/root", "/point/point/x", "/r", *expression)
            fields = ["std_msgs/Header", "frame_id: m.data"]
            self.start("topic_tools/relay_field", "/field", "/names", "/headers", *fields)
            self.assertEqual(comes("/r", Float64).data, 2.0)
            self.assertEqual(comes("/headers", Header).frame_id, "camera")
            connect("/root", **{"/point": "/other", "/r": "/s"})
            point.point.x = 8.0
            with Talker("/other", point):
                self.assertEqual(comes("/s", Float64).data, 4.0)
        self.stop("/root")
        self.stop("/field")


class AloneTest(Scripts, graph.TellingCase):
    """Each in a process of its own."""

    def setUp(self):
        self.running: dict[str, graph.Ended] = {}

    def start(self, script: str, name: str, *arguments: str, **names: str) -> None:
        words = [f"{source}:={topic}" for source, topic in names.items()]
        self.running[name] = self.run_process(
            *RUN, *script.split("/"), *arguments, f"__name:={name[1:]}", *words
        )

    def stop(self, name: str) -> None:
        self.running[name].stop(signal.SIGINT)
        self.ends(name)

    def prints(self, name: str, text: str) -> None:
        self.running[name].wait_for(text)

    def ends(self, name: str) -> None:
        self.assertEqual(self.running[name].exit_code(40.0), 0, self.running[name].output)


@contextlib.contextmanager
def time_server() -> Iterator[None]:
    """What ntp_monitor.py asks for the time, without a network."""
    with tempfile.TemporaryDirectory() as folder:
        program = os.path.join(folder, "ntpdate")
        with open(program, "w") as file:
            file.write('#!/bin/sh\necho "server $2, stratum 1, offset 0.000012, delay 0.02"\n')
        os.chmod(program, 0o755)
        os.environ["PATH"] = folder + os.pathsep + os.environ["PATH"]
        yield


if __name__ == "__main__":
    with time_server():
        run()
