# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers and re-wirable nodes that the DyKnow manager did not start, on any host.

Nodelet managers are named by the settings. Each re-wirable node announces its name to each new
subscriber of one topic, so either side can start first.

Ownership: an ``External`` owns the presence of one process, which a key of its loop updates.
While the process answers, each caller asks it directly over a kept connection. The first caller
without an answer marks it as unresponsive; from then on every call fails at once and only the
loop goes on asking, so no call waits for a host that is away.

The ROS master decides which process bears a name. When another process registers under the name
while the host of the first is away, the master cannot end the first. The loop does so as
soon as it can be reached.
"""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from typing import Callable, Iterable

import rospy
from dyknow_msgs.msg import NodeletChanges
from dyknow_msgs.srv import GetCounts

from dyknow import names
from dyknow.backoff import Backoff
from dyknow.errors import HostError, PeerTimeout
from dyknow.locks import state_lock
from dyknow.manager.host import ProcessState
from dyknow.model.graph import NodeletKind
from dyknow.ros.hosting.counts import SERVICE as COUNTS
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.peer import LIST_TIMEOUT, ListClient, Peer, Presence
from dyknow.ros.nodelets.announcements import NODES_TOPIC, changes_in
from dyknow.ros.wire.addresses import host_of
from dyknow.ros.wire.service_client import ServiceClient, ServiceFailed, ServiceLost

#: Seconds for a new connection and the first answer over it, on a slow link.
FIND_TIMEOUT = 3.0
#: Seconds between two attempts to find a process, doubling up to the longest.
_FIRST_PAUSE = 0.25
_LONGEST_PAUSE = 2.0
#: Poll period for a responsive nodelet manager (detects that another process took its name).
_PERIOD = 1.0
#: Seconds for which a node is looked for that has ended, or whose name was announced. Should it
#: come back later, rospy connects again and it announces itself again.
_NODE_PATIENCE = 10.0

_log = logging.getLogger("rosout.dyknow")


class NotRunning(HostError):
    """The master has no node of that name, or it is another sort of node."""


class External(Peer):
    """One nodelet manager or re-wirable node of a third party; safe from any thread."""

    def __init__(
        self,
        context: PeerContext,
        name: str,
        is_node: bool = False,
        on_gone: Callable[[External], None] = lambda gone: None,
    ) -> None:
        """Prepare; ``start`` begins to look for a nodelet manager, or a re-wirable node.

        ``on_gone`` is called when a node has been gone for so long that it is not looked for.
        """
        self._gone = ProcessState(name, own=False, responsive=False)
        unseen = replace(self._gone, away=True, unseen=True)
        super().__init__(context, name, is_node, Presence(unseen, "it has not answered yet"))
        self._on_gone = on_gone
        self._master = context.master
        #: What was known when it was logged last.
        self._reported = self.presence
        #: Incarnations that bore the name before and do not know yet that they lost it.
        self.displaced: list[str] = []
        self._expected_until = time.monotonic() + _NODE_PATIENCE
        self._backoff = Backoff(time.monotonic, _FIRST_PAUSE, _LONGEST_PAUSE, tolerated=0)

    @property
    def may_publish(self) -> bool:
        """Whether it may hold a lease; one that has ended publishes no more."""
        state = self.state
        return (state.responsive or state.away) and super().may_publish

    def start(self) -> None:
        """Look for it from now on."""
        self.follow(self._round)

    def look_now(self, timeout: float = FIND_TIMEOUT) -> None:
        """Probe it once more if it was not found the last time, and wait for the outcome."""
        state = self.state
        if state.unseen or not (state.responsive or state.away):
            self.start()
            self.loop.wait_for(self._key, self.wake(), timeout)

    def expect(self) -> None:
        """Look for a node for some more time: its name was announced."""
        self._expected_until = time.monotonic() + _NODE_PATIENCE
        self.start()
        self.wake()

    def forget(self, nodelet: str) -> None:
        """Note that a nodelet which it ran is loaded elsewhere now."""
        with self._state_lock:
            nodelets = self.presence.nodelets - {nodelet}
            self.presence = replace(self.presence, nodelets=nodelets)

    def look(self) -> None:
        """Find out whether it is there, and which process it is."""
        if self.presence.trouble or not self.is_node:
            self._find()
        if not self.presence.trouble:
            self.displaced = [each for each in self.displaced if not self._end(each)]

    # Inside

    def _missed(self, client: ListClient, error: HostError | PeerTimeout) -> None:
        # A lost connection does not prove that it has ended: the next look finds out.
        self._miss(client, error, away=self.is_node or may_be_there(error))
        self.wake()

    def _round(self) -> float | None:
        self.look()
        self._report()
        known = self.presence
        if self.is_node and not known.state.alive and time.monotonic() > self._expected_until:
            self._on_gone(self)
        if known.trouble or self.displaced:
            self._backoff.failed(self.name)
            return self._backoff.remaining(self.name)
        self._backoff.forgive(self.name)
        return None if self.is_node else _PERIOD

    def _report(self) -> None:
        """Log a change, and report it."""
        before, self._reported = self._reported.state, self.presence
        now, trouble = self._reported.state, self._reported.trouble
        if (before.incarnation, before.responsive, before.away) == (
            now.incarnation,
            now.responsive,
            now.away,
        ):
            return
        if now.responsive:
            _log.info("%s is there (%s)", self.title, now.incarnation)
        elif not self.is_node or now.alive:
            _log.warning("%s cannot be asked: %s", self.title, trouble)
        elif before.alive:
            _log.info("%s is gone", self.title)
            self.guarding.withdraw()
        self.context.on_change()

    def _miss(self, client: ListClient, trouble: Exception, away: bool) -> None:
        """Note that it cannot be queried, unless it was found again meanwhile."""
        with self._state_lock:
            if client is not self._client:
                return
            known = self.presence
            if not known.trouble:
                self._expected_until = time.monotonic() + _NODE_PATIENCE
            state = replace(
                known.state if away else self._gone, responsive=False, away=away, unseen=False
            )
            self.presence = Presence(state, str(trouble), known.nodelets)

    def _find(self) -> None:
        known = self.presence
        try:
            uri = self._master.node(self.name)
        except PeerTimeout as error:
            if known.trouble:
                self._miss(self._client, error, away=True)
            return  # a master that is away says nothing of the process
        if uri and not known.trouble and _address_of(known.state) == uri:
            return
        client = ListClient(self._master, self.name, self.is_node, reconnects=False)
        try:
            if not uri:
                raise NotRunning("it is not running")
            pid = self._master.pid(self.name, uri, LIST_TIMEOUT)
            nodelets = frozenset(client.list(FIND_TIMEOUT))
            found = replace(self._kind(), incarnation=f"{uri}@{pid}", host=host_of(uri))
        except (HostError, PeerTimeout, LookupError) as error:
            client.close()
            self._miss(self._client, error, may_be_there(error))
            return
        before = self.presence.state
        self._found(Presence(found, nodelets=nodelets), client)
        if before.alive and _address_of(before) != uri:
            self.displaced.append(before.incarnation)

    def _kind(self) -> ProcessState:
        """Ask what it is; a stock C++ nodelet manager has no counts, and its nodelets no ports."""
        client = ServiceClient(self._master, names.join(self.name, COUNTS), GetCounts)
        try:
            kind = client.call(LIST_TIMEOUT, [self.name]).kind
        except (ServiceFailed, ServiceLost):
            return ProcessState(self.name, NodeletKind.CPP, own=False, rewirable=False)
        if not self.is_node:
            is_python = kind == NodeletKind.PYTHON.value
            kind = NodeletKind.PYTHON if is_python else NodeletKind.CPP
        elif kind not in [each.value for each in NodeletKind if each.is_node]:
            raise NotRunning("it is no re-wirable node")
        return ProcessState(self.name, NodeletKind(kind), own=False)

    def _end(self, displaced: str) -> bool:
        """End a process whose name another one bears now; returns whether it needs no more."""
        uri, _, pid = displaced.rpartition("@")
        reason = f"another node bears the name {self.name}"
        try:
            if self._master.pid(self.name, uri, LIST_TIMEOUT) == int(pid):
                self._master.shut_down(self.name, uri, reason, LIST_TIMEOUT)
        except PeerTimeout as error:
            return not may_be_there(error)
        except LookupError:
            return True
        return True


def _address_of(state: ProcessState) -> str:
    return state.incarnation.rpartition("@")[0]


def may_be_there(trouble: BaseException) -> bool:
    """Whether the host did not answer at all, so that the process may run all the same."""
    answers = (ConnectionRefusedError, ConnectionResetError, LookupError, NotRunning)
    return not isinstance(trouble, answers) and not isinstance(trouble.__cause__, answers)


class Externals:
    """All external nodelet managers, and the re-wirable nodes that run."""

    def __init__(
        self,
        context: PeerContext,
        managers: Iterable[str] = (),
        is_child: Callable[[str], bool] = lambda name: False,
    ) -> None:
        """Prepare; a node for which ``is_child`` is true is a child of ours, and not external."""
        self._context = context
        self._is_child = is_child
        self._state_lock = state_lock("external processes")
        self._externals = {name: External(context, name) for name in sorted(set(managers))}
        self._subscriber: rospy.Subscriber | None = None

    def start(self) -> None:
        """Look for the nodelet managers from now on, side by side."""
        for each in list(self._externals.values()):
            each.start()

    def listen(self, changed: Callable[[str, str, str], None]) -> None:
        """Listen for re-wirable nodes from now on, and to them.

        ``changed`` is that of ``Listener``, for which a node is its own nodelet manager.
        """

        def receive(message: NodeletChanges) -> None:
            self._expect(message.nodelets)
            for name, detail in changes_in(message):
                changed(name, name, detail)

        self._subscriber = rospy.Subscriber(NODES_TOPIC, NodeletChanges, receive)

    def look_for(self, nodes: Iterable[str]) -> None:
        """Find nodes that may run, before they announce their names; waits for the outcome."""
        for each in self._expect(nodes):
            each.look_now()

    def all(self) -> list[External]:
        """Return the nodelet managers, there or not, and the nodes that are there, by name."""
        with self._state_lock:
            found = [self._externals[name] for name in sorted(self._externals)]
        return [each for each in found if not each.is_node or each.state.alive]

    def find(self, name: str) -> External | None:
        """Return the one of that name; None if there is none, or if it is a node and gone."""
        found = self._externals.get(name)
        is_gone = found is not None and found.is_node and not found.state.alive
        return None if is_gone else found

    def hosting(self, nodelet: str) -> External | None:
        """Return the one that ran a nodelet the last time, if there is one."""
        return next((each for each in self.all() if nodelet in each.presence.nodelets), None)

    def close(self) -> None:
        """Look for none of them any more."""
        if self._subscriber is not None:
            self._subscriber.unregister()
        for each in list(self._externals.values()):
            each.close()

    def _expect(self, nodes: Iterable[str]) -> list[External]:
        """Look for nodes that are not our children."""
        found = []
        for name in nodes:
            if not self._is_child(name):
                made = External(self._context, name, is_node=True, on_gone=self._drop)
                with self._state_lock:
                    found.append(self._externals.setdefault(name, made))
                found[-1].expect()
        return found

    def _drop(self, gone: External) -> None:
        with self._state_lock:
            self._externals.pop(gone.name, None)
        gone.close()
