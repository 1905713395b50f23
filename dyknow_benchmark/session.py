# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A separate ROS for a measurement: a master on a free port and the processes that it needs."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from typing import Any, Callable, Iterable, Mapping, Sequence

import psutil
import rospy
from nodelet.srv import NodeletLoad, NodeletUnload
from tqdm import tqdm

from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.ros.client import ManagerClient
from dyknow.ros.process.owned import START_TIMEOUT, Processes
from dyknow.ros.process.programs import find_program
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

#: The DyKnow manager that ``Session.start_manager`` starts, and its own nodelet manager.
MANAGER = "/dyknow_manager"
NODELET_MANAGER = "/dyknow_nodelet_manager"

#: Package and program of each kind of nodelet manager, and its arguments: two of DyKnow's for
#: Python, the stock one for C++, and DyKnow's.
_NODELET_MANAGERS = {
    "python": ("dyknow", "nodelet_manager"),
    "python_beside": ("dyknow", "nodelet_manager"),
    "cpp": ("nodelet", "nodelet", "manager"),
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


class MeasurementFailed(DyKnowError):
    """A measurement could not be made."""


class Session(Processes):
    """A master and processes, as a context manager that makes this process a ROS node."""

    def __init__(self) -> None:
        super().__init__("dyknow-benchmark")
        self._managers: dict[str, RunningManager] = {}

    def __enter__(self) -> Session:
        os.environ.pop("ROS_NAMESPACE", None)
        os.environ.update(ROS_HOME=str(self.folder), ROS_LOG_DIR=str(self.folder / "log"))
        try:
            self.start_master()
            rospy.init_node("benchmark", disable_signals=True)
        except BaseException:
            super().__exit__()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        rospy.signal_shutdown("the measurement is over")
        super().__exit__(*error)

    def run(self, command: Sequence[str], ready: Callable[[], bool] = lambda: True) -> Any:
        """Start a process of which no more is known than its command."""
        return self.start(f"process {' '.join(command)}", command, ready=ready)

    def nodelet_manager(self, kind: str = "python", own: str = "") -> RunningManager:
        """Return the nodelet manager of a kind, or one of its ``own``, started on first need."""
        key = kind + own
        if key not in self._managers:
            name = f"/{key}_manager_process"
            package, program, *arguments = _NODELET_MANAGERS[kind]
            command = [find_program(package, program), *arguments, f"__name:={name[1:]}"]
            process = self.run(command, lambda: offers(f"{name}/list"))
            self._managers[key] = RunningManager(name, process)
        return self._managers[key]

    def dyknow_manager(self) -> ManagerClient:
        """Start a DyKnow manager with the shipped source and relay in its library."""
        self.start_manager()
        client = ManagerClient(MANAGER)
        client.add_transformation(_RELAYS)
        return client

    def start_manager(self) -> None:
        """Start the process of ``MANAGER``, which goes on where one that was killed ended."""
        # Its nodelet managers end soon after it, even if it is killed.
        command = [find_program("dyknow", "manager"), "_orphan_timeout:=2"]
        self.run(command, lambda: offers(f"{MANAGER}/get_model"))


class RunningManager:
    """A nodelet manager that runs; all kinds have the same services."""

    def __init__(self, name: str, process: psutil.Process) -> None:
        self.process = process
        self._load, self._unload = (
            ServiceClient(_master(), f"{name}/{service}", kind, persistent=True)
            for service, kind in (("load_nodelet", NodeletLoad), ("unload_nodelet", NodeletUnload))
        )

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
        self._load.call(START_TIMEOUT, name, type_name, sources, targets, list(my_argv), "")

    def unload(self, name: str) -> None:
        self._unload.call(START_TIMEOUT, name)


def _master() -> Master:
    return Master(rospy.get_name())


def offers(service: str) -> bool:
    with contextlib.suppress(LookupError, PeerTimeout):
        return bool(_master().ask("lookupService", service))
    return False


def kill(*nodes: str) -> None:
    """Kill the processes of nodes, all looked up first, with SIGKILL."""
    master = _master()
    for pid in [master.pid(node, master.node(node), START_TIMEOUT) for node in nodes]:
        os.kill(pid, signal.SIGKILL)


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Look every few milliseconds until ``condition`` holds; raises MeasurementFailed."""
    end = time.monotonic() + START_TIMEOUT
    while not condition():
        if time.monotonic() > end:
            raise MeasurementFailed(f"waited {START_TIMEOUT:g} s for {what}")
        time.sleep(0.01)


def seconds(call: Callable[[], object]) -> float:
    begin = time.monotonic()
    call()
    return time.monotonic() - begin


def say(text: str) -> None:
    """Print a line to standard error, above a bar that is there."""
    tqdm.write(text, file=sys.stderr)


def steps(things: Iterable[Any], what: str, unit: str = "block") -> Iterable[Any]:
    """Pass things on, with a bar if standard error is a terminal."""
    bar: Iterable[Any] = tqdm(things, desc=what, unit=unit, disable=None, leave=False)
    return bar
