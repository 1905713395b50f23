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
from typing import Iterator

from dyknow_msgs.srv import GetCounts
from nodelet.srv import NodeletList

from dyknow import names
from dyknow.errors import HostError, HostTimeout, PeerTimeout
from dyknow.manager.host import ProcessState
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


class NodeletPeer(ABC):
    """One process that runs nodelets, or its successors of the same name; thread-safe.

    Attributes:
        name: its global node name.
        counts: how many messages its nodelets have sent.
        lease: lets it publish on topics of claims.
        guarding: its guards.
        failures: loads that failed, by nodelet.
        details: problems of its nodelets, as it announced them.
    """

    def __init__(self, context: PeerContext, name: str) -> None:
        """Prepare; nothing is connected yet."""
        self.name = name
        self.context = context
        self.counts = CountClient(context.master, name)
        self.lease = Lease(context, name, lambda: self.answers)
        self.guarding = Guarding(context, name)
        self.failures: dict[str, LoadFailure] = {}
        self.details: dict[str, str] = {}

    @property
    @abstractmethod
    def state(self) -> ProcessState:
        """Its last known state, without a request."""

    @abstractmethod
    def list(self, incarnation: str = "") -> builtins.list[str]:
        """Return the names of its nodelets, sorted.

        Raises ``HostTimeout`` if it does not answer, or did not the last time, and ``HostError``
        if it is not there, or is not the ``incarnation`` that is meant (empty for any).
        """

    @property
    def answers(self) -> bool:
        """Whether it is there, and answered the last time."""
        state = self.state
        return state.alive and state.responsive

    @property
    def may_publish(self) -> bool:
        """Whether it may hold a lease; while it may, it must not be taken for lost."""
        return self.lease.may_be_held

    def close(self) -> None:
        """Close the connections; the process goes on."""
        self.counts.close()
        self.lease.close()


class ListClient:
    """Asks one process for its nodelets, over a connection that is kept.

    When the connection breaks another process may have the name by now. Its list says nothing of
    the nodelets of this one, so it is not taken for an answer.
    """

    def __init__(
        self, master: Master, name: str, reconnects: bool = True, is_node: bool = False
    ) -> None:
        """Prepare; a node answers for as long as it runs itself, by its counts."""
        service, question = (COUNTS, GetCounts) if is_node else ("list", NodeletList)
        self._client = ServiceClient(
            master, names.join(name, service), question, persistent=True, reconnects=reconnects
        )
        self.close = self._client.close
        self._node = name if is_node else ""
        self._address = ""
        #: Whether the last question was answered in time.
        self.answers = True

    def list(self, timeout: float = LIST_TIMEOUT) -> builtins.list[str]:
        """Return the names of its nodelets, sorted; raises `PeerTimeout` or ``HostError``."""
        try:
            answer = self._client.call(timeout, *([[self._node]] if self._node else ()))
        except PeerTimeout:
            self.answers = False
            raise
        self.answers = True
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
