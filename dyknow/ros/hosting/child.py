# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""One child process, as the manager's node knows it and asks it."""

from __future__ import annotations

import builtins
import signal
import sys
import threading

import rosgraph.network

from dyknow.errors import HostError
from dyknow.manager.host import ProcessState
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.peer import ListClient, NodeletPeer, host_errors
from dyknow.ros.process.os_process import LogTail, ProcessId, boot

#: Seconds that a child may take to offer its services.
START_TIMEOUT = 20.0
#: Seconds that a child has to end after a signal.
PATIENCE = 3.0


class Child(NodeletPeer):
    """One nodelet manager or node that we start; its own thread (in `Children`) alone writes.

    Attributes:
        record: its record on disk.
        adopted: whether an earlier manager started its process.
        up: whether it offers its services.
        wanted: whether it is to be started again when it dies.
        gone: set when its name is free again.
        trouble: why it did not come up; empty if it did.
        stale: address of a dead predecessor at the master; empty if there is none.
        log: its output.
        rewirable: whether its nodelets have live ports.
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
        super().__init__(context, record.name)
        self.record = record
        self.adopted = adopted
        self.up = False
        self.wanted = True
        self.gone = threading.Event()
        self.trouble = ""
        self.stale = ""
        self.log: LogTail | None = None
        self.rewirable = True
        self.command = command
        self.start_timeout = start_timeout
        self._lists: tuple[str, ListClient | None] = ("", None)  # of one incarnation

    @property
    def title(self) -> str:
        """Its sort and name."""
        return f"{'node' if self.record.kind.is_node else 'nodelet manager'} {self.name}"

    @property
    def incarnation(self) -> str:
        """Differs for each process, also of other boots; empty while none is up."""
        found = self.record.process
        return incarnation_of(found) if found is not None and self.up else ""

    @property
    def state(self) -> ProcessState:
        incarnation = self.incarnation
        asked, client = self._lists
        return ProcessState(
            self.name,
            self.record.kind,
            incarnation,
            self.record.isolated_for,
            responsive=client is None or asked != incarnation or client.answers,
            rewirable=self.rewirable,
            host=rosgraph.network.get_host_name(),
            cure=self._cure,
        )

    def list(self, incarnation: str = "") -> builtins.list[str]:
        """Ask for its nodelets, over a connection that is kept for as long as its process runs."""
        current = self.incarnation
        if not current:
            raise HostError(f"nodelet manager '{self.name}' is not running")
        asked, client = self._lists
        if client is None or asked != current:
            if client is not None:
                client.close()
            client = ListClient(self.context.master, self.name, is_node=self.record.kind.is_node)
            self._lists = current, client
        with host_errors(self.name):
            return client.list()

    def echo(self) -> None:
        """Print its output since the last call."""
        if self.log is not None:
            self.log.copy(sys.stdout)

    def end(self) -> None:
        """End its process; nodes take leave of the master on SIGINT, as roslaunch sends it."""
        is_node = self.record.kind.is_node
        signals = (signal.SIGINT, signal.SIGTERM) if is_node else (signal.SIGTERM,)
        if self.record.process is not None:
            self.record.process.end(PATIENCE, signals)

    def close(self) -> None:
        super().close()
        client = self._lists[1]
        if client is not None:
            client.close()

    @property
    def _cure(self) -> str:
        """Advice for users if it does not answer."""
        process = self.record.process
        if process is None:
            return ""
        again = "" if self.record.kind.is_node else ", and it is started again with its nodelets"
        return (
            f"if its process is stopped, kill -CONT {process.pid}; if it hangs, "
            f"kill -9 {process.pid}{again}"
        )


def incarnation_of(process: ProcessId) -> str:
    """Return a text that differs for each process, also of other boots."""
    return f"{boot()[:8]}/{process.pid}@{process.started}"
