# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The life of one child process: it comes up, dies, is started again, and ends for good."""

from __future__ import annotations

import logging
import signal
import sys
import threading
import time
from dataclasses import replace
from typing import Callable, List, Optional, Tuple

import rosgraph.network

from dyknow.backoff import Backoff
from dyknow.errors import HostError, PeerTimeout
from dyknow.manager.host import Crash, ProcessState
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.hosting.peer import ListClient, NodeletPeer, host_errors
from dyknow.ros.process.os_process import LogTail, ProcessId, boot

#: Seconds that a child may take to offer its services.
START_TIMEOUT = 20.0
#: Seconds that a child has to end after a signal.
PATIENCE = 3.0
#: Seconds before a nodelet manager that died twice is started again.
_FIRST_PAUSE = 0.25
_STEP = 0.02

_log = logging.getLogger("rosout.dyknow")


class Child(NodeletPeer):
    """One nodelet manager or node that we start; its own thread alone writes.

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
        command: Tuple[str, ...] = (),
        start_timeout: float = START_TIMEOUT,
    ) -> None:
        """Prepare; ``ChildKeeper`` runs it."""
        super().__init__(context, record.name)
        self.record = record
        self.adopted = adopted
        self.up = False
        self.wanted = True
        self.gone = threading.Event()
        self.trouble = ""
        self.stale = ""
        self.log: Optional[LogTail] = None
        self.rewirable = True
        self.command = command
        self.start_timeout = start_timeout
        self._lists: Tuple[str, Optional[ListClient]] = ("", None)  # of one incarnation

    @property
    def title(self) -> str:
        """Its sort and name."""
        what = "node" if self.record.kind.is_node else "nodelet manager"
        return f"{what} {self.name}"

    @property
    def incarnation(self) -> str:
        """Differs for each process, also of other boots; empty while none is up."""
        found = self.record.process
        return incarnation_of(found) if found is not None and self.up else ""

    @property
    def responsive(self) -> bool:
        """False if its present process did not answer the last request."""
        of, client = self._lists
        return client is None or of != self.incarnation or client.answers

    @property
    def state(self) -> ProcessState:
        """Its present state, without a request."""
        return ProcessState(
            self.name,
            self.record.kind,
            self.incarnation,
            self.record.isolated_for,
            responsive=self.responsive,
            rewirable=self.rewirable,
            host=rosgraph.network.get_host_name(),
            cure=self._cure,
        )

    def list(self, incarnation: str = "") -> List[str]:
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
        """Close the connections; its process runs on."""
        super().close()
        client = self._lists[1]
        if client is not None:
            client.close()

    @property
    def _cure(self) -> str:
        """Say what to do about it if it does not answer."""
        process = self.record.process
        if process is None:
            return ""
        text = f"if its process is stopped, kill -CONT {process.pid}; if it hangs, kill -9 "
        again = "" if self.record.kind.is_node else ", and it is started again with its nodelets"
        return f"{text}{process.pid}{again}"


def incarnation_of(process: ProcessId) -> str:
    """Return a text that differs for each process, also of other boots."""
    return f"{boot()[:8]}/{process.pid}@{process.started}"


class ChildKeeper:
    """Keeps children, each by a call of ``keep`` on a thread of its own."""

    def __init__(
        self,
        launcher: Launcher,
        changed: threading.Condition,
        on_process: Callable[[], None],
        on_crash: Callable[[Crash], None],
    ) -> None:
        """Keep none yet.

        Args:
            launcher: starts processes.
            changed: held while a child is changed, and notified of it.
            on_process: called before a child gets a process, and when it has it.
            on_crash: called with a crash before its child is shown as dead.
        """
        self._launcher = launcher
        self._changed = changed
        self._on_process = on_process
        self._on_crash = on_crash

    def keep(self, child: Child) -> None:
        """Run a child, and start it again when it dies, until it is not wanted any more."""
        deaths = Backoff(time.monotonic, _FIRST_PAUSE, tolerated=2)
        while child.wanted:
            begin = time.monotonic()
            try:
                self._live(child)
            except (OSError, HostError, PeerTimeout, LookupError) as error:
                child.trouble = str(error)
                _log.error("%s: %s", child.title, error)
            except Exception as error:  # the boundary of the thread: the next start may succeed
                child.trouble = str(error)
                _log.exception("%s", child.title)
            if not child.wanted:
                break
            deaths.served(child.name, time.monotonic() - begin)
            deaths.failed(child.name)
            pause = deaths.remaining(child.name)
            with self._changed:
                self._changed.wait_for(lambda: not child.wanted, pause)
        self._launcher.clean_up(child.record)

    def _live(self, child: Child) -> None:
        try:
            if child.record.process is None:
                self._launch(child)
            found = child.record.process
            assert found is not None
            self._follow_until_up(child, found)
            if not child.wanted:
                child.end()
            status = found.wait_for_rest()
            if child.wanted:
                _log.warning("%s (process %d) has died", child.title, found.pid)
                crash = self._launcher.examine(child.record.kind, child.name, found.pid, status)
                if crash is not None:
                    self._on_crash(replace(crash, incarnation=incarnation_of(found)))
        finally:
            with self._changed:
                child.up, child.adopted = False, False
                child.wanted &= not child.record.isolated_for  # that one is not started again
                child.record = replace(child.record, process=None)
                self._changed.notify_all()
        child.echo()
        child.context.on_change()

    def _launch(self, child: Child) -> None:
        if self._launcher.living(child.name) is not None:
            raise HostError("another node has that name")
        child.stale = self._launcher.registered(child.name)
        self._on_process()  # on disk before it is there: nothing of it is left if we are killed
        found, child.log = self._launcher.launch(child.record, child.command)
        with self._changed:
            child.record = replace(child.record, process=found)
        self._on_process()

    def _follow_until_up(self, child: Child, found: ProcessId) -> None:
        """Wait until its services are offered; end a process that is late and lost."""
        if child.adopted:
            child.log = self._launcher.follow(child.name)
        deadline = time.monotonic() + child.start_timeout
        kind = child.record.kind
        while not self._launcher.address(kind, child.name, child.stale):
            if not found.alive or not child.wanted:
                child.trouble = "it ended at its start"
                return
            if time.monotonic() > deadline and self._is_lost(child):
                child.end()
                what = "offered no ports" if kind.is_node else "not come up"
                raise HostError(f"it has {what} within {child.start_timeout:g} s")
            time.sleep(_STEP)
        rewirable = self._launcher.is_rewirable(kind, child.name)
        with self._changed:
            child.rewirable = rewirable
            child.up = child.wanted
            self._changed.notify_all()
        child.context.on_change()

    def _is_lost(self, child: Child) -> bool:
        """Whether a process that is late will never come up.

        An adopted one may be suspended, and go on later. One that the master does not know belongs
        to an earlier master, and is lost.
        """
        try:
            return not child.adopted or not self._launcher.registered(child.name)
        except PeerTimeout:
            return False
