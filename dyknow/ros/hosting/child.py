# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""One child process, as the manager's node knows it and asks it."""

from __future__ import annotations

import signal
import sys
import threading
from dataclasses import replace

import rosgraph.network

from dyknow.errors import HostError, HostTimeout, PeerTimeout
from dyknow.manager.host import ProcessState
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.peer import ListClient, Peer, Presence
from dyknow.ros.process.os_process import LogTail, ProcessId, boot

#: Seconds that a child may take to offer its services.
START_TIMEOUT = 20.0
#: Seconds that a child has to end after a signal.
PATIENCE = 3.0
NOT_UP = "it is not up"


class Child(Peer):
    """One nodelet manager or node that we start; its loop (in `Children`) alone writes.

    Attributes:
        record: its record on disk.
        adopted: whether an earlier manager started its process.
        wanted: whether it is to be started again when it dies.
        gone: set when its name is free again.
        stale: address of a dead predecessor at the master; empty if there is none.
        log: its output.
        command: program and arguments of a node; empty for a nodelet manager.
        start_timeout: seconds that it may take to offer its services.
    """

    def __init__(
        self,
        context: PeerContext,
        record: ChildRecord,
        adopted: bool = False,
        command: tuple[str, ...] = (),
        start_timeout: float = START_TIMEOUT,
    ) -> None:
        here = rosgraph.network.get_host_name()
        self._down = ProcessState(
            record.name, record.kind, isolated_for=record.isolated_for, host=here
        )
        presence = Presence(self._down, NOT_UP)
        super().__init__(context, record.name, record.kind.is_node, presence)
        self.record = record
        self.adopted = adopted
        self.wanted = True
        self.gone = threading.Event()
        self.stale = ""
        self.log: LogTail | None = None
        self.command = command
        self.start_timeout = start_timeout

    @property
    def up(self) -> bool:
        """Whether it offers its services."""
        return self.state.alive

    def came_up(self, process: ProcessId, rewirable: bool) -> None:
        """Note that a process of its own offers its services."""
        again = "" if self.is_node else ", and it is started again with its nodelets"
        cure = (
            f"if its process is stopped, kill -CONT {process.pid}; if it hangs, "
            f"kill -9 {process.pid}{again}"
        )
        self._down = replace(self._down, rewirable=rewirable)
        up = replace(self._down, incarnation=incarnation_of(process), cure=cure)
        self._found(Presence(up))

    def went_down(self, trouble: str = "") -> None:
        """Note that it offers no services, as it has ended or is to end."""
        self._found(Presence(self._down, trouble or self.presence.trouble or NOT_UP))

    def echo(self) -> None:
        """Print its output since the last call."""
        if self.log is not None:
            self.log.copy(sys.stdout)

    def end(self) -> None:
        """End its process; nodes take leave of the master on SIGINT, as roslaunch sends it."""
        signals = (signal.SIGINT, signal.SIGTERM) if self.is_node else (signal.SIGTERM,)
        if self.record.process is not None:
            self.record.process.end(PATIENCE, signals)

    def _missed(self, client: ListClient, error: HostError | PeerTimeout) -> None:
        is_late = isinstance(error, PeerTimeout)
        with self._state_lock:
            if client is self._client and is_late:
                state = replace(self.presence.state, responsive=False)
                self.presence = replace(self.presence, state=state)
        raise (HostTimeout if is_late else HostError)(f"{self.name}: {error}") from error


def incarnation_of(process: ProcessId) -> str:
    """Return a text that differs for each process, also of other boots."""
    return f"{boot()[:8]}/{process.pid}@{process.started}"
