# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers and re-wirable nodes that the DyKnow manager did not start, on any host.

Nodelet managers are named by the settings. Each re-wirable node announces its name to each new
subscriber of one topic, so either side can start first.

Ownership: an ``External`` owns the presence of one process, and a thread that updates it.
While the process answers, each caller asks it directly over a kept connection. The first caller
without an answer marks it as unresponsive; from then on every call fails at once and only the
thread goes on asking, so no call waits for a host that is away.

The ROS master decides which process bears a name. When another process registers under the name
while the host of the first is away, the master cannot end the first. The thread does so as
soon as it can be reached.
"""

from __future__ import annotations

import builtins
import logging
import time
from dataclasses import dataclass, replace
from typing import Callable, Iterable

import rospy
from dyknow_msgs.msg import NodeletChanges
from dyknow_msgs.srv import GetCounts

from dyknow import names
from dyknow.backoff import Backoff
from dyknow.errors import HostError, HostTimeout, PeerTimeout
from dyknow.locks import state_lock
from dyknow.manager.host import ProcessState
from dyknow.model.graph import NodeletKind
from dyknow.periodic import PeriodicWorker
from dyknow.ros.hosting.counts import SERVICE as COUNTS
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.peer import LIST_TIMEOUT, ListClient, NodeletPeer
from dyknow.ros.nodelets.announcements import NODES_TOPIC
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


@dataclass(frozen=True)
class Presence:
    """Knowledge of the process behind a name.

    Attributes:
        state: the last that answered; without an incarnation if it has ended, or none has
            answered yet.
        trouble: why it cannot be queried; empty if it can.
        nodelets: its last list of nodelets.
    """

    state: ProcessState
    trouble: str = ""
    nodelets: frozenset[str] = frozenset()


class NotRunning(HostError):
    """The master has no node of that name, or it is another sort of node."""


class External(NodeletPeer):
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
        super().__init__(context, name)
        self.is_node = is_node
        self._on_gone = on_gone
        self._master = context.master
        self._state_lock = state_lock("external process")
        self._client = ListClient(self._master, name, is_node=is_node)
        self._gone = ProcessState(name, own=False, responsive=False)
        #: Present knowledge of its process, and that which was logged.
        self.presence = self._reported = Presence(
            replace(self._gone, away=True, unseen=True), "it has not answered yet"
        )
        #: Incarnations that bore the name before and do not know yet that they lost it.
        self.displaced: list[str] = []
        self._expected_until = time.monotonic() + _NODE_PATIENCE
        self._backoff = Backoff(time.monotonic, _FIRST_PAUSE, _LONGEST_PAUSE, tolerated=0)
        self._period: float | None = 0.0
        self._title = f"{'node' if is_node else 'nodelet manager'} '{name}'"
        self._worker = PeriodicWorker(
            f"looking for {self._title}", self._round, lambda: self._period, pause=0.0
        )
        self.start = self._worker.start

    @property
    def state(self) -> ProcessState:
        return self.presence.state

    @property
    def may_publish(self) -> bool:
        """Whether it may hold a lease; one that has ended publishes no more."""
        state = self.state
        return (state.responsive or state.away) and super().may_publish

    def check(self) -> None:
        """Raise ``HostTimeout`` if it did not answer the last time, ``HostError`` if it ended."""
        self._refuse_if_missed(self.presence)

    def list(self, incarnation: str = "") -> builtins.list[str]:
        """Ask for its nodelets, if it answers at all."""
        while True:
            with self._state_lock:
                client, known = self._client, self.presence
            self._refuse_if_missed(known)
            if incarnation not in ("", known.state.incarnation):
                raise HostError(f"{self._title} is another process by now")
            try:
                nodelets = client.list()
            except (HostError, PeerTimeout) as error:
                # A lost connection does not prove that it has ended: the thread finds out.
                self._miss(client, error, away=self.is_node or may_be_there(error))
                self._worker.wake()
                continue  # now there is a new connection, or trouble
            with self._state_lock:
                if client is self._client:
                    self.presence = replace(self.presence, nodelets=frozenset(nodelets))
            return nodelets

    def look_now(self, timeout: float = FIND_TIMEOUT) -> None:
        """Probe it once more if it was not found the last time, and wait for the outcome."""
        state = self.state
        if state.unseen or not (state.responsive or state.away):
            self._worker.wait_for(self._worker.wake(), timeout)

    def expect(self) -> None:
        """Look for a node for some more time: its name was announced."""
        self._expected_until = time.monotonic() + _NODE_PATIENCE
        self._worker.start()
        self._worker.wake()

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

    def close(self) -> None:
        """Look for it no more."""
        super().close()
        self._worker.close()
        self._client.close()

    # Inside

    def _round(self) -> None:
        self.look()
        self._report()
        known = self.presence
        if known.trouble or self.displaced:
            self._backoff.failed(self.name)
            self._period = self._backoff.remaining(self.name)
        else:
            self._backoff.forgive(self.name)
            self._period = None if self.is_node else _PERIOD
        if self.is_node and not known.state.alive and time.monotonic() > self._expected_until:
            self._on_gone(self)

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
        title = self._title.replace("'", "")
        if now.responsive:
            _log.info("%s is there (%s)", title, now.incarnation)
        elif not self.is_node or now.alive:
            _log.warning("%s cannot be asked: %s", title, trouble)
        elif before.alive:
            _log.info("%s is gone", title)
            self.guarding.withdraw()
        self.context.on_change()

    def _refuse_if_missed(self, known: Presence) -> None:
        if known.trouble:
            text = f"{self._title}: {known.trouble}"
            raise HostTimeout(text) if known.state.away else HostError(text)

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
        client = ListClient(self._master, self.name, reconnects=False, is_node=self.is_node)
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
        with self._state_lock:
            before, old, self._client = self.presence.state, self._client, client
            self.presence = Presence(found, nodelets=nodelets)
        old.close()
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

    def listen(self) -> None:
        """Listen for re-wirable nodes from now on."""
        self._subscriber = rospy.Subscriber(
            NODES_TOPIC, NodeletChanges, lambda message: self._expect(message.nodelets)
        )

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
