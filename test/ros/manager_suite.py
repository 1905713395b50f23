# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about the DyKnow manager: its process, its client, views of the graph."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
import unittest
from pathlib import Path
from typing import Any, Iterator

import graph  # noqa: F401 - it makes the test packages known
import rosgraph
import rospy
from nodelet.srv import NodeletList
from processes import BUSY, TellingCase, eventually, forget_ended, nodes
from roslib.packages import find_node
from std_msgs.msg import Header

from dyknow.errors import DyKnowError, HostError, PeerTimeout, Refused
from dyknow.model.streams import StreamStatus
from dyknow.ros.client import ManagerClient
from dyknow.ros.process.os_process import ProcessId
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

MANAGER = "/dyknow_manager"
CHILD = "/dyknow_nodelet_manager"
CPP_CHILD = "/dyknow_cpp_nodelet_manager"


def specification(label: str, source: str, ports: str, **params: Any) -> str:
    """Write a transformation; ports are `>name` for in and `name>` for out."""
    kinds = {float: "double", int: "int", str: "string", bool: "bool"}
    lines = [f"<transformation><label>{label}</label><source>{source}</source>"]
    if params:
        lines.append("<params>")
        for name, value in params.items():
            text = str(value).lower() if isinstance(value, bool) else value
            lines.append(f'<param name="{name}" type="{kinds[type(value)]}">{text}</param>')
        lines.append("</params>")
    if ports:
        lines.append("<ports>")
        for port in ports.split():
            side = "in" if port[0] == ">" else "out"
            lines.append(f'<port type="{side}">{port.strip(">")}</port>')
        lines.append("</ports>")
    return "".join([*lines, "</transformation>"])


LIBRARY = "".join(
    [
        "<transformations>",
        specification("counter", "dyknow_manager_test/Counter", "out>", rate=50.0),
        specification("relay", "dyknow_manager_test/Relay", ">in out>"),
        specification("fails", "dyknow_manager_test/FailsInInit", ">in out>", speed=3),
        specification("hangs", "dyknow_manager_test/HangsInInit", ">in out>", speed=3),
        specification("wrong", "dyknow_manager_test/Relay", ">in out> nothing>", speed=3),
        specification("unknown", "dyknow_manager_test/Nothing", ">in out>"),
        specification("suicidal", "dyknow_manager_test/DestroysItself", ">in"),
        specification("fatal", "dyknow_manager_test/Fatal", ">in out>"),
        specification("forks", "dyknow_manager_test/Forks", ""),
        specification("aborts", "dyknow_manager_test/Aborts", ">in out> >order"),
        "</transformations>",
    ]
)


class ManagerProcess:
    """A DyKnow manager in its own process, its state, and a client."""

    def __init__(self, state: str, node: str = MANAGER, **parameters: Any) -> None:
        self.state = state
        self.node = node
        self.command = [find_node("dyknow", "manager")[0], f"__name:={node.lstrip('/')}"]
        self.given = parameters
        self.parameters = {"state_dir": state, "orphan_timeout": 60.0, **parameters}
        self.client = ManagerClient(node, rospy.get_name())
        self.log = os.path.join(state, "output.log")
        self.process: Any = None
        self._log_begin = 0

    def start(self, wait: bool = True) -> None:
        for name, value in self.parameters.items():
            rospy.set_param(f"{self.node}/{name}", value)
        with open(self.log, "ab") as log:
            self.process = subprocess.Popen(
                self.command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
            )
        if wait:
            eventually(self.is_up, 30.0, "the manager is up", lambda: self.output)

    def is_up(self) -> bool:
        try:
            self.client.get_model(1.0)
        except Exception:
            assert self.process.poll() is None, self.output
            return False
        return True

    @property
    def output(self) -> str:
        """Its output in this test."""
        with open(self.log) as log:
            log.seek(self._log_begin)
            return log.read()

    def children(self) -> dict[str, ProcessId]:
        """Nodelet managers on its list."""
        name = re.sub(r"[^A-Za-z0-9.]+", "-", self.node)
        for file in Path(self.state).glob(f"*{name}.children.json"):
            return {
                each["name"]: ProcessId(each["pid"], each["started"])
                for each in json.loads(file.read_text())
            }
        return {}

    def child(self, name: str = CHILD) -> ProcessId:
        eventually(lambda: name in self.children(), 10.0, f"{name} is started")
        return self.children()[name]

    def kill_child(self, name: str = CHILD) -> None:
        """Kill a nodelet manager and wait until it is started again."""
        killed = self.child(name)
        killed.signal(signal.SIGKILL)
        eventually(lambda: self.child(name) != killed, 10.0, f"{name} is started again")

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def stop(self, number: int = signal.SIGINT) -> float:
        """End it as a user would; returns how long (s) that took."""
        begin = time.monotonic()
        self.process.send_signal(number)
        self.process.wait(20.0 * BUSY)
        return time.monotonic() - begin

    def destroy(self) -> None:
        """Remove everything, after any test."""
        started = []
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGSTOP)
            eventually(lambda: _stat(self.process.pid)[0] == "T", 5.0, "it stands still")
            started = _children_of(self.process.pid)  # it may not have them on its list yet
            self.kill()
        children = self.children()
        for process in [*started, *children.values()]:
            process.signal(signal.SIGKILL)
            process.wait(5.0 * BUSY)
        names = (self.node, *children)
        for name in names:
            if rospy.has_param(name):
                rospy.delete_param(name)
        forget_ended(*names, *nodes())

    def clear(self) -> None:
        """Remove all that a test has made, so that the next one finds it as new."""
        client = self.client
        for claim in self.claims():
            client.release_stream(claim.claim_id)
        for each in client.get_model().transformations:
            client.remove_transformation(each.label)

        def is_empty() -> bool:
            left = client.get_model().nodelets
            for nodelet in left:
                with contextlib.suppress(Refused):  # it is collected just now
                    if nodelet.is_protected:
                        client.set_protection(nodelet.name, False)
                    client.destroy(nodelet.name)
            return not left

        eventually(is_empty, 1.0, "no nodelet is left")
        eventually(lambda: set(self.children()) <= {CHILD, CPP_CHILD}, 1.0, "no process is left")
        assert self.child().alive
        self._log_begin = os.path.getsize(self.log)

    def claims(self) -> list[StreamStatus]:
        """The claims that have not ended."""
        return [each for each in self.client.list_streams() if not each.state.ended]

    def nodelet(self, name: str) -> Any:
        return self.client.get_model().nodelet(name)

    def topics(self, name: str) -> dict[str, str]:
        found = self.nodelet(name)
        return {port.name: port.topic for port in found.ports} if found is not None else {}


class ManagerCase(TellingCase):
    """Each test has a manager without nodelets, claims and transformations."""

    #: The manager that earlier tests used, while no test uses it.
    idle: ManagerProcess | None = None

    def make(self, node: str = MANAGER, **parameters: Any) -> ManagerProcess:
        """A manager of this test alone, to be started by it."""
        self.end_idle()
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        manager = ManagerProcess(folder.name, node, **parameters)
        self.addCleanup(manager.destroy)
        return manager

    def running(self, own: bool = False, **parameters: Any) -> ManagerProcess:
        """A manager that runs: that of the last test, if its parameters are the same.

        Args:
            own: it is not to be used by other tests.
            parameters: of the manager.
        """
        if own:
            manager = self.make(**parameters)
            manager.start()
            return manager
        manager = self.idle
        if manager is None or manager.given != parameters:
            self.end_idle()
            manager = ManagerProcess(tempfile.mkdtemp(), **parameters)
            unittest.addModuleCleanup(shutil.rmtree, manager.state)
            unittest.addModuleCleanup(manager.destroy)
            manager.start()
        ManagerCase.idle = None
        self.addCleanup(self._keep, manager, dict(manager.parameters))
        return manager

    def started(self, own: bool = False, **parameters: Any) -> ManagerProcess:
        """A manager that runs and has the library of the tests."""
        manager = self.running(own, **parameters)
        manager.client.add_transformation(LIBRARY)
        return manager

    @staticmethod
    def _keep(manager: ManagerProcess, parameters: dict[str, Any]) -> None:
        """Keep a manager for the next test, if it still is as it was."""
        try:
            assert manager.parameters == parameters and manager.process.poll() is None
            manager.clear()
        except (AssertionError, DyKnowError):
            manager.destroy()
        else:
            ManagerCase.idle = manager

    @classmethod
    def end_idle(cls) -> None:
        manager, ManagerCase.idle = cls.idle, None
        if manager is not None:
            manager.destroy()


class Receiver:
    """Records the numbers of the headers that arrive on a topic, in order."""

    def __init__(self, topic: str) -> None:
        self.numbers: list[int] = []
        self._subscriber = rospy.Subscriber(topic, Header, self._note, queue_size=10000)

    def _note(self, message: Header) -> None:
        self.numbers.append(int(message.frame_id))

    def close(self) -> None:
        self._subscriber.unregister()

    def flows(self, timeout: float = 5.0) -> float:
        """Wait for further messages; returns how long (s) that took."""
        count = len(self.numbers)
        return eventually(lambda: len(self.numbers) > count + 1, timeout, "messages flow")


def _stat(pid: int) -> list[str]:
    """Fields of a process's /proc stat, from its state on."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def _children_of(pid: int) -> list[ProcessId]:
    found = []
    for each in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if _stat(int(each.name))[1] == str(pid):
                found.append(ProcessId.of(int(each.name)))
    return [process for process in found if process is not None]


def listed(manager: str) -> list[str] | None:
    """The nodelets that a nodelet manager lists; None if it does not answer."""
    master = Master(rospy.get_name())
    try:
        return sorted(ServiceClient(master, f"{manager}/list", NodeletList).call(5.0).nodelets)
    except (HostError, PeerTimeout):
        return None


def registrations(prefix: str) -> list[str]:
    """Topics and services at the master whose names begin with a prefix."""
    state = rosgraph.Master(rospy.get_name()).getSystemState()
    return sorted(name for part in state for name, _ in part if name.startswith(prefix))


def parameters(prefix: str) -> list[str]:
    return sorted(name for name in rospy.get_param_names() if name.startswith(prefix))


def gaps(numbers: list[int]) -> list[tuple[int, int]]:
    """Pairs of neighbours in a sequence that are not consecutive."""
    return [(a, b) for a, b in zip(numbers, numbers[1:]) if b != a + 1]


def each_within(seconds: float) -> Iterator[float]:
    """Yield times until the given time is over."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        yield time.monotonic()
