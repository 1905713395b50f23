# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The life of one child process: it comes up, dies, is started again, and ends for good."""

from __future__ import annotations

import logging
import signal
import sys
import threading
import time
from dataclasses import dataclass, field, replace
from typing import Callable, Optional, Tuple

from dyknow.backoff import Backoff
from dyknow.errors import HostError, PeerTimeout
from dyknow.manager.host import Crash
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.log_tail import LogTail
from dyknow.ros.os_process import ProcessId, boot

#: Seconds that a child may take to offer its services.
START_TIMEOUT = 20.0
#: Seconds that a child has to end when it is asked to.
PATIENCE = 3.0
#: Seconds before a nodelet manager that died twice is started again.
_FIRST_PAUSE = 0.25
_STEP = 0.02

_log = logging.getLogger("rosout.dyknow")


@dataclass
class Child:
    """One nodelet manager or node; its thread writes, others read.

    Attributes:
        record: what is known of it on disk.
        adopted: whether an earlier manager started its process.
        up: whether it offers its services.
        wanted: whether it is to be started again when it dies.
        gone: set when its name is free again.
        trouble: why it did not come up; empty if it did.
        stale: address of a dead predecessor at the master; empty if there is none.
        log: what it prints.
        rewirable: whether what it hosts has ports that can be connected elsewhere.
        command: program and arguments of a node; empty for a nodelet manager.
        start_timeout: seconds that it may take to offer its services.
    """

    record: ChildRecord
    adopted: bool = False
    up: bool = False
    wanted: bool = True
    gone: threading.Event = field(default_factory=threading.Event)
    trouble: str = ""
    stale: str = ""
    log: Optional[LogTail] = None
    rewirable: bool = True
    command: Tuple[str, ...] = ()
    start_timeout: float = START_TIMEOUT

    @property
    def title(self) -> str:
        """What it is, with its name."""
        what = "node" if self.record.kind.is_node else "nodelet manager"
        return f"{what} {self.record.name}"

    @property
    def incarnation(self) -> str:
        """Differs for each process, also of other boots; empty while none is up."""
        found = self.record.process
        if found is None or not self.up:
            return ""
        return f"{boot()[:8]}/{found.pid}@{found.started}"

    def echo(self) -> None:
        """Print what it printed since the last call."""
        if self.log is not None:
            self.log.copy(sys.stdout)


class ChildKeeper:
    """Keeps children, each by a call of ``keep`` on a thread of its own."""

    def __init__(
        self,
        launcher: Launcher,
        changed: threading.Condition,
        on_process: Callable[[], None],
        on_change: Callable[[], None],
        on_crash: Callable[[Crash], None],
    ) -> None:
        """Keep none yet.

        Args:
            launcher: starts processes.
            changed: held while a child is changed, and notified of it.
            on_process: called before a child gets a process, and when it has it.
            on_change: called when a child is up or has ended.
            on_crash: called with a crash before its child is shown as dead.
        """
        self._launcher = launcher
        self._changed = changed
        self._on_process = on_process
        self._on_change = on_change
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
            deaths.served(child.record.name, time.monotonic() - begin)
            deaths.failed(child.record.name)
            pause = deaths.remaining(child.record.name)
            with self._changed:
                self._changed.wait_for(lambda: not child.wanted, pause)
        self._launcher.clean_up(child.record)

    def _live(self, child: Child) -> None:
        name = child.record.name
        try:
            if child.record.process is None:
                self._launch(child)
            found = child.record.process
            assert found is not None
            self._follow_until_up(child, found)
            if not child.wanted:
                end_process(child.record)
            status = found.wait_for_rest()
            if child.wanted:
                _log.warning("%s (process %d) has died", child.title, found.pid)
                crash = self._launcher.examine(child.record.kind, name, found.pid, status)
                if crash is not None:
                    self._on_crash(crash)
        finally:
            with self._changed:
                child.up, child.adopted = False, False
                child.wanted &= not child.record.isolated_for  # that one is not started again
                child.record = replace(child.record, process=None)
                self._changed.notify_all()
        child.echo()
        self._on_change()

    def _launch(self, child: Child) -> None:
        name = child.record.name
        if self._launcher.living(name) is not None:
            raise HostError("another node has that name")
        child.stale = self._launcher.registered(name)
        self._on_process()  # on disk before it is there: nothing of it is left if we are killed
        found, child.log = self._launcher.launch(child.record, child.command)
        with self._changed:
            child.record = replace(child.record, process=found)
        self._on_process()

    def _follow_until_up(self, child: Child, found: ProcessId) -> None:
        """Wait until its services are offered; end a process that is late and lost."""
        name = child.record.name
        if child.adopted:
            child.log = self._launcher.follow(name)
        deadline = time.monotonic() + child.start_timeout
        kind = child.record.kind
        uri = self._launcher.address(kind, name, child.stale)
        while not uri:
            if not found.alive or not child.wanted:
                child.trouble = "it ended at its start"
                return
            if time.monotonic() > deadline and self._is_lost(child):
                end_process(child.record)
                what = "offered no ports" if kind.is_node else "not come up"
                raise HostError(f"it has {what} within {child.start_timeout:g} s")
            time.sleep(_STEP)
            uri = self._launcher.address(kind, name, child.stale)
        rewirable = self._launcher.is_rewirable(kind, name)
        with self._changed:
            child.rewirable = rewirable
            child.up = child.wanted
            self._changed.notify_all()
        self._on_change()

    def _is_lost(self, child: Child) -> bool:
        """Whether a process that is late will never come up.

        An adopted one may be suspended, and go on later. One that the master does not know belongs
        to an earlier master, and is lost.
        """
        try:
            return not child.adopted or not self._launcher.registered(child.record.name)
        except PeerTimeout:
            return False


def end_process(record: ChildRecord) -> None:
    """End a process; nodes take leave of the master on SIGINT, as roslaunch sends it."""
    signals = (signal.SIGINT, signal.SIGTERM) if record.kind.is_node else (signal.SIGTERM,)
    if record.process is not None:
        record.process.end(PATIENCE, signals)
