# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps the picture true, and restores dead nodelets.

A deliberate unload or reconnection by a third party is respected; the record is updated to match.
A nodelet was unloaded on purpose if its process runs on and no longer lists it; a process that is
about to end returns no list. Every other end of a nodelet is a death, and repaired.
"""

from __future__ import annotations

import contextlib
import enum
import logging
from dataclasses import replace
from functools import partial
from typing import AbstractSet, Iterable

from dyknow import names
from dyknow.backoff import Backoff
from dyknow.errors import Busy, HostError, NameTaken
from dyknow.locks import turn_lock
from dyknow.manager.host import Crash, HostReport, ProcessState, Reported
from dyknow.manager.record import (
    NOTHING_HEARD,
    Record,
    declared_ports,
    missing_connections,
    seen_ports,
    with_present_ports,
)
from dyknow.manager.supervision.lifecycle import Lifecycle, ManagerContext, is_displaced
from dyknow.manager.supervision.restarts import outdated
from dyknow.model.graph import PortState, State
from dyknow.model.transformation import Transformation
from dyknow.periodic import PAUSE

#: Seconds of the first pause between two attempts to bring back one nodelet. It is short, since a
#: stream is interrupted meanwhile.
_FIRST_PAUSE = 0.25

#: Seconds between two looks when nothing happens.
PERIOD = 0.5

_log = logging.getLogger("rosout.dyknow")


class Fate(enum.Enum):
    """A nodelet's fate, by a report of the host.

    UNSEEN: until its host was looked for, it is as it was. UNLISTED: its process runs on without
    it. UNLOADED: its process crashed while it was unloaded on request.
    """

    RUNS = enum.auto()
    UNSEEN = enum.auto()
    SILENT = enum.auto()
    UNLISTED = enum.auto()
    UNLOADED = enum.auto()
    DIED = enum.auto()


class Observer:
    """Compares the graph with the reports of the host."""

    def __init__(self, context: ManagerContext, lifecycle: Lifecycle) -> None:
        """``adopt`` comes first."""
        self._host = context.host
        self._graph = context.graph
        self._lifecycle = lifecycle
        self._suspects = lifecycle.suspects
        self._library = context.library
        self._run = context.run
        self._keeper = context.keeper
        self._turn = turn_lock("look at nodelet managers")
        self._backoff = Backoff(context.clock.now, _FIRST_PAUSE)
        self.forgive = self._backoff.forgive
        self._accused: AbstractSet[str] = frozenset()  # incarnations whose crash is accounted for
        #: Records, each with the report that it showed when they were compared last.
        self._shown: dict[str, tuple[Record, Reported]] = {}

    def adopt(self, records: Iterable[Record]) -> None:
        """Take over the records of an earlier life.

        A nodelet whose spawn never returned is destroyed, with the process that was started for
        it alone. What still runs is left as it is, and the first look restores the dead ones.
        """
        for record in records:
            self._suspects.know(record)
            if record.state is State.STARTING and not record.incarnation:
                self._lifecycle.clear(record, is_heard=False)
            else:
                self._graph.put(record)
        for state in self._host.states().values():  # whose spawn never returned
            if state.own and state.isolated_for and not self._graph.find(state.isolated_for):
                self._host.retire(state.name)
        self.look()

    def look(self) -> float:
        """Compare the picture with a report of the host.

        Returns the seconds until the next look, which comes soon if operations held up this one.
        """
        with self._turn:
            records = self._graph.all()  # before the processes: none of them is newer
            self._shown = {
                each.name: self._shown[each.name] for each in records if each.name in self._shown
            }
            report = self._host.poll()
            self._lifecycle.hosts.look(report.processes)
            for incarnation, crash in report.crashes.items():
                if incarnation not in self._accused:
                    self._accuse(crash)
            self._accused = report.crashes.keys()
            doubtful = [
                (record, fate)
                for record, fate in ((each, _fate(each, report)) for each in records)
                if self._description(record) != record.transformation
                or record.outdated != outdated(record, self._library, self._host)
                or (fate, record.state) != (Fate.RUNS, State.RUNNING)
                or record.incarnation != report.processes[record.manager].incarnation
                or not self._is_shown(record)
            ]
            is_held_up = any(
                record.state is State.RUNNING and self._graph.is_busy(record.name)
                for record, _ in doubtful
            )
            self._lose(doubtful, report)
            dead = [record.name for record, fate in doubtful if self._follow(record, fate, report)]
            known = {record.name for record in self._graph.all()}
            for manager in sorted(report.nodelets):
                for name in sorted(report.nodelets[manager] - known):
                    if not self._graph.is_busy(name):
                        self._adopt_unknown(name, report.processes[manager])
        for name in dead:
            if self._is_mended(name):
                self._backoff.forgive(name)
            if self._backoff.allows(name):
                self._run(f"bringing back {name}", partial(self._bring_back, name))
        return PAUSE if is_held_up else PERIOD

    def _is_mended(self, name: str) -> bool:
        """Whether a nodelet that could not be brought back has other code now."""
        record = self._graph.find(name)
        if record is None or record.state is not State.FAILED or record.transformation is None:
            return False
        code = self._host.code_of(record.manager, record.transformation)
        return code not in ("", record.code)

    def _accuse(self, crash: Crash) -> None:
        hosted = [each.name for each in self._graph.all() if each.manager == crash.manager]
        for label in self._suspects.accuse(crash, hosted):
            self._keeper.on_crash(label)
        running = crash.running or frozenset()
        at_work = ", ".join(name for name in hosted if names.mark(name) in running)
        _log.error(
            "%s crashed (%s)%s",
            crash.manager,
            crash.cause,
            f" while it ran code of {at_work}" if at_work else "",
        )

    def _lose(self, doubtful: Iterable[tuple[Record, Fate]], report: HostReport) -> None:
        """Mark the nodelets that are lost with their nodelet manager.

        All in one step: a claim that uses several of them sees one loss.
        """
        lost = []
        with contextlib.ExitStack() as held:
            for record, fate in doubtful:
                current = self._reserve(record, held)
                trouble = self._trouble(current, fate, report) if current is not None else ""
                if not trouble or current is None:
                    continue
                why = "; ".join(filter(None, (trouble, current.suspicion)))
                if current.state is State.RUNNING:
                    _log.warning("%s is lost: %s", current.name, why)
                    self._backoff.served(current.name, self._graph.lifetime(current.name))
                state = State.STARTING if current.state is State.STARTING else State.LOST
                lost.append(replace(current, state=state, detail=why))
            self._graph.put(*lost)

    def _reserve(self, record: Record, held: contextlib.ExitStack) -> Record | None:
        """Reserve a nodelet; None if it is busy, or was restored or replaced meanwhile.

        The next look sees the outcome of the operation.
        """
        try:
            current = held.enter_context(self._graph.changing(record.name))
        except Busy:
            return None
        life = (record.manager, record.incarnation)
        return current if current and (current.manager, current.incarnation) == life else None

    def _trouble(self, record: Record, fate: Fate, report: HostReport) -> str:
        """Say why a nodelet is lost, or not up yet, with its nodelet manager; else empty."""
        if record.is_ending or not (record.transformation or record.cut):
            return ""
        if record.state is State.FAILED:
            return ""
        if is_displaced(record, report.processes.get(record.manager)):
            return NameTaken(record.name, "running", "another node").holder
        if fate is Fate.DIED and record.is_spawned:
            crash = report.crashes.get(record.incarnation)
            cause = f" ({crash.cause})" if crash is not None else ""
            return f"{'it' if record.kind.is_node else 'its nodelet manager'} has died{cause}"
        if fate is not Fate.SILENT or self._host.may_publish(record.manager):
            return ""
        what = "it" if record.kind.is_node else f"nodelet manager {record.manager}"
        cure = report.processes[record.manager].cure
        return f"{what} does not answer{f': {cure}' if cure else ''}"

    def _is_shown(self, record: Record) -> bool:
        """Whether a record has the process's last report of its nodelet."""
        reported = self._host.reported(record.manager, record.name)
        if reported is None:
            return _with_some_ports(record) == record
        known = self._shown.get(record.name, ())
        if not (known and known[0] is record and known[1] is reported):
            detail = "; ".join(filter(None, (reported.detail, record.suspicion)))
            shown = (seen_ports(record, reported.ports), detail, _owner(record, reported))
            if shown != (record.ports, record.detail, record.owner):
                return False
            self._shown[record.name] = record, reported
        return True

    def _follow(self, record: Record, fate: Fate, report: HostReport) -> bool:
        """Update a record to match; returns whether work on the nodelet is left."""
        with contextlib.ExitStack() as held:
            current = self._reserve(record, held)
            if current is None:
                return False
            state = report.processes.get(record.manager)
            if fate is Fate.RUNS and state is not None and not current.is_ending:
                self._update(current, state)
            elif fate is Fate.UNSEEN:
                return False
            elif not current.is_spawned and fate in (Fate.DIED, Fate.UNLOADED):
                self._graph.remove(record.name)
            elif current.is_ending:
                return fate is not Fate.SILENT
            elif current.transformation is None:
                if fate is not Fate.SILENT or not current.cut:  # nothing else shows what was cut
                    self._graph.remove(record.name)
            elif fate is Fate.UNLISTED and self._is_unlisted(current):
                if current.state is not State.RUNNING:
                    return True  # it failed, or the manager was killed while it brought it back
                _log.info("%s was unloaded by others; it is not brought back", record.name)
                self._lifecycle.forget(current)
            elif fate is Fate.UNLOADED and current.state in (State.RUNNING, State.LOST):
                _log.info("%s was being unloaded when its process died", record.name)
                self._lifecycle.forget(current)
            elif fate in (Fate.DIED, Fate.UNLOADED):  # if it runs, it was just worked on
                return current.state is not State.RUNNING
            return False

    def _update(self, record: Record, state: ProcessState) -> None:
        """Update the record of a nodelet that runs."""
        if record.state in (State.STARTING, State.FAILED):
            wanted = self._lifecycle.fitted(record)
            trouble = self._complete(wanted)
            if trouble:
                self._graph.put(replace(record, detail=trouble))
                return
            record = wanted
        record = replace(
            record,
            transformation=self._description(record),
            state=State.RUNNING,
            detail=record.detail if record.state is State.RUNNING else record.suspicion,
            incarnation=state.incarnation,
            heard=record.heard if record.incarnation == state.incarnation else NOTHING_HEARD,
            host=state.host,
            outdated=outdated(record, self._library, self._host),
        )
        reported = self._host.reported(record.manager, record.name)
        if reported is not None:
            ports = self._with_late_ports(record, reported.ports)
            detail = "; ".join(filter(None, (reported.detail, record.suspicion)))
            record = replace(
                with_present_ports(record, ports), detail=detail, owner=_owner(record, reported)
            )
        self._graph.put(_with_some_ports(record))

    def _with_late_ports(
        self, record: Record, ports: tuple[PortState, ...]
    ) -> tuple[PortState, ...]:
        """Connect new ports of a claim's nodelet as planned; return all of its ports.

        A lazy nodelet makes declared ports when a subscriber comes, some at topics of its choice.
        Without a claim, these cannot be distinguished from recent connections by users.
        """
        if not (record.claimed and record.awaited):
            return ports
        wanted = missing_connections(record, [port for port in ports if port.datatype])
        late = {port: topic for port, topic in wanted.items() if port in record.awaited}
        if late:
            try:
                self._host.connect(record.name, late)
            except HostError as error:
                _log.debug("%s: %s", record.name, error)
                return record.ports
        return tuple(replace(port, topic=late.get(port.name, port.topic)) for port in ports)

    def _complete(self, record: Record) -> str:
        """Finish bringing a nodelet back, which an earlier life of the manager had begun.

        The load of one that FAILED ended after all: its name was taken by that load, for example.

        Returns why it is not finished; empty if it is.
        """
        try:
            if record.is_fixed:  # its present wiring cannot be known
                self._host.unload(record.manager, record.name)
                return "it is loaded again, since its wiring is not known"
            wiring = missing_connections(record, self._host.ports(record.name))
            if wiring:
                self._host.connect(record.name, wiring)
        except HostError as error:
            _log.warning("%s: %s", record.name, error)
            return str(error)
        return ""

    def _bring_back(self, name: str) -> None:
        # Busy: another operation works on it; the next look sees the outcome.
        with contextlib.suppress(Busy), self._graph.changing(name) as record:
            if record is None or (record.state is State.RUNNING and not record.is_ending):
                return
            if record.is_ending and not self._is_ended(record):
                return
            if record.unwanted:
                self._graph.remove(name)
                _log.info("%s, which was to be destroyed, is destroyed now", name)
                return
            if record.claimed:  # the claim's repair replaces it
                self._keeper.on_death(record)
                self._lifecycle.forget(record)
                return
            has_served = record.state is State.LOST
            self._backoff.failed(name, self._graph.lifetime(name) if has_served else 0.0)
            self._lifecycle.restore(record)

    def _is_ended(self, record: Record) -> bool:
        """Unload a nodelet that should have been; returns whether it is certainly gone."""
        try:
            self._lifecycle.end(record)
        except HostError as error:
            self._backoff.failed(record.name)
            _log.warning("%s: %s", record.name, error)
            return False
        return True

    def _adopt_unknown(self, name: str, state: ProcessState) -> None:
        with contextlib.suppress(Busy, NameTaken, HostError), self._graph.changing(name, new=True):
            if name in self._host.list(state.name):  # and not gone since the look began
                is_fixed, kind = not state.rewirable, state.kind
                record = Record(
                    name, None, state.name, is_fixed=is_fixed, kind=kind, owner=state.name
                )
                self._update(replace(record, state=State.RUNNING), state)

    def _description(self, record: Record) -> Transformation | None:
        """Return the blueprint of a spawned nodelet, or the description of an external node."""
        if record.is_spawned or not record.kind.is_node:
            return record.transformation
        return self._library.nodes().get(record.name)

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


def _with_some_ports(record: Record) -> Record:
    """Let a nodelet without a proxy have the ports that it should have."""
    if record.ports or record.is_described:
        return record
    return replace(record, ports=declared_ports(record))


def _owner(record: Record, reported: Reported) -> str:
    return "" if record.is_spawned else reported.loader or record.manager


def _fate(record: Record, report: HostReport) -> Fate:
    state = report.processes.get(record.manager)
    listed = report.nodelets.get(record.manager)
    if is_displaced(record, state):
        return Fate.DIED
    if state is not None and listed is not None and record.name in listed:
        return Fate.RUNS
    if state is not None and state.unseen:
        return Fate.UNSEEN
    is_restarted = (
        listed is not None and state is not None and state.incarnation != record.incarnation
    )
    if state is None or (state.own and not state.alive) or is_restarted:
        crash = report.crashes.get(record.incarnation)
        is_unloaded = crash is not None and names.mark(record.name) in crash.unloading
        return Fate.UNLOADED if is_unloaded else Fate.DIED
    return Fate.SILENT if listed is None else Fate.UNLISTED
