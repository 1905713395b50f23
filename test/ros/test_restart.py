#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Restarts of real processes: files are edited, and the robot runs them."""

from __future__ import annotations

import os
import time
from pathlib import Path
from unittest import mock

import rospy
from graph import Heard
from manager_suite import CHILD, ManagerCase, library, specification
from processes import DYKNOW, Ended, becomes, eventually, run
from std_msgs.msg import Int32
from stream_suite import Events
from test_dyknow_command import Done

from dyknow.errors import Refused
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.model.transformation import Parameter

MANIFEST = """<package format="2"><name>edited</name><version>0.0.0</version><description/>
<maintainer email="a@example.org">a</maintainer><license>BSD-3-Clause</license>
<export><dyknow plugin="${prefix}/nodelets.xml"/></export></package>"""
PLUGINS = """<library path="src">
  <class name="edited/Source" type="edited_source.Source" base_class_type="dyknow.Nodelet"/>
  <class name="edited/Sum" type="edited_sum.Sum" base_class_type="dyknow.Nodelet"/>
</library>"""
SOURCE = """import dyknow
from std_msgs.msg import Int32
import edited_value
class Source(dyknow.Nodelet):
    def on_init(self):
        handle = dyknow.NodeHandle(self.node_handle)
        self.value = edited_value.VALUE + handle.get_param("~step", 0)
        self.out = handle.Publisher("out", Int32, queue_size=10)
        self.timer = handle.Timer(handle.Duration(0.01), self.publish)
    def publish(self, event):
        self.out.publish(Int32(self.value))
"""
SUM = """import dyknow
from std_msgs.msg import Int32
class Sum(dyknow.Nodelet):
    def on_init(self):
        handle = dyknow.NodeHandle(self.node_handle)
        self.out = handle.Publisher("out", Int32, queue_size=10)
        self.input = handle.Subscriber("in", Int32, self.out.publish, queue_size=10)
"""
SCRIPT = """#!/usr/bin/env python3
import rospy
from std_msgs.msg import Int32
import script_value
rospy.init_node("script")
publisher = rospy.Publisher("out", Int32, queue_size=10)
rate = rospy.Rate(100)
while not rospy.is_shutdown():
    publisher.publish(script_value.VALUE)
    rate.sleep()
"""
LIBRARY = library(
    specification("source", "edited/Source", "out>=Value(it)", step=0),
    specification("sum", "edited/Sum", ">in=Value(it) out>=Sum(it)"),
    specification("script", "edited/script.py", "out>", "node"),
)


class RestartTest(ManagerCase):
    def setUp(self):
        self.folder = Path(self.make_folder()) / "edited"
        (self.folder / "src").mkdir(parents=True)
        (self.folder / "scripts").mkdir()
        self.write("package.xml", MANIFEST)
        self.write("nodelets.xml", PLUGINS)
        self.write("src/edited_source.py", SOURCE)
        self.write("src/edited_sum.py", SUM)
        self.value("src/edited_value.py", 1)
        self.write("scripts/script.py", SCRIPT)
        (self.folder / "scripts/script.py").chmod(0o755)
        self.value("scripts/script_value.py", 1)
        path = os.pathsep.join([str(self.folder), os.environ["ROS_PACKAGE_PATH"]])
        patch = mock.patch.dict(os.environ, {"ROS_PACKAGE_PATH": path})
        patch.start()
        self.addCleanup(patch.stop)
        self.manager = self.running(own=True)
        self.client = self.manager.client
        self.client.add_transformation(LIBRARY)

    def write(self, path, text):
        (self.folder / path).write_text(text)

    def value(self, path, value):
        self.write(path, f"VALUE = {value}\n")

    def heard(self, topic):
        return self.enter(Heard(topic, Int32, lambda message: message.data))

    def is_outdated(self, name):
        becomes(lambda: bool(self.manager.nodelet(name).outdated), True)

    def test_today_s_code_and_what_is_kept(self):
        self.client.spawn("source", "/source", {"out": "/a"}, is_protected=True)
        self.client.spawn("sum", "/sum", {"in": "/a", "out": "/b"})
        self.client.spawn("source", "/alone", {"out": "/c"}, isolated=True)
        self.client.spawn("script", "/shared", {"out": "/d"})
        self.client.spawn("script", "/own", {"out": "/e"}, isolated=True)
        heard = {topic: self.heard(topic) for topic in ("/b", "/c", "/d", "/e")}
        for each in heard.values():
            each.has(lambda value: value == 1)
        before = {each.name: each for each in self.client.get_model().nodelets}
        self.value("src/edited_value.py", 2)
        self.value("scripts/script_value.py", 3)
        for name in ("/source", "/alone", "/shared", "/own"):
            self.is_outdated(name)
        self.assertEqual(self.manager.nodelet("/sum").outdated, "")
        text = "/source: outdated: its code changed since it was loaded"
        becomes(lambda: text in Done("list", "-l").out, True)
        done = Done("restart", "--all-outdated", "--json")
        self.assertEqual((done.code, done.err), (0, ""))
        self.assertEqual(done.json["restarted"], ["/alone", "/own", "/shared", "/source"])
        for topic, value in (("/b", 2), ("/c", 2), ("/d", 3), ("/e", 3)):
            heard[topic].has(lambda each, value=value: each == value)
        becomes(lambda: {n.name: n for n in self.client.get_model().nodelets}, before)
        self.assertEqual(Done("restart", "--all-outdated").out, "nothing is outdated\n")

    def test_edit_save_and_the_robot_runs_it(self):
        self.client.spawn("source", "/source", {"out": "/a"})
        heard = self.heard("/a")
        heard.flows()
        watch = self.enter(Ended(*DYKNOW, "restart", "--watch", "source"))
        spent = []
        for value in range(2, 6):
            eventually(lambda: not self.manager.nodelet("/source").outdated, 10.0, "it is new")
            saved = time.monotonic()
            self.value("src/edited_value.py", value)
            heard.has(lambda each, value=value: each == value)
            spent.append(time.monotonic() - saved)
        print(f"from saving a file to the first message: {sorted(spent)} s")
        self.write("src/edited_value.py", "VALUE = = 7\n")
        watch.wait_for("edited_value.py cannot be run: line 1: invalid syntax")
        heard.flows()
        self.assertEqual(heard[-1], 5)
        self.value("src/edited_value.py", 8)
        heard.has(lambda each: each == 8)
        self.write("src/edited_value.py", "VALUE = NAME\n")
        watch.wait_for("name 'NAME' is not defined")
        self.manager.becomes("/source", State.FAILED)
        self.value("src/edited_value.py", 9)
        heard.has(lambda each: each == 9)
        watch.stop()
        self.assertEqual(watch.exit_code(10.0), 130)

    def test_claims_go_on(self):
        events = self.enter(Events())
        claim = self.client.acquire_stream(StreamRequest("Sum(it)", max_silence=2.0))
        heard = self.heard(claim.topic)
        heard.flows()
        parts = [each.name for each in self.client.get_model().nodelets]
        self.value("src/edited_value.py", 2)
        for name in (*parts, CHILD):
            heard.clear()
            done = self.client.restart(name)
            self.assertEqual(list(done.names), parts if name == CHILD else [name])
            heard.flows(100)
        self.assertEqual(heard[-1], 2)
        self.assertEqual([each.name for each in self.client.get_model().nodelets], parts)
        states = {each.after.state for each in events if each.after.claim_id == claim.claim_id}
        self.assertLessEqual(states, {ClaimState.ACTIVE, ClaimState.PENDING})
        self.assertNotIn("lost", self.manager.output)

    def test_a_parameter_is_set_for_life(self):
        self.client.spawn("source", "/source", {"out": "/a"})
        heard = self.heard("/a")
        heard.flows()
        done = Done("set", "source", "step", "10")
        self.assertIn("reads it when it is restarted: dyknow restart /source", done.out)
        self.assertEqual(
            Done("set", "source", "step", "20", "--restart").out, "/source: step = 20\n"
        )
        heard.has(lambda each: each == 21)
        self.assertNotIn(11, heard)
        self.manager.kill_child()
        heard.clear()
        heard.has(lambda each: each == 21)
        given = self.manager.nodelet("/source").parameters
        self.assertEqual(given, (Parameter("step", "int", "20"),))
        self.assertEqual(Done("set", "source", "step", "many").code, 1)

    def test_a_nodelet_with_dynamic_reconfigure_reads_at_once(self):
        ports = ">image ~image>"
        half = specification("half", "image_proc/resize", ports, use_scale=True, scale_width=0.5)
        self.client.add_transformation(half)
        self.client.spawn("half", "/half")
        done = Done("set", "half", "scale_width", "0.25", "--restart", "--json")
        self.assertEqual((done.json["is_read"], done.err), (True, ""))
        self.assertNotIn("restarting", self.manager.output)
        self.assertEqual(rospy.get_param("/half/scale_width"), 0.25)
        self.assertFalse(Done("set", "half", "unknown", "1", "--json").json["is_read"])

    def test_the_manager_is_killed_while_it_restarts_a_nodelet(self):
        self.client.spawn("source", "/source", {"out": "/a"}, is_protected=True)
        heard = self.heard("/a")
        heard.flows()
        hang, begun = self.folder / "hang", self.folder / "begun"
        wait = f"import os, time\nopen('{begun}', 'w').close()\n"
        wait += f"while os.path.exists('{hang}'):\n    time.sleep(0.01)\n"
        hang.touch()
        self.write("src/edited_value.py", f"{wait}VALUE = 2\n")
        self.enter(Ended(*DYKNOW, "restart", "source"))
        eventually(begun.exists, 10.0, "it is loaded again")
        self.assertEqual(self.manager.nodelet("/source").state, State.STARTING)
        self.manager.kill()
        hang.unlink()
        self.manager.start()
        found = self.manager.becomes("/source", State.RUNNING)
        self.assertTrue(found.is_protected)
        heard.has(lambda each: each == 2)
        self.assertEqual(self.manager.topics("/source"), {"out": "/a"})

    def test_what_cannot_be_restarted(self):
        with self.assertRaisesRegex(Refused, "no nodelet named '/nothing'"):
            self.client.restart("nothing")


run()
