# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Where a nodelet runs, and how it comes up there: loaded, checked and connected."""

from __future__ import annotations

import collections
from dataclasses import replace
from typing import Counter, Iterable

from dyknow import names
from dyknow.datatypes import types_fit
from dyknow.errors import FixedTopics, HostError
from dyknow.locks import state_condition
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host, LoadRequest
from dyknow.manager.record import (
    NOTHING_HEARD,
    Record,
    declared_ports,
    missing_connections,
    topics_of,
    with_ports,
)
from dyknow.manager.specifications.given import set_on_load
from dyknow.model.graph import NodeletKind, PortState, State
from dyknow.model.transformation import NODE, Port, Transformation
from dyknow.periodic import Clock

#: Seconds without a further port after which those of a node that are missing come later: it is
#: lazy, and makes them once it has a subscriber or receives a message.
_SETTLED = 1.0
#: Seconds between two questions for the ports of a node that starts.
_STEP = 0.05


class Loading:
    """Chooses nodelet managers for nodelets, and loads them there."""

    def __init__(self, host: Host, graph: Graph, timeout: float, clock: Clock) -> None:
        """A nodelet may take ``timeout`` seconds to come up."""
        self._host = host
        self._graph = graph
        self._timeout = timeout
        self._clock = clock
        self._pause = state_condition("ports of nodes that start")

    def place(self, record: Record, near: Iterable[str] = ()) -> str:
        """Return the nodelet manager of a nodelet that is made or brought back, started if needed.

        It is the one where it was, or that the spawn names. Without one, it is the one that runs
        most neighbours of the nodelet on its topics and those ``near`` it, since messages go by
        reference there; else the one with fewest nodelets. One without live ports is used only if
        the spawn names it, or if the host can start no other.
        """
        kind = record.kind.host
        if record.isolated:
            return self._host.ensure(kind, record.name)
        states = self._host.states()
        present = states.get(record.manager)
        if present is not None:
            if present.own and not present.alive:
                self._host.ensure(present.kind)
            return record.manager
        shared = [
            state.name
            for state in states.values()
            if state.alive
            and state.responsive
            and state.rewirable
            and state.kind is kind
            and not state.isolated_for
        ]
        if not shared:
            return self._host.ensure(kind)
        wanted = {*record.topics.values(), *near}
        load: Counter[str] = collections.Counter()
        neighbours: Counter[str] = collections.Counter()
        for each in self._graph.all():
            load[each.manager] += 1
            used = {*topics_of(each).values(), *each.topics.values()}
            neighbours[each.manager] += not wanted.isdisjoint(used)
        return min(shared, key=lambda name: (-neighbours[name], load[name], name))

    def check(self, record: Record) -> None:
        """Raise HostError if a new nodelet cannot be in the nodelet manager that it names."""
        asked, kind = record.manager, record.kind
        """Check that a nodelet can go to the nodelet manager that was requested."""
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
        state = self._host.states().get(asked)
        if state is None:
            known = ", ".join(self._host.states()) or "none"
            raise HostError(f"unknown nodelet manager '{asked}'; known: {known}")
        if state.isolated_for:
            raise HostError(f"nodelet manager '{asked}' is there for '{state.isolated_for}' alone")
        if not state.alive:
            what = "does not answer" if state.away else "is not running"
            raise HostError(f"nodelet manager '{asked}' {what}")
        if state.kind is not kind.host:
            raise HostError(
                f"'{asked}' hosts no {kind.title}s: it is there for a {state.kind.title}"
            )

    def bring_up(self, record: Record) -> Record:
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
        state = self._host.states().get(record.manager)
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

    def _checked_ports(self, record: Record, deadline: float) -> tuple[PortState, ...]:
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


def _remappings(record: Record, transformation: Transformation) -> dict[str, str]:
    """Return the remappings that connect a nodelet from its start.

    What people spawn and was written for DyKnow is connected once it is up: the spawn returns when
    the connections to its peers are made, too. Of a claim's stream the first message shows that.

    What was not written for DyKnow would use the name of a port that is not remapped as its topic.
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
