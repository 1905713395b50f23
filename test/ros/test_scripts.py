#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Scripts of rospy, unchanged: as nodelets of one process, and in processes of their own.

Those of the tests, and those that distributions ship, at their work.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Callable, Iterator, List

import graph  # first: it makes the test package known
import psutil
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from dyknow_msgs.msg import NodeletChanges, Port
from geometry_msgs.msg import PointStamped, TransformStamped
from graph import (
    Heard,
    NodeletManagerCase,
    Talker,
    comes,
    connect,
    get_config,
    hears,
    registered,
    set_config,
    topics_of_ports,
)
from processes import BUSY, DYKNOW, HELD_UP, NODELET, becomes, eventually, run
from roslib.packages import find_node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Header, Int32, String
from test_leaks import ScriptLeakTest
from tf2_msgs.msg import TFMessage

from dyknow.ros.nodelets.announcements import TOPIC as NODES_TOPIC

__all__ = ["ScriptLeakTest"]  # is run here for some cycles, and for many in the long run

RUN = [*DYKNOW, "run"]
SCRIPT = "dyknow/Script"
#: Where packages of the tests' own are, beside those of test/packages.
FURTHER_PACKAGES = tempfile.TemporaryDirectory()
os.environ["ROS_PACKAGE_PATH"] += os.pathsep + FURTHER_PACKAGES.name
MANIFEST = """<package format="2"><name>news</name><version>0.0.0</version>
<description>none</description><maintainer email="a@example.org">a</maintainer>
<license>BSD</license></package>"""
#: A script that reports a word of its sibling.
NEWS = """#!/usr/bin/env python3
import rospy, news_sibling
rospy.init_node('news')
rospy.set_param('~word', news_sibling.word)
rospy.spin()
"""


LAST_WORDS = ["stopping", "stopped"]
#: Runs a script where rospy takes its time until it takes registrations back.
SLOW_END = """
import sys, time, rospy
from dyknow.ros.nodelets import script_process
rospy.core.add_preshutdown_hook(lambda reason: time.sleep(1.0))
sys.exit(script_process.main())
"""
#: A robot with one joint.
ROBOT = """<robot name="r"><link name="base"/><link name="arm"/>
<joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def words_on(topic: str) -> Heard:
    """The words that come on a topic."""
    return Heard(topic, String, lambda message: message.data)


def without_traces(output: str) -> List[str]:
    """The lines that a program printed, but for the frames of tracebacks."""
    return [line for line in output.splitlines() if line and not line.startswith("  ")]


class SharedTest(NodeletManagerCase):
    """In one nodelet manager, whose loads wait 2 s for a script: a busy machine takes longer."""

    def load(self, script: str, name: str, *arguments: str, **remappings: str) -> None:
        self.manager.load(SCRIPT, name, remappings, [f"dyknow_test/{script}", *arguments])

    def unload(self, name: str) -> None:
        began = time.monotonic()
        self.manager.unload(name)
        self.assertLess(time.monotonic() - began, HELD_UP)

    def is_free(self, name: str) -> None:
        """Nothing of it is left, and its name can be used again."""
        eventually(lambda: self.manager.is_free(name), 5.0, f"{name} is free")
        self.nothing_of(name)

    def nothing_of(self, name: str) -> None:
        becomes(lambda: [each for each in registered("/manager") if name in each], [])

    def test_a_node_becomes_a_nodelet(self):
        rospy.set_param("/robot/a/word", "one")
        self.load("talker.py", "/robot/a")
        self.load("talker.py", "/robot/b", "--word", "two", **{"/robot/words": "/b_words"})
        becomes(lambda: topics_of_ports("/robot/a"), {"words": "/robot/words"})
        becomes(lambda: topics_of_ports("/robot/b"), {"words": "/b_words"})
        hears("/robot/words", "one 1")
        with words_on("/b_words") as heard:
            heard.has(lambda text: "two 2" in text)
            self.unload("/robot/b")
            heard.has(lambda text: text == "good-bye")  # a loop may send another one after it
        self.nothing_of("/b_words")

    def test_it_is_connected_elsewhere_and_loses_nothing(self):
        self.load("talker.py", "/talker")
        with words_on("/words") as first, words_on("/second") as second:
            first.flows()
            for topic, heard in (("/second", second), ("/words", first)):
                connect("/talker", **{"/words": topic})
                heard.flows(6)

            def missing():
                numbers = {int(text.split()[1]) for text in [*first, *second]}
                return set(range(min(numbers), max(numbers))) - numbers

            becomes(missing, set())  # the last of each may come in any order
            self.assertEqual(len({*first, *second}), len(first) + len(second))

    def test_what_the_manager_disconnects_begins_disconnected(self):
        self.load("talker.py", "/talker", words="/talker/disconnected/words")
        becomes(lambda: topics_of_ports("/talker"), {"words": ""})

    def test_ports_bear_the_names_of_the_code(self):
        names = {"/robot/told": "/news", "/robot/shout": "/yell"}
        self.load("both_ways.py", "/robot/n", **names)
        becomes(
            lambda: {each.name: (each.direction, each.topic) for each in get_config("/robot/n")},
            {
                "shout_out": (Port.OUT, "/yell"),
                "shout_in": (Port.IN, "/yell"),
                "~whisper": (Port.IN, "/robot/n/whisper"),
                "/siren": (Port.IN, "/siren"),
                "told": (Port.IN, "/news"),
            },
        )
        connect("/robot/n", **{"/robot/n/whisper": "/quiet"})
        self.assertEqual(topics_of_ports("/robot/n")["~whisper"], "/quiet")
        refused = set_config("/robot/n", **{"/robot/shout": "/x"})
        self.assertIn("shout_out", refused.message)

    def test_neighbours_see_what_a_script_does_to_its_messages_only_on_request(self):
        for by_reference in (False, True):
            rospy.set_param("/spoiler/by_reference", by_reference)
            self.load("spoiler.py", "/spoiler")
            with Heard("/spoiler/seen", JointState) as seen:
                if by_reference:
                    seen.has(lambda state: state.name[0] == "spoilt")
                else:
                    seen.flows(50)
                    self.assertEqual({each.name[0] for each in seen}, {"a"})
                    self.assertTrue(all(each.position[0] >= 0 for each in seen))
            self.unload("/spoiler")

    def test_libraries_work_between_two_instances(self):
        self.load("libraries.py", "/server")
        comes("/diagnostics", rospy.AnyMsg)
        self.load("libraries.py", "/client", "/server/count")
        hears("/client/told", "42 2.0")
        self.assertIn("subscribers /server/count/goal", registered("/manager"))
        self.unload("/client")
        self.unload("/server")
        self.nothing_is_left()

    def refusal(self, script: str, *arguments: str) -> str:
        """The message of a refused load; a late script may fail after its load."""
        said: List[str] = []

        def is_refused() -> bool:
            try:
                self.load(script, "/ill", *arguments)
            except rospy.ServiceException as error:
                said.append(str(error))
            else:
                self.is_free("/ill")
            return bool(said)

        eventually(is_refused, 5.0, "it is refused")
        return said[0]

    def test_what_cannot_share_a_process_is_refused_with_the_cure(self):
        for what, said in (
            ("keyboard", "input"),
            ("stdin", "keyboard"),
            ("toolkit", "tkinter"),
            ("fork", "os.fork"),
            ("chdir", "os.chdir"),
            ("alarm", "signal.alarm"),
            ("processes", "multiprocessing.Pool"),
            ("raises", "of its own"),
            ("exits", "sys.exit(3)"),
            ("no such argument", None),
        ):
            with self.subTest(what):
                if said is None:
                    self.load("ill.py", "/ill", what)  # it ends at once, in order
                else:
                    refusal = self.refusal("ill.py", what)
                    self.assertIn(said, refusal)
                    if "own" not in said and "exit" not in said:
                        cure = "dyknow run" if what in ("keyboard", "stdin") else "isolated"
                        self.assertIn(cure, refusal)
                self.is_free("/ill")
        for script in ("gone.py", "package.xml"):
            self.assertIn(script, self.refusal(script))
        self.load("ill.py", "/ill", "optional")  # a script may do without a refused import
        without = "services /ill/without"
        eventually(lambda: without in registered("/manager"), 5.0, "it goes on")

    def test_a_script_that_ends_or_fails_is_gone_and_its_neighbours_stay(self):
        self.load("talker.py", "/talker")
        for what in ("later", "quit", "_exit", "display", "show"):
            with self.subTest(what):
                self.load("ill.py", "/ill", what)
                self.is_free("/ill")
        hears("/words", "hello")

    def test_last_words_are_sent(self):
        def are_sent():
            self.load("habits.py", "/habits", "spin", **{"/camera": "/left"})
            becomes(lambda: rospy.get_param("/habits/remapped", None), ["/left", "lamp"])
            with words_on("/habits/words") as heard:
                self.unload("/habits")
                self.nothing_of("/habits")
                heard.has(lambda text: text == LAST_WORDS[0])
                return list(heard)

        # On a busy machine an unload may not wait for the second one.
        eventually(lambda: are_sent() == LAST_WORDS, 5.0, "both last words are sent")

    def test_waits_end_with_the_unload(self):
        before = self.manager.threads()
        for what in ("service", "message"):
            with self.subTest(what):
                self.load("habits.py", "/waiting", what)
                self.unload("/waiting")
        eventually(lambda: self.manager.threads() <= before + 1, 10.0, "threads have ended")

    def test_a_shutdown_of_its_own_is_complete_when_it_returns(self):
        self.load("habits.py", "/habits", "quit")
        becomes(lambda: rospy.get_param("/habits/quit", None), [True, "enough"])
        self.is_free("/habits")

    def test_endless_threads_end_within_a_second(self):
        before = self.manager.threads()
        self.load("endless.py", "/endless", "busy", "deaf", "sleepy", "waiting", "working")
        self.unload("/endless")
        eventually(lambda: self.manager.threads() <= before + 2, 10.0, "threads have ended")
        self.load("endless.py", "/endless", "listening")
        self.unload("/endless")
        self.manager.wait_for("thread 'listening' does not end")

    def test_a_load_runs_the_code_of_today(self):
        with tempfile.TemporaryDirectory(dir=FURTHER_PACKAGES.name) as folder:
            write(f"{folder}/package.xml", MANIFEST, 0)
            write(f"{folder}/news.py", NEWS, 0)
            os.chmod(f"{folder}/news.py", 0o755)
            for number, word in enumerate(("old", "new")):
                write(f"{folder}/news_sibling.py", f"word = '{word}'", number)
                self.manager.load(SCRIPT, f"/n{number}", {}, ["news/news.py"])
                becomes(lambda n=number: rospy.get_param(f"/n{n}/word", None), word)


def write(path: str, text: str, seconds: int) -> None:
    """Write a file of another second: Python distinguishes compiled files by that."""
    with open(path, "w") as file:
        file.write(text)
    os.utime(path, (1e9 + seconds, 1e9 + seconds))


class CommandTest(graph.TellingCase):
    """With `load_script`, `standalone_script` and `run`."""

    def run_script(self, *words: str) -> graph.Ended:
        return self.run_process(*RUN, "dyknow_test", *words)

    def test_load_script_is_bonded_as_load_is(self):
        manager = self.run_process(*NODELET, "manager", "__name:=host")
        client = self.run_process(
            *(*NODELET, "load_script", "dyknow_test", "talker.py", "host", "--word", "w"),
            *("__name:=told", "words:=/told_words", "_rate:=20"),
        )
        hears("/told_words", "w 3")
        self.assertEqual(rospy.get_param("/told/rate"), 20)
        graph.let_the_bond_form("/host/bond")
        client.stop(signal.SIGKILL)
        manager.wait_for("unloaded nodelet /told", 30.0)

    def test_a_script_in_a_process_of_its_own(self):
        words = ("--word", "alone", "words:=/here", "_rate:=100")
        node = self.run_script("talker.py", *words)
        hears("/here", "alone")
        (name,) = graph.nodes_on("/here")[0]
        self.assertRegex(name, r"^/talker_\d+_\d+$")  # as anonymous nodes are called
        rospy.wait_for_service(f"{name}/get_statistics", 5.0 * BUSY)  # its last
        self.assertEqual(topics_of_ports(name), {"words": "/here"})
        self.assertEqual(rospy.get_param(f"{name}/rate"), 100)
        becomes(lambda: graph.poll(name, is_node=True).changes.kind, "node")
        services = [
            "get_config",
            "get_loggers",
            "get_statistics",
            "set_config",
            "set_logger_level",
        ]
        self.assertEqual(graph.services_of(name), [f"{name}/{each}" for each in services])
        self.assertIn("did you mean words?", set_config(name, wrods="/there").message)
        publishers = [NODES_TOPIC, "/here", "/rosout"]
        becomes(lambda: graph.registrations(name)["publishers"], publishers)
        with Heard(NODES_TOPIC, NodeletChanges, graph.named) as told:
            told.has(lambda names: names == [name])
            del told[:]
            connect(name, words="/there")
            told.has(lambda names: names == [name])
        with words_on("/there") as heard:
            heard.flows()
            node.stop()
            heard.has(lambda text: text == "good-bye")
        self.assertEqual(node.exit_code(20.0), 0)

    def test_last_words_are_sent_alone(self):
        node = self.run_script("habits.py", "spin", "__name:=habits")
        becomes(lambda: rospy.get_param("/habits/remapped", None), ["camera", "lamp"], 40.0)
        with words_on("/habits/words") as heard:
            node.stop(signal.SIGTERM)
            self.assertEqual(node.exit_code(20.0), 0)
            becomes(heard.copy, LAST_WORDS)

    def test_an_interrupt_takes_its_registrations_back_however_long_that_takes(self):
        talker = find_node("dyknow_test", "talker.py")[0]
        node = self.run_process(sys.executable, "-c", SLOW_END, talker, "__name:=slow")
        hears("/words", "hello")
        node.stop()
        self.assertEqual(node.exit_code(20.0), 0, node.output)
        self.assertEqual(registered("/slow"), set())

    def test_its_exit_code_and_errors_are_its_own(self):
        for what, code, said in (
            ("exits", 3, ""),
            ("raises", 1, "ValueError: of its own"),
            ("_exit", 4, ""),
            ("crash", -signal.SIGSEGV, ""),
        ):
            with self.subTest(what):
                node = self.run_process(
                    *NODELET, "standalone_script", "dyknow_test", "ill.py", what
                )
                self.assertEqual(node.exit_code(30.0), code)
                self.assertIn(said, node.output)
                self.assertNotIn("dyknow/ros", node.output)

    def test_a_program_sees_itself_as_without_dyknow(self):
        words = ("dyknow_test", "mirror.py", "here:=there", "_word:=5", "__ns:=/mirrors")
        seen = []
        for command in (find_node(*words[:2]), [*RUN, *words[:2]]):
            node = self.run_process(*command, *words[2:])
            self.assertEqual(node.exit_code(60.0), 0, node.output)
            lines = node.output.splitlines()
            seen.append([line for line in lines if line and "[INFO]" not in line])
        self.assertEqual(len(seen[0]), 9)
        self.assertEqual(*seen)

    def test_what_a_script_sets_takes_effect_on_its_process(self):
        words = ("dyknow_test", "own_process.py")
        for what in ("settings", "catches", "handles", "no_node"):
            with self.subTest(what):
                seen = []

                def is_same(what=what, seen=seen):
                    commands = (find_node(*words), [*RUN, *words])
                    nodes = [self.run_process(*command, what) for command in commands]
                    codes = [node.exit_code(60.0) for node in nodes]
                    seen[:] = [(c, without_traces(n.output)) for c, n in zip(codes, nodes)]
                    return seen[0] == seen[1]

                # On a busy machine a signal that is due in half a second may find it elsewhere.
                eventually(is_same, 1.0, "it does as without DyKnow", lambda seen=seen: seen)

    def test_what_cannot_share_a_process_runs_alone(self):
        # A child that is forked while another thread holds a lock ends too.
        for what in ("chdir", "alarm", "stdin", "fork", "fork", "fork"):
            with self.subTest(what):
                code = self.run_script("ill.py", what).exit_code(30.0)
                self.assertIn(code, (0, -signal.SIGALRM))
        words = [*find_node("dyknow_test", "ill.py"), "fork"]
        eventually(
            lambda: all(
                each.info["cmdline"][-2:] != words for each in psutil.process_iter(["cmdline"])
            ),
            5.0,
            "forked children end",
        )

    def test_libraries_work_between_processes(self):
        self.run_script("libraries.py", "__name:=far_server")
        self.run_script("libraries.py", "/far_server/count", "__name:=far")
        hears("/far/told", "42 2.0")
        self.assertEqual(topics_of_ports("/far")["/tf_static"], "/tf_static")


def transform(parent: str, child: str, x: float) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id = parent
    message.header.stamp = rospy.Time(1)
    message.transform.translation.x = x
    message.transform.rotation.w = 1.0
    return message


class Scripts:
    """Their behaviour in either way: `start` and `stop` them, and await `prints` and `ends`."""

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

            def is_drawn():  # draws messages of 5 s, in which a busy machine may connect nothing
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


class ShippedTest(Scripts, NodeletManagerCase):
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


class ShippedAloneTest(Scripts, graph.TellingCase):
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
    """Put an `ntpdate` for ntp_monitor.py on the path, which needs no network."""
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
