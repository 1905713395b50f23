#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The command line `dyknow` against a real manager.

Commands run in this process, which takes a hundredth of the time; those whose process matters
(signals, pipes, completion) run in one of their own.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from unittest.mock import patch

import rospy
import rostest
from manager_suite import (
    CHILD,
    LIBRARY,
    MANAGER,
    ManagerProcess,
    Receiver,
    eventually,
    nodes,
    specification,
)
from processes import Running
from roslib.packages import find_node

from dyknow.cli.main import main

DYKNOW = [sys.executable, "-m", "dyknow.cli"]


class Done:
    """A command that has ended."""

    def __init__(self, *words, stdin="", **environment):
        out, err, given = (
            io.StringIO(),
            io.StringIO(),
            io.TextIOWrapper(io.BytesIO(stdin.encode())),
        )
        interrupt = signal.getsignal(signal.SIGINT)
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), patch.dict(
            os.environ, environment
        ), patch("sys.stdin", given):
            self.code = main(words)
        signal.signal(signal.SIGINT, interrupt)
        self.out, self.err = out.getvalue(), err.getvalue()

    @property
    def lines(self):
        return self.out.splitlines()

    @property
    def json(self):
        return json.loads(self.out)


def completions(line):
    """Completions by argcomplete at the end of a line, without the space after a word."""
    done = subprocess.run(
        ["sh", "-c", 'exec "$@" 8>&1 >/dev/null', "sh", *DYKNOW],
        stdout=subprocess.PIPE,
        text=True,
        timeout=60,
        check=False,
        env={
            **os.environ,
            "_ARGCOMPLETE": "1",
            "_ARGCOMPLETE_COMP_WORDBREAKS": " \t\n\"'><=;|&(:",
            "COMP_LINE": line,
            "COMP_POINT": str(len(line)),
        },
    )
    return [each.strip() for each in done.stdout.split("\013") if each]


class CommandTest(unittest.TestCase):
    """One manager for all of these tests."""

    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.manager = ManagerProcess(cls.folder.name)
        cls.manager.start()
        cls.client = cls.manager.client
        cls.manager.child()

    @classmethod
    def tearDownClass(cls):
        cls.manager.destroy()
        cls.folder.cleanup()

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.work = Path(folder.name)
        self.client.add_transformation(LIBRARY)

    def tearDown(self):
        model = self.client.get_model()
        for nodelet in model.nodelets:
            if nodelet.is_protected:
                self.client.set_protection(nodelet.name, False)
            self.client.destroy(nodelet.name)
        for transformation in model.transformations:
            self.client.remove_transformation(transformation.label)

    def done(self, *words, **more):
        """Run a command that has to succeed and print only its result."""
        done = Done(*words, **more)
        self.assertEqual((done.code, done.err), (0, ""), done.out)
        return done

    def failed(self, code, *words, **more):
        """Run a command that has to fail; returns its one-line message."""
        done = Done(*words, **more)
        self.assertEqual(done.code, code, done.out + done.err)
        self.assertEqual(done.err.count("\n"), 1, done.err)
        return done.err

    def topics(self, name):
        return {port.name: port.topic for port in self.client.get_config(name)}

    # Nodelets

    def test_spawn_list_info_destroy(self):
        done = self.done(
            "spawn", "relay", "/robot/r", "--protected", "--connect", "in:/x", "out:y"
        )
        self.assertEqual(
            done.lines,
            [f"spawned /robot/r from relay in {CHILD}", "  in - /x", "  out - /robot/y"],
        )
        self.done("spawn", "counter", "c")
        self.assertEqual(self.done("list").lines, ["/c", "/robot/r"])
        self.assertEqual(self.done("list", "/robot").lines, ["/robot/r"])
        self.assertIn("running,protected", self.done("list", "-l").lines[2])
        (shape,) = self.done("info", "robot/r", "--json").json["nodelets"]
        self.assertEqual(shape["state"], "running")
        self.assertEqual(
            {port["name"]: (port["datatype"], port["topic"]) for port in shape["ports"]},
            {"in": ("std_msgs/Header", "/x"), "out": ("std_msgs/Header", "/robot/y")},
        )
        self.assertIn("protected", self.failed(1, "destroy", "robot/r"))
        self.done("unprotect", "robot/r")
        self.assertEqual(self.done("destroy", "robot/r", "c").lines[0], "destroyed /robot/r")
        eventually(lambda: self.done("list").out == "", 5.0, "nothing is listed")

    def test_isolated_and_a_named_nodelet_manager(self):
        shape = self.done("spawn", "relay", "r", "--isolated", "--json").json
        self.assertTrue(shape["isolated"])
        self.assertNotEqual(shape["manager"], CHILD)
        shape = self.done("spawn", "relay", "s", "--manager", CHILD, "--json").json
        self.assertEqual(shape["manager"], CHILD)
        self.assertIn(
            "unknown nodelet manager '/n'", self.failed(1, "spawn", "relay", "t", "--manager", "n")
        )

    def test_what_is_refused_names_the_thing(self):
        self.done("spawn", "relay", "r")
        for words, said in (
            (("spawn", "relay", "r"), "'/r'"),
            (("spawn", "relai", "s"), "did you mean relay?"),
            (("spawn", "relay", "s", "--connect", "nix:/x"), "unknown port 'nix'"),
            (("spawn", "fails", "s"), "cannot spawn '/s'"),
            (("spawn", "unknown", "s"), "dyknow_manager_test/Nothing"),
            (("destroy", "nobody"), "no nodelet named '/nobody'"),
            (("protect", "nobody"), "no nodelet named '/nobody'"),
            (("info", "nobody"), "no nodelet named '/nobody'"),
            (("stats", "nobody"), "no nodelet named '/nobody'"),
            (("remove", "nothing"), "'nothing'"),
            (("library", "nothing"), "'nothing'"),
            (("export", "nothing"), "'nothing'"),
            (("import", "/no/file.xml"), "/no/file.xml: cannot be read: No such file"),
            (("load", "/no/file.xml"), "/no/file.xml: cannot be read: No such file"),
            (("connect", "nobody:out", "r:in"), "no nodelet named '/nobody'"),
            (("connect", "r:nix", "r:in"), "nodelet '/r' has no port 'nix'"),
            (("connect", "r:in", "r:out"), "swap the two"),
            (("disconnect", "r:nix"), "nodelet '/r' has no port 'nix'"),
        ):
            self.assertIn(said, self.failed(1, *words), words)

    def test_wrong_usage_ends_with_2(self):
        for words in ((), ("nonsense",), ("spawn",), ("connect", "a", "b"), ("list", "--colour")):
            self.failed(2, *words)

    # Connections

    def test_connect_and_disconnect_while_messages_flow(self):
        self.done("spawn", "counter", "c")
        self.done("spawn", "relay", "r")
        receiver = Receiver("/out")
        self.addCleanup(receiver.close)
        self.client.set_config("/r", {"out": "/out"})
        done = self.done("connect", "c:out", "r:in")
        self.assertEqual(done.lines, ["/c:out -> /c/out -> /r:in"])
        receiver.flows()
        # When the command ends, its effect is in the model.
        found = self.done("graph", "--json").json["topics"]
        self.assertIn(
            {
                "topic": "/c/out",
                "datatype": "std_msgs/Header",
                "out": [{"nodelet": "/c", "port": "out"}],
                "in": [{"nodelet": "/r", "port": "in"}],
            },
            found,
        )
        shape = self.done("connect", "c:out", "r:in", "--topic", "other", "--json").json
        self.assertEqual(shape["topic"], "/other")
        self.assertEqual(
            [(each["nodelet"], each["before"], each["after"]) for each in shape["changed"]],
            [("/r", "/c/out", "/other"), ("/c", "/c/out", "/other")],
        )
        receiver.flows()
        self.assertIn("(as it was)", self.done("connect", "c:out", "r:in").out)
        self.assertEqual(self.done("disconnect", "r:in").lines, ["/r:in has left /other"])
        self.assertEqual(self.topics("/r")["in"], "")

    def test_ports_are_connected_to_topics_while_messages_flow(self):
        self.done("spawn", "counter", "c")
        self.done("spawn", "relay", "r")
        receiver = Receiver("/out")
        self.addCleanup(receiver.close)
        self.assertEqual(self.done("connect", "c:out", "/numbers").lines, ["/c:out -> /numbers"])
        self.assertEqual(self.done("connect", "numbers", "r:in").lines, ["/numbers -> /r:in"])
        self.assertEqual(self.done("connect", "r:out", "out").lines, ["/r:out -> /out"])
        receiver.flows()
        self.assertEqual(self.topics("/r"), {"in": "/numbers", "out": "/out"})
        self.assertIn("swap the two", self.failed(1, "connect", "/numbers", "c:out"))
        # A topic with another type is refused by the proxy.
        self.assertIn("std_msgs/Header", self.failed(1, "connect", "/rosout", "r:in"))
        self.assertEqual(self.topics("/r")["in"], "/numbers")

    def test_the_first_end_goes_back_when_the_second_is_refused(self):
        self.done("spawn", "counter", "c")
        self.done("spawn", "relay", "r", "--connect", "in:/before")
        # Of another type, and live between the two ends: the in-port is refused.
        from std_msgs.msg import String

        publisher = rospy.Publisher("/taken", String, queue_size=1)
        self.addCleanup(publisher.unregister)
        said = self.failed(1, "connect", "c:out", "r:in", "--topic", "/taken")
        self.assertIn("std_msgs/String", said)
        self.assertEqual(self.topics("/r")["in"], "/before")
        self.assertEqual(self.topics("/c")["out"], "")

    # Transformations

    def test_library_export_remove_import(self):
        labels = self.done("library").lines
        self.assertIn("relay", labels)
        self.assertIn("<label>relay</label>", self.done("library", "relay").out)
        self.assertIn("dyknow_manager_test/Relay", self.done("library", "-l", "relay").out)
        exported = self.done("export").out
        file = self.work / "some.xml"
        self.done("export", "relay", "counter", "-o", str(file))
        self.done("remove", *labels)
        self.assertEqual(self.done("library").out, "")
        shape = self.done("import", str(file), "--json").json
        self.assertEqual(shape["imported"][0]["labels"], ["counter", "relay"])
        done = Done("import", "-", stdin=exported)
        self.assertEqual(done.code, 0, done.err)
        (warning,) = done.err.splitlines()
        self.assertIn("transformation 'unknown': no package declares a nodelet type", warning)
        self.assertEqual(self.done("export").out, exported)

    def test_a_bad_specification_is_told_with_file_and_lines(self):
        file = self.work / "bad.xml"
        file.write_text("<transformation>\n<label>x</label>\n<nonsense/>\n</transformation>\n")
        done = Done("import", str(file))
        self.assertEqual(done.code, 1)
        self.assertIn(f"dyknow: {file}:3: ", done.err)
        checked = Done("check", str(file), "--json", ROS_MASTER_URI="http://localhost:1")
        self.assertEqual(checked.code, 1)
        problems = checked.json["files"][0]["problems"]
        self.assertEqual(
            [f"dyknow: {each['file']}:{each['line']}: {each['message']}" for each in problems],
            done.err.splitlines(),
        )

    def test_warnings_are_shown(self):
        file = self.work / "odd.xml"
        file.write_text(specification("odd", "a/B", "", **{"config-path": "x"}))
        done = Done("import", str(file))
        self.assertEqual((done.code, done.lines), (0, [f"{file}: odd"]))
        self.assertTrue(done.err.startswith(f"dyknow: warning: {file}:1: "), done.err)

    # Everything together

    def test_graph_in_all_forms(self):
        self.done("spawn", "relay", "r", "--connect", "in:/x")
        self.assertIn("    to   /r:in", self.done("graph").lines)
        self.assertIn('"t/x" -> "n/r" [label="in"];', self.done("graph", "--dot").out)
        self.done("graph", "--svg", str(self.work / "g.svg"))
        self.done("graph", "--png", str(self.work / "g.png"))
        self.assertIn("<svg", (self.work / "g.svg").read_text())
        self.assertTrue((self.work / "g.png").read_bytes().startswith(b"\x89PNG"))

    def test_stats(self):
        self.done("spawn", "counter", "c", "--connect", "out:/x")
        self.done("spawn", "relay", "r", "--connect", "in:/x")

        def rate():
            (shape,) = self.done("stats", "r", "--json").json["nodelets"]
            return {port["name"]: port for port in shape["ports"]}["in"]["rate"]

        eventually(lambda: 40.0 < rate() < 60.0, 15.0, "50 Hz are shown")
        rows = [line.split() for line in self.done("stats").lines]
        self.assertEqual(rows[1][:3], ["/c", "out", "out"])
        watched = self.done("stats", "--watch", "0.1", "--count", "3", "--json")
        self.assertEqual(len(watched.lines), 3)

    def test_save_and_load_is_the_identity(self):
        self.done("spawn", "counter", "c", "--connect", "out:/x")
        self.done("spawn", "relay", "/robot/r", "--protected", "--connect", "in:/x")
        self.done("spawn", "relay", "alone", "--isolated")
        first, second = self.work / "first.xml", self.work / "second.xml"
        self.done("save", str(first))
        shape = self.done("load", str(first), "--json").json
        self.assertEqual(shape["nodelets"]["kept"], ["/alone", "/c", "/robot/r"])
        self.tearDown()
        shape = self.done("load", str(first), "--json").json
        self.assertEqual(shape["transformations"]["added"], ["counter", "relay"])
        self.assertEqual(set(shape["nodelets"]["spawned"]), {"/alone", "/c", "/robot/r"})
        self.done("save", str(second))
        self.assertEqual(second.read_text(), first.read_text())

    def test_a_load_that_fails_leaves_nothing_unless_it_keeps_going(self):
        self.done("spawn", "counter", "c")
        self.done("spawn", "relay", "r")
        file = self.work / "w.xml"
        self.done("save", str(file))
        self.tearDown()
        text = file.read_text().replace(
            "dyknow_manager_test/Counter", "dyknow_manager_test/FailsInInit"
        )
        file.write_text(text)
        said = self.failed(1, "load", str(file))
        self.assertIn("spawning '/c': cannot spawn '/c'", said)
        self.assertIn("everything is as it was", said)
        model = self.client.get_model()
        self.assertEqual((model.nodelets, model.transformations), ((), ()))
        done = Done("load", str(file), "--keep-going", "--json")
        self.assertEqual((done.code, done.json["nodelets"]["spawned"]), (1, ["/r"]))
        self.assertEqual([each.name for each in self.client.get_model().nodelets], ["/r"])

    def test_replacing_reaches_the_nodelets(self):
        self.done("spawn", "counter", "c", "--connect", "out:/x")
        self.done("spawn", "relay", "r", "--connect", "in:/x")
        file = self.work / "w.xml"
        self.done("save", str(file))
        text = file.read_text()
        file.write_text(text.replace(">50", ">20"))
        self.assertIn("--replace", self.failed(1, "load", str(file)))
        done = self.done("load", str(file), "--replace")
        self.assertIn("nodelet /c: replaced", done.lines)
        self.assertIn("nodelet /r: exists already", done.lines)
        self.assertEqual(rospy.get_param("/c/rate"), 20.0)
        self.assertEqual(self.topics("/c"), {"out": "/x"})
        # A parameter changed by others is reported, and reset only by --replace.
        rospy.set_param("/c/rate", 5.0)
        done = self.done("load", str(file))
        line = "nodelet /c: exists already (parameter rate is 5.0, expected 20.0: see --replace)"
        self.assertIn(line, done.lines)
        self.assertEqual(rospy.get_param("/c/rate"), 5.0)
        self.done("load", str(file), "--replace")
        self.assertEqual(rospy.get_param("/c/rate"), 20.0)

    def test_tags_and_what_is_excluded(self):
        file = self.work / "tagged.xml"
        text = specification("tagged", "dyknow_manager_test/Counter", "out>", rate=50.0)
        tags = '<tags><tag port="out">Number(robot)</tag></tags>'
        file.write_text(text.replace("</transformation>", tags + "</transformation>"))
        self.done("import", str(file))
        self.assertEqual(self.done("tags").lines[1].split(), ["Number(robot)", "-", "-", "tagged"])
        said = self.failed(1, "plan", "Numbers(robot)", "--exclude", "tagget")
        self.assertIn("(excluded: tagget); did you mean Number(robot)?", said)
        self.assertIn("no transformation is labelled 'tagget'; did you mean tagged?", said)
        done = Done("plan", "Number(robot)", "--exclude", "tagget")
        self.assertEqual(done.code, 0)
        self.assertIn("warning: no transformation is labelled 'tagget'", done.err)

    # Conventions

    def test_a_process_has_the_exit_code_and_the_output_of_its_command(self):
        self.done("spawn", "relay", "r")
        for words, code, out, err in (
            (["list"], 0, "/r\n", ""),
            (["info", "x"], 1, "", "dyknow: no nodelet named '/x' runs; see 'dyknow list'\n"),
            (["list", "--manager-node", "n", "--timeout", "x"], 2, "", None),
            (["list", "--manager-node", "n"], 3, "", None),
        ):
            done = subprocess.run(
                [*DYKNOW, *words], capture_output=True, text=True, timeout=60, check=False
            )
            self.assertEqual((done.returncode, done.stdout), (code, out), done.stderr)
            self.assertEqual(done.stderr, done.stderr if err is None else err)
            self.assertEqual(done.stderr.count("\n"), int(code > 0), done.stderr)

    def test_no_node_is_started(self):
        self.done("spawn", "relay", "r")
        before = nodes()
        with Running(*DYKNOW, "stats", "--watch", "0.1") as watching:
            watching.wait_for("/r")
            self.assertEqual(nodes(), before)
            watching.stop()
            self.assertEqual(watching.exit_code(20.0), 130)
            self.assertNotIn("Traceback", watching.output)

    def test_a_reader_that_goes_away_ends_it_quietly(self):
        with subprocess.Popen(
            [*DYKNOW, "stats", "--watch", "0.01"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        ) as process:
            try:
                process.stdout.readline()
                process.stdout.close()
                self.assertEqual(process.wait(10.0), 141)
                self.assertEqual(process.stderr.read(), b"")
            finally:
                if process.poll() is None:
                    process.kill()

    def test_completion(self):
        self.done("spawn", "relay", "r")
        for line, candidates in (
            ("dyknow info ", ["/r"]),
            ("dyknow connect r:", ["out"]),
            ("dyknow spawn rel", ["relay"]),
            ("dyknow spawn relay x --connect in:/dyknow_manager/m", ["/dyknow_manager/model"]),
            ("dyknow list --manager-node ", [MANAGER]),
        ):
            # It gives up early rather than keep the user waiting, so a busy machine may need two.
            eventually(
                lambda line=line, candidates=candidates: completions(line) == candidates,
                10.0,
                f"{line}: {candidates}",
            )


class UnreachableTest(unittest.TestCase):
    """The missing party is named, and the exit code is 3."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.manager = ManagerProcess(folder.name)
        self.addCleanup(self.manager.destroy)

    def check(self, said, *words, **environment):
        done = Done(*words, **environment)
        self.assertEqual((done.code, done.out), (3, ""), done.err)
        self.assertIn(said, done.err)
        self.assertEqual(done.err.count("\n"), 1, done.err)
        return done

    def test_no_manager(self):
        for words in (["list"], ["library"], ["spawn", "a", "b"], ["save", "-"], ["stats"]):
            self.check("DyKnow manager '/n' is not running", *words, "--manager-node", "n")
        self.check("'/ns/other' is not", "list", DYKNOW_MANAGER="other", ROS_NAMESPACE="/ns")

    def test_a_manager_that_was_stopped(self):
        self.manager.start()
        self.assertEqual(Done("list").code, 0)
        self.manager.stop()
        for words in (["list"], ["library"]):
            self.check("is not running: start one", *words)

    def test_a_manager_takes_no_words_that_would_have_no_effect(self):
        program = find_node("dyknow", "manager")[0]
        done = subprocess.run(
            [program, "--read-only"], capture_output=True, text=True, timeout=60, check=False
        )
        self.assertEqual((done.returncode, done.stdout), (255, ""))
        self.assertIn("'--read-only' would have no effect", done.stderr)

    def test_no_master(self):
        for uri in ("http://localhost:1", "http://no.such.host.invalid:11311", "nonsense"):
            self.check(f"no ROS master at {uri}", "list", ROS_MASTER_URI=uri)

    def test_a_manager_that_hangs_or_was_killed(self):
        self.manager.start()
        os.kill(self.manager.process.pid, signal.SIGSTOP)
        try:
            for words in (["list"], ["library"], ["destroy", "x"]):
                done = self.check("did not answer within 0.5 s", *words, "--timeout", "0.5")
                self.assertIn("it hangs, is busy, or its host is away", done.err)
                self.assertNotIn("start one", done.err)
            self.assertEqual(completions("dyknow info "), [])
        finally:
            os.kill(self.manager.process.pid, signal.SIGCONT)
        self.manager.kill()
        for words in (["list"], ["library"]):
            done = self.check(f"'{MANAGER}' is registered, but does not answer", *words)
            self.assertIn("start it again", done.err)


if __name__ == "__main__":
    rospy.init_node("test_dyknow_command")
    rostest.rosrun("dyknow", "dyknow_command", "__main__")
