"""Processes of this machine, known for certain: by their id and the moment of their start.

An id alone may belong to somebody else by now. The end of a process is noticed at once, whether
it is a child of this process or was started in an earlier life of it.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import time
from dataclasses import dataclass
from typing import Optional, Sequence

#: Seconds between two looks, where the kernel cannot tell of the end of a process.
_PERIOD = 0.1


@dataclass(frozen=True)
class ProcessId:
    """One process.

    Attributes:
        pid: its id.
        started: clock ticks between the start of the machine and its own.
    """

    pid: int
    started: int

    @classmethod
    def of(cls, pid: int) -> Optional[ProcessId]:
        """Look a process up; None if there is none, or only the memory of one."""
        try:
            with open(f"/proc/{pid}/stat", "rb") as file:
                # The second field is the program's name, in brackets, with anything in it.
                fields = file.read().rpartition(b")")[2].split()
        except OSError:
            return None
        return None if fields[0] in (b"Z", b"X") else cls(pid, int(fields[19]))

    @property
    def alive(self) -> bool:
        """Whether it still runs; a stopped process does."""
        return ProcessId.of(self.pid) == self

    def signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.alive:
            try:
                os.kill(self.pid, number)
            except ProcessLookupError:
                return

    def wait(self, timeout: Optional[float] = None) -> bool:
        """Wait for its end.

        Args:
            timeout: seconds; None waits as long as it takes.

        Returns:
            Whether it has ended.
        """
        _reap(self.pid)
        descriptor = _pidfd(self.pid)
        if descriptor is None:
            return self._poll(timeout)
        try:
            if self.alive:
                poll = select.poll()
                poll.register(descriptor, select.POLLIN)
                poll.poll(None if timeout is None else max(0.0, timeout) * 1000)
        finally:
            os.close(descriptor)
        _reap(self.pid)
        return not self.alive

    def end(self, patience: float) -> None:
        """End it: ask it first, and force it when it has not ended after ``patience`` seconds."""
        self.signal(signal.SIGTERM)
        if not self.wait(patience):
            self.signal(signal.SIGKILL)
            self.wait()

    def _poll(self, timeout: Optional[float]) -> bool:
        deadline = None if timeout is None else time.monotonic() + timeout
        while self.alive:
            if deadline is not None and time.monotonic() >= deadline:
                return False
            time.sleep(_PERIOD)
            _reap(self.pid)
        return True


def start(command: Sequence[str], output: str, folder: str) -> ProcessId:
    """Start a process in a session of its own, so that it may outlive this one.

    Args:
        command: program and arguments.
        output: file that gets what it prints. It is not given our own output: who waits for
            the end of that would wait for a process that is meant to go on.
        folder: working directory, made if need be.

    Raises:
        OSError: it cannot be started.
    """
    os.makedirs(folder, exist_ok=True)
    with open(output, "wb") as file:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            cwd=folder,
        )
    process.returncode = 0  # who waits for it is ``ProcessId.wait``
    found = ProcessId.of(process.pid)
    return found if found is not None else ProcessId(process.pid, -1)


def _pidfd(pid: int) -> Optional[int]:
    try:
        return int(getattr(os, "pidfd_open")(pid))  # noqa: B009
    except (AttributeError, OSError):  # before Python 3.9, or no such process
        return None


def _reap(pid: int) -> None:
    try:
        os.waitpid(pid, os.WNOHANG)
    except ChildProcessError:
        return  # not a child of this process
