# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Making, restoring and destroying nodelets; a failure leaves nothing behind.

A nodelet is placed in a nodelet manager, loaded there, checked against its transformation, and
connected.
"""

from __future__ import annotations

import collections
import contextlib
import logging
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Callable, Counter, Iterable, Mapping

from dyknow import names
from dyknow.datatypes import types_fit
from dyknow.errors import (
    DyKnowError,
    FixedTopics,
    HostError,
    HostTimeout,
    InvalidConfiguration,
    NameTaken,
    NotOurs,
    NotSpawnable,
    Protected,
    SpawnFailed,
    UnknownPort,
)
from dyknow.guards import NO_GUARDS, Guards
from dyknow.locks import state_condition
from dyknow.manager.graph import PATIENCE, Graph
from dyknow.manager.host import Host, LoadRequest, ProcessState
from dyknow.manager.library import Library
from dyknow.manager.record import (
    NOTHING_HEARD,
    UNSURE,
    Record,
    awaited_ports,
    declared_ports,
    missing_connections,
    seen_ports,
    topics_of,
    with_cut,
)
from dyknow.manager.specifications.given import completed, names_of, set_on_load
from dyknow.manager.store import Store
from dyknow.manager.supervision.hosts import HostTable
from dyknow.manager.supervision.suspects import Suspects
from dyknow.model.graph import NodeletKind, PortState, SpawnRequest, State
from dyknow.model.hosts import AT
from dyknow.model.transformation import NODE, Port, Program, Transformation
from dyknow.periodic import STEADY, Clock

#: Seconds without a further port after which those of a node that are missing come later: it is
#: lazy, and makes them once it has a subscriber or receives a message.
_SETTLED = 1.0
#: Seconds between two questions for the ports of a node that starts.
_STEP = 0.05

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class StreamKeeper:
    """Callbacks of the room that keeps streams for clients."""

    #: Returns the connections of a nodelet that can be made when it is brought back.
    fitting: Callable[[Record], Mapping[str, str]] = lambda record: record.topics
    #: Called with the record of a nodelet of a claim that died.
    on_death: Callable[[Record], None] = lambda record: None
    #: Called with the label of a nodelet whose code ran when its process crashed, and that was
    #: destroyed since.
    on_crash: Callable[[str], None] = lambda label: None
    #: Called with the label of a transformation that was replaced.
    on_replaced: Callable[[str], None] = lambda label: None


NO_STREAMS = StreamKeeper()
"""No streams are kept: nodelets come back with all their connections."""


def at_once(key: str, work: Callable[[], object]) -> None:
    """Call ``work`` now, in the thread of the caller."""
    work()


@dataclass(frozen=True)
class ManagerContext:
    """The context that the parts of a manager share."""

    host: Host  # reaches the nodelet managers
    store: Store  # durable state
    library: Library  # transformations
    graph: Graph  # the nodelets
    guards: Guards = NO_GUARDS  # limits and denials
    clock: Clock = STEADY  # steady time
    #: Brings a nodelet back, by key; it may take long.
    run: Callable[[str, Callable[[], object]], None] = at_once
    keeper: StreamKeeper = NO_STREAMS  # keeps streams
    namespace: str = "/"  # where relative names begin
    spawn_timeout: float = 10.0  # seconds that a nodelet may take to come up


class Lifecycle:
    """Makes, restores and destroys the nodelets of the graph."""

    def __init__(self, context: ManagerContext) -> None:
        self._host = context.host
        self._graph = context.graph
        self._guards = context.guards
        self._clock = context.clock
        self._timeout = context.spawn_timeout
        self._library = context.library
        self._pause = state_condition("ports of nodes that start")
        self._fitting = context.keeper.fitting
        #: Nodelets that are isolated since they crashed their processes.
        self.suspects = Suspects(context.clock.now)
        self.hosts = HostTable(context.host, context.clock.now)  # where they run
        self._on_replaced = context.keeper.on_replaced
        #: The code of libraries in C++, by the incarnation that has loaded them and the source.
        self._libraries: dict[tuple[str, str], str] = {}

    def acquit(self, label: str) -> None:
        """Forget the failures of a transformation, which was replaced."""
        self.suspects.acquit_transformation(label)
        self._on_replaced(label)

    # Making

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
        if transformation.type == NODE:
            self._guards.check_program(Program.of(transformation.source).name, is_own=True)
        parameters = completed(transformation, request.parameters, self._library.ontology)
        config = self._resolved(transformation, request.name, request.config)
        most = self._guards.nodelets
        with self._graph.changing(request.name, new=True, patience=PATIENCE, most=most):
            kind = self._host.kind_of(transformation)
            is_here = request.host != "" and request.host == self._host.here
            by_default = transformation.isolated and (is_here or not request.manager)
            isolated = request.isolated or kind.is_node or by_default
            record = Record(
                request.name,
                transformation,
                "" if request.host else request.manager,
                request.is_protected,
                isolated,
                topics=config,
                claimed=claimed,
                parameters=parameters,
                kind=kind.alone if isolated else kind,
                pinned=request.host,
            )
            self.suspects.know(record)
            if request.host:
                self._check_host(record)
            elif request.manager:
                self._check_place(record)
            else:
                record = self._judged(record)
            place = self._place(record, near)
            detail = f"it is being started{'' if kind.is_node else f' in {place}'}"
            code = self._code(record, place)
            record = replace(record, manager=place, detail=detail, code=code)
            try:
                self._graph.put(record)
                running = self._bring_up(record)
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

    def restore(self, record: Record) -> DyKnowError | None:
        """Bring back a nodelet that died, where it was or, if it is isolated, in a new process.

        It is isolated from now on if it is suspected of having crashed its process, and placed
        like a new one if its nodelet manager is gone. If that does not work, its record says
        FAILED, with the reason, which is returned too.
        """
        problem: DyKnowError | None = None
        record = replace(self._judged(record), superseded=False)
        why = (record.detail, "" if record.suspicion in record.detail else record.suspicion)
        detail = "; ".join(filter(None, why))
        starting = replace(record, state=State.STARTING, detail=detail, heard=NOTHING_HEARD)
        self._graph.put(starting)
        try:
            # Its place is on disk before it is there: the manager's next life finds it.
            place = self._place(starting)
            starting = replace(starting, manager=place, code=self._code(starting, place))
            self._graph.put(starting)
            starting = self.fitted(starting)
            running = self._bring_up(starting)
        except NameTaken as error:  # if it is a nodelet of ours, the next look finds it
            problem = error
            running = replace(starting, detail=error.holder)
        except DyKnowError as error:
            problem = error
            starting = replace(starting, incarnation=UNSURE)  # not in its former process
            is_gone = self._take_down(starting)
            _log.warning("%s is not back: %s", record.name, error)
            detail = "; ".join(filter(None, (str(error), record.suspicion)))
            running = replace(
                record,
                manager=starting.manager,
                code=starting.code,
                state=State.FAILED,
                detail=detail,
                ports=(),
                incarnation=record.incarnation if is_gone else UNSURE,
                superseded=not is_gone,
            )
        else:
            _log.info("%s is back", record.name)
        self._graph.put(running)
        return problem

    def fitted(self, record: Record) -> Record:
        """Disconnect the ports that must not be connected at present; claims give them back."""
        topics = self._fitting(record)
        cut = [port for port, topic in record.topics.items() if topics.get(port) != topic]
        return replace(with_cut(record, cut), topics=topics)

    def _judged(self, record: Record) -> Record:
        """Isolate a nodelet that is suspected of having crashed its process."""
        suspicion = self.suspects.verdict(record.name)
        if not suspicion:
            return record
        if not record.isolated:
            _log.warning("%s is given a process of its own; %s", record.name, suspicion)
            # Without the name of the process that it leaves, which does not end with it.
            record = replace(record, isolated=True, manager="", kind=record.kind.alone)
        return replace(record, suspicion=suspicion)

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

    # Its place

    def _place(self, record: Record, near: Iterable[str] = ()) -> str:
        """Return the nodelet manager of a nodelet that is made or brought back, started if needed.

        It is the one where it was, or that the spawn names, or one on the host that it names.
        Without one, it is the one that runs most neighbours of the nodelet on its topics and those
        ``near`` it, since messages go by reference there; then one on their host; then one on a
        host that is not overloaded; else the one with fewest nodelets. A host that was away too
        often lately is the last choice. One without live ports is used only if the spawn names it,
        or if the host can start no other.
        """
        kind = record.kind.host
        if record.isolated:
            return self._host.ensure(kind, record.name)
        present = self._host.states().get(record.manager)
        if (
            present is not None
            and not present.foreign
            and (present.kind is kind if present.alive else not record.pinned)
        ):
            if present.own and not present.alive:
                self._host.ensure(present.kind)
            return record.manager
        shared = [*self.hosts.managers(record.pinned, kind)]
        if not shared:
            if record.pinned not in ("", self._host.here):
                raise HostError(f"no nodelet manager on host '{record.pinned}' answers")
            return self._host.ensure(kind)
        wanted = {*record.topics.values(), *near} - {""}
        load: Counter[str] = collections.Counter()
        neighbours: Counter[str] = collections.Counter()
        outside = set(wanted)
        for each in self._graph.all():
            load[each.manager] += 1
            used = {*topics_of(each).values(), *each.topics.values()}
            neighbours[each.manager] += not wanted.isdisjoint(used)
            neighbours[AT + each.host] += not wanted.isdisjoint(used)
            outside -= used
        if outside and len(set(map(attrgetter("host"), shared))) > 1:
            with contextlib.suppress(HostError):  # without the ROS master they are not known
                neighbours.update(AT + host for host in self._host.publishing_hosts(outside))

        paused = self.hosts.paused

        def rank(state: ProcessState) -> tuple[object, ...]:
            return (
                state.host in paused,
                -neighbours[state.name],
                -neighbours[AT + state.host],
                state.machine.is_overloaded,
                load[state.name],
                state.name,
            )

        return min(shared, key=rank).name

    def _check_host(self, record: Record) -> None:
        """Raise HostError if a new nodelet cannot be on the host that was requested."""
        here = self._host.here
        if record.isolated and record.pinned != here:
            raise HostError(
                f"'{record.name}' would have a process of its own, which is started on host "
                f"'{here}' alone; '{record.pinned}' needs a nodelet in a nodelet manager"
            )
        self.hosts.check(record.pinned, record.kind.host)

    def _check_place(self, record: Record) -> None:
        """Raise HostError if a new nodelet cannot be in the nodelet manager that was requested."""
        asked, kind = record.manager, record.kind
        if kind.is_node:
            raise HostError(
                f"a {kind.title} has a process of its own, and is in no nodelet manager such as "
                f"'{asked}'"
            )
        if record.isolated:
            raise HostError(
                f"'{record.name}' cannot be isolated in nodelet manager '{asked}': "
                "expected a process of its own or a named one, not both"
            )
        self._host.look_for(asked)
        states = {each.name: each for each in self._host.states().values() if not each.foreign}
        state = states.get(asked)
        if state is None:
            raise HostError(
                f"unknown nodelet manager '{asked}'; known: {', '.join(states) or 'none'}; the "
                "parameter ~nodelet_managers of the DyKnow manager names further ones"
            )
        if state.isolated_for:
            raise HostError(f"nodelet manager '{asked}' is there for '{state.isolated_for}' alone")
        if not state.alive:
            what = "does not answer" if state.away else "is not running"
            raise HostError(f"nodelet manager '{asked}' {what}")
        if state.kind is not kind.host:
            raise HostError(
                f"'{asked}' hosts no {kind.title}s: it is there for a {state.kind.title}"
            )

    def _code(self, record: Record, place: str) -> str:
        """Return the code that a load would run; a library in C++ stays with its process."""
        assert record.transformation is not None
        source, code = record.transformation.source, ""
        if record.kind is NodeletKind.CPP:
            state = self._host.states().get(place)
            loaded = [
                each.code
                for each in self._graph.all()
                if each.transformation is not None
                and (each.transformation.source, each.manager) == (source, place)
                and state is not None
                and each.incarnation == state.incarnation
            ]
            incarnation = state.incarnation if state is not None else ""
            known = self._libraries.get((incarnation, source), "")
            code = next(filter(None, loaded), known)
        return code or self._host.code_of(place, record.transformation, anew=True)

    # Loading

    def _bring_up(self, record: Record) -> Record:
        """Load a nodelet, or start a node; check and connect its ports."""
        transformation = record.transformation
        assert transformation is not None
        request = LoadRequest(
            record.name,
            transformation.source,
            set_on_load(transformation, record.parameters),
            _remappings(record, transformation),
            record.kind,
        )
        if record.claimed and record.kind is NodeletKind.CPP:
            state = self._host.states().get(record.manager)
            if state is not None and not state.rewirable:
                raise FixedTopics(record.name, record.manager)  # a claim may move all its ports
        deadline = self._clock.now() + self._timeout
        self._host.load(record.manager, request, self._timeout)
        states = self._host.states()
        state = states.get(record.manager, ProcessState(record.manager))
        if record.kind is NodeletKind.CPP:  # also after the end of the nodelet
            alive = {each.incarnation for each in states.values()}
            kept = {key: code for key, code in self._libraries.items() if key[0] in alive}
            self._libraries = {(state.incarnation, transformation.source): record.code, **kept}
        awaited: tuple[str, ...] = ()
        if not state.rewirable:
            ports = declared_ports(record)
        else:
            if transformation.type == NODE:
                found = self._settled_ports(record.name, transformation, deadline)
            else:
                found = self._host.ports(record.name)
            _check_ports(record, transformation, found)
            wiring = missing_connections(record, found)
            if wiring:
                self._host.connect(record.name, wiring)
                found = tuple(replace(e, topic=wiring.get(e.name, e.topic)) for e in found)
            ports, awaited = seen_ports(record, found), awaited_ports(record, found)
        return replace(
            record,
            state=State.RUNNING,
            detail=record.suspicion,
            incarnation=state.incarnation,
            host=state.host,
            is_fixed=not state.rewirable,
            heard=NOTHING_HEARD,
            ports=ports,
            awaited=awaited,
        )

    def _settled_ports(
        self, name: str, transformation: Transformation, deadline: float
    ) -> tuple[PortState, ...]:
        """Wait for the declared ports of a node, which makes them one after the other."""
        declared = {port.name for port in transformation.ports}
        seen: set[str] = set()
        since = self._clock.now()
        while True:
            ports = self._host.ports(name)
            now = self._clock.now()
            found = declared & {port.name for port in ports if port.datatype}
            if found != seen:
                seen, since = found, now
            if found == declared or (found and (now - since >= _SETTLED or now >= deadline)):
                return ports
            if now >= deadline:
                break
            with self._pause:
                self._clock.wait(self._pause, _STEP)
        own = ", ".join(sorted(port.name for port in ports)) or "none"
        raise HostError(
            f"it has none of the declared ports {', '.join(sorted(declared))} within "
            f"{self._timeout:g} s; its ports: {own}"
        )

    # Destroying

    def destroy(self, name: str) -> None:
        """Destroy a nodelet; if its process does not answer in time, as soon as it does."""
        with self._graph.changing_present(name) as record:
            if record.is_protected:
                raise Protected(name)
            state = self._host.states().get(record.manager)
            if state is not None and state.foreign and not record.is_spawned:
                raise NotOurs(name, record.manager, record.owner)
            try:
                self.end(record)
            except HostTimeout as error:
                later = self._destroy_later(record)
                raise HostTimeout(f"'{name}' is not destroyed yet: {error}; {later}") from error
            self._graph.remove(record.name)

    def _destroy_later(self, record: Record) -> str:
        """Have a nodelet that may still run destroyed later; returns when."""
        later = f"it is destroyed as soon as {record.manager} answers"
        self._graph.put(replace(record, state=State.LOST, detail=later, unwanted=True))
        return later

    def end(self, record: Record) -> None:
        """End a nodelet, with its parameters and a process of its own; its record stays.

        Raises HostError if it may still run.
        """
        if record.state is not State.FAILED or record.is_ending:
            self._unload(record)
        self.dispose(record)

    def clear(self, record: Record, is_heard: bool = True) -> None:
        """Destroy a nodelet in any state, later if it was up and its process does not answer.

        Unless ``is_heard``, nothing is known yet of a process that does not answer.
        """
        if self._take_down(record):
            self._graph.remove(record.name)
        elif is_heard and self._host.reported(record.manager, record.name) is None:
            self.forget(record)
        else:
            self._destroy_later(record)

    def forget(self, record: Record) -> None:
        """Forget a nodelet that is gone, with its parameters and its process."""
        self.dispose(record)
        self._graph.remove(record.name)

    def _unload(self, record: Record) -> None:
        if self._is_displaced(record):
            return
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
        if record.incarnation not in ("", UNSURE, state.incarnation):
            return True
        return record.name not in self._host.list(record.manager)

    def _take_down(self, record: Record) -> bool:
        """End a nodelet if that is possible; returns whether it is certainly gone.

        While it may still run, it keeps its parameters.
        """
        try:
            self._unload(record)
        except HostError as error:
            _log.debug("%s: %s", record.name, error)
            return False
        self.dispose(record)
        return True

    def dispose(self, record: Record) -> None:
        """Delete the parameters of a nodelet that is gone, and end its own process."""
        if self._is_displaced(record):
            return
        if record.is_spawned:
            self._host.forget(record.name, parameter_names(record))
        if record.isolated:
            self._host.retire(record.manager)

    def _is_displaced(self, record: Record) -> bool:
        return is_displaced(record, self._host.states().get(record.manager))


def is_displaced(record: Record, state: ProcessState | None) -> bool:
    """Whether a node of another client has the name of one of ours, which has ended."""
    return state is not None and state.foreign and record.is_spawned and record.kind.is_node


def parameter_names(record: Record) -> list[str]:
    """List the parameters that the load of a nodelet sets."""
    made = record.transformation
    declared = [each.name for each in made.parameters] if made is not None else []
    return [*declared, *names_of(record.parameters)]


def _check_ports(
    record: Record, transformation: Transformation, ports: Iterable[PortState]
) -> None:
    """Raise HostError if the ports of a nodelet are not those that its transformation declares."""
    found = {port.name: port for port in ports}
    wrong = []
    for port in transformation.ports:
        real = found.get(port.name)
        if not record.kind.is_written_for_dyknow and (real is None or not real.datatype):
            # A lazy one subscribes once another node listens, unless this is its misspelling.
            misspelt = _namesake(port, found.values(), transformation)
            if misspelt:
                wrong.append(f"it has no port '{port.name}'; did you mean '{misspelt}'?")
        elif real is None:
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


def _namesake(port: Port, ports: Iterable[PortState], transformation: Transformation) -> str:
    """Return a port that is there and not declared, whose name differs in its namespace alone."""
    declared = {each.name for each in transformation.ports}
    base = port.name.lstrip("~/")
    alike = (
        each.name
        for each in ports
        if each.datatype and each.direction == port.direction and each.name not in declared
    )
    return next((name for name in alike if name.lstrip("~/") == base), "")


def _remappings(record: Record, transformation: Transformation) -> dict[str, str]:
    """Return the remappings that connect a nodelet from its start.

    A nodelet for DyKnow that people spawn is connected once it is up: the spawn returns when the
    connections to its peers are made, too. Of a claim's stream the first message shows that.

    Code that was not written for DyKnow uses the name of a port that is not remapped as its topic.
    So a disconnected port is remapped to a topic below ``NODELET/disconnected``: a re-wirable
    nodelet manager takes it for disconnected, and in a stock one nothing else uses it.
    """
    is_ours = record.kind.is_written_for_dyknow
    if is_ours and not record.claimed:
        return {}
    found: dict[str, str] = {}
    for port in transformation.ports:
        topic = record.topics.get(port.name, "")
        if not topic and not is_ours:
            topic = names.disconnected(record.name, port.name)
        if topic:
            found[names.resolve(port.name, names.parent(record.name), record.name)] = topic
    return found
