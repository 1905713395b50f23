# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Asks nodelet managers and nodes what they run, over connections that are kept."""

from __future__ import annotations

from typing import Collection, Dict, List, Tuple

from dyknow_msgs.srv import GetCounts
from nodelet.srv import NodeletList

from dyknow import names
from dyknow.errors import HostError, PeerTimeout
from dyknow.locks import state_lock
from dyknow.model.graph import NodeletKind
from dyknow.ros.hosting.count_collector import SERVICE as COUNTS
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient

#: Seconds for an answer over a connection that is there.
TIMEOUT = 1.0


class ListClient:
    """Asks one process of a nodelet manager, or a node, which runs itself.

    When the connection breaks another process may have the name by now. Its list says nothing of
    the nodelets of this one, so it is not taken for an answer.
    """

    def __init__(
        self, master: Master, name: str, reconnects: bool = True, is_node: bool = False
    ) -> None:
        """Prepare questions.

        Args:
            master: where the nodelet manager is looked up.
            name: its global name.
            reconnects: whether to connect again when the connection is lost.
            is_node: whether it is a node; that answers for as long as it runs itself.
        """
        service, question = (COUNTS, GetCounts) if is_node else ("list", NodeletList)
        self._client = ServiceClient(
            master, names.join(name, service), question, persistent=True, reconnects=reconnects
        )
        self._node = name if is_node else ""
        self._address = ""
        #: Whether the last question was answered in time.
        self.answers = True

    def list(self, timeout: float = TIMEOUT) -> List[str]:
        """Return the names of its nodelets, sorted.

        Raises:
            PeerTimeout: no answer in time.
            HostError: it is not there, or another process has its name.
        """
        try:
            if self._node:
                self._client.call(timeout, [self._node])
                found = [self._node]
            else:
                found = self._client.call(timeout).nodelets
        except PeerTimeout:
            self.answers = False
            raise
        self.answers = True
        self._address = self._address or self._client.address
        if self._client.address != self._address:
            self._client.close()
            raise HostError("another process has that name now")
        return sorted(found)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()


class ListClients:
    """A client for each process that was asked; every method is safe from any thread."""

    def __init__(self, master: Master) -> None:
        """Make clients when they are needed; ``master`` looks nodelet managers up."""
        self._master = master
        self._state_lock = state_lock("list clients")
        self._clients: Dict[str, Tuple[str, ListClient]] = {}

    def of(self, manager: str, incarnation: str, kind: NodeletKind) -> ListClient:
        """Return the client for a process; that for an earlier one of the name is closed."""
        with self._state_lock:
            known, client = self._clients.get(manager, ("", None))
            if known == incarnation and client is not None:
                return client
            made = ListClient(self._master, manager, is_node=kind.is_node)
            self._clients[manager] = (incarnation, made)
        if client is not None:
            client.close()
        return made

    def answers(self, manager: str, incarnation: str) -> bool:
        """Whether a process answered in time when it was asked last, if it was."""
        known, client = self._clients.get(manager, ("", None))
        return client is None or known != incarnation or client.answers

    def keep(self, managers: Collection[str]) -> None:
        """Close the connections to all other processes: they are gone for good."""
        with self._state_lock:
            gone = [name for name in self._clients if name not in managers]
            clients = [self._clients.pop(name)[1] for name in gone]
        for client in clients:
            client.close()

    def close(self) -> None:
        """Close all connections."""
        self.keep(())
