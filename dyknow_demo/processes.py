# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The processes of the demonstrations: a roscore where there is none, and managers.

``Processes`` owns the processes that it started and ends exactly those, by process id, in reverse
order, however the demonstration ends.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Callable, Sequence

from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.ros.wire.master import Master

#: Names of the nodes that the demonstrations start.
NAMESPACE = "/dyknow_demo"
MANAGER = f"{NAMESPACE}/manager"

#: Seconds for a process to be up, and to end after each signal.
START_TIMEOUT = 20.0
END_TIMEOUT = 5.0

_LOOK = 0.05
_TAIL = 20


class ProcessFailed(DyKnowError):
    """A process of the demonstration ended by itself, or was not ready in time."""

    def __init__(self, what: str, reason: str, output: str) -> None:
        super().__init__(f"{what} {reason}; the last it printed:\n{output or '(nothing)'}")


class Processes:
    """Child processes with their output in files of a temporary folder."""

    def __init__(self) -> None:
        self._children: list[tuple[str, subprocess.Popen[bytes], Path]] = []
        self._folder = tempfile.TemporaryDirectory(prefix="dyknow_demo_")

    @property
    def folder(self) -> str:
        """A folder that is removed at the end."""
        return self._folder.name

    def __enter__(self) -> Processes:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # A second Ctrl-C must not leave processes behind.
        handlers = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
        for each in handlers:
            signal.signal(each, signal.SIG_IGN)
        try:
            for _, child, _ in reversed(self._children):
                _end(child)
            self._folder.cleanup()
        finally:
            for each, handler in handlers.items():
                signal.signal(each, handler)

    def start(
        self,
        what: str,
        command: Sequence[str],
        environment: dict[str, str],
        ready: Callable[[], bool],
    ) -> int:
        """Start a process, wait until it is ready, and return its id.

        Raises:
            ProcessFailed: it ended, or was not ready in time.
        """
        log = Path(self._folder.name) / f"{len(self._children)}.log"
        with log.open("wb") as output:
            child = subprocess.Popen(
                command,
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C reaches us alone; we end it in its turn
            )
        self._children.append((what, child, log))
        deadline = time.monotonic() + START_TIMEOUT
        while not ready():
            self.check()
            if time.monotonic() > deadline:
                raise ProcessFailed(what, f"was not ready after {START_TIMEOUT:.0f} s", _tail(log))
            time.sleep(_LOOK)
        return child.pid

    def check(self, patience: float = 0.0) -> None:
        """Make sure that all still run.

        Args:
            patience: seconds for each to end, where there is reason to think that one does.

        Raises:
            ProcessFailed: one has ended.
        """
        for what, child, log in self._children:
            try:
                code = child.wait(patience)
            except subprocess.TimeoutExpired:
                continue
            raise ProcessFailed(what, f"ended with exit code {code}", _tail(log))


def master_answers() -> bool:
    """Whether the master that the environment names answers."""
    try:
        Master(NAMESPACE, timeout=1.0).ask("getPid")
    except PeerTimeout:
        return False
    return True


def check_real_time() -> None:
    """Make sure that time is not simulated.

    Raises:
        DyKnowError: /use_sim_time is set.
    """
    master, name = Master(NAMESPACE), "/use_sim_time"
    if master.ask("hasParam", name) and master.ask("getParam", name):
        raise DyKnowError(f"{name} is set, but what the demonstration measures needs real time")


def forget_parameters() -> None:
    """Delete the parameters of the nodes that were started."""
    with contextlib.suppress(LookupError, PeerTimeout):
        Master(NAMESPACE).ask("deleteParam", NAMESPACE)


def find_master(processes: Processes) -> str:
    """Use the ROS master that is there, or start one; says which."""
    if master_answers():
        return f"the one at {Master(NAMESPACE).uri}"
    return f"our own, at {start_roscore(processes)}"


def start_roscore(processes: Processes) -> str:
    """Start a roscore on a free port of the loopback interface, and use it from now on.

    Returns:
        Its URI.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    uri = f"http://127.0.0.1:{port}"
    os.environ.pop("ROS_HOSTNAME", None)
    os.environ.update(ROS_MASTER_URI=uri, ROS_IP="127.0.0.1")
    processes.start("roscore", ["roscore", "-p", str(port)], {}, master_answers)
    return uri


def start_nodelet_manager(processes: Processes, ready: Callable[[], bool]) -> int:
    """Start a nodelet manager, ``MANAGER``, and return its process id."""
    return _start_node(processes, "the nodelet manager", ready, "dyknow.cli.nodelet", "manager")


def start_manager(processes: Processes, ready: Callable[[], bool], **parameters: Any) -> int:
    """Start a DyKnow manager, ``MANAGER``, and return its process id.

    Its durable state is forgotten with the folder of ``processes``.
    """
    given = {"state_dir": processes.folder, **parameters}
    arguments = [f"_{key}:={value}" for key, value in given.items()]
    return _start_node(processes, "the manager", ready, "dyknow.cli.manager", *arguments)


def _start_node(
    processes: Processes, what: str, ready: Callable[[], bool], module: str, *arguments: str
) -> int:
    name = MANAGER[len(NAMESPACE) + 1 :]
    command = [sys.executable, "-m", module, *arguments, f"__name:={name}"]
    return processes.start(what, command, {"ROS_NAMESPACE": NAMESPACE}, ready)


def _end(child: subprocess.Popen[bytes]) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        if child.poll() is not None:
            return
        child.send_signal(number)
        try:
            child.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            continue


def _tail(log: Path) -> str:
    return "\n".join(log.read_text(errors="replace").splitlines()[-_TAIL:])
