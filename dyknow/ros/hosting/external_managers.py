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
import threading
from dataclasses import dataclass, replace
from typing import Dict, FrozenSet, Iterable, List, Optional

from nodelet.srv import NodeletList

from dyknow.errors import HostError, HostTimeout, PeerTimeout
from dyknow.manager.host import ManagerState, NodeletKind
from dyknow.periodic import attempt
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient

#: Seconds for an answer over a connection that is there.
TIMEOUT = 1.0
#: Seconds for a new connection and the first answer over it, on a slow link.
FIND_TIMEOUT = 3.0
#: Seconds until a peer that is not there is looked for again, doubling up to the longest.
FIRST_PAUSE = 0.25
LONGEST_PAUSE = 2.0
#: Seconds until the master is asked again whether a peer that answers still bears its name.
PERIOD = 1.0
_PYTHON_SIGN = "changes"

_log = logging.getLogger("rosout.dyknow")


class ListClient:
    """Asks one process of a nodelet manager what it runs, over a connection that is kept.

    When the connection breaks another process may have the name by now. Its list says nothing of
    the nodelets of this one, so it is not taken for an answer.
    """

    def __init__(self, master: Master, name: str, reconnects: bool = True) -> None:
        """Prepare; nothing is sent yet."""
        self._client = ServiceClient(
            master, f"{name}/list", NodeletList, persistent=True, reconnects=reconnects
        )
        self._address = ""
        #: Whether the last question was answered in time.
        self.answers = True

    def list(self, timeout: float = TIMEOUT) -> List[str]:
        """Ask.

        Raises:
            PeerTimeout: no answer in time.
            HostError: it is not there, or another process has its name.
        """
        try:
            names: List[str] = self._client.call(timeout).nodelets
        except PeerTimeout:
            self.answers = False
            raise
        self.answers = True
        self._address = self._address or self._client.address
        if self._client.address != self._address:
            self._client.close()
            raise HostError("another process has that name now")
        return sorted(names)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()


@dataclass(frozen=True)
class Process:
    """The process that bears the name of a peer.

    Attributes:
        uri: of its node.
        pid: its process id.
        kind: what it hosts.
    """

    uri: str
    pid: int
    kind: NodeletKind

    @property
    def incarnation(self) -> str:
        """Differs for every process."""
        return f"{self.uri}@{self.pid}"


@dataclass(frozen=True)
class Presence:
    """What is known of a peer.

    Attributes:
        process: the last that answered; None if it is known to have ended, or never answered.
        trouble: why it cannot be asked; empty if it can.
        away: whether the trouble is that it did not answer: it may be there all the same.
        nodelets: what it ran when it was asked last.
        unseen: whether the first look at it is not over yet.
    """

    process: Optional[Process] = None
    trouble: str = "it has not answered yet"
    away: bool = True
    nodelets: FrozenSet[str] = frozenset()
    unseen: bool = True


class ExternalManager:
    """One nodelet manager of others."""

    def __init__(self, master: Master, name: str) -> None:
        """Begin to look for it."""
        self.name = name
        self._master = master
        self._lock = threading.Condition()
        self._presence = Presence()
        self._client = ListClient(master, name)
        #: Processes that bore the name before, and are to be told that they lost it.
        self.displaced: List[Process] = []
        self._closed = False
        #: Looks that were begun, and ended; the one that is asked for is the last of `_wanted`.
        self._begun = self._ended = self._wanted = 0
        self._thread = threading.Thread(target=self._run, name=f"peer {name}", daemon=True)
        self._thread.start()

    @property
    def presence(self) -> Presence:
        """What is known of it now."""
        return self._presence

    @property
    def state(self) -> ManagerState:
        """What is known of it now, as the manager sees it."""
        known = self._presence
        return ManagerState(
            self.name,
            known.process.kind if known.process is not None else NodeletKind.PYTHON,
            known.process.incarnation if known.process is not None else "",
            own=False,
            responsive=not known.trouble,
            away=known.away,
            unseen=known.unseen,
        )

    def check(self) -> None:
        """Do nothing if it answers.

        Raises:
            HostTimeout: it did not when it was asked last.
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
            with self._lock:
                client, known = self._client, self._presence
            self._refuse_if_missed(known)
            assert known.process is not None
            if incarnation not in ("", known.process.incarnation):
                raise HostError(f"nodelet manager '{self.name}' is another process by now")
            try:
                names = client.list()
            except (HostError, PeerTimeout) as error:
                self._miss(client, error)
                continue  # it has a new connection, or trouble
            with self._lock:
                if client is self._client:
                    self._presence = replace(self._presence, nodelets=frozenset(names))
            return names

    def look_now(self, timeout: float = FIND_TIMEOUT) -> None:
        """Let one look be made that begins now, if it was not there at the last.

        One that does not answer is not waited for: it is looked for with pauses.
        """
        with self._lock:
            known = self._presence
            if known.unseen or (known.trouble and not known.away):
                wanted = self._wanted = self._begun + 1
                self._lock.notify_all()
                self._lock.wait_for(lambda: self._closed or self._ended >= wanted, timeout)

    def forget(self, nodelet: str) -> None:
        """Note that a nodelet which it ran is made elsewhere now."""
        with self._lock:
            nodelets = self._presence.nodelets - {nodelet}
            self._presence = replace(self._presence, nodelets=nodelets)

    def close(self) -> None:
        """Look for it no more."""
        with self._lock:
            self._closed = True
            self._lock.notify_all()
            client = self._client
        client.close()

    # Inside

    def _refuse_if_missed(self, known: Presence) -> None:
        if known.trouble:
            text = f"nodelet manager '{self.name}': {known.trouble}"
            raise HostTimeout(text) if known.away else HostError(text)

    def _miss(self, client: ListClient, trouble: Exception) -> None:
        """Note that it cannot be asked, unless it was found again meanwhile."""
        away = _may_be_there(trouble)
        with self._lock:
            if client is not self._client:
                return
            known = self._presence
            process = known.process if away else None
            self._presence = Presence(process, str(trouble), away, known.nodelets, unseen=False)
            self._lock.notify_all()
        if not known.trouble or known.unseen or known.away != away:
            _log.warning("nodelet manager %s cannot be asked: %s", self.name, trouble)

    def _run(self) -> None:
        pause = FIRST_PAUSE
        while True:
            with self._lock:
                self._begun += 1
            attempt(f"looking for nodelet manager {self.name}", self.look)
            with self._lock:
                self._ended = self._begun
                self._lock.notify_all()
                answers = not self._presence.trouble
                if answers and not self.displaced:
                    pause = FIRST_PAUSE
                    self._lock.wait_for(lambda: self._closed or self._presence.trouble, PERIOD)
                else:
                    self._lock.wait_for(lambda: self._closed or self._wanted > self._begun, pause)
                    pause = min(2 * pause, LONGEST_PAUSE)
                if self._closed:
                    return

    def look(self) -> None:
        """Find out whether it is there, and who it is."""
        try:
            uri = self._master.node(self.name)
        except PeerTimeout as error:
            if self._presence.trouble:
                self._miss(self._client, error)
            return  # the peer need not be away because the master is
        known = self._presence
        if not uri:
            self._miss(self._client, NotRunning("it is not running"))
        elif known.trouble or known.process is None or known.process.uri != uri:
            self._find(uri)
        if not self._presence.trouble:
            self.displaced = [each for each in self.displaced if not self._end(each)]

    def _find(self, uri: str) -> None:
        client = ListClient(self._master, self.name, reconnects=False)
        try:
            pid = self._master.pid(self.name, uri, TIMEOUT)
            nodelets = frozenset(client.list(FIND_TIMEOUT))
            publishes = self._master.publishers(f"{self.name}/{_PYTHON_SIGN}")
        except (HostError, PeerTimeout, LookupError) as error:
            client.close()
            self._miss(self._client, error)
            return
        found = Process(
            uri, pid, NodeletKind.PYTHON if self.name in publishes else NodeletKind.CPP
        )
        with self._lock:
            before, old, self._client = self._presence, self._client, client
            self._presence = Presence(found, "", False, nodelets, unseen=False)
        old.close()
        if before.process is not None and before.process.uri != uri:
            self.displaced.append(before.process)
        _log.info("nodelet manager %s is there (%s)", self.name, found.incarnation)

    def _end(self, displaced: Process) -> bool:
        """Tell a process to end whose name another one bears now; returns whether it knows."""
        reason = f"another node bears the name {self.name}"
        try:
            if self._master.pid(self.name, displaced.uri, TIMEOUT) == displaced.pid:
                self._master.shut_down(self.name, displaced.uri, reason, TIMEOUT)
        except PeerTimeout as error:
            return not _may_be_there(error)
        except LookupError:
            return True
        return True


class NotRunning(HostError):
    """The master has no node of that name."""


def _may_be_there(trouble: BaseException) -> bool:
    """Whether nothing of the host answered, so that nobody knows what became of the process."""
    answers = (ConnectionRefusedError, ConnectionResetError, LookupError, NotRunning)
    return not isinstance(trouble, answers) and not isinstance(trouble.__cause__, answers)


class ExternalManagers:
    """All nodelet managers of others."""

    def __init__(self, master: Master, names: Iterable[str]) -> None:
        """Begin to look for all of them, side by side."""
        self._peers: Dict[str, ExternalManager] = {
            name: ExternalManager(master, name) for name in sorted(set(names))
        }

    def all(self) -> List[ExternalManager]:
        """Return every peer, by name."""
        return list(self._peers.values())

    def find(self, name: str) -> Optional[ExternalManager]:
        """Return the peer of that name, if there is one."""
        return self._peers.get(name)

    def hosting(self, nodelet: str) -> Optional[ExternalManager]:
        """Return the peer that ran a nodelet when it was asked last, if there is one."""
        peers = self._peers.values()
        return next((peer for peer in peers if nodelet in peer.presence.nodelets), None)

    def close(self) -> None:
        """Look for nobody any more."""
        for peer in self._peers.values():
            peer.close()
