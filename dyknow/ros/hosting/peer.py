# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A process that runs nodelets, as the manager's node knows it and polls it.

There are three sorts: children of ours (``child``), external nodelet managers and re-wirable nodes
(both ``external``). Their announcements all come on one topic.

One key of a peer's loop alone asks its process, over one connection. A poll renews the lease,
counts messages, and returns the nodelets with the ports that have changed. A caller that needs to
know the present state asks for a round that begins from now on, and waits for its end. A process
that did not answer is polled again by that key alone: until it answers, callers fail at once.
"""

from __future__ import annotations

import contextlib
import math
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, Collection, Dict, Iterator, Mapping, Optional, Sequence

from dyknow_msgs.msg import Guards, NodeletChanges, NodeletCounts, Port
from dyknow_msgs.srv import PollResponse

from dyknow.errors import HostError, HostTimeout, PeerTimeout
from dyknow.guards import NO_GUARDS
from dyknow.locks import state_lock
from dyknow.manager.host import Count, ProcessState, Reported, Usage
from dyknow.periodic import ControlLoop
from dyknow.ros.hosting.grants import Lease, PeerContext
from dyknow.ros.wire.messages import guards_message, machine_from, port_from
from dyknow.ros.wire.poll_client import PollClient

#: Seconds for a poll, over a connection that is there.
POLL_TIMEOUT = 1.0
#: Seconds for a new connection and the first answer over it, on a slow link.
FIND_TIMEOUT = 3.0
#: Seconds that a caller waits for a poll, which may have to wait for the one before.
_PATIENCE = 1.2
#: Seconds between the beginnings of two polls that renew a lease, and of a process that did not
#: answer; on a slow link one begins when the last ended.
_PERIOD = 0.25
#: Seconds between two polls for a nodelet that is not reported yet.
_STEP = 0.02

Counts = Dict[str, Optional[Mapping[str, Count]]]
"""By nodelet, the counts of its out-ports; None for one that is not there."""


@dataclass(frozen=True)
class Presence:
    """Knowledge of the process behind a name.

    Attributes:
        state: its state; without an incarnation while none is known to run.
        trouble: why it cannot be queried; empty if it can.
        nodelets: those that it runs, with their reports; None for one without live ports.
        process: text by which its announcements are known.
    """

    state: ProcessState
    trouble: str = ""
    nodelets: Mapping[str, Reported | None] = field(default_factory=dict)
    process: str = ""

    def check(self, title: str) -> None:
        """Raise ``HostTimeout`` if it did not answer the last time, ``HostError`` if it ended."""
        if self.trouble:
            is_late = self.state.away or (self.state.alive and not self.state.responsive)
            raise (HostTimeout if is_late else HostError)(f"{title}: {self.trouble}")


class Peer(ABC):
    """One process that runs nodelets, or its successors of the same name; thread-safe.

    It has a control loop, so one that hangs delays no other.

    Attributes:
        name: its global node name.
        title: its sort and name, for texts.
        presence: present knowledge of its process.
        loop: its loop, with a thread for each key.
        lease: lets it publish on topics of claims.
        late: nodelets whose load was given up, and which may still come up.
        refused: nodelets whose load was refused: there is nothing to unload.
    """

    def __init__(self, context: PeerContext, name: str, is_node: bool, presence: Presence) -> None:
        """Prepare; nothing is connected yet."""
        self.name = name
        self.title = f"{'node' if is_node else 'nodelet manager'} '{name}'"
        self.is_node = is_node
        self.context = context
        self.presence = presence
        self.lease = Lease(context)
        self.late: set[str] = set()
        self.refused: set[str] = set()
        self._state_lock = state_lock("peer")
        self._client: PollClient | None = None
        self._guards: Guards | None = None  # those that its process has
        self._counted: set[str] = set()
        self._counts: Counts = {}
        self._is_traffic_wanted = False
        self._traffic: Sequence[NodeletCounts] = ()
        #: Resources that its process has used; None if that is not measured.
        self.usage: Usage | None = None
        self._is_prompt = True
        self._key = f"polling {name}"
        self.loop = ControlLoop(name=f"peer {name}")
        self.loop.add(self._key, self._round, pause=0.0)
        self.loop.start()

    @property
    def state(self) -> ProcessState:
        """Its last known state, without a request."""
        return self.presence.state

    @property
    def may_publish(self) -> bool:
        """Whether it may hold a lease; while it may, it must not be taken for lost."""
        return self.lease.may_be_held

    # Its nodelets

    def wake(self) -> int:
        """Ask for a poll that begins from now on, and return its number."""
        return self.loop.wake(self._key)

    def wait(self, number: int, deadline: float) -> bool:
        """Wait for a poll that ``wake`` has requested; returns whether it has ended."""
        return self.loop.wait_for(self._key, number, max(0.0, deadline - time.monotonic()))

    def nodelets(
        self, number: int | None = None, incarnation: str = ""
    ) -> Mapping[str, Reported | None]:
        """Return its nodelets after a poll: one from now on, or that of a ``number``.

        Raises ``HostTimeout`` if it does not answer, or did not the last time, and ``HostError``
        if it is not there, or is not the ``incarnation`` that is meant (empty for any).
        """
        self.presence.check(self.title)
        number = self.wake() if number is None else number
        if not self.loop.wait_for(self._key, number, _PATIENCE):
            raise HostTimeout(f"{self.title} does not answer")
        known = self.presence
        known.check(self.title)
        if incarnation not in ("", known.state.incarnation):
            raise HostError(f"{self.title} is another process by now")
        return known.nodelets

    def await_report(self, nodelet: str, timeout: float) -> None:
        """Wait until it reports a nodelet that it has loaded, also one that was late before."""
        deadline = time.monotonic() + timeout
        while True:
            self.wait(self.wake(), deadline)
            if nodelet in self.presence.nodelets or time.monotonic() >= deadline:
                return
            time.sleep(_STEP)

    def take_late(self, nodelets: Collection[str]) -> set[str]:
        """Return those of nodelets whose load was given up, and which are to be unloaded, once."""
        with self._state_lock:
            taken = self.late.intersection(nodelets)
            self.late -= taken
        return taken

    def hand_over_guards(self) -> None:
        """Return when it has the present guards, or does not answer."""
        if self.state.alive and self.state.rewirable and self._guards != self._wanted_guards():
            with contextlib.suppress(HostError):
                self.nodelets()

    def _wanted_guards(self) -> Guards | None:
        """Return the guards that its process should have from us; None for none."""
        protected = sorted(self.context.protected.get(self.name, ()))
        return guards_message(self.context.guards, protected)

    def hear(self, changes: NodeletChanges) -> None:
        """Take an announcement of its process; others of its name are ignored."""
        with self._state_lock:
            known = self.presence
            if changes.process == known.process:
                self.presence = replace(known, nodelets=_merged(known.nodelets, changes))
        self.context.on_change()

    # Counts

    def ask_counts(self, nodelets: Collection[str]) -> int:
        """Have the messages of nodelets counted by the next poll; returns its number."""
        with self._state_lock:
            self._counted.update(nodelets)
        return self.wake()

    def counts(self, number: int, nodelets: Collection[str], deadline: float) -> Counts:
        """Return new counts, after waiting for a poll unless that may take long."""
        if self._is_prompt:
            self._is_prompt = self.wait(number, deadline)
        with self._state_lock:
            return {name: self._counts.pop(name) for name in nodelets if name in self._counts}

    def ask_traffic(self) -> int:
        """Have the messages of all nodelets counted by the next poll; returns its number."""
        self._is_traffic_wanted = True
        return self.wake()

    def traffic(self, number: int, deadline: float) -> Sequence[NodeletCounts]:
        """Return these counts as they came; the next time if they come later."""
        self.wait(number, deadline)
        with self._state_lock:
            found, self._traffic = self._traffic, ()
        return found

    # The end

    def release(self) -> None:
        """Take its lease and its guards back, so that it goes on without us."""
        self.loop.close(POLL_TIMEOUT)  # a renewal must not come after it
        client, known = self._client, self.presence
        if client is not None and not known.trouble:
            with contextlib.suppress(HostError, PeerTimeout):
                no_guards = [guards_message(NO_GUARDS)] if self._guards else []
                client.ask(POLL_TIMEOUT, guards=no_guards, **self.lease.release())

    def close(self) -> None:
        """Close the loop and the connections; the process goes on."""
        self.loop.close()
        self._let_go(None)

    # Rounds

    def _round(self) -> float | None:
        began, before = time.monotonic(), self.presence
        if self._client is None or self._is_doubtful:
            self._find()
        with self._state_lock:
            client = self._client
            counted, self._counted = sorted(self._counted), set()
        if client is not None:
            self._poll(client, counted)
        elif not (self.state.alive or self.state.away):
            self._note_counts(dict.fromkeys(counted))
        self._report(before)
        if self.lease.has_just_run_out():
            self.context.on_change()
        return self._pause(began)

    def _pause(self, began: float) -> float | None:
        """Seconds until the poll after one that ``began`` then; None for the next request."""
        is_pressing = self.lease.is_granted or (self.state.alive and self.presence.trouble)
        return max(0.0, began + _PERIOD - time.monotonic()) if is_pressing else None

    @property
    def _is_doubtful(self) -> bool:
        """Whether another process may bear the name by now."""
        return False

    @abstractmethod
    def _find(self) -> None:
        """Connect to the process that bears the name now, and call ``_found`` if there is one."""

    @abstractmethod
    def _missed(self, client: PollClient, error: HostError | PeerTimeout) -> None:
        """Note that a poll failed."""

    def _report(self, before: Presence) -> None:
        """Report a change of the presence."""
        if bool(before.trouble) != bool(self.presence.trouble):
            self.context.on_change()

    def _found(self, state: ProcessState, client: PollClient, answer: PollResponse) -> None:
        """Note which process it is now, and how it answered."""
        self._let_go(client)
        self._guards = None
        if self.state.incarnation != state.incarnation:
            self.late.clear()
            self.refused.clear()
        with self._state_lock:
            self.presence = _answered(Presence(state), answer, client)
        self.lease.note_clock(answer.clock)

    def _let_go(self, client: PollClient | None) -> None:
        """Replace the connection, which may be to a process that bears the name no more."""
        with self._state_lock:
            old, self._client = self._client, client
        if old is not None and old is not client:
            old.close()

    def _poll(self, client: PollClient, counted: list[str]) -> None:
        asked, guards = time.monotonic(), self._wanted_guards()
        handed = [guards] if guards != self._guards else []
        is_traffic, self._is_traffic_wanted = self._is_traffic_wanted, False
        asked_for = sorted({*counted, *self.presence.nodelets}) if is_traffic else counted
        renewal = self.lease.renewal()
        try:
            answer = client.ask(POLL_TIMEOUT, counted=asked_for, guards=handed, **renewal)
        except (HostError, PeerTimeout) as error:
            if isinstance(error, HostError):
                self._note_counts(dict.fromkeys(counted))
            self._missed(client, error)
            return
        self._guards = guards
        if not client.is_stock:
            (self.lease.answered if renewal else self.lease.note_clock)(answer.clock)
        with self._state_lock:
            if client is self._client:
                self.presence = _answered(self.presence, answer, client)
            self._traffic = answer.counts if is_traffic else self._traffic
            busy = dict(zip(answer.nodelets, answer.busy))
            self.usage = Usage(answer.clock, answer.cpu, busy) if answer.cpu else None
        found: Counts = dict.fromkeys(counted)
        answered = time.monotonic()
        for each in answer.counts:
            if each.nodelet not in found:
                continue
            out_ports = (port for port in each.ports if port.direction == Port.OUT)
            found[each.nodelet] = {port.port: _count(port, asked, answered) for port in out_ports}
        self._note_counts(found)
        self._is_prompt = True

    def _note_counts(self, found: Counts) -> None:
        with self._state_lock:
            self._counts.update(found)


def _answered(known: Presence, answer: PollResponse, client: PollClient) -> Presence:
    """Return the knowledge of a process that has answered, and of its clock."""
    changes = answer.changes
    before = known.nodelets if changes.process == known.process else {}
    nodelets = _merged({name: before.get(name) for name in answer.nodelets}, changes)
    machine, clock = machine_from(answer.machine), client.clock.offset
    state = replace(known.state, responsive=True, away=False, machine=machine, clock=clock)
    return Presence(state, nodelets=nodelets, process=changes.process)


def _merged(
    nodelets: Mapping[str, Reported | None], changes: NodeletChanges
) -> Mapping[str, Reported | None]:
    """Return nodelets with those changes that are newer."""
    newer = {}
    for each in changes.nodelets:
        known = nodelets.get(each.nodelet)
        is_newer = known is None or known.sequence < changes.sequence
        if each.nodelet in nodelets and each.is_loaded and is_newer:
            ports = tuple(map(port_from, each.ports))
            reported = Reported(ports, each.detail, changes.sequence, each.loader)
            newer[each.nodelet] = reported
    return {**nodelets, **newer} if newer else nodelets


def _count(port: Any, asked: float, answered: float) -> Count:
    age = None if math.isnan(port.age) else port.age
    return Count(port.messages, asked, answered, port.latched, age)


@contextlib.contextmanager
def host_errors(whom: str = "") -> Iterator[None]:
    """Turn a time-out or a refusal into an error of the host, whose text begins with ``whom``."""
    try:
        yield
    except (PeerTimeout, LookupError) as error:
        kind = HostTimeout if isinstance(error, PeerTimeout) else HostError
        raise kind(f"{whom}: {error}" if whom else str(error)) from error
