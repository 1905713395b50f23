# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers that the DyKnow manager did not start, on any host of the ROS graph.

Who owns what: an ``ExternalManager`` owns what is known of one nodelet manager, and a thread that
finds it out. While the nodelet manager answers, each caller asks it directly over a kept
connection. The first caller without an answer marks it as unresponsive; from then on every call
fails at once and only the thread goes on asking, so no call waits for a host that is away.

The ROS master decides which process bears a name. When another process registers under the name
while the host of the first is away, the master cannot tell the first to end. The thread does so as
soon as it can be reached.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, replace
from typing import Dict, FrozenSet, Iterable, List, Optional

from dyknow_msgs.srv import GetCounts

from dyknow import names
from dyknow.backoff import Backoff
from dyknow.errors import HostError, HostTimeout, PeerTimeout
from dyknow.locks import state_lock
from dyknow.manager.host import ManagerState
from dyknow.model.graph import NodeletKind
from dyknow.periodic import PeriodicWorker
from dyknow.ros.addresses import host_of
from dyknow.ros.hosting.count_collector import SERVICE as COUNTS
from dyknow.ros.hosting.list_client import TIMEOUT, ListClient
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient, ServiceFailed, ServiceLost

#: Seconds for a new connection and the first answer over it, on a slow link.
FIND_TIMEOUT = 3.0
#: Seconds between two looks at one that cannot be asked, doubling up to the longest.
FIRST_PAUSE = 0.25
LONGEST_PAUSE = 2.0
#: Seconds between two looks at one that answers: does it still bear its name?
PERIOD = 1.0

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class Process:
    """The process that bears the name of a nodelet manager.

    Attributes:
        uri: address of its node.
        pid: its process id.
        kind: what it hosts; None for a stock C++ nodelet manager, whose nodelets have no ports.
    """

    uri: str
    pid: int
    kind: Optional[NodeletKind]

    @property
    def incarnation(self) -> str:
        """Differs for every process."""
        return f"{self.uri}@{self.pid}"


@dataclass(frozen=True)
class Presence:
    """What is known of a nodelet manager.

    Attributes:
        process: the last that answered; None if it has ended, or none has answered yet.
        trouble: why it cannot be asked; empty if it can.
        away: whether the trouble is that it did not answer: it may run all the same.
        nodelets: what it ran when it was asked last.
        unseen: whether the first look at it is not over yet.
    """

    process: Optional[Process] = None
    trouble: str = "it has not answered yet"
    away: bool = True
    nodelets: FrozenSet[str] = frozenset()
    unseen: bool = True


class ExternalManager:
    """One nodelet manager of others; every method is safe from any thread."""

    def __init__(self, master: Master, name: str) -> None:
        """Begin to look for it."""
        self.name = name
        self._master = master
        self._state_lock = state_lock("external manager")
        self._presence = Presence()
        self._client = ListClient(master, name)
        #: Processes that bore the name before and have not been told yet that they lost it.
        self.displaced: List[Process] = []
        self._backoff = Backoff(time.monotonic, FIRST_PAUSE, LONGEST_PAUSE, tolerated=0)
        self._period = 0.0
        self._worker = PeriodicWorker(
            f"looking for nodelet manager {name}", self._look, lambda: self._period, pause=0.0
        )
        self._worker.start()

    @property
    def presence(self) -> Presence:
        """What is known of it now."""
        return self._presence

    @property
    def state(self) -> ManagerState:
        """What is known of it now, as the manager sees it."""
        known = self._presence
        kind = known.process.kind if known.process is not None else NodeletKind.PYTHON
        return ManagerState(
            self.name,
            kind or NodeletKind.CPP,
            known.process.incarnation if known.process is not None else "",
            own=False,
            responsive=not known.trouble,
            away=known.away,
            unseen=known.unseen,
            rewirable=kind is not None,
            host=host_of(known.process.uri) if known.process is not None else "",
        )

    def check(self) -> None:
        """Refuse to ask one that cannot be asked.

        Raises:
            HostTimeout: it did not answer when it was asked last.
            HostError: it is not there.
        """
        self._refuse_if_missed(self._presence)

    def list(self, incarnation: str = "") -> List[str]:
        """Ask what it runs, if it answers at all.

        Args:
            incarnation: process that is meant; empty for any.

        Raises:
            HostTimeout: it does not answer, or did not when it was asked last.
            HostError: it is not there.
        """
        while True:
            with self._state_lock:
                client, known = self._client, self._presence
            self._refuse_if_missed(known)
            assert known.process is not None
            if incarnation not in ("", known.process.incarnation):
                raise HostError(f"nodelet manager '{self.name}' is another process by now")
            try:
                names = client.list()
            except (HostError, PeerTimeout) as error:
                self._miss(client, error)
                self._worker.wake()
                continue  # now there is a new connection, or trouble
            with self._state_lock:
                if client is self._client:
                    self._presence = replace(self._presence, nodelets=frozenset(names))
            return names

    def look_now(self, timeout: float = FIND_TIMEOUT) -> None:
        """Wait for a look that begins now, if the last one did not find it.

        One that does not answer is not waited for.

        Args:
            timeout: seconds to wait at most.
        """
        known = self._presence
        if known.unseen or (known.trouble and not known.away):
            self._worker.wait_for(self._worker.wake(), timeout)

    def forget(self, nodelet: str) -> None:
        """Note that a nodelet which it ran is loaded elsewhere now."""
        with self._state_lock:
            nodelets = self._presence.nodelets - {nodelet}
            self._presence = replace(self._presence, nodelets=nodelets)

    def look(self) -> None:
        """Find out whether it is there, and which process it is."""
        try:
            uri = self._master.node(self.name)
        except PeerTimeout as error:
            if self._presence.trouble:
                self._miss(self._client, error)
            return  # a master that is away says nothing of the nodelet manager
        known = self._presence
        if not uri:
            self._miss(self._client, NotRunning("it is not running"))
        elif known.trouble or known.process is None or known.process.uri != uri:
            self._find(uri)
        if not self._presence.trouble:
            self.displaced = [each for each in self.displaced if not self._end(each)]

    def close(self) -> None:
        """Look for it no more."""
        self._worker.close()
        self._client.close()

    # Inside

    def _look(self) -> None:
        self.look()
        if self._presence.trouble or self.displaced:
            self._backoff.failed(self.name)
            self._period = self._backoff.remaining(self.name)
        else:
            self._backoff.forgive(self.name)
            self._period = PERIOD

    def _refuse_if_missed(self, known: Presence) -> None:
        if known.trouble:
            text = f"nodelet manager '{self.name}': {known.trouble}"
            raise HostTimeout(text) if known.away else HostError(text)

    def _miss(self, client: ListClient, trouble: Exception) -> None:
        """Note that it cannot be asked, unless it was found again meanwhile."""
        away = may_be_there(trouble)
        with self._state_lock:
            if client is not self._client:
                return
            known = self._presence
            process = known.process if away else None
            self._presence = Presence(process, str(trouble), away, known.nodelets, unseen=False)
        if not known.trouble or known.unseen or known.away != away:
            _log.warning("nodelet manager %s cannot be asked: %s", self.name, trouble)

    def _find(self, uri: str) -> None:
        client = ListClient(self._master, self.name, reconnects=False)
        try:
            pid = self._master.pid(self.name, uri, TIMEOUT)
            nodelets = frozenset(client.list(FIND_TIMEOUT))
            found = Process(uri, pid, self._kind())
        except (HostError, PeerTimeout, LookupError) as error:
            client.close()
            self._miss(self._client, error)
            return
        with self._state_lock:
            before, old, self._client = self._presence, self._client, client
            self._presence = Presence(found, "", False, nodelets, unseen=False)
        old.close()
        if before.process is not None and before.process.uri != uri:
            self.displaced.append(before.process)
        _log.info("nodelet manager %s is there (%s)", self.name, found.incarnation)

    def _kind(self) -> Optional[NodeletKind]:
        client = ServiceClient(self._master, names.join(self.name, COUNTS), GetCounts)
        try:
            kind = client.call(TIMEOUT, [self.name]).kind
        except (ServiceFailed, ServiceLost):
            return None
        return NodeletKind.PYTHON if kind == NodeletKind.PYTHON.value else NodeletKind.CPP

    def _end(self, displaced: Process) -> bool:
        """Tell a process to end whose name another one bears now; returns whether it knows."""
        reason = f"another node bears the name {self.name}"
        try:
            if self._master.pid(self.name, displaced.uri, TIMEOUT) == displaced.pid:
                self._master.shut_down(self.name, displaced.uri, reason, TIMEOUT)
        except PeerTimeout as error:
            return not may_be_there(error)
        except LookupError:
            return True
        return True


class NotRunning(HostError):
    """The master has no node of that name."""


def may_be_there(trouble: BaseException) -> bool:
    """Whether the host did not answer at all, so that the process may run all the same."""
    answers = (ConnectionRefusedError, ConnectionResetError, LookupError, NotRunning)
    return not isinstance(trouble, answers) and not isinstance(trouble.__cause__, answers)


class ExternalManagers:
    """All nodelet managers of others."""

    def __init__(self, master: Master, names: Iterable[str]) -> None:
        """Begin to look for all of them, side by side."""
        self._managers: Dict[str, ExternalManager] = {
            name: ExternalManager(master, name) for name in sorted(set(names))
        }

    def all(self) -> List[ExternalManager]:
        """Return all of them, by name."""
        return list(self._managers.values())

    def find(self, name: str) -> Optional[ExternalManager]:
        """Return the one of that name, if there is one."""
        return self._managers.get(name)

    def hosting(self, nodelet: str) -> Optional[ExternalManager]:
        """Return the one that ran a nodelet when it was asked last, if there is one."""
        managers = self._managers.values()
        return next((each for each in managers if nodelet in each.presence.nodelets), None)

    def close(self) -> None:
        """Look for none of them any more."""
        for manager in self._managers.values():
            manager.close()
