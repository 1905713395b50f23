# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodes in processes of their own that are re-wirable, whoever started them.

Who owns what: ``RewirableNodes`` owns a table of the nodes, and a thread that alone looks for
them. The ROS master knows the nodes that offer the counts of their ports and the ports themselves.
The process is asked what it is: nodelet managers offer counts too. One that does not answer stays
in the table until its connection is lost; it holds up one look by ``TIMEOUT``, once.
"""

from __future__ import annotations

import logging
from typing import Callable, Dict, List, Set

from dyknow_msgs.srv import GetCounts

from dyknow import names
from dyknow.errors import PeerTimeout
from dyknow.locks import state_lock
from dyknow.manager.host import ManagerState
from dyknow.model.graph import NodeletKind
from dyknow.periodic import PeriodicWorker
from dyknow.ros.hosting.count_collector import SERVICE as COUNTS
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient, ServiceFailed, ServiceLost

#: Seconds between two looks.
PERIOD = 0.5
#: Seconds for the answer of one node.
TIMEOUT = 0.5

_KINDS = [each.value for each in NodeletKind if each.is_node]

_log = logging.getLogger("rosout.dyknow")


class RewirableNodes:
    """The nodes that run now; every method is safe from any thread."""

    def __init__(self, master: Master, is_known: Callable[[str], bool]) -> None:
        """Begin without nodes; ``start`` begins to look for them.

        Args:
            master: the ROS master.
            is_known: whether a name is that of a nodelet manager that is known as such.
        """
        self._master = master
        self._is_known = is_known
        self._clients: Dict[str, ServiceClient] = {}  # of the thread
        self._state_lock = state_lock("re-wirable nodes")
        self._states: Dict[str, ManagerState] = {}
        #: Called after a look that found a change.
        self.on_change: Callable[[], object] = lambda: None
        #: Called with the name of a node that is gone.
        self.on_end: Callable[[str], None] = lambda name: None
        self._worker = PeriodicWorker("looking for re-wirable nodes", self.look, PERIOD)

    def start(self) -> None:
        """Look for nodes from now on."""
        self._worker.start()

    def all(self) -> List[ManagerState]:
        """Return each node, by name, as a process that hosts itself."""
        with self._state_lock:
            return [self._states[name] for name in sorted(self._states)]

    def has(self, name: str) -> bool:
        """Whether a name is that of such a node."""
        with self._state_lock:
            return name in self._states

    def look(self) -> None:
        """Look once."""
        try:
            present = self._offering()
        except PeerTimeout:
            return  # a master that is away says nothing of the nodes
        with self._state_lock:
            before = dict(self._states)
        found = {name: state for name in sorted(present) for state in self._ask(name)}
        for name in [name for name in self._clients if name not in present]:
            self._clients.pop(name).close()
        with self._state_lock:
            self._states = found
        for name in sorted(set(before) - set(found)):
            _log.info("node %s is gone", name)
            self.on_end(name)
        for name in sorted(set(found) - set(before)):
            _log.info("node %s can be re-wired", name)
        if found != before:
            self.on_change()

    def close(self) -> None:
        """Look no more."""
        self._worker.close(TIMEOUT)
        for client in list(self._clients.values()):
            client.close()

    # Inside

    def _offering(self) -> Set[str]:
        """Nodes that offer both the counts and the configuration of their ports themselves."""
        _, _, services = self._master.ask("getSystemState")
        providers = dict(services)
        candidates = {nodes[0] for service, nodes in services if service.endswith("/" + COUNTS)}
        return {
            node
            for node in candidates
            if all(
                providers.get(names.join(node, service)) == [node]
                for service in (COUNTS, "get_config")
            )
            and not self._is_known(node)
        }

    def _ask(self, name: str) -> List[ManagerState]:
        """Return the node as it is now; nothing if it is none, or has ended."""
        for _ in range(2):  # a second time if another process may have its name by now
            client = self._clients.get(name)
            if client is None:
                service = names.join(name, COUNTS)
                client = ServiceClient(self._master, service, GetCounts, True, reconnects=False)
                self._clients[name] = client
            is_first = not client.address
            try:
                kind = client.call(TIMEOUT, [name]).kind
            except PeerTimeout:
                with self._state_lock:
                    known = self._states.get(name)
                if known is None:
                    return []
                return [_state(name, known.incarnation, known.kind, is_responsive=False)]
            except (ServiceFailed, ServiceLost):
                self._clients.pop(name).close()
                if is_first:
                    return []
                continue
            if kind not in _KINDS:
                return []
            return [_state(name, client.address, NodeletKind(kind), is_responsive=True)]
        return []


def _state(name: str, incarnation: str, kind: NodeletKind, is_responsive: bool) -> ManagerState:
    return ManagerState(
        name,
        kind,
        incarnation,
        own=False,
        responsive=is_responsive,
        away=not is_responsive,
    )
