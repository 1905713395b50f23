# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers and re-wirable nodes that the DyKnow manager did not start, on any host.

Nodelet managers that the settings name are used like our own. Those of other clients, and
re-wirable nodes, are found by their announcements to each new subscriber of one topic, so either
side can start first. These are foreign: nothing is loaded or unloaded there, and a foreign
nodelet manager gets no guards.

The ROS master decides which process bears a name. When another process registers under the name
while the host of the first is away, the master cannot end the first. Another key of the peer's
loop does so as soon as it can be reached.
"""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from functools import partial
from typing import Any, Callable, Iterable

from dyknow_msgs.msg import Guards, NodeletChanges

from dyknow.backoff import Backoff
from dyknow.errors import HostError, PeerTimeout
from dyknow.locks import state_lock
from dyknow.manager.host import ProcessState
from dyknow.model.graph import NodeletKind
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.peer import FIND_TIMEOUT, POLL_TIMEOUT, Peer, Presence
from dyknow.ros.nodelets.announcements import TOPIC
from dyknow.ros.wire.addresses import host_of
from dyknow.ros.wire.poll_client import PollClient

#: Seconds between two attempts to find a process, doubling up to the longest.
_FIRST_PAUSE = 0.25
_LONGEST_PAUSE = 2.0
#: Seconds between two checks that no other process took the name of a nodelet manager.
_NAME_PERIOD = 1.0
#: Seconds for which a foreign process is looked for that has ended, or whose name was announced.
#: Should it come back later, rospy connects again and it announces itself again.
_PATIENCE = 10.0

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
        on_gone: Callable[[External], None] | None = None,
        is_foreign: bool = False,
    ) -> None:
        """Prepare; a ``wake`` begins to look for a nodelet manager, or a re-wirable node.

        One that the settings do not name has ``on_gone``, which is called when it has been gone
        for so long that it is not looked for.
        """
        self.is_foreign = is_foreign
        self._gone = ProcessState(name, own=False, responsive=False, foreign=self.is_foreign)
        unseen = replace(self._gone, away=True, unseen=True)
        super().__init__(context, name, is_node, Presence(unseen, "it has not answered yet"))
        self._on_gone = on_gone
        self._master = context.master
        #: Incarnations that bore the name before and do not know yet that they lost it.
        self.displaced: list[str] = []
        self._ending = f"ending nodes that lost the name {name}"
        self._named = 0.0
        self._expected_until = time.monotonic() + _PATIENCE
        self._backoff = Backoff(time.monotonic, _FIRST_PAUSE, _LONGEST_PAUSE, tolerated=0)

    @property
    def may_publish(self) -> bool:
        """Whether it may hold a lease; one that has ended publishes no more."""
        state = self.state
        return (state.responsive or state.away) and super().may_publish

    def look_now(self, timeout: float = FIND_TIMEOUT) -> None:
        """Probe it once more if it was not found the last time, and wait for the outcome."""
        state = self.state
        if state.unseen or not (state.responsive or state.away):
            self.loop.wait_for(self._key, self.wake(), timeout)

    def expect(self) -> None:
        """Look for it for some more time, from the next ``wake`` on: its name was announced."""
        self._expected_until = time.monotonic() + _PATIENCE

    @property
    def is_expected(self) -> bool:
        """Whether it is looked for while it is not there."""
        return time.monotonic() <= self._expected_until

    # Inside

    def _pause(self, began: float) -> float | None:
        if self.presence.trouble:
            return self._backoff.remaining(self.name)
        pause = super()._pause(began)
        return _NAME_PERIOD if pause is None and not self.is_foreign else pause

    @property
    def _is_doubtful(self) -> bool:
        return not self.is_foreign and time.monotonic() - self._named >= _NAME_PERIOD

    def _find(self) -> None:
        known = self.presence
        try:
            uri = self._master.bearer(self.name)
        except PeerTimeout as error:
            if known.trouble:
                self._miss(error, away=True)
            return  # a master that is away, or new, says nothing of the process
        self._named = time.monotonic()
        if uri and not known.trouble and _address_of(known.state) == uri:
            return
        client = PollClient(self._master, self.name, self.is_node)
        try:
            if not uri:
                raise NotRunning("it is not running")
            pid = self._master.pid(self.name, uri, POLL_TIMEOUT)
            answer = client.ask(FIND_TIMEOUT)
            kind = NodeletKind(answer.changes.kind)
            if kind.is_node is not self.is_node:
                raise NotRunning(f"it is no {'re-wirable node' if self.is_node else 'manager'}")
        except (HostError, PeerTimeout, LookupError) as error:
            client.close()
            self._miss(error, may_be_there(error))
            return
        state = replace(
            self._gone,
            kind=kind,
            incarnation=f"{uri}@{pid}",
            rewirable=not client.is_stock,
            host=host_of(uri),
        )
        self._found(state, client, answer)
        if known.state.alive and _address_of(known.state) != uri:
            self.displaced.append(known.state.incarnation)
            self.loop.add(self._ending, self._end_displaced, pause=0.0)
            self.loop.wake(self._ending)

    def _missed(self, client: PollClient, error: HostError | PeerTimeout) -> None:
        # A lost connection does not prove that it has ended: the next round finds out.
        self._miss(error, away=self.is_foreign or may_be_there(error))
        self.wake()

    def _miss(self, trouble: Exception, away: bool) -> None:
        """Note that it cannot be queried."""
        self._let_go(None)
        with self._state_lock:
            known = self.presence
            if not known.trouble:
                self._expected_until = time.monotonic() + _PATIENCE
            state = replace(
                known.state if away else self._gone, responsive=False, away=away, unseen=False
            )
            self.presence = replace(known, state=state, trouble=str(trouble))

    def _report(self, before: Presence) -> None:
        if self.presence.trouble:
            self._backoff.failed(self.name)
        else:
            self._backoff.forgive(self.name)
        self._log(before.state)
        if self._on_gone and not self.state.alive and not self.is_expected:
            self._on_gone(self)

    def _log(self, old: ProcessState) -> None:
        """Log a change, and report it."""
        now = self.state
        if (old.incarnation, old.responsive, old.away) == (
            now.incarnation,
            now.responsive,
            now.away,
        ):
            return
        if now.responsive:
            _log.info("%s is there (%s)", self.title, now.incarnation)
        elif not self._on_gone or now.alive:
            _log.warning("%s cannot be polled: %s", self.title, self.presence.trouble)
        elif old.alive:
            _log.info("%s is gone", self.title)
        self.context.on_change()

    def _wanted_guards(self) -> Guards | None:
        return super()._wanted_guards() if self.is_node or not self.is_foreign else None

    def _end_displaced(self) -> float | None:
        for each in list(self.displaced):
            if self._end(each):
                self.displaced.remove(each)
        return _FIRST_PAUSE if self.displaced else None

    def _end(self, displaced: str) -> bool:
        """End a process whose name another one bears now; returns whether it needs no more."""
        uri, _, pid = displaced.rpartition("@")
        reason = f"another node bears the name {self.name}"
        try:
            if self._master.pid(self.name, uri, POLL_TIMEOUT) == int(pid):
                self._master.shut_down(self.name, uri, reason, POLL_TIMEOUT)
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
    """The named nodelet managers, and the foreign ones and re-wirable nodes that run."""

    def __init__(
        self,
        context: PeerContext,
        managers: Iterable[str] = (),
        is_child: Callable[[str], bool] = lambda name: False,
    ) -> None:
        """Prepare; a process for which ``is_child`` is true is a child of ours, not external."""
        self._context = context
        self._is_child = is_child
        self._state_lock = state_lock("external processes")
        self._externals = {name: External(context, name) for name in sorted(set(managers))}
        self._subscriber: Any = None

    def start(self) -> None:
        """Look for the nodelet managers from now on, side by side."""
        for each in list(self._externals.values()):
            each.wake()

    def use(self, managers: Iterable[str]) -> None:
        """Use nodelet managers as named ones, unless they are certainly gone; waits for that."""

        def drop(gone: External) -> None:
            if not gone.state.away:
                self._drop(gone, unless_expected=True)

        new = [
            External(self._context, name, on_gone=drop)
            for name in sorted(set(managers))
            if name not in self._externals and not self._is_child(name)
        ]
        with self._state_lock:
            self._externals.update((each.name, each) for each in new)
        for each in new:
            each.wake()
        for each in new:
            each.look_now()
            if each.state.alive or each.state.away:
                _log.info("%s is used, though ~nodelet_managers does not name it", each.title)
            else:
                self._drop(each)

    def listen(self, hear: Callable[[str, NodeletChanges], None]) -> None:
        """Listen to all processes that run nodelets from now on, and find foreign ones by that.

        ``hear`` is called with the name of each process and its announcement.
        """

        def receive(message: Any) -> None:
            name = message._connection_header["callerid"]
            if any(each.is_loaded for each in message.nodelets):  # else it may be about to end
                self._expect([name], NodeletKind(message.kind).is_node)
            hear(name, message)

        self._subscriber = self._context.subscribe(TOPIC, receive)

    def look_for(self, nodes: Iterable[str]) -> None:
        """Find nodes that may run, before they announce their names; waits for the outcome."""
        for each in self._expect(nodes):
            each.look_now()

    def all(self) -> list[External]:
        """Return the named ones, there or not, and the foreign ones that are there, by name."""
        with self._state_lock:
            found = [self._externals[name] for name in sorted(self._externals)]
        return [each for each in found if not each.is_foreign or each.state.alive]

    def find(self, name: str) -> External | None:
        """Return the one of that name; None if there is none, or if it is foreign and gone."""
        found = self._externals.get(name)
        is_gone = found is not None and found.is_foreign and not found.state.alive
        return None if is_gone else found

    def close(self) -> None:
        """Look for none of them any more."""
        if self._subscriber is not None:
            self._subscriber.unregister()
        for each in list(self._externals.values()):
            each.close()

    def _expect(self, nodes: Iterable[str], are_nodes: bool = True) -> list[External]:
        """Look for processes that are not our children."""
        found = []
        for name in nodes:
            if not self._is_child(name):
                known = self._externals.get(name)
                if known and known.is_foreign and known.is_node is not are_nodes:
                    self._drop(known)  # it was announced before it was a nodelet manager
                kept = self._kept(name)
                if kept is None:
                    on_gone = partial(self._drop, unless_expected=True)
                    made = External(self._context, name, are_nodes, on_gone, is_foreign=True)
                    kept = self._kept(name, made) or made
                    if kept is not made:
                        made.close()
                kept.wake()
                found.append(kept)
        return found

    def _kept(self, name: str, made: External | None = None) -> External | None:
        """Expect the one of that name, or else the one that was ``made``, and return it."""
        with self._state_lock:
            kept = self._externals.get(name) or made
            if kept is not None:
                self._externals[name] = kept
                kept.expect()
        return kept

    def _drop(self, gone: External, unless_expected: bool = False) -> None:
        """Forget one; what was announced just now, or took its place, stays."""
        with self._state_lock:
            is_announced = unless_expected and gone.is_expected
            if is_announced or self._externals.get(gone.name) is not gone:
                return
            del self._externals[gone.name]
        gone.close()
