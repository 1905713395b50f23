# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""One child process, as the manager's node knows it and asks it."""

from __future__ import annotations

import logging
import signal
import sys
import threading
from dataclasses import replace
from typing import Callable

import rosgraph.network

from dyknow.errors import HostError, PeerTimeout
from dyknow.manager.host import ProcessState
from dyknow.periodic import Work
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.peer import FIND_TIMEOUT, POLL_TIMEOUT, Peer, Presence
from dyknow.ros.process.os_process import LogTail, ProcessId, boot
from dyknow.ros.wire.poll_client import PollClient
from dyknow.ros.wire.service_client import OTHER_VERSION

#: Seconds that a child may take to offer its services.
START_TIMEOUT = 20.0
#: Seconds that a child has to end after a signal.
PATIENCE = 3.0
#: Seconds between two looks at a process that starts.
STEP = 0.02
NOT_UP = "it is not up"

_log = logging.getLogger("rosout.dyknow")


class Child(Peer):
    """One nodelet manager or node that we start.

    A second key of its loop is the life of its process (in `Children`).

    Attributes:
        record: its record on disk.
        adopted: whether an earlier manager started its process.
        wanted: whether it is to be started again when it dies.
        is_renewed: whether its process is being ended for another one.
        gone: set when its name is free again.
        stale: address of a dead predecessor at the master; empty if there is none.
        log: its output.
        command: program and arguments of a node; empty for a nodelet manager.
        start_timeout: seconds that it may take to offer its services.
        on_up: called when it offers them.
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
        self.is_renewed = False
        self.gone = threading.Event()
        self.stale = ""
        self.log: LogTail | None = None
        self.command = command
        self.start_timeout = start_timeout
        self.on_up: Callable[[], object] = lambda: None

    @property
    def up(self) -> bool:
        """Whether it offers its services."""
        return self.state.alive

    def live(self, work: Work) -> None:
        """Do the work that starts its process, and waits for its end, in rounds from now on."""
        self._life = f"life of {self.name}"
        self.loop.add(self._life, work, 0.0, pause=0.0)

    def live_on(self) -> None:
        """Begin the next round of that work without a pause."""
        self.loop.wake(self._life)

    def end_soon(self) -> None:
        """Start it no more, and let the work of its life see that."""
        self.wanted = False
        self.live_on()
        self.went_down()

    def went_down(self, trouble: str = "") -> None:
        """Note that it offers no services, as it has ended or is to end."""
        self._let_go(None)
        with self._state_lock:
            self.presence = Presence(self._down, trouble or self.presence.trouble or NOT_UP)

    def echo(self) -> None:
        """Print its output since the last call."""
        if self.log is not None:
            self.log.copy(sys.stdout)

    def end(self) -> None:
        """End its process; nodes take leave of the master on SIGINT, as roslaunch sends it."""
        signals = (signal.SIGINT, signal.SIGTERM) if self.is_node else (signal.SIGTERM,)
        if self.record.process is not None:
            self.record.process.end(PATIENCE, signals)

    # Its polls

    def _find(self) -> None:
        """Connect to its process once that has registered, in the place of a dead predecessor."""
        process = self.record.process
        if process is None or not self.wanted or not self._is_registered():
            return
        again = "" if self.is_node else ", and it is started again with its nodelets"
        cure = (
            f"if its process is stopped, kill -CONT {process.pid}; if it hangs, "
            f"kill -9 {process.pid}{again}"
        )
        state = replace(self._down, incarnation=incarnation_of(process), cure=cure)
        client = PollClient(self.context.master, self.name, self.is_node)
        try:
            answer = client.ask(POLL_TIMEOUT if self.adopted else FIND_TIMEOUT)
        except (HostError, PeerTimeout) as error:
            client.close()
            self._not_found(state, error)
            return
        if self.is_node and self.name not in answer.nodelets:
            client.close()
            return  # it is about to offer its ports
        if client.is_stock and not self.up:
            _log.warning(
                "nodelets in %s cannot be connected while they run: their topics are fixed; its "
                "log says why, or it was built without roscpp",
                self.name,
            )
        self._down = replace(self._down, rewirable=not client.is_stock)
        self._found(replace(state, rewirable=not client.is_stock), client, answer)
        if self.record.process != process or not self.wanted:  # it has ended meanwhile
            self.went_down()
        self.on_up()

    def _is_registered(self) -> bool:
        try:
            return self.context.master.node(self.name) not in ("", self.stale)
        except PeerTimeout:
            return False

    def _not_found(self, state: ProcessState, error: HostError | PeerTimeout) -> None:
        if self.adopted and isinstance(error, PeerTimeout):  # it is there, and perhaps stopped
            with self._state_lock:
                trouble = str(error)
                self.presence = replace(
                    self.presence, state=replace(state, responsive=False), trouble=trouble
                )
            self.on_up()
        elif OTHER_VERSION in str(error):
            self.went_down(str(error))

    def _missed(self, client: PollClient, error: HostError | PeerTimeout) -> None:
        if not isinstance(error, PeerTimeout):  # of a late answer the connection waits
            self._let_go(None)
        with self._state_lock:
            known = self.presence
            if known.state.alive:
                state = replace(known.state, responsive=False)
                self.presence = replace(known, state=state, trouble=str(error))

    def _report(self, before: Presence) -> None:
        if self.state.alive and self.presence.trouble and not before.trouble:
            _log.warning("%s: %s", self.title, self.presence.trouble)
        super()._report(before)

    def _pause(self, began: float) -> float | None:
        is_starting = self.record.process is not None and not self.up and self.wanted
        return STEP if is_starting else super()._pause(began)


def incarnation_of(process: ProcessId) -> str:
    """Return a text that differs for each process, also of other boots."""
    return f"{boot()[:8]}/{process.pid}@{process.started}"
