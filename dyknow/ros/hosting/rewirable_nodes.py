# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodes in processes of their own that are re-wirable, whoever started them.

Each tells its name to everybody who begins to listen to one topic, so it does not matter which
side begins first, and the ROS master is asked nothing. From then on the node itself is asked, over
a connection that is kept, whether it is there.

Who owns what: ``RewirableNodes`` owns a table of the nodes, and a thread that alone asks them. One
that does not answer stays in the table until its connection is lost; it holds up one round by
``TIMEOUT``, once.
"""

from __future__ import annotations

import logging
from typing import Callable, Dict, Iterable, List, Optional

import rospy
from dyknow_msgs.msg import NodeletChanges
from dyknow_msgs.srv import GetCounts

from dyknow import names
from dyknow.errors import PeerTimeout
from dyknow.locks import state_lock
from dyknow.manager.host import ManagerState
from dyknow.model.graph import NodeletKind
from dyknow.periodic import PeriodicWorker
from dyknow.ros.addresses import host_of
from dyknow.ros.hosting.count_collector import SERVICE as COUNTS
from dyknow.ros.master import Master
from dyknow.ros.nodelets.announcements import NODES_TOPIC
from dyknow.ros.service_client import ServiceClient, ServiceFailed, ServiceLost

#: Seconds between two rounds of questions.
PERIOD = 0.5
#: How often a node is asked that is not there. Should it come back later, rospy connects again and
#: hears of it again.
ATTEMPTS = 20
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
        self._attempts: Dict[str, int] = {}  # that are left, by name
        self._states: Dict[str, ManagerState] = {}
        #: Called after a round that found a change.
        self.on_change: Callable[[], object] = lambda: None
        #: Called with the name of a node that is gone.
        self.on_end: Callable[[str], None] = lambda name: None
        self._subscriber: Optional[rospy.Subscriber] = None
        self._worker = PeriodicWorker(
            "looking for re-wirable nodes",
            self.look,
            lambda: PERIOD if self._attempts else None,
        )

    def start(self) -> None:
        """Listen for nodes from now on."""
        self._worker.start()
        self._subscriber = rospy.Subscriber(NODES_TOPIC, NodeletChanges, self._told)

    def look_for(self, nodes: Iterable[str]) -> None:
        """Ask at once for nodes that may run, before any tells its name."""
        self._add(nodes)
        self.look()

    def all(self) -> List[ManagerState]:
        """Return each node, by name, as a process that hosts itself."""
        with self._state_lock:
            return [self._states[name] for name in sorted(self._states)]

    def has(self, name: str) -> bool:
        """Whether a name is that of such a node."""
        with self._state_lock:
            return name in self._states

    def look(self) -> None:
        """Ask all nodes once."""
        with self._state_lock:
            before, told = dict(self._states), sorted(self._attempts)
        found: Dict[str, ManagerState] = {}
        for name in told:
            if self._is_known(name):
                continue
            try:
                state = self._ask(name)
            except PeerTimeout:
                if name in before:
                    known = before[name]
                    found[name] = _state(name, known.incarnation, known.kind, is_responsive=False)
                continue
            self._note(name, state is not None)
            if state is not None:
                found[name] = state
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
        """Listen and ask no more."""
        if self._subscriber is not None:
            self._subscriber.unregister()
        self._worker.close(TIMEOUT)
        for client in list(self._clients.values()):
            client.close()

    # Inside

    def _told(self, message: NodeletChanges) -> None:
        """Hear of nodes, on rospy's threads."""
        self._add(message.nodelets)
        self._worker.wake()

    def _add(self, nodes: Iterable[str]) -> None:
        with self._state_lock:
            self._attempts.update(dict.fromkeys(nodes, ATTEMPTS))

    def _note(self, name: str, is_there: bool) -> None:
        """Forget a node that was not there too often."""
        with self._state_lock:
            self._attempts[name] = ATTEMPTS if is_there else self._attempts[name] - 1
            if self._attempts[name] == 0:
                del self._attempts[name]

    def _ask(self, name: str) -> Optional[ManagerState]:
        """Return the node as it is now; None if it is none, or has ended.

        Raises:
            PeerTimeout: it does not answer.
        """
        for _ in range(2):  # a second time if another process may have its name by now
            client = self._clients.get(name)
            if client is None:
                service = names.join(name, COUNTS)
                client = ServiceClient(self._master, service, GetCounts, True, reconnects=False)
                self._clients[name] = client
            is_first = not client.address
            try:
                kind = client.call(TIMEOUT, [name]).kind
            except (ServiceFailed, ServiceLost):
                self._clients.pop(name).close()
                if is_first:
                    return None
                continue
            if kind not in _KINDS:
                self._clients.pop(name).close()
                return None
            return _state(name, client.address, NodeletKind(kind), is_responsive=True)
        return None


def _state(name: str, incarnation: str, kind: NodeletKind, is_responsive: bool) -> ManagerState:
    return ManagerState(
        name,
        kind,
        incarnation,
        own=False,
        responsive=is_responsive,
        away=not is_responsive,
        host=host_of(incarnation),
    )
