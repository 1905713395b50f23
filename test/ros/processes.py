# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Real processes for tests: started, watched by their output, and certain to be ended."""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
import traceback
import unittest
from pathlib import Path
from typing import Any, Callable, Iterator, Sequence
from unittest import mock

import rosgraph
import rospy
import rostest
from roslib.packages import find_node

from dyknow.cli.main import main
from dyknow.errors import PeerTimeout
from dyknow.ros.wire.master import Master

DYKNOW = [sys.executable, "-m", "dyknow.cli"]
NODELET = [sys.executable, "-m", "dyknow.cli.nodelet"]
#: The program itself: `rosrun` takes several times as long to find it as it takes to start.
STOCK_NODELET = find_node("nodelet", "nodelet")

#: Factor by which waits may be longer on a busy machine than on a quiet one. A wait ends with its
#: condition, so a large factor costs time only where a test fails.
BUSY = 20.0
#: Seconds that a wait lasts at least, before that factor.
LEAST = 5.0
#: Seconds after which a call that a suspended process could hold up counts as held up: it would
#: be for as long as that process is suspended.
HELD_UP = 120.0


def eventually(
    condition: Callable[[], object],
    timeout: float,
    what: str,
    shown: Callable[[], object] = lambda: "",
) -> float:
    """Wait until something holds and return how long (s) that took; fail if it does not.

    The longer it takes, the more seldom it looks: a look may cost several processes some work.

    Args:
        condition: Whether it holds.
        timeout: How long (s) it may take on a quiet machine.
        what: Names the condition.
        shown: Returns more text for a failure, as of then.
    """
    start = time.monotonic()
    timeout = max(timeout, LEAST) * BUSY
    while not condition():
        waited = time.monotonic() - start
        if waited > timeout:
            raise AssertionError(f"not within {timeout:g} s: {what}\n{shown()}".rstrip())
        time.sleep(min(max(0.04, waited / 8), 0.5))
    return time.monotonic() - start


def becomes(value: Callable[[], Any], wanted: Any, timeout: float = 10.0) -> None:
    """Wait until a function returns a wanted value; a failure shows the last one."""
    eventually(lambda: value() == wanted, timeout, f"it becomes {wanted!r}", value)


class Running:
    """A process; leaving the `with` block kills it."""

    def __init__(self, *command: str) -> None:
        self.command = command
        # Not a pipe: its reader may be behind the writing process.
        self._written = tempfile.TemporaryFile()  # noqa: SIM115 - it is read after the end too
        self._begin = 0
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=self._written,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )

    def __enter__(self) -> Running:
        return self

    def __exit__(self, *unused: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        special = dict(word.split(":=", 1) for word in self.command if word.startswith("__"))
        if "__name" in special:
            forget_ended(rosgraph.names.ns_join(special.get("__ns", "/"), special["__name"]))

    @property
    def output(self) -> str:
        """Its output by now, or since `forget_output`."""
        size = os.fstat(self._written.fileno()).st_size - self._begin
        return os.pread(self._written.fileno(), size, self._begin).decode(errors="replace")

    def forget_output(self) -> None:
        self._begin = os.fstat(self._written.fileno()).st_size

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    def wait_for(self, text: str, timeout: float = 20.0) -> None:
        """Wait until the process has printed a text."""
        self.wait_for_match(re.escape(text), timeout)

    def wait_for_match(self, pattern: str | re.Pattern[str], timeout: float = 20.0) -> None:
        """Wait until the process has printed something that a regular expression matches."""
        what = f"{self.command} says '{pattern}'"

        def said() -> bool:
            return re.search(pattern, self.output) is not None

        eventually(lambda: self.has_ended or said(), timeout, what, self._said)
        assert said(), f"not true: {what}\n{self._said()}"

    @property
    def pid(self) -> int:
        return self._process.pid

    def stop(self, number: int = signal.SIGINT) -> None:
        """Send a signal; with SIGSTOP it stands still afterwards."""
        self._process.send_signal(number)
        if number == signal.SIGSTOP:
            await_standstill(self.pid)

    def exit_code(self, timeout: float) -> int:
        """Wait for the end of the process; on a quiet machine it takes at most so long (s)."""
        limit = max(timeout, LEAST) * BUSY
        assert self.ends_within(limit), f"still running: {self.command}\n{self.output}"
        return self._process.returncode

    def ends_within(self, seconds: float) -> bool:
        """Wait for the end of the process, but no longer."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(seconds)
        return self.has_ended

    def _said(self) -> str:
        code = self._process.poll()
        end = "It runs on" if code is None else f"It ended with code {code}"
        return f"{end}; it said:\n{self.output}"


class Ended(Running):
    """A process that gets SIGINT before it is killed, to unregister and end its children."""

    def __exit__(self, *unused: object) -> None:
        if not self.has_ended:
            self.stop(signal.SIGCONT)
            self.stop()
            self.ends_within(60.0)  # roslaunch gives its nodes 17 s to end
        super().__exit__()


def await_standstill(*pids: int) -> None:
    """Wait for the effect of SIGSTOP: processes may still answer after it was sent."""

    def states() -> set[str]:
        """Of all threads."""
        found = set()
        for pid in pids:
            for task in Path(f"/proc/{pid}/task").glob("*/stat"):
                with contextlib.suppress(OSError):  # it has ended
                    found.add(task.read_text().rpartition(") ")[2][0])
        return found

    eventually(lambda: states() <= {*"TtZX"}, 5.0, f"{pids} stand still", states)


@contextlib.contextmanager
def suspended(*pids: int) -> Iterator[None]:
    """Processes stand still."""
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    try:
        await_standstill(*pids)
        yield
    finally:
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)


def free_port() -> str:
    """A free port, for a master of a test's own; no connection gets it meanwhile.

    It is below the ports that the system assigns, which start at 12000 in a suite's own network.
    """
    while True:
        port = random.randrange(2000, 11000)
        with socket.socket() as free, contextlib.suppress(OSError):
            free.bind(("", port))
            return str(port)


def nodes() -> set[str]:
    """Names of the nodes that are registered at the master."""
    state = rosgraph.Master("/tests").getSystemState()
    return {node for kind in state for _, names in kind for node in names}


def forget_ended(*names: str) -> None:
    """Make the master forget those nodes, by default of all, that have ended.

    Else it shuts down the next process on their port, as soon as their names are back.
    """
    master = Master("/tests")
    for node in names or nodes():
        with contextlib.suppress(PeerTimeout):  # no master: it has ended too
            uri = master.node(node)
            try:
                if uri:
                    master.pid(node, uri, 1.0)
            except (PeerTimeout, LookupError):
                master.purge(node, uri)


def forget(parameter: str) -> None:
    """Delete a parameter, if it is there."""
    if rospy.has_param(parameter):
        rospy.delete_param(parameter)


def finished(command: Sequence[str], timeout: float = 20.0) -> tuple[int, str]:
    """Run a process to its end; returns its exit code and its output."""
    with Running(*command) as process:
        code = process.exit_code(timeout)
    return code, process.output


class Done:
    """A command `dyknow` that has ended, in this process, which takes a tenth of the time."""

    def __init__(self, *words, **environment):
        out, err = io.StringIO(), io.StringIO()
        interrupt = signal.getsignal(signal.SIGINT)
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), mock.patch.dict(
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


class TellingCase(unittest.TestCase):
    """Prints the traceback of a sub-test that fails: rosunit counts it, but loses its text."""

    @contextlib.contextmanager
    def subTest(self, *args: Any, **kwds: Any) -> Iterator[None]:  # noqa: N802
        with super().subTest(*args, **kwds):
            try:
                yield
            except Exception:
                print(f"{self.id()} {args or ''} {kwds or ''}\n{traceback.format_exc()}")
                raise

    def enter(self, context: Any) -> Any:
        """Enter a context, which is left at the end of the test."""
        value = context.__enter__()
        self.addCleanup(context.__exit__, None, None, None)
        return value

    def publisher(self, topic: str, message_class: Any, **options: Any) -> rospy.Publisher:
        """Advertise a topic until the end of the test."""
        publisher = rospy.Publisher(topic, message_class, **{"queue_size": 100, **options})
        self.addCleanup(publisher.unregister)
        return publisher

    def make_folder(self) -> Path:
        """Make a folder, which is removed at the end of the test."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        return Path(folder.name)

    def parameter(self, name: str, value: Any) -> None:
        """Set a parameter until the end of the test."""
        rospy.set_param(name, value)
        self.addCleanup(forget, name)

    def run_process(self, *command: str) -> Ended:
        """Start a process, which is ended at the end of the test."""
        return self.enter(Ended(*command))


def run(tests: Any = "__main__", is_node: bool = True) -> None:
    """Run the tests of the main module, or some of them, by default in a node of its name."""
    name = Path(sys.argv[0]).stem
    if is_node:
        rospy.init_node(name)
    rostest.rosrun("dyknow", name.replace("test_", ""), tests)
