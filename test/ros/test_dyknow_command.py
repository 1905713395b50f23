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
from pathlib import Path
from unittest.mock import patch

import rospy
import rostest
from manager_suite import (
    CHILD,
    MANAGER,
    ManagerCase,
    Receiver,
    eventually,
    nodes,
)
from processes import BUSY, Running
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


class CommandTest(ManagerCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.work = Path(folder.name)
        self.manager = self.started()
        self.client = self.manager.client
        self.manager.child()

    def done(self, *words, **more):
        """Run a command that has to succeed and print only its result."""
        done = Done(*words, **more)
        self.assertEqual((done.code, done.err), (0, ""), done.out)
        return done

    def topics(self, name):
        return {port.name: port.topic for port in self.client.get_config(name)}

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
        refused = Done("destroy", "robot/r")
        self.assertEqual(refused.code, 1)
        self.assertIn("protected", refused.err)
        self.done("unprotect", "robot/r")
        self.assertEqual(self.done("destroy", "robot/r", "c").lines[0], "destroyed /robot/r")
        eventually(lambda: self.done("list").out == "", 5.0, "nothing is listed")

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

    def test_save_and_load_is_the_identity(self):
        self.done("spawn", "counter", "c", "--connect", "out:/x")
        self.done("spawn", "relay", "/robot/r", "--protected", "--connect", "in:/x")
        self.done("spawn", "relay", "alone", "--isolated")
        first, second = self.work / "first.xml", self.work / "second.xml"
        self.done("save", str(first))
        shape = self.done("load", str(first), "--json").json
        self.assertEqual(shape["nodelets"]["kept"], ["/alone", "/c", "/robot/r"])
        self.manager.clear()
        shape = self.done("load", str(first), "--json").json
        self.assertEqual(shape["transformations"]["added"], ["counter", "relay"])
        self.assertEqual(set(shape["nodelets"]["spawned"]), {"/alone", "/c", "/robot/r"})
        self.done("save", str(second))
        self.assertEqual(second.read_text(), first.read_text())

    def test_a_process_has_the_exit_code_and_the_output_of_its_command(self):
        self.done("spawn", "relay", "r")
        for words, code, out, err in (
            (["list"], 0, "/r\n", ""),
            (["info", "x"], 1, "", "dyknow: no nodelet named '/x' runs; see 'dyknow list'\n"),
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
                self.assertEqual(process.wait(10.0 * BUSY), 141)
                self.assertEqual(process.stderr.read(), b"")
            finally:
                if process.poll() is None:
                    process.kill()

    def test_completion(self):
        self.done("spawn", "relay", "r")
        for line, candidates in (
            ("dyknow info ", ["/r"]),
            ("dyknow connect r:", ["out"]),
            ("dyknow spawn relay x --connect in:/dyknow_manager/m", ["/dyknow_manager/model"]),
        ):
            # It gives up early rather than keep the user waiting, so a busy machine may need two.
            eventually(
                lambda line=line, candidates=candidates: completions(line) == candidates,
                10.0,
                f"{line}: {candidates}",
            )


class UnreachableTest(ManagerCase):
    """The missing party is named, and the exit code is 3."""

    def setUp(self):
        self.manager = self.make()

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
