# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A separate ROS for a measurement: a master on a free port and the processes that it needs.

A ``Session`` owns every process that it starts and ends each by its pid, the newest
first. Everything stays on the loopback interface.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, Mapping, Sequence

import psutil
import rosgraph
import roslib.packages
import rospy
from nodelet.srv import NodeletLoad, NodeletUnload
from tqdm import tqdm

from dyknow.ros.client import ManagerClient
from dyknow.ros.wire.master import Master

#: Seconds for something to come up on a machine that is busy.
START_PATIENCE = 120.0
#: Seconds that a process gets to end by itself.
END_PATIENCE = 5.0

#: The DyKnow manager that ``Session.start_manager`` starts, and its own nodelet manager.
MANAGER = "/dyknow_manager"
NODELET_MANAGER = "/dyknow_nodelet_manager"

#: Package and program of each kind of nodelet manager.
_NODELET_MANAGERS = {
    "python": ("dyknow", "nodelet_manager"),
    "cpp": ("nodelet", "nodelet"),
    "cpp_live": ("dyknow", "cpp_nodelet_manager"),
}

_RELAYS = """
<transformations>
  <transformation><label>source</label><source>dyknow/Source</source>
    <params><param name="rate" type="double">50</param></params>
    <ports><port type="out">out</port></ports></transformation>
  <transformation><label>relay</label><source>dyknow/Relay</source>
    <ports><port type="in">in</port><port type="out">out</port></ports></transformation>
</transformations>
"""


class MeasurementFailed(Exception):
    """A measurement could not be made: something did not come up, or ended."""


class Session:
    """A master and processes, as a context manager that makes this process a ROS node."""

    def __init__(self) -> None:
        self._processes: list[psutil.Popen] = []
        self._directory = Path()
        self._managers: dict[str, RunningManager] = {}

    def __enter__(self) -> Session:
        """Start the master and register this process with it."""
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self._directory = Path(tempfile.mkdtemp(prefix="dyknow-benchmark-"))
        os.environ.pop("ROS_HOSTNAME", None)
        os.environ.pop("ROS_NAMESPACE", None)
        os.environ.update(
            ROS_MASTER_URI=f"http://127.0.0.1:{port}",
            ROS_IP="127.0.0.1",
            ROS_HOME=str(self._directory),
            ROS_LOG_DIR=str(self._directory / "log"),
        )
        try:
            self.start(["rosmaster", "--core", "-p", str(port)])
            wait_until(lambda: bool(rosgraph.is_master_online()), "the ROS master to come up")
            rospy.init_node("benchmark", disable_signals=True)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        """End this node and all processes."""
        rospy.signal_shutdown("the measurement is over")
        self._end()

    def start(self, command: Sequence[str]) -> psutil.Popen:
        """Start a process with its output in a file beside the logs."""
        log = self._directory / f"{len(self._processes):03}-{Path(command[0]).name}.txt"
        with log.open("wb") as output:
            process = psutil.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C is for us; we end them
            )
        self._processes.append(process)
        return process

    @property
    def processes(self) -> Sequence[psutil.Popen]:
        """The processes that were started, in that order."""
        return tuple(self._processes)

    def check(self) -> None:
        """Raise if a process has ended by itself."""
        for process in self._processes:
            if process.poll() is not None:
                texts = [
                    file.read_text("utf-8", "replace") for file in self._directory.glob("*.txt")
                ]
                printed = "\n".join(text.strip() for text in texts if text.strip())[-4000:]
                raise MeasurementFailed(
                    f"process {process.pid} ({' '.join(map(str, process.args))}) ended with exit "
                    f"code {process.returncode}:\n{printed}"
                )

    def nodelet_manager(self, kind: str = "python", name: str = "") -> RunningManager:
        """Return a nodelet manager, started when it is needed first.

        Args:
            kind: ``python`` or ``cpp_live`` for DyKnow's, ``cpp`` for the stock one.
            name: of the node, if it is not to be the one of its kind.
        """
        name = name or f"/{kind}_manager_process"
        if name not in self._managers:
            program = executable(*_NODELET_MANAGERS[kind])
            command = [sys.executable, program] if kind == "python" else [program]
            command += ["manager"] if kind == "cpp" else []
            process = self.start([*command, f"__name:={name[1:]}"])
            self._managers[name] = RunningManager(self, name, process)
        return self._managers[name]

    def dyknow_manager(self) -> ManagerClient:
        """Start a DyKnow manager with the shipped source and relay in its library."""
        self.start_manager()
        _wait_for_services(self, MANAGER, "get_model")
        client = ManagerClient(MANAGER)
        client.add_transformation(_RELAYS)
        return client

    def start_manager(self) -> None:
        """Start the process of ``MANAGER``, which goes on where one that was killed ended."""
        # Its nodelet managers end soon after it, even if it is killed.
        self.start([executable("dyknow", "manager"), "_orphan_timeout:=2"])

    def _end(self) -> None:
        processes = [each for each in self._processes[::-1] if each.poll() is None]
        for process in processes:
            os.kill(process.pid, signal.SIGINT)
        for process in psutil.wait_procs(processes, END_PATIENCE)[1]:
            process.kill()
            process.wait()
        shutil.rmtree(self._directory, ignore_errors=True)


class RunningManager:
    """A nodelet manager that runs; all kinds have the same services."""

    def __init__(self, session: Session, name: str, process: psutil.Process) -> None:
        """Wait for the services of a manager that was started."""
        self.name = name
        self.process = process
        self._load = rospy.ServiceProxy(f"{name}/load_nodelet", NodeletLoad, persistent=True)
        self._unload = rospy.ServiceProxy(f"{name}/unload_nodelet", NodeletUnload, persistent=True)
        _wait_for_services(session, name, "load_nodelet", "unload_nodelet", "list")

    def load(
        self,
        name: str,
        type_name: str,
        remappings: Mapping[str, str] = {},
        my_argv: Sequence[str] = (),
        **parameters: Any,
    ) -> None:
        """Set a nodelet's private parameters and load it; all names are global."""
        if parameters:
            rospy.set_param(name, parameters)
        sources, targets = list(remappings), list(remappings.values())
        try:
            self._load(name, type_name, sources, targets, list(my_argv), "")
        except rospy.ServiceException as error:
            raise MeasurementFailed(f"cannot load {name} of type {type_name}: {error}") from error

    def unload(self, name: str) -> None:
        """Unload a nodelet."""
        try:
            self._unload(name)
        except rospy.ServiceException as error:
            raise MeasurementFailed(f"cannot unload {name}: {error}") from error


def _wait_for_services(session: Session, node: str, *services: str) -> None:
    for service in services:
        try:
            rospy.wait_for_service(f"{node}/{service}", START_PATIENCE)
        except rospy.ROSException as error:
            session.check()
            raise MeasurementFailed(f"{node} offers no services: {error}") from error


def executable(package: str, name: str) -> str:
    """Path of a program of a ROS package.

    Raises:
        MeasurementFailed: it is not there.
    """
    found = roslib.packages.find_node(package, name)
    if not found:
        raise MeasurementFailed(f"package '{package}' has no program '{name}': is it built?")
    return str(found[0])


def kill(*nodes: str) -> None:
    """Kill the processes of nodes, all looked up first, with SIGKILL."""
    master = Master(rospy.get_name())
    for pid in [master.pid(node, master.node(node), START_PATIENCE) for node in nodes]:
        os.kill(pid, signal.SIGKILL)


def wait_until(condition: Callable[[], bool], what: str, patience: float = START_PATIENCE) -> None:
    """Look every few milliseconds until ``condition`` holds.

    Raises:
        MeasurementFailed: it does not within ``patience`` seconds.
    """
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            raise MeasurementFailed(f"waited {patience:g} s for {what}")
        time.sleep(0.01)


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGTERM end the measurement as Ctrl-C does, so that its processes are ended too."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def say(text: str) -> None:
    """Print a line to standard error, above a bar that is there."""
    tqdm.write(text, file=sys.stderr)


def steps(things: Iterable[Any], what: str, unit: str = "block") -> Iterable[Any]:
    """Pass things on, with a bar if standard error is a terminal."""
    bar: Iterable[Any] = tqdm(things, desc=what, unit=unit, disable=None, leave=False)
    return bar
