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
from unittest.mock import patch

from graph import Heard
from manager_suite import CHILD, MANAGER, PROGRAM, ManagerCase
from processes import DYKNOW, Running, becomes, eventually, nodes, run, suspended

from dyknow.cli.main import main

WATCH = ("stats", "--watch", "0.01")


class Done:
    """A command that has ended."""

    def __init__(self, *words, **environment):
        out, err = io.StringIO(), io.StringIO()
        interrupt = signal.getsignal(signal.SIGINT)
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), patch.dict(
            os.environ, environment
        ):
            self.code = main(words)
        signal.signal(signal.SIGINT, interrupt)
        self.out, self.err = out.getvalue(), err.getvalue()

    @property
    def lines(self):
        return self.out.splitlines()

    @property
    def json(self):
        return json.loads(self.out)


def execute(*command, **environment):
    """A command in a process of its own, with the texts that it writes."""
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        env={**os.environ, **environment},
    )


def completions(line):
    """Completions by argcomplete at the end of a line, without the space after a word."""
    done = execute(
        *("sh", "-c", 'exec "$@" 8>&1 >/dev/null', "sh", *DYKNOW),
        _ARGCOMPLETE="1",
        _ARGCOMPLETE_COMP_WORDBREAKS=" \t\n\"'><=;|&(:",
        COMP_LINE=line,
        COMP_POINT=str(len(line)),
    )
    return [each.strip() for each in done.stdout.split("\013") if each]


class CommandTest(ManagerCase):
    def setUp(self):
        self.manager = self.started()
        self.client = self.manager.client

    def done(self, *words):
        """Run a command that has to succeed and print only its result."""
        done = Done(*words)
        self.assertEqual((done.code, done.err), (0, ""), done.out)
        return done

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
        self.assertIn("running,protected", self.done("list", "-l").lines[2])
        (shape,) = self.done("info", "robot/r", "--json").json["nodelets"]
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
        self.done("spawn", "relay", "r", "--connect", "out:/out")
        heard = self.enter(Heard("/out"))
        done = self.done("connect", "c:out", "r:in")
        self.assertEqual(done.lines, ["/c:out -> /c/out -> /r:in"])
        heard.flows()
        # When the command ends, its effect is in the model.
        self.assertEqual(self.manager.topics("/r"), {"in": "/c/out", "out": "/out"})
        shape = self.done("connect", "c:out", "r:in", "--topic", "other", "--json").json
        self.assertEqual(
            [(each["nodelet"], each["before"], each["after"]) for each in shape["changed"]],
            [("/r", "/c/out", "/other"), ("/c", "/c/out", "/other")],
        )
        heard.flows()
        self.assertEqual(self.done("disconnect", "r:in").lines, ["/r:in has left /other"])
        self.assertEqual(self.manager.topics("/r"), {"in": "", "out": "/out"})

    def test_a_process_has_the_exit_code_and_the_output_of_its_command(self):
        self.done("spawn", "relay", "r")
        for words, code, out, err in (
            (["list"], 0, "/r\n", ""),
            (["info", "x"], 1, "", "dyknow: no nodelet named '/x' runs; see 'dyknow list'\n"),
            (["list", "--manager-node", "n"], 3, "", None),
        ):
            done = execute(*DYKNOW, *words)
            self.assertEqual((done.returncode, done.stdout), (code, out), done.stderr)
            self.assertEqual(done.stderr, done.stderr if err is None else err)
            self.assertEqual(done.stderr.count("\n"), int(code > 0), done.stderr)
        before = nodes()
        with Running(*DYKNOW, "stats", "--watch", "0.1") as watching:
            watching.wait_for("/r")
            self.assertEqual(nodes(), before)  # no node is started
            watching.stop()
            self.assertEqual(watching.exit_code(20.0), 130)
            self.assertNotIn("Traceback", watching.output)
        # A reader that goes away ends it quietly.
        done = execute(
            "bash", "-c", '"$@" | head -n 1; exit ${PIPESTATUS[0]}', "-", *DYKNOW, *WATCH
        )
        self.assertEqual((done.returncode, done.stderr), (141, ""))

    def test_completion(self):
        self.done("spawn", "relay", "r")
        for line, candidates in (
            ("dyknow info ", ["/r"]),
            ("dyknow connect r:", ["out"]),
            ("dyknow spawn relay x --connect in:/dyknow_manager/m", ["/dyknow_manager/model"]),
        ):
            # It gives up early rather than keep the user waiting, so a busy machine may need two.
            becomes(lambda line=line: completions(line), candidates)


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
        done = execute(PROGRAM, "--read-only")
        self.assertEqual((done.returncode, done.stdout), (255, ""))
        self.assertIn("'--read-only' would have no effect", done.stderr)

    def test_a_manager_that_hangs_or_was_killed(self):
        self.manager.start()
        with suspended(self.manager.process.pid):
            for words in (["list"], ["library"], ["destroy", "x"]):
                done = self.check("did not answer within 0.5 s", *words, "--timeout", "0.5")
                self.assertIn("it hangs, is busy, or its host is away", done.err)
                self.assertNotIn("start one", done.err)
            self.assertEqual(completions("dyknow info "), [])
        self.manager.kill()
        for words in (["list"], ["library"]):
            done = self.check(f"'{MANAGER}' is registered, but does not answer", *words)
            self.assertIn("start it again", done.err)


if __name__ == "__main__":
    run()
