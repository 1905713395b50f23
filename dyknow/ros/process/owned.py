# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Processes that end with their owner, a ROS master on a free port among them."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Callable, Mapping, Sequence, TypeVar

import psutil
import rosgraph

from dyknow.errors import DyKnowError

ProcessesType = TypeVar("ProcessesType", bound="Processes")

#: Seconds for a process to be ready, and to end after each signal.
START_TIMEOUT = 120.0
END_TIMEOUT = 5.0
#: Seconds between two looks.
_GLANCE = 0.02
#: Lines of a process's output that are shown.
_LINES = 30


class ProcessFailed(DyKnowError):
    """A process ended by itself, or was not ready in time."""


class Processes:
    """Child processes whose output goes to files of a temporary folder.

    At the end of a ``with`` block all of them are ended, the first one last, and the folder is
    removed; SIGINT and SIGTERM are ignored meanwhile.

    Attributes:
        folder: the temporary folder.
        started: the processes, in the order of their start.
    """

    def __init__(self, name: str) -> None:
        """Own nothing yet; the folder's name begins with ``name``."""
        self._temporary = tempfile.TemporaryDirectory(prefix=f"{name}_")
        self.folder = Path(self._temporary.name)
        self.started: list[psutil.Popen] = []
        self._titles: list[str] = []

    def __enter__(self: ProcessesType) -> ProcessesType:
        return self

    def __exit__(self, *error: object) -> None:
        signals = (signal.SIGINT, signal.SIGTERM)
        handlers = [signal.signal(number, signal.SIG_IGN) for number in signals]
        try:
            self.close()
        finally:
            for number, handler in zip(signals, handlers):
                signal.signal(number, handler)

    def close(self) -> None:
        """End all processes: by SIGINT, then SIGTERM, then SIGKILL."""
        for some in (self.started[:0:-1], self.started[:1]):
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
                running = [each for each in some if each.poll() is None]
                for process in running:
                    process.send_signal(number)
                psutil.wait_procs(running, END_TIMEOUT)
        self._temporary.cleanup()

    def start_master(self) -> str:
        """Start a ROS master on the loopback interface, and use it from now on.

        Returns:
            Its URI.
        """
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        uri = f"http://127.0.0.1:{port}"
        os.environ.pop("ROS_HOSTNAME", None)
        os.environ.update(ROS_MASTER_URI=uri, ROS_IP="127.0.0.1")
        self.start(
            "the ROS master",
            ["rosmaster", "--core", "-p", str(port)],
            ready=lambda: bool(rosgraph.is_master_online()),
        )
        return uri

    def start(
        self,
        title: str,
        command: Sequence[str],
        environment: Mapping[str, str] = {},
        ready: Callable[[], bool] = lambda: True,
    ) -> psutil.Popen:
        """Start a process and wait until it is ready.

        Raises:
            ProcessFailed: it ended, or was not ready in time.
        """
        with self._log(len(self.started)).open("wb") as output:
            process = psutil.Popen(
                list(command),
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C reaches the owner alone
            )
        self.started.append(process)
        self._titles.append(title)
        deadline = time.monotonic() + START_TIMEOUT
        while not ready():
            self.check()
            if time.monotonic() > deadline:
                self._fail(len(self.started) - 1, f"was not ready after {START_TIMEOUT:g} s")
            time.sleep(_GLANCE)
        return process

    def check(self, patience: float = 0.0) -> None:
        """Make sure that all still run.

        Args:
            patience: seconds for each to end, where an error suggests that one does.

        Raises:
            ProcessFailed: one has ended.
        """
        for number, process in enumerate(self.started):
            try:
                code = process.wait(patience)
            except psutil.TimeoutExpired:
                continue
            self._fail(number, f"ended with exit code {code}")

    def output(self, number: int) -> str:
        """Return the output of a process so far."""
        return self._log(number).read_text(errors="replace")

    def _fail(self, number: int, reason: str) -> None:
        printed = "\n".join(self.output(number).splitlines()[-_LINES:]) or "(nothing)"
        raise ProcessFailed(f"{self._titles[number]} {reason}; the last it printed:\n{printed}")

    def _log(self, number: int) -> Path:
        return self.folder / f"{number}.log"
