# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about the DyKnow manager: its process, its client, views of the graph."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import tempfile
import unittest
from pathlib import Path
from typing import Any, Iterator
from unittest import mock

import graph  # first: it makes the test packages known
import psutil
import rosgraph
import rospy
from nodelet.srv import NodeletList
from processes import BUSY, Ended, TellingCase, eventually, forget_ended, free_port, suspended
from roslib.packages import find_node
from std_msgs.msg import Header

from dyknow.errors import DyKnowError, HostError, PeerTimeout, Refused
from dyknow.model.graph import State
from dyknow.model.streams import StreamStatus
from dyknow.model.transformation import Parameter, Port, Transformation
from dyknow.ros.client import ManagerClient
from dyknow.ros.hosting import child_records
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.manager.mirror import MasterMirror
from dyknow.ros.process.os_process import ProcessId
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

PROGRAM = find_node("dyknow", "manager")[0]
MANAGER = "/dyknow_manager"
CHILD = "/dyknow_nodelet_manager"
CPP_CHILD = "/dyknow_cpp_nodelet_manager"


def specification(
    label: str, source: str, ports: str, kind: str = "nodelet", cost: int = 1, **params: Any
) -> str:
    """Write a transformation; ports are `>name` for in and `name>` for out, or `name>=tag`."""
    types = {float: "double", int: "int", str: "string", bool: "bool"}
    given = []
    for name, value in params.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        given.append(Parameter(name, types[type(value)], text))
    made = [
        Port(name.strip(">"), "in" if name[0] == ">" else "out", tags=(tag,) if tag else ())
        for name, _, tag in (each.partition("=") for each in ports.split())
    ]
    return Transformation(label, source, kind, cost, tuple(given), tuple(made)).to_xml()


def library(*specifications: str) -> str:
    return "\n".join(["<transformations>", *specifications, "</transformations>"])


LIBRARY = library(
    specification("counter", "dyknow_manager_test/Counter", "out>", rate=50.0),
    specification("relay", "dyknow_manager_test/Relay", ">in out>"),
    specification("fails", "dyknow_manager_test/FailsInInit", ">in out>", speed=3),
    specification("hangs", "dyknow_manager_test/HangsInInit", ">in out>", speed=3),
    specification("wrong", "dyknow_manager_test/Relay", ">in out> nothing>", speed=3),
    specification("unknown", "dyknow_manager_test/Nothing", ">in out>"),
    specification("suicidal", "dyknow_manager_test/DestroysItself", ">in"),
    specification("fatal", "dyknow_manager_test/Fatal", ">in out>"),
)


class ManagerProcess:
    """A DyKnow manager in its own process, its state, and a client."""

    def __init__(self, state: str, node: str = MANAGER, **parameters: Any) -> None:
        self.state = state
        self.node = node
        namespace, _, base = node.rpartition("/")
        self.command = [PROGRAM, f"__name:={base}", f"__ns:={namespace or '/'}"]
        self.given = parameters
        # Limits of the product that only a busy machine reaches are out of the way.
        limits = {"orphan_timeout": 60.0, "spawn_timeout": 60.0}
        self.parameters = {"state_dir": state, **limits, **parameters}
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
        assert self.process.poll() is None, self.output
        return answers(self.client)

    def forget_output(self) -> None:
        self._log_begin = os.path.getsize(self.log)

    @property
    def output(self) -> str:
        """Its output in this test, or since `forget_output`."""
        with open(self.log) as log:
            log.seek(self._log_begin)
            return log.read()

    def children(self) -> dict[str, ProcessId]:
        """Nodelet managers on its list."""
        return children_in(self.state, self.node)

    def child(self, name: str = CHILD) -> ProcessId:
        found: dict[str, ProcessId] = {}
        is_started = lambda: found.update(self.children()) or name in found  # noqa: E731
        eventually(is_started, 10.0, f"{name} is started")
        return found[name]

    def kill_child(self, name: str = CHILD, number: int = signal.SIGKILL) -> None:
        """End a nodelet manager and wait until it is started again."""
        ended = self.child(name)
        ended.signal(number)
        eventually(lambda: self.child(name) != ended, 10.0, f"{name} is started again")

    @contextlib.contextmanager
    def child_stopped(self, name: str = CHILD) -> Iterator[ProcessId]:
        """Stop a nodelet manager with SIGSTOP."""
        child = self.child(name)
        with suspended(child.pid):
            yield child

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def stop(self, number: int = signal.SIGINT) -> None:
        """End it as a user would."""
        self.process.send_signal(number)
        self.process.wait(20.0 * BUSY)

    def fails(self) -> str:
        """Wait until it ends with an error; returns its output."""
        assert self.process.wait(20.0 * BUSY) != 0, self.output
        return self.output

    def destroy(self) -> None:
        """Remove everything, after any test."""
        if self.process is not None and self.process.poll() is None:
            with suspended(self.process.pid):
                # It may not have them on its list yet.
                started = psutil.Process(self.process.pid).children()
                self.kill()
            for each in started:
                each.kill()
            psutil.wait_procs(started, 5.0 * BUSY)
        children = self.children()
        for process in children.values():
            process.signal(signal.SIGKILL)
            process.wait(5.0 * BUSY)
        for name in (self.node, *children):
            graph.forget(name)
        forget_ended()

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
        self.forget_output()

    def claims(self) -> list[StreamStatus]:
        """The claims that have not ended."""
        return [each for each in self.client.list_streams() if not each.state.ended]

    def nodelet(self, name: str) -> Any:
        return self.client.get_model().nodelet(name)

    def is_gone(self, name: str) -> None:
        """Wait until the model shows a nodelet no longer."""
        eventually(lambda: self.nodelet(name) is None, 5.0, f"{name} is gone")

    def becomes(self, name: str, state: State) -> Any:
        """Wait until a nodelet is in a state; returns it."""
        found: list[Any] = []

        def does() -> bool:
            found[:] = [self.nodelet(name)]
            return found[0] is not None and found[0].state is state

        eventually(does, 10.0, f"{name} is {state.name}", lambda: f"{found}\n{self.output}")
        return found[0]

    def topics(self, name: str) -> dict[str, str]:
        found = self.nodelet(name)
        return {port.name: port.topic for port in found.ports} if found is not None else {}

    def shows(self, name: str, **topics: str) -> None:
        """Wait until the model shows ports connected to topics."""
        eventually(
            lambda: topics.items() <= self.topics(name).items(),
            2.0,
            f"{name} is shown with {topics}",
            lambda: self.topics(name),
        )


def children_in(state: str, node: str = MANAGER) -> dict[str, ProcessId]:
    """Processes that a manager with its state in a folder has started: recorded, or running."""
    name = re.sub(r"[^A-Za-z0-9.]+", "-", node)
    found: list[ChildRecord] = []
    for path in Path(state).glob(f"*{name}.sqlite3"):
        with contextlib.suppress(sqlite3.Error), contextlib.closing(
            sqlite3.connect(f"file:{path}?mode=ro", uri=True)
        ) as file:
            rows = file.execute("SELECT name, body FROM children")
            found += [ChildRecord.from_body(*row) for row in rows]
        found += child_records.running(str(path.with_suffix(".lock")))
    return {each.name: each.process for each in found if each.process is not None}


def answers(client: ManagerClient) -> bool:
    with contextlib.suppress(DyKnowError):
        client.get_model(1.0)
        return True
    return False


class ManagerCase(TellingCase):
    """Each test has a manager without nodelets, claims and transformations."""

    #: The manager that earlier tests used, while no test uses it.
    idle: ManagerProcess | None = None

    def make(self, node: str = MANAGER, **parameters: Any) -> ManagerProcess:
        """A manager of this test alone, to be started by it."""
        self.end_idle()
        manager = ManagerProcess(str(self.make_folder()), node, **parameters)
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
        """A manager that runs and has the library of the tests; its nodelet manager is up."""
        manager = self.running(own, **parameters)
        manager.client.add_transformation(LIBRARY)
        eventually(lambda: listed(CHILD) is not None, 20.0, f"{CHILD} is up")
        return manager

    def spawned(self, manager: ManagerProcess, name: str, where: str = "") -> None:
        """Spawn a relay as soon as its nodelet manager is used, whenever that is."""

        def is_spawned() -> bool:
            with contextlib.suppress(Refused):
                manager.client.spawn("relay", name, manager=where)
                return True
            return False

        eventually(is_spawned, 20.0, f"{name} is spawned", lambda: manager.output)

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


class MasterCase(TellingCase):
    """Each test has a master of its own, which can be killed, for all its processes."""

    def setUp(self) -> None:
        self.state = str(self.make_folder())
        self.addCleanup(self.end_children)
        self.port = free_port()
        self.uri = f"http://localhost:{self.port}"
        patch = mock.patch.dict(os.environ, {"ROS_MASTER_URI": self.uri})
        patch.start()
        self.addCleanup(patch.stop)
        self.client = ManagerClient(MANAGER, rospy.get_name())

    def end_children(self) -> None:
        """End the processes that killed managers have left, whatever their names."""
        for process in children_in(self.state, "").values():
            process.signal(signal.SIGKILL)

    def roscore(self) -> Ended:
        core = self.run_process("rosmaster", "--core", "-p", self.port)
        eventually(rosgraph.Master(rospy.get_name(), self.uri).is_online, 10.0, "a master")
        return core

    def manager(self, *settings: str) -> Ended:
        return self.run_process(PROGRAM, f"_state_dir:={self.state}", *settings)

    def mirrored(self, *wanted: str) -> Any:
        """Wait until the services are there, and on disk all that is; returns the contents."""
        eventually(lambda: {*wanted} <= contents()[2].keys(), 20.0, "all services are there")

        def is_mirrored() -> bool:
            there = contents()
            paths = [*Path(self.state).glob("*.master")]
            mirrors = [MasterMirror.from_text(each.read_text()) for each in paths]
            return bool(mirrors) and all(
                [
                    {topic: set(nodes) for topic, nodes in each.publishers.items()},
                    {topic: set(nodes) for topic, nodes in each.subscribers.items()},
                    {service: {node} for service, node in each.services.items()},
                    each.parameters,
                ]
                == there
                for each in mirrors
            )

        eventually(is_mirrored, 10.0, "the mirror is complete")
        return contents()

    def kill(self, *processes: Ended) -> None:
        for process in processes:
            process.stop(signal.SIGKILL)
            process.exit_code(10.0)


def contents() -> Any:
    """All registrations and parameters of the master; None if it does not answer."""
    master = Master(rospy.get_name())
    try:
        sides = [
            {name: set(nodes) for name, nodes in side} for side in master.ask("getSystemState")
        ]
        return [*sides, master.ask("getParam", "/")]
    except PeerTimeout:
        return None


def counted(message: Header) -> int:
    """The number of a header of the counter."""
    return int(message.frame_id)


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


def everything(prefix: str = "/") -> set[str]:
    """Registrations and parameters with a name that begins so, without those of roslaunch."""
    state = rosgraph.Master(rospy.get_name()).getSystemState()
    found = {
        f"{kind} {name} of {node}"
        for kind, part in zip(("publisher", "subscriber", "service"), state)
        for name, nodes in part
        for node in nodes
    }
    found |= {f"parameter {name}" for name in parameters("/")}
    return {each for each in found if f" {prefix}" in each and " /roslaunch/" not in each}


def gaps(numbers: list[int]) -> list[tuple[int, int]]:
    """Pairs of neighbours in a sequence that are not consecutive."""
    return [(a, b) for a, b in zip(numbers, numbers[1:]) if b != a + 1]
