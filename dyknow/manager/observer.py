# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps the picture true, and restores dead nodelets.

A deliberate unload or reconnection by a third party is respected; the record is updated to match.
A nodelet was unloaded on purpose if its process runs on and no longer lists it; a process that is
about to end returns no list. Every other end of a nodelet is a death, and repaired.
"""

from __future__ import annotations

import contextlib
import logging
import time
from dataclasses import replace
from functools import partial
from typing import AbstractSet, Callable, Iterable, List, Optional, Set, Tuple

from dyknow import names
from dyknow.backoff import Backoff
from dyknow.errors import Busy, DyKnowError, HostError, NameTaken
from dyknow.locks import state_lock, turn_lock
from dyknow.manager.graph import Graph
from dyknow.manager.host import Crash, Host, HostReport, ProcessState
from dyknow.manager.lifecycle import NO_STREAMS, Lifecycle, StreamKeeper
from dyknow.manager.record import (
    NOTHING_HEARD,
    Record,
    declared_ports,
    missing_connections,
    seen_ports,
    topics_of,
    with_ports,
)
from dyknow.manager.suspects import Suspects
from dyknow.model.graph import PortState, State
from dyknow.model.transformation import Transformation
from dyknow.periodic import PAUSE

#: Seconds of the first pause between two attempts to bring back one nodelet. It is short, since a
#: stream is interrupted meanwhile.
_FIRST_PAUSE = 0.25

_log = logging.getLogger("rosout.dyknow")


#: Seconds between two looks when nothing happens.
PERIOD = 0.5


def at_once(key: str, work: Callable[[], object]) -> None:
    """Call ``work`` now, in the thread of the caller."""
    work()


class Observer:
    """Compares the graph with the reports of the host."""

    def __init__(
        self,
        host: Host,
        graph: Graph,
        lifecycle: Lifecycle,
        suspects: Suspects,
        described: Callable[[str], Optional[Transformation]] = lambda name: None,
        clock: Callable[[], float] = time.monotonic,
        run: Callable[[str, Callable[[], object]], None] = at_once,
        keeper: StreamKeeper = NO_STREAMS,
    ) -> None:
        """``adopt`` comes first; ``run`` brings a nodelet back, by key, while looks go on."""
        self._host = host
        self._graph = graph
        self._lifecycle = lifecycle
        self._suspects = suspects
        self._described = described
        self._turn = turn_lock("look at nodelet managers")
        self._backoff = Backoff(clock, _FIRST_PAUSE)
        self._run = run
        self._state_lock = state_lock("nodelets to query")
        self._dead: Set[str] = set()  # found by the present look
        self._accused: AbstractSet[str] = frozenset()  # incarnations whose crash is accounted for
        self._to_ask: Set[str] = set()  # nodelets whose ports the next look queries
        self._keeper = keeper

    def adopt(self, records: Iterable[Record]) -> None:
        """Take over the records of an earlier life.

        A nodelet whose spawn never returned is destroyed, with the process that was started for
        it alone. What still runs is left as it is, and the first look restores the dead ones.
        """
        for record in records:
            self._suspects.know(record)
            if record.state is State.STARTING and not record.incarnation:
                self._lifecycle.clear(record)
            else:
                self._graph.put(record)
        for state in self._host.states().values():  # whose spawn never returned
            if state.own and state.isolated_for and not self._graph.find(state.isolated_for):
                self._host.retire(state.name)
        self.look(record.name for record in self._graph.all())

    def note(self, names: Iterable[str]) -> None:
        """Have the next look query the ports of these nodelets."""
        with self._state_lock:
            self._to_ask.update(names)

    def look(self, changed: Iterable[str] = ()) -> float:
        """Compare the picture with a report of the host; query the ports of ``changed`` nodelets.

        Returns the seconds until the next look, which comes soon if operations held up this one.
        """
        with self._turn:
            with self._state_lock:
                changed, self._to_ask = self._to_ask.union(changed), set()
            busy = {name for name in changed if self._graph.is_busy(name)}
            self.note(busy)
            records = self._graph.all()  # before the processes: none of them is newer
            report = self._host.poll()
            for incarnation, crash in report.crashes.items():
                if incarnation not in self._accused:
                    self._accuse(crash)
            self._accused = report.crashes.keys()
            doubtful = [
                record
                for record in records
                if record.name in changed
                or self._description(record) != record.transformation
                or not _as_it_was(record, report)
            ]
            self._lose(doubtful, report)
            for record in doubtful:
                self._check(record, report, changed)
            known = {record.name for record in self._graph.all()}
            self.note(changed & known - {record.name for record in records})
            for manager in sorted(report.nodelets):
                for name in sorted(report.nodelets[manager] - known):
                    if not self._graph.is_busy(name):
                        self._adopt_unknown(name, report.processes[manager])
            dead, self._dead = sorted(self._dead), set()
        for name in dead:
            if self._backoff.allows(name):
                self._run(f"bringing back {name}", partial(self._bring_back, name))
        return PAUSE if busy else PERIOD

    def _accuse(self, crash: Crash) -> None:
        hosted = [each.name for each in self._graph.all() if each.manager == crash.manager]
        self._suspects.accuse(crash, hosted)
        running = crash.running or frozenset()
        gone = running.difference(map(names.mark, hosted))
        for label in {self._suspects.label(mark) for mark in gone} - {""}:
            self._keeper.on_crash(label)
        at_work = ", ".join(name for name in hosted if names.mark(name) in running)
        _log.error(
            "%s crashed (%s)%s",
            crash.manager,
            crash.cause,
            f" while it ran code of {at_work}" if at_work else "",
        )

    def _lose(self, doubtful: List[Record], report: HostReport) -> None:
        """Mark the nodelets that are lost with their nodelet manager.

        All in one step: a claim that uses several of them sees one loss.
        """
        lost = []
        with contextlib.ExitStack() as held:
            for record in doubtful:
                try:
                    current = held.enter_context(self._graph.changing(record.name))
                except Busy:
                    continue  # another operation works on it; the next look sees the outcome
                if current is None or not _is_same_life(current, record):
                    continue
                trouble = self._trouble(current, report)
                if not trouble or current.state not in (State.RUNNING, State.LOST):
                    continue
                why = "; ".join(filter(None, (trouble, current.suspicion)))
                if current.state is State.RUNNING:
                    _log.warning("%s is lost: %s", current.name, why)
                    self._backoff.served(current.name, self._graph.lifetime(current.name))
                lost.append(replace(current, state=State.LOST, detail=why))
            self._graph.put(*lost)

    def _trouble(self, record: Record, report: HostReport) -> str:
        """Say why a nodelet is lost with its nodelet manager; empty if it is not."""
        state = report.processes.get(record.manager)
        if record.transformation is None or record.unwanted or (state and state.unseen):
            return ""  # until its host was looked for, it is as it was
        if _has_died(record, report):
            if _was_being_unloaded(record, report) or not record.is_spawned:
                return ""
            crash = report.crashes.get(record.incarnation)
            cause = f" ({crash.cause})" if crash is not None else ""
            return f"{'it' if record.kind.is_node else 'its nodelet manager'} has died{cause}"
        if record.manager in report.nodelets or self._host.may_publish(record.manager):
            return ""
        what = "it" if record.kind.is_node else f"nodelet manager {record.manager}"
        cure = f": {state.cure}" if state is not None and state.cure else ""
        return f"{what} does not answer{cure}"

    def _check(self, record: Record, report: HostReport, changed: Set[str]) -> None:
        try:
            with self._graph.changing(record.name) as current:
                if current is None or not _is_same_life(current, record):
                    self.note({record.name} & changed)
                    return
                self._compare(current, report, changed)
        except Busy:
            self.note({record.name} & changed)
            return  # another operation works on it; the next look sees the outcome

    def _compare(self, record: Record, report: HostReport, changed: Set[str]) -> None:
        state = report.processes.get(record.manager)
        listed = report.nodelets.get(record.manager)
        alive = state is not None and listed is not None
        if alive and listed and record.name in listed and not record.unwanted:
            self._follow(record, state, record.name in changed)
        elif state is not None and state.unseen:
            return  # until its host was looked for, it is as it was
        elif record.transformation is None or (
            not record.is_spawned and _has_died(record, report)
        ):
            self._graph.remove(record.name)
        elif record.unwanted:
            if alive or state is None or not state.away:
                self._dead.add(record.name)
        elif alive and state is not None and state.incarnation == record.incarnation:
            if not self._is_unlisted(record):
                return
            if record.state is State.RUNNING:
                _log.info("%s was unloaded by others; it is not brought back", record.name)
                self._lifecycle.forget(record)
            else:  # it failed, or the manager was killed while it was bringing it back
                self._dead.add(record.name)
        elif _has_died(record, report):
            if _was_being_unloaded(record, report):
                _log.info("%s was being unloaded when its process died", record.name)
                self._lifecycle.forget(record)
            elif record.state is not State.RUNNING:  # else another operation has just worked on it
                self._dead.add(record.name)

    def _follow(self, record: Record, state: ProcessState | None, closely: bool) -> None:
        incarnation = state.incarnation if state is not None else record.incarnation
        description = self._description(record)
        is_new = description != record.transformation
        came_back = (
            is_new or record.state is not State.RUNNING or record.incarnation != incarnation
        )
        if record.state is State.STARTING and not self._complete(record):
            return
        record = replace(
            record,
            transformation=description,
            state=State.RUNNING,
            detail=record.detail if record.state is State.RUNNING else record.suspicion,
            incarnation=incarnation,
            heard=record.heard if record.incarnation == incarnation else NOTHING_HEARD,
            host=state.host if state is not None else record.host,
        )
        if (closely or came_back) and not record.is_fixed:
            try:
                record = with_ports(record, self._ports(record))
            except HostError as error:
                _log.debug("%s: %s", record.name, error)
                if closely or record.transformation is not None:  # it has a proxy
                    self.note([record.name])
            else:
                detail = "; ".join(
                    filter(None, (self._host.detail(record.name), record.suspicion))
                )
                record = replace(record, detail=detail)
                record = replace(record, topics=topics_of(record))
        if (
            not record.ports and not record.is_described
        ):  # it has no proxy, so it is taken to be as it should be
            record = replace(record, ports=declared_ports(record))
        self._graph.put(record)

    def _ports(self, record: Record) -> Tuple[PortState, ...]:
        """Query the ports of a nodelet; new ports of a claim's nodelet are connected as planned.

        A lazy nodelet makes declared ports when a subscriber comes, some at topics of its choice.
        Without a claim, these cannot be distinguished from recent connections by users.
        """
        ports = self._host.ports(record.name)
        if not (record.claimed and record.awaited):
            return ports
        wanted = missing_connections(record, [port for port in ports if port.datatype])
        late = {port: topic for port, topic in wanted.items() if port in record.awaited}
        if late:
            self._host.connect(record.name, late)
        return tuple(replace(port, topic=late.get(port.name, port.topic)) for port in ports)

    def _complete(self, record: Record) -> bool:
        """Finish bringing a nodelet back, which an earlier life of the manager had begun."""
        wanted = replace(record, topics=self._lifecycle.fitting(record))
        try:
            if record.is_fixed:  # its present wiring cannot be known
                self._host.unload(record.manager, record.name)
                return False
            wiring = missing_connections(wanted, self._host.ports(record.name))
            if wiring:
                self._host.connect(record.name, wiring)
        except HostError as error:
            _log.warning("%s: %s", record.name, error)
            return False
        return True

    def _bring_back(self, name: str) -> None:
        try:
            with self._graph.changing(name) as record:
                if record is not None and record.unwanted:
                    self._backoff.failed(name)
                    self._lifecycle.finish_destroying(record)
                elif record is not None and record.state is not State.RUNNING:
                    if record.claimed:  # the claim's repair chooses its replacement
                        self._keeper.on_death(record)
                        self._lifecycle.forget(record)
                        return
                    self._backoff.failed(name)
                    self._restore(record)
        except Busy:
            return  # another operation works on it; the next look sees the outcome

    def _restore(self, record: Record) -> None:
        try:
            restored = self._lifecycle.restore(record)
        except DyKnowError as error:
            _log.warning("%s cannot be brought back yet: %s", record.name, error)
            return
        if restored.state is State.RUNNING:
            _log.info("%s is back", record.name)
        else:
            _log.warning("%s is not back: %s", record.name, restored.detail)

    def _adopt_unknown(self, name: str, state: ProcessState) -> None:
        try:
            with self._graph.changing(name, new=True):
                if name in self._host.list(state.name):  # and not gone since the look began
                    self._graph.put(self._foreign(name, state))
        except (Busy, NameTaken, HostError):
            return

    def _foreign(self, name: str, state: ProcessState) -> Record:
        ports: Tuple[PortState, ...] = ()
        if state.rewirable:
            with contextlib.suppress(HostError):
                ports = self._host.ports(name)
        record = Record(
            name,
            None,
            state.name,
            state=State.RUNNING,
            incarnation=state.incarnation,
            is_fixed=not state.rewirable,
            kind=state.kind,
            host=state.host,
        )
        record = replace(record, transformation=self._description(record))
        record = replace(record, ports=seen_ports(record, ports))
        return replace(record, topics=topics_of(record))

    def _description(self, record: Record) -> Optional[Transformation]:
        """Return the blueprint of a spawned nodelet, or the description of an external node."""
        if record.is_spawned or not record.kind.is_node:
            return record.transformation
        return self._described(record.name)

    def _is_unlisted(self, record: Record) -> bool:
        """Whether the process of a nodelet runs on without it.

        The list is requested again, and after the reply the state of its process.
        """
        try:
            if record.name in self._host.list(record.manager):
                return False
        except HostError:
            return False
        state = self._host.states().get(record.manager)
        return state is not None and state.incarnation == record.incarnation


def _is_same_life(current: Record, record: Record) -> bool:
    """Whether a nodelet was neither restored nor replaced since its record was read."""
    return (current.manager, current.incarnation) == (record.manager, record.incarnation)


def _has_died(record: Record, report: HostReport) -> bool:
    """Whether the process that ran a nodelet has ended, as far as is known."""
    state = report.processes.get(record.manager)
    if state is None or (state.own and not state.alive):
        return True
    return (
        record.manager in report.nodelets
        and record.name not in report.nodelets[record.manager]
        and state.incarnation != record.incarnation
    )


def _was_being_unloaded(record: Record, report: HostReport) -> bool:
    """Whether a nodelet's process crashed while the nodelet was unloaded on request."""
    crash = report.crashes.get(record.incarnation)
    return crash is not None and names.mark(record.name) in crash.unloading


def _as_it_was(record: Record, report: HostReport) -> bool:
    """Whether a nodelet runs on in the process that was seen last: nothing is to be done."""
    state = report.processes.get(record.manager)
    return (
        state is not None
        and record.state is State.RUNNING
        and record.incarnation == state.incarnation
        and record.name in report.nodelets.get(record.manager, ())
    )
