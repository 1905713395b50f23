# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Making and destroying nodelets; what fails leaves nothing behind."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass, replace
from typing import Callable, Dict, Iterable, List, Mapping, Optional, Set, Tuple

from dyknow import names
from dyknow.datatypes import types_fit
from dyknow.errors import (
    DyKnowError,
    FixedTopics,
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
from dyknow.locks import state_condition
from dyknow.manager import placement
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host, LoadRequest, ManagerState
from dyknow.manager.record import (
    NOTHING_HEARD,
    Record,
    declared_ports,
    missing_connections,
    with_ports,
)
from dyknow.manager.specifications.given import completed, names_of, set_on_load
from dyknow.manager.specifications.tags import Subsumption
from dyknow.manager.suspects import Suspects
from dyknow.model.graph import NodeletKind, PortState, SpawnRequest, State
from dyknow.model.transformation import NODE, Port, Program, Transformation
from dyknow.periodic import Clock

#: Seconds without a further port after which those of a node that are missing come later: it is
#: lazy, and makes them once somebody listens to it or sends it something.
_SETTLED = 1.0
#: Seconds between two questions for the ports of a node that starts.
_STEP = 0.05
#: Seconds to wait for a look, or another operation, to be done with a nodelet.
PATIENCE = 5.0

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class StreamKeeper:
    """What the manager asks of, and reports to, those who keep streams for clients.

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
        """Prepare.

        Args:
            host: reaches the nodelet managers.
            graph: the nodelets.
            guards: what is forbidden.
            spawn_timeout: seconds that a nodelet may take to come up.
            suspects: nodelets that get processes of their own.
            ontology: what is a kind of what.
            clock: steady time.
            keeper: says which connections come back.
        """
        self._host = host
        self._graph = graph
        self._guards = guards
        self._timeout = spawn_timeout
        self._suspects = suspects
        self._ontology = ontology
        self._clock = clock
        self._pause = state_condition("ports of nodes that start")
        self.fitting = keeper.fitting

    def spawn(
        self,
        transformation: Transformation,
        request: SpawnRequest,
        claimed: bool = False,
        near: Iterable[str] = (),
    ) -> Record:
        """Make a nodelet of a transformation.

        Args:
            transformation: what to make.
            request: how; its name is global.
            claimed: whether it is made for a claim, not by hand.
            near: topics that it will be connected to: its place is near their nodelets.

        Raises:
            DyKnowError: it did not work, and nothing is left of it.
        """
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
            planned = Record(
                request.name, transformation, "", claimed=claimed, parameters=parameters, kind=kind
            )
            self._suspects.know(planned)
            suspicion = "" if request.manager else self._suspects.verdict(request.name)
            isolated = (
                request.isolated
                or kind.is_node
                or (transformation.isolated and not request.manager)
            )
            if suspicion and not isolated:
                _log.warning("%s is given a process of its own; %s", request.name, suspicion)
            isolated = isolated or bool(suspicion)
            kind = kind.alone if isolated else kind
            manager = placement.choose(
                self._host,
                self._graph.all(),
                kind,
                (*config.values(), *near),
                request.manager,
                request.name if isolated else "",
            )
            record = replace(
                planned,
                kind=kind,
                manager=manager,
                is_protected=request.is_protected,
                isolated=isolated,
                topics=config,
                suspicion=suspicion,
            )
            try:
                self._graph.put(record)
                running = self._bring_up(record)
            except NameTaken:  # by a nodelet of others that was not seen yet: it stays
                self._graph.remove(record.name)
                with contextlib.suppress(HostError):
                    if record.isolated and record.name not in self._host.list(manager):
                        self._host.retire(manager)
                raise
            except BaseException as error:
                self._take_down(record)
                self._graph.remove(record.name)
                if isinstance(error, DyKnowError):
                    raise SpawnFailed(record.name, error) from error
                raise
            self._graph.put(running)
            return running

    def restore(self, record: Record) -> Record:
        """Bring back a nodelet that died, where it was or, if it is isolated, in a new process.

        A nodelet that is suspected of having crashed its process is isolated from now on. One
        whose nodelet manager exists no more is placed as a new one is.

        Returns:
            Its record, which says FAILED, with the reason, if that did not work.
        """
        transformation = record.transformation
        assert transformation is not None
        suspicion = self._suspects.verdict(record.name)
        if suspicion and not record.isolated:
            _log.warning("%s is given a process of its own; %s", record.name, suspicion)
            # Without the name of the process that it leaves, which does not end with it.
            record = replace(record, isolated=True, manager="", kind=record.kind.alone)
        record = replace(record, suspicion=suspicion or record.suspicion)
        starting = replace(
            record, state=State.STARTING, detail=record.suspicion, heard=NOTHING_HEARD
        )
        self._graph.put(starting)  # from now on it counts where it will be
        try:
            # Its place is on disk before it is there: the manager's next life finds it.
            starting = replace(starting, manager=self._place_again(starting))
            self._graph.put(starting)
            starting = replace(starting, topics=self.fitting(starting))
            running = self._bring_up(starting)
        except NameTaken:
            return starting  # it is there: the next look finds it
        except DyKnowError as error:
            self._take_down(starting)
            detail = "; ".join(filter(None, (str(error), record.suspicion)))
            running = replace(
                record, manager=starting.manager, state=State.FAILED, detail=detail, ports=()
            )
        self._graph.put(running)
        return running

    def destroy(self, name: str) -> None:
        """Destroy a nodelet.

        Raises:
            UnknownNodelet: there is none of that name.
            Protected: it is protected.
            HostTimeout: its nodelet manager does not answer; the nodelet is destroyed as soon as
                it does.
            HostError: its nodelet manager refused.
        """
        self._graph.get(name)
        with self._graph.changing(name, patience=PATIENCE) as record:
            if record is None:
                self._graph.get(name)
                return
            if record.is_protected:
                raise Protected(name)
            if record.state in (State.RUNNING, State.LOST):
                try:
                    self._unload(record)
                except HostTimeout as error:
                    later = f"it is destroyed as soon as {record.manager} answers"
                    self._graph.put(replace(record, state=State.LOST, detail=later, unwanted=True))
                    raise HostTimeout(
                        f"'{name}' is not destroyed yet: {error}; {later}"
                    ) from error
            self._dispose(record)
            self._graph.remove(name)

    def finish_destroying(self, record: Record) -> None:
        """Destroy a nodelet whose nodelet manager did not answer when it should be destroyed."""
        try:
            self._unload(record)
        except HostError as error:
            _log.warning("%s: %s", record.name, error)
            return
        self._dispose(record)
        self._graph.remove(record.name)
        _log.info("%s, which was to be destroyed, is destroyed now", record.name)

    def clear(self, record: Record) -> None:
        """Destroy a nodelet, whatever its state."""
        self._take_down(record)
        self._graph.remove(record.name)

    def forget(self, record: Record) -> None:
        """Forget a nodelet that others unloaded on purpose."""
        self._dispose(record)
        self._graph.remove(record.name)

    # Inside

    def _place_again(self, record: Record) -> str:
        """Return the nodelet manager for one that died: where it was, if that is there or ours.

        Raises:
            HostError: no nodelet manager comes up.
        """
        if record.isolated:
            return self._host.ensure(record.kind.host, record.name)
        state = self._state(record.manager)
        if state is None:  # it died while there was no manager, and has no successor
            return placement.choose(
                self._host, self._graph.all(), record.kind, record.topics.values()
            )
        if state.own and not state.alive:
            self._host.ensure(state.kind)
        return record.manager

    def _unload(self, record: Record) -> None:
        try:
            self._host.unload(record.manager, record.name)
        except HostError:
            if not self._is_gone(record):
                raise

    def _is_gone(self, record: Record) -> bool:
        """Whether a nodelet that could not be unloaded is certainly gone."""
        state = self._state(record.manager)
        if record.isolated or state is None:
            return True
        if state.away or not state.alive:
            return not state.away
        if record.incarnation not in ("", state.incarnation):
            return True
        return record.name not in self._host.list(record.manager)

    def _resolved(
        self, transformation: Transformation, name: str, config: Mapping[str, str]
    ) -> Dict[str, str]:
        known = [port.name for port in transformation.ports]
        problems: List[DyKnowError] = []
        resolved: Dict[str, str] = {}
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

    def _bring_up(self, record: Record) -> Record:
        transformation = record.transformation
        assert transformation is not None
        request = LoadRequest(
            record.name,
            transformation.source,
            set_on_load(transformation, record.parameters),
            {} if record.kind.is_written_for_dyknow else _remappings(record, transformation),
            record.kind,
        )
        if record.claimed and record.kind is NodeletKind.CPP:
            state = self._state(record.manager)
            if state is not None and not state.rewirable:
                raise FixedTopics(record.name, record.manager)  # a claim may move all its ports
        deadline = self._clock.now() + self._timeout
        self._host.load(record.manager, request, self._timeout)
        state = self._state(record.manager)
        record = replace(
            record,
            state=State.RUNNING,
            detail=record.suspicion,
            incarnation=state.incarnation if state is not None else "",
            host=state.host if state is not None else "",
            is_fixed=state is not None and not state.rewirable,
            heard=NOTHING_HEARD,
        )
        if record.is_fixed:
            return replace(record, ports=declared_ports(record))
        ports = self._checked_ports(record, deadline)
        wiring = missing_connections(record, ports)
        if wiring:
            self._host.connect(record.name, wiring)
            ports = tuple(replace(port, topic=wiring.get(port.name, port.topic)) for port in ports)
        return with_ports(record, ports)

    def _checked_ports(self, record: Record, deadline: float) -> Tuple[PortState, ...]:
        transformation = record.transformation
        assert transformation is not None
        if transformation.type == NODE:
            ports = self._settled_ports(record.name, transformation, deadline)
        else:
            ports = self._host.ports(record.name)
        found = {port.name: port for port in ports}
        wrong = []
        for port in transformation.ports:
            real = found.get(port.name)
            if not record.kind.is_written_for_dyknow and (real is None or not real.datatype):
                # A lazy one subscribes once another node listens, unless this is its misspelling.
                misspelt = _namesake(port, ports, transformation)
                if misspelt:
                    wrong.append(f"it has no port '{port.name}'; did you mean '{misspelt}'?")
                continue
            if real is None:
                known = ", ".join(sorted(found)) or "none"
                wrong.append(f"it has no port '{port.name}'; its ports: {known}")
            elif real.direction != port.direction:
                wrong.append(
                    f"port '{port.name}' is an {real.direction}-port, "
                    f"the transformation says {port.direction}"
                )
            elif not types_fit(port.datatype, real.datatype):
                wrong.append(
                    f"port '{port.name}' carries {real.datatype}, "
                    f"the transformation says {port.datatype}"
                )
        if wrong:
            raise HostError("; ".join(wrong))
        return ports

    def _settled_ports(
        self, name: str, transformation: Transformation, deadline: float
    ) -> Tuple[PortState, ...]:
        """Wait for the declared ports of a node, which makes them one after the other.

        Raises:
            HostError: it has made none of them when its time is over.
        """
        declared = {port.name for port in transformation.ports}
        seen: Set[str] = set()
        since = self._clock.now()
        while True:
            ports = self._host.ports(name)
            now = self._clock.now()
            found = declared & {port.name for port in ports if port.datatype}
            if found != seen:
                seen, since = found, now
            if found == declared or (found and now - since >= _SETTLED):
                return ports
            if now >= deadline:
                break
            with self._pause:
                self._clock.wait(self._pause, _STEP)
        if found:
            return ports
        own = ", ".join(sorted(port.name for port in ports)) or "none"
        raise HostError(
            f"it has none of the declared ports {', '.join(sorted(declared))} within "
            f"{self._timeout:g} s; its ports: {own}"
        )

    def _take_down(self, record: Record) -> None:
        self._drop(record)
        self._dispose(record)

    def _drop(self, record: Record) -> None:
        try:
            self._host.unload(record.manager, record.name)
        except HostError as error:
            _log.debug("%s: %s", record.name, error)

    def _dispose(self, record: Record) -> None:
        if record.is_spawned and record.transformation is not None:
            declared = [each.name for each in record.transformation.parameters]
            self._host.forget(record.name, [*declared, *names_of(record.parameters)])
        if record.isolated:
            self._host.retire(record.manager)

    def _state(self, manager: str) -> Optional[ManagerState]:
        return next((each for each in self._host.managers() if each.name == manager), None)


def _namesake(port: Port, ports: Iterable[PortState], transformation: Transformation) -> str:
    """Return a port that is there and not declared, whose name differs in its namespace alone."""
    declared = {each.name for each in transformation.ports}
    base = port.name.lstrip("~/")
    return next(
        (
            each.name
            for each in ports
            if each.datatype
            and each.direction == port.direction
            and each.name not in declared
            and each.name.lstrip("~/") == base
        ),
        "",
    )


def _remappings(record: Record, transformation: Transformation) -> Dict[str, str]:
    """Return the remappings that wire what was not written for DyKnow from its start.

    A port that is not remapped would use its own name as its topic. So a port that is connected to
    nothing is remapped, too, to a topic below ``NODELET/disconnected``: a re-wirable nodelet
    manager takes it for disconnected, and in a stock one nothing else uses it.
    """
    return {
        names.resolve(port.name, names.parent(record.name), record.name): record.topics.get(
            port.name, ""
        )
        or names.disconnected(record.name, port.name)
        for port in transformation.ports
    }
