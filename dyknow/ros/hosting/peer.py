# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A process that runs nodelets, as the manager's node knows it and asks it.

There are three sorts: children of ours (``child``), external nodelet managers and re-wirable nodes
(both ``external``).
"""

from __future__ import annotations

import builtins
import contextlib
import enum
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Iterator

from dyknow_msgs.srv import GetCounts
from nodelet.srv import NodeletList

from dyknow import names
from dyknow.errors import HostError, HostTimeout, PeerTimeout
from dyknow.locks import state_lock
from dyknow.manager.host import ProcessState
from dyknow.periodic import ControlLoop, Work
from dyknow.ros.hosting.counts import SERVICE as COUNTS
from dyknow.ros.hosting.counts import CountClient
from dyknow.ros.hosting.grants import Guarding, Lease, PeerContext
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

#: Seconds for the list of a process, over a connection that is there.
LIST_TIMEOUT = 1.0


class LoadFailure(enum.Enum):
    """How the last load of a nodelet failed."""

    LATE = "not up in time; it may still come up"
    REFUSED = "refused; there is nothing to unload"


@dataclass(frozen=True)
class Presence:
    """Knowledge of the process behind a name.

    Attributes:
        state: its state; without an incarnation while none is known to run.
        trouble: why it cannot be queried; empty if it can.
        nodelets: its last list of nodelets.
    """

    state: ProcessState
    trouble: str = ""
    nodelets: frozenset[str] = frozenset()


class Peer(ABC):
    """One process that runs nodelets, or its successors of the same name; thread-safe.

    It has a control loop, so one that hangs delays no other. Keys are following the process, and
    once they are needed, renewing its lease and counting its messages.

    Attributes:
        name: its global node name.
        title: its sort and name, for texts.
        presence: present knowledge of its process.
        loop: its loop, with a thread for each key.
        counts: how many messages its nodelets have sent.
        lease: lets it publish on topics of claims.
        guarding: its guards.
        failures: loads that failed, by nodelet.
        details: problems of its nodelets, as it announced them.
    """

    def __init__(self, context: PeerContext, name: str, is_node: bool, presence: Presence) -> None:
        """Prepare; nothing is connected yet."""
        self.name = name
        self.title = f"{'node' if is_node else 'nodelet manager'} '{name}'"
        self.is_node = is_node
        self.context = context
        self.presence = presence
        self._state_lock = state_lock("peer")
        self._client = ListClient(context.master, name, is_node)
        self.loop = ControlLoop(name=f"peer {name}")
        self.loop.start()
        self._key = f"following {name}"
        self.counts = CountClient(context.master, name, self.loop)
        self.lease = Lease(context, name, self.loop, lambda: self.answers)
        self.guarding = Guarding(context, name)
        self.failures: dict[str, LoadFailure] = {}
        self.details: dict[str, str] = {}

    @property
    def state(self) -> ProcessState:
        """Its last known state, without a request."""
        return self.presence.state

    def list(self, incarnation: str = "") -> builtins.list[str]:
        """Return the names of its nodelets, sorted.

        Raises ``HostTimeout`` if it does not answer, or did not the last time, and ``HostError``
        if it is not there, or is not the ``incarnation`` that is meant (empty for any).
        """
        while True:
            with self._state_lock:
                client, known = self._client, self.presence
            self.check(known)
            if incarnation not in ("", known.state.incarnation):
                raise HostError(f"{self.title} is another process by now")
            try:
                nodelets = client.list()
            except (HostError, PeerTimeout) as error:
                self._missed(client, error)
                continue  # now there is a new connection, or trouble
            with self._state_lock:
                if client is self._client and not self.presence.trouble:
                    state = replace(self.presence.state, responsive=True)
                    self.presence = replace(
                        self.presence, state=state, nodelets=frozenset(nodelets)
                    )
            return nodelets

    def check(self, known: Presence | None = None) -> None:
        """Raise ``HostTimeout`` if it did not answer the last time, ``HostError`` if it ended."""
        known = known or self.presence
        if known.trouble:
            text = f"{self.title}: {known.trouble}"
            raise HostTimeout(text) if known.state.away else HostError(text)

    @abstractmethod
    def _missed(self, client: ListClient, error: HostError | PeerTimeout) -> None:
        """Note that a list failed; raises an error if it is not to be requested again now."""

    def _found(self, presence: Presence, client: ListClient | None = None) -> None:
        """Note which process it is now, or that there is none; another one gets new connections.

        The old ones may be to a process that hangs, and that bears the name no more.
        """
        new = client or ListClient(self.context.master, self.name, self.is_node)
        with self._state_lock:
            old, self._client = self._client, new
            before, self.presence = self.presence, presence
        old.close()
        if before.state.incarnation != presence.state.incarnation:
            self.counts.close()
            self.lease.close()

    @property
    def answers(self) -> bool:
        """Whether it is there, and answered the last time."""
        state = self.state
        return state.alive and state.responsive

    @property
    def may_publish(self) -> bool:
        """Whether it may hold a lease; while it may, it must not be taken for lost."""
        return self.lease.may_be_held

    def follow(self, work: Work) -> None:
        """Do the work that keeps up with its process in rounds from now on."""
        self.loop.add(self._key, work, 0.0, pause=0.0)

    def wake(self) -> int:
        """Ask for a round of that work, and return its number."""
        return self.loop.wake(self._key)

    def release(self) -> None:
        """Take its lease back, and follow it no more."""
        self.loop.close()
        if self.lease.is_granted:
            self.lease.release()

    def close(self) -> None:
        """Close the loop and the connections; the process goes on."""
        self.loop.close()
        self.counts.close()
        self.lease.close()
        self._client.close()


class ListClient:
    """Asks one process for its nodelets, over a connection that is kept.

    When the connection breaks another process may have the name by now. Its list says nothing of
    the nodelets of this one, so it is not taken for an answer.
    """

    def __init__(self, master: Master, name: str, is_node: bool, reconnects: bool = True) -> None:
        """Prepare; a node answers for as long as it runs itself, by its counts."""
        service, question = (COUNTS, GetCounts) if is_node else ("list", NodeletList)
        self._client = ServiceClient(
            master, names.join(name, service), question, persistent=True, reconnects=reconnects
        )
        self.close = self._client.close
        self._node = name if is_node else ""
        self._address = ""

    def list(self, timeout: float = LIST_TIMEOUT) -> builtins.list[str]:
        """Return the names of its nodelets, sorted; raises `PeerTimeout` or ``HostError``."""
        answer = self._client.call(timeout, *([[self._node]] if self._node else ()))
        self._address = self._address or self._client.address
        if self._client.address != self._address:
            self.close()
            raise HostError("another process has that name now")
        return [self._node] if self._node else sorted(answer.nodelets)


@contextlib.contextmanager
def host_errors(whom: str = "") -> Iterator[None]:
    """Turn a time-out or a refusal into an error of the host, whose text begins with ``whom``."""
    try:
        yield
    except (PeerTimeout, LookupError) as error:
        kind = HostTimeout if isinstance(error, PeerTimeout) else HostError
        raise kind(f"{whom}: {error}" if whom else str(error)) from error
