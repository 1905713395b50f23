# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A separate ROS for a measurement: a master on a free port and the processes that it needs.

Who owns what: a ``Session`` owns every process that it starts and ends each by its pid, the newest
first. Everything stays on the loopback interface.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Type

import rosgraph
import roslib.packages
import rospy

#: Seconds for something to come up on a machine that is busy.
START_PATIENCE = 120.0
#: Seconds that a process gets to end by itself.
END_PATIENCE = 5.0


class MeasurementFailed(Exception):
    """A measurement could not be made: something did not come up, or ended."""


class Session:
    """A master and processes, as a context manager that makes this process a ROS node."""

    def __init__(self) -> None:
        self._processes: List[subprocess.Popen[bytes]] = []
        self._names: Dict[int, str] = {}
        self._directory = Path()
        self._environment: Dict[str, str] = {}

    def __enter__(self) -> Session:
        """Start the master and register this process with it."""
        port = _free_port()
        self._directory = Path(tempfile.mkdtemp(prefix="dyknow-benchmark-"))
        self._environment = {
            "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(self._directory),
            "ROS_LOG_DIR": str(self._directory / "log"),
        }
        os.environ.pop("ROS_HOSTNAME", None)
        os.environ.pop("ROS_NAMESPACE", None)
        os.environ.update(self._environment)
        try:
            self.start(["rosmaster", "--core", "-p", str(port)])
            wait_until(lambda: bool(rosgraph.is_master_online()), "the ROS master to come up")
            rospy.init_node("benchmark", disable_signals=True)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        """End this node and all processes."""
        rospy.signal_shutdown("the measurement is over")
        self.close()

    def start(self, command: Sequence[str]) -> subprocess.Popen[bytes]:
        """Start a process; what it prints goes into a file beside the logs."""
        name = f"{len(self._processes):03}-{Path(command[0]).name}"
        with (self._directory / f"{name}.txt").open("wb") as output:
            process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C is for us; we end them
            )
        self._processes.append(process)
        self._names[process.pid] = " ".join(command)
        return process

    @property
    def pids(self) -> Sequence[int]:
        """Process ids of what was started, in that order."""
        return [process.pid for process in self._processes]

    def check(self) -> None:
        """Raise if a process has ended by itself."""
        for process in self._processes:
            if process.poll() is not None:
                raise MeasurementFailed(
                    f"process {process.pid} ({self._names[process.pid]}) ended with exit code "
                    f"{process.returncode}:\n{self._printed()}"
                )

    def close(self) -> None:
        """End all processes, the newest first, and remove what they wrote."""
        processes, self._processes = self._processes[::-1], []
        _end(processes)
        shutil.rmtree(self._directory, ignore_errors=True)

    def _printed(self) -> str:
        texts = [each.read_text(errors="replace") for each in self._directory.glob("*.txt")]
        return "\n".join(text.strip() for text in texts if text.strip())[-4000:]


def executable(package: str, name: str) -> str:
    """Path of a program of a ROS package.

    Raises:
        MeasurementFailed: it is not there.
    """
    found = roslib.packages.find_node(package, name)
    if not found:
        raise MeasurementFailed(f"package '{package}' has no program '{name}': is it built?")
    return str(found[0])


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

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _end(processes: Sequence[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
    end = time.monotonic() + END_PATIENCE
    for process in processes:
        try:
            process.wait(max(0.1, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
