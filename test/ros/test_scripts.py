#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Scripts of rospy, unchanged: as nodelets of one process, and in processes of their own."""

from __future__ import annotations

import os
import re
import signal
import tempfile
import time
from typing import Any, List

import graph  # first: it makes the test package known
import rosgraph
import rospy
import rostest
from dyknow_msgs.msg import Port
from dyknow_msgs.srv import GetCounts
from graph import NodeletManagerCase, get_config, hearing, hears, set_config, topics_of_ports
from processes import BUSY, DYKNOW, HELD_UP, NODELET, eventually
from roslib.packages import find_node
from sensor_msgs.msg import JointState

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


def said(text: str, heard: List[Any]) -> bool:
    """Whether a text is among the messages; a loop may send another one after it."""
    return any(each.data == text for each in list(heard))


def without_traces(output: str) -> List[str]:
    """The lines that a program printed, but for the frames of tracebacks."""
    return [line for line in output.splitlines() if line and not line.startswith("  ")]


def said_last(heard: List[Any]) -> None:
    """Wait until the last words of `habits.py` have come: the process may have ended before."""
    words = ["stopping", "stopped"]
    eventually(lambda: [each.data for each in heard] == words, 5.0, "last words", lambda: heard)


def connected(topic: str, publisher: str) -> None:
    """Wait until the node that publishes a topic sends it to this process.

    It greets before that, and messages in between do not come.
    """
    me = rospy.get_name()
    eventually(
        lambda: any(
            each[1] == me and each[2] == "o" and each[4] == topic
            for each in graph.bus_info(publisher)
        ),
        10.0,
        f"connected to {topic}",
    )


class SharedTest(NodeletManagerCase):
    """In one nodelet manager."""

    def load(self, script: str, name: str, *arguments: str, **remappings: str) -> None:
        self.manager.load(SCRIPT, name, remappings, [f"dyknow_test/{script}", *arguments])

    def unload(self, name: str) -> None:
        began = time.monotonic()
        self.manager.unload(name)
        self.assertLess(time.monotonic() - began, HELD_UP)

    def test_a_node_becomes_a_nodelet(self):
        rospy.set_param("/robot/a/word", "one")
        self.load("talker.py", "/robot/a")
        names = {"/robot/words": "/b_words"}
        self.load("talker.py", "/robot/b", "--word", "two", **names)
        self.assertEqual(topics_of_ports("/robot/a"), {"words": "/robot/words"})
        self.assertEqual(topics_of_ports("/robot/b"), {"words": "/b_words"})
        hears("/robot/words", "one 1")
        hears("/b_words", "two 2")
        with hearing("/b_words") as heard:
            eventually(lambda: heard, 5.0, "connected")
            self.unload("/robot/b")
            eventually(lambda: said("good-bye", heard), 5.0, "on_shutdown", lambda: heard)
        state = rosgraph.Master("/tests").getSystemState()
        self.assertNotIn("/b_words", [topic for topic, nodes in state[0] if "/manager" in nodes])

    def test_it_is_connected_elsewhere_and_loses_nothing(self):
        self.load("talker.py", "/talker")
        with hearing("/words") as first, hearing("/second") as second:
            eventually(lambda: first, 5.0, "heard")
            self.assertTrue(set_config("/talker", **{"/words": "/second"}).success)
            eventually(lambda: len(second) > 5, 5.0, "moved")
            self.assertTrue(set_config("/talker", words="/words").success)
            count = len(first)
            eventually(lambda: len(first) > count + 5, 5.0, "moved back")
            numbers = sorted(int(each.data.split()[1]) for each in [*first, *second])
            self.assertEqual(numbers, list(range(numbers[0], numbers[0] + len(numbers))))

    def test_what_the_manager_disconnects_begins_disconnected(self):
        self.load("talker.py", "/talker", words="/talker/disconnected/words")
        self.assertEqual(topics_of_ports("/talker"), {"words": ""})

    def test_ports_bear_the_names_of_the_code(self):
        names = {"/robot/told": "/news", "/robot/shout": "/yell"}
        self.load("both_ways.py", "/robot/n", **names)
        ports = {port.name: (port.direction, port.topic) for port in get_config("/robot/n")}
        self.assertEqual(
            ports,
            {
                "shout_out": (Port.OUT, "/yell"),
                "shout_in": (Port.IN, "/yell"),
                "~whisper": (Port.IN, "/robot/n/whisper"),
                "/siren": (Port.IN, "/siren"),
                "told": (Port.IN, "/news"),
            },
        )
        self.assertTrue(set_config("/robot/n", **{"/robot/n/whisper": "/quiet"}).success)
        self.assertEqual(topics_of_ports("/robot/n")["~whisper"], "/quiet")
        refused = set_config("/robot/n", **{"/robot/shout": "/x"})
        self.assertIn("shout_out", refused.message)

    def test_neighbours_see_what_a_script_does_to_its_messages_only_on_request(self):
        for by_reference in (False, True):
            with hearing("/spoiler/seen", JointState) as seen:
                rospy.set_param("/spoiler/by_reference", by_reference)
                self.load("spoiler.py", "/spoiler")
                eventually(lambda seen=seen: len(seen) > 50, 10.0, "messages")
            self.assertEqual("spoilt" in {each.name[0] for each in seen}, by_reference)
            if not by_reference:
                self.assertTrue(all(each.position[0] >= 0 for each in seen))
            self.unload("/spoiler")

    def test_libraries_work_between_two_instances(self):
        self.load("libraries.py", "/server")
        with hearing("/diagnostics", rospy.AnyMsg) as told:
            eventually(lambda: told, 10.0, "diagnostics")
        self.load("libraries.py", "/client", "/server/count")
        hears("/client/told", "42 2.0")
        self.assertIn("/server/count/goal", graph.registrations("/manager")["subscribers"])
        self.unload("/client")
        self.unload("/server")
        left = graph.registrations("/manager")
        self.assertEqual([t for kind in left.values() for t in kind if "/server" in t], [])
        self.assertNotIn("/tf_static", left["publishers"] + left["subscribers"])

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
                    with self.assertRaisesRegex(rospy.ServiceException, re.escape(said)) as caught:
                        self.load("ill.py", "/ill", what)
                    if "own" not in said and "exit" not in said:
                        self.assertIn("isolated", str(caught.exception))
                eventually(lambda: self.manager.is_free("/ill"), 5.0, "nothing is left")
        for script in ("gone.py", "package.xml"):
            with self.assertRaises(rospy.ServiceException) as caught:
                self.load(script, "/ill")
            self.assertIn(script, str(caught.exception))

    def test_a_script_may_do_without_what_is_refused(self):
        self.load("ill.py", "/ill", "optional")
        self.assertIn("/ill/without", graph.services_of("/manager"))

    def test_a_script_that_ends_or_fails_is_gone_and_its_neighbours_stay(self):
        self.load("talker.py", "/talker")
        for what in ("later", "quit", "_exit", "display", "show"):
            with self.subTest(what):
                self.load("ill.py", "/ill", what)
                eventually(lambda: self.manager.is_free("/ill"), 5.0, "it is unloaded")
        hears("/words", "hello")

    def test_last_words_are_sent(self):
        self.load("habits.py", "/habits", "spin", **{"/camera": "/left"})
        self.assertEqual(rospy.get_param("/habits/remapped"), ["/left", "lamp"])
        with hearing("/habits/words") as heard:
            connected("/habits/words", "/manager")
            self.unload("/habits")
            said_last(heard)

    def test_waits_end_with_the_unload(self):
        for what in ("service", "message"):
            with self.subTest(what):
                self.load("habits.py", "/waiting", what)
                self.unload("/waiting")
        self.assertNotIn("thread '/waiting main' does not end", self.manager.output)

    def test_a_shutdown_of_its_own_is_complete_when_it_returns(self):
        self.load("habits.py", "/habits", "quit")
        eventually(lambda: rospy.has_param("/habits/quit"), 10.0, "it has shut down")
        self.assertEqual(rospy.get_param("/habits/quit"), [True, "enough"])
        eventually(lambda: self.manager.is_free("/habits"), 5.0, "it is unloaded")

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
                self.assertEqual(rospy.get_param(f"/n{number}/word"), word)


def write(path: str, text: str, seconds: int) -> None:
    """Write a file of another second: Python distinguishes compiled files by that."""
    with open(path, "w") as file:
        file.write(text)
    os.utime(path, (1e9 + seconds, 1e9 + seconds))


class CommandTest(graph.TellingCase):
    """With `load_script`, `standalone_script` and `run`."""

    def start(self, *command: str) -> graph.Ended:
        process = graph.Ended(*command)
        self.addCleanup(process.__exit__)
        return process

    def test_load_script_is_bonded_as_load_is(self):
        manager = self.start(*NODELET, "manager", "__name:=host")
        client = self.start(
            *NODELET, "load_script", "dyknow_test", "talker.py", "host", "--word", "w",
            "__name:=told", "words:=/told_words", "_rate:=20",
        )  # fmt: skip
        hears("/told_words", "w 3")
        self.assertEqual(rospy.get_param("/told/rate"), 20)
        graph.let_the_bond_form("/host/bond")
        client.stop(signal.SIGKILL)
        manager.wait_for("unloaded nodelet /told", 30.0)

    def test_a_script_in_a_process_of_its_own(self):
        node = self.start(
            *RUN, "dyknow_test", "talker.py", "--word", "alone", "words:=/here", "_rate:=100"
        )
        hears("/here", "alone")
        name = next(n for n in graph.nodes_on("/here")[0])
        self.assertRegex(name, r"^/talker_\d+_\d+$")  # as anonymous nodes are called
        self.assertEqual(topics_of_ports(name), {"words": "/here"})
        self.assertEqual(rospy.get_param(f"{name}/rate"), 100)
        rospy.wait_for_service(f"{name}/get_counts", 5.0 * BUSY)
        counts = rospy.ServiceProxy(f"{name}/get_counts", GetCounts)([])
        self.assertEqual(counts.kind, "node")
        self.assertTrue(set_config(name, words="/there").success)
        with hearing("/there") as heard:
            eventually(lambda: heard, 5.0, "moved")
            node.stop()
            eventually(lambda: said("good-bye", heard), 5.0, "on_shutdown", lambda: heard)
        self.assertEqual(node.exit_code(20.0), 0)

    def test_last_words_are_sent_alone(self):
        node = self.start(*RUN, "dyknow_test", "habits.py", "spin", "__name:=habits")
        rospy.wait_for_service("/habits/get_config", 40.0 * BUSY)
        with hearing("/habits/words") as heard:
            connected("/habits/words", "/habits")
            node.stop(signal.SIGTERM)
            self.assertEqual(node.exit_code(20.0), 0)
            said_last(heard)

    def test_its_exit_code_and_errors_are_its_own(self):
        for what, code, said in (
            ("exits", 3, ""),
            ("raises", 1, "ValueError: of its own"),
            ("quit", 0, ""),
            ("_exit", 4, ""),
            ("crash", -signal.SIGSEGV, ""),
        ):
            with self.subTest(what):
                node = self.start(*NODELET, "standalone_script", "dyknow_test", "ill.py", what)
                self.assertEqual(node.exit_code(30.0), code)
                self.assertIn(said, node.output)
                self.assertNotIn("dyknow/ros", node.output)

    def test_a_program_sees_itself_as_without_dyknow(self):
        words = ("dyknow_test", "mirror.py", "here:=there", "_word:=5", "__ns:=/mirrors")
        seen = []
        for command in (find_node(*words[:2]), [*RUN, *words[:2]]):
            node = self.start(*command, *words[2:])
            self.assertEqual(node.exit_code(60.0), 0, node.output)
            lines = node.output.splitlines()
            seen.append([line for line in lines if line and "[INFO]" not in line])
        self.assertEqual(len(seen[0]), 9)
        self.assertEqual(*seen)

    def test_what_a_script_sets_takes_effect_on_its_process(self):
        for what in ("settings", "waits", "catches", "handles", "no_node"):
            with self.subTest(what):
                words = ("dyknow_test", "own_process.py")
                plain = self.start(*find_node(*words), what)
                live = self.start(*RUN, *words, what)
                codes = [each.exit_code(60.0) for each in (plain, live)]
                self.assertEqual(codes[1], codes[0], live.output)
                self.assertEqual(without_traces(live.output), without_traces(plain.output))

    def test_what_cannot_share_a_process_runs_alone(self):
        for what in ("fork", "chdir", "alarm", "stdin"):
            with self.subTest(what):
                node = self.start(*RUN, "dyknow_test", "ill.py", what)
                self.assertIn(node.exit_code(30.0), (0, -signal.SIGALRM))

    def test_libraries_work_between_processes(self):
        self.start(*RUN, "dyknow_test", "libraries.py", "__name:=far_server")
        self.start(*RUN, "dyknow_test", "libraries.py", "/far_server/count", "__name:=far")
        hears("/far/told", "42 2.0")
        self.assertEqual(topics_of_ports("/far")["/tf_static"], "/tf_static")

    def test_what_is_no_node_runs_as_ever(self):
        script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "no_such")
        node = self.start(*RUN, "dyknow_test", script)
        self.assertNotEqual(node.exit_code(20.0), 0)


if __name__ == "__main__":
    rospy.init_node("test_scripts")
    rostest.rosrun("dyknow", "scripts", "__main__")
