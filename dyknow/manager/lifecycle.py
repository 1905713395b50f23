# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Making and destroying nodelets; a failure leaves nothing behind."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass, replace
from typing import Callable, Iterable, Mapping

from dyknow import names
from dyknow.errors import (
    DyKnowError,
    HostError,
    HostTimeout,
    InvalidConfiguration,
    LimitExceeded,
    NameTaken,
    NotSpawnable,
    Protected,
    SpawnFailed,
    UnknownPort,
)
from dyknow.guards import Guards
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host
from dyknow.manager.loading import Loading
from dyknow.manager.record import NOTHING_HEARD, Record, with_present_ports
from dyknow.manager.specifications.given import completed, names_of
from dyknow.manager.specifications.tags import Subsumption
from dyknow.manager.suspects import Suspects
from dyknow.model.graph import SpawnRequest, State
from dyknow.model.transformation import NODE, Program, Transformation
from dyknow.periodic import Clock

#: Seconds to wait for a look, or another operation, to be done with a nodelet.
PATIENCE = 5.0

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class StreamKeeper:
    """Callbacks of the room that keeps streams for clients.

    Attributes:
        fitting: returns the connections of a nodelet that can be made when it is brought back.
        on_death: called with the record of a nodelet of a claim that died.
        on_crash: called with the label of a nodelet whose code ran when its process crashed, and
            that was destroyed since.
    """

    fitting: Callable[[Record], Mapping[str, str]] = lambda record: record.topics
    on_death: Callable[[Record], None] = lambda record: None
    on_crash: Callable[[str], None] = lambda label: None


NO_STREAMS = StreamKeeper()
"""No streams are kept: nodelets come back with all their connections."""


class Lifecycle:
    """Makes, restores and destroys the nodelets of the graph."""

    def __init__(
        self,
        host: Host,
        graph: Graph,
        guards: Guards,
        spawn_timeout: float,
        suspects: Suspects,
        ontology: Subsumption,
        clock: Clock,
        keeper: StreamKeeper = NO_STREAMS,
    ) -> None:
        """A nodelet may take ``spawn_timeout`` seconds to come up."""
        self._host = host
        self._graph = graph
        self._guards = guards
        self._loading = Loading(host, graph, spawn_timeout, clock)
        self._suspects = suspects
        self._ontology = ontology
        self.fitting = keeper.fitting

    def spawn(
        self,
        transformation: Transformation,
        request: SpawnRequest,
        claimed: bool = False,
        near: Iterable[str] = (),
    ) -> Record:
        """Make a nodelet, ``near`` those of topics; if that fails, nothing is left of it."""
        if transformation.is_described:
            what = f"node '{transformation.node}'" if transformation.node else ""
            what = what or f"topic '{transformation.source}'"
            raise NotSpawnable(transformation.label, what)
        count = len(self._graph.all()) + 1
        if count > self._guards.nodelets:
            raise LimitExceeded("nodelets", count, self._guards.nodelets)
        if transformation.type == NODE:
            self._guards.check_program(Program.of(transformation.source).name, is_own=True)
        parameters = completed(transformation, request.parameters, self._ontology)
        config = self._resolved(transformation, request.name, request.config)
        with self._graph.changing(request.name, new=True, patience=PATIENCE):
            kind = self._host.kind_of(transformation)
            by_default = transformation.isolated and not request.manager
            isolated = request.isolated or kind.is_node or by_default
            record = Record(
                request.name,
                transformation,
                request.manager,
                request.is_protected,
                isolated,
                topics=config,
                claimed=claimed,
                parameters=parameters,
                kind=kind.alone if isolated else kind,
            )
            self._suspects.know(record)
            if request.manager:
                self._loading.check(record)
            else:
                record = self._judged(record)
            place = self._loading.place(record, near)
            detail = f"it is being started{'' if kind.is_node else f' in {place}'}"
            record = replace(record, manager=place, detail=detail)
            try:
                self._graph.put(record)
                running = self._loading.bring_up(record)
            except NameTaken:  # by an external nodelet that was not seen yet: it stays
                self._graph.remove(record.name)
                with contextlib.suppress(HostError):
                    if record.isolated and record.name not in self._host.list(record.manager):
                        self._host.retire(record.manager)
                raise
            except BaseException as error:
                self.clear(record)
                if isinstance(error, DyKnowError):
                    raise SpawnFailed(record.name, error) from error
                raise
            self._graph.put(running, soon=claimed)  # with the claim; the next life clears it
            return running

    def restore(self, record: Record) -> None:
        """Bring back a nodelet that died, where it was or, if it is isolated, in a new process.

        It is isolated from now on if it is suspected of having crashed its process, and placed
        like a new one if its nodelet manager is gone. If that does not work, its record says
        FAILED, with the reason.
        """
        record = self._judged(record)
        why = (record.detail, "" if record.suspicion in record.detail else record.suspicion)
        starting = replace(
            record,
            state=State.STARTING,
            detail="; ".join(filter(None, why)),
            heard=NOTHING_HEARD,
        )
        self._graph.put(starting)
        try:
            # Its place is on disk before it is there: the manager's next life finds it.
            starting = replace(starting, manager=self._loading.place(starting))
            self._graph.put(starting)
            starting = replace(starting, topics=self.fitting(starting))
            running = self._loading.bring_up(starting)
        except NameTaken as error:  # if it is a nodelet of ours, the next look finds it
            running = replace(starting, detail=error.holder)
        except DyKnowError as error:
            self._take_down(starting)
            _log.warning("%s is not back: %s", record.name, error)
            detail = "; ".join(filter(None, (str(error), record.suspicion)))
            running = replace(
                record, manager=starting.manager, state=State.FAILED, detail=detail, ports=()
            )
        else:
            _log.info("%s is back", record.name)
        self._graph.put(running)

    def destroy(self, name: str) -> None:
        """Destroy a nodelet; if its process does not answer in time, as soon as it does."""
        self._graph.get(name)
        with self._graph.changing(name, patience=PATIENCE) as record:
            if record is None:
                self._graph.get(name)
                return
            if record.is_protected:
                raise Protected(name)
            try:
                if record.state in (State.RUNNING, State.LOST):
                    self._unload(record)
            except HostTimeout as error:
                later = f"it is destroyed as soon as {record.manager} answers"
                self._graph.put(replace(record, state=State.LOST, detail=later, unwanted=True))
                raise HostTimeout(f"'{name}' is not destroyed yet: {error}; {later}") from error
            self.forget(record)

    def finish_destroying(self, record: Record) -> None:
        """Destroy a nodelet whose nodelet manager did not answer when it should be destroyed."""
        try:
            self._unload(record)
        except HostError as error:
            _log.warning("%s: %s", record.name, error)
            return
        self.forget(record)
        _log.info("%s, which was to be destroyed, is destroyed now", record.name)

    def clear(self, record: Record) -> None:
        """Destroy a nodelet in any state."""
        self._take_down(record)
        self._graph.remove(record.name)

    def forget(self, record: Record) -> None:
        """Forget a nodelet that is gone, with its parameters and its process."""
        self._dispose(record)
        self._graph.remove(record.name)

    # Inside

    def _judged(self, record: Record) -> Record:
        """Isolate a nodelet that is suspected of having crashed its process."""
        suspicion = self._suspects.verdict(record.name)
        if not suspicion:
            return record
        if not record.isolated:
            _log.warning("%s is given a process of its own; %s", record.name, suspicion)
            # Without the name of the process that it leaves, which does not end with it.
            record = replace(record, isolated=True, manager="", kind=record.kind.alone)
        return replace(record, suspicion=suspicion)

    def _unload(self, record: Record) -> None:
        try:
            self._host.unload(record.manager, record.name)
        except HostError:
            if not self._is_gone(record):
                raise

    def _is_gone(self, record: Record) -> bool:
        """Whether a nodelet that could not be unloaded is certainly gone."""
        state = self._host.states().get(record.manager)
        if record.isolated or state is None:
            return True
        if state.away or not state.alive:
            return not state.away
        if record.incarnation not in ("", state.incarnation):
            return True
        return record.name not in self._host.list(record.manager)

    def _resolved(
        self, transformation: Transformation, name: str, config: Mapping[str, str]
    ) -> dict[str, str]:
        known = [port.name for port in transformation.ports]
        problems: list[DyKnowError] = []
        resolved: dict[str, str] = {}
        for port, text in config.items():
            if port not in known:
                problems.append(UnknownPort(port, known))
                continue
            try:
                topic = names.resolve(text, names.parent(name), name, "topic name") if text else ""
                self._guards.check_topic(topic)
                resolved[port] = topic
            except DyKnowError as problem:
                problems.append(problem)
        if problems:
            raise InvalidConfiguration(name, problems)
        return resolved

    def _take_down(self, record: Record) -> None:
        try:
            self._host.unload(record.manager, record.name)
        except HostError as error:
            _log.debug("%s: %s", record.name, error)
        self._dispose(record)

    def _dispose(self, record: Record) -> None:
        if record.is_spawned and record.transformation is not None:
            declared = [each.name for each in record.transformation.parameters]
            self._host.forget(record.name, [*declared, *names_of(record.parameters)])
        if record.isolated:
            self._host.retire(record.manager)


def show_ports(graph: Graph, host: Host, name: str, patience: float = 0.0) -> None:
    """Show the present ports of a nodelet at once."""
    with graph.changing(name, patience=patience) as record:
        if record is not None and record.state is State.RUNNING:
            graph.put(with_present_ports(record, host.ports(name)))
