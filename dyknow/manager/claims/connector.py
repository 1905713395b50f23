# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads the world, and changes it: connects ports, one nodelet at a time or several as one.

A connection that was not answered in time may be made later. Its nodelet is polled until it
answers, and for a while after that its ports count on the topics that they were sent to.
"""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass, replace
from functools import partial
from typing import Callable, Hashable, Iterable, Mapping

from dyknow import names
from dyknow.errors import Busy, DyKnowError, FixedTopics, HostError, HostTimeout, NameTaken
from dyknow.manager.claims.claim_table import ClaimLock, ClaimTable
from dyknow.manager.claims.ends import ends_of
from dyknow.manager.claims.judgements import StreamMonitor
from dyknow.manager.claims.world import Config, World
from dyknow.manager.manager import Manager
from dyknow.manager.record import (
    NOTHING_HEARD,
    Record,
    seen_ports,
    with_cut,
    with_present_ports,
    without_cut,
)
from dyknow.manager.steps import ReversibleStep, take_back
from dyknow.manager.supervision.lifecycle import ManagerContext
from dyknow.model.graph import SpawnRequest, State
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import Transformation

#: Seconds to wait for a look to be done with a nodelet.
_PATIENCE = 1.0
#: Seconds for which a connection that was not answered may still be made.
_LATE = 30.0
#: Seconds until a nodelet that did not answer is polled again.
_PAUSE = 1.0

_log = logging.getLogger("rosout.dyknow")


class Connector:
    """Reads the world, connects ports, and asks the nodelets whose connections are not known."""

    def __init__(self, context: ManagerContext, table: ClaimTable) -> None:
        self._host = context.host
        self._graph = context.graph
        self._library = context.library
        self._table = table
        self._guards = context.guards
        self._namespace = context.namespace
        self._clock = context.clock.now
        #: The world that was read last, when, and what it is based on; threads read the three as
        #: one, and replace them as one.
        nothing = World(context.library.ontology, {})
        self._known: tuple[World, Hashable, Hashable] = nothing, None, None
        #: Topics that a port was sent to without an answer, and until when it may arrive there;
        #: replaced as a whole by every change.
        self._late: Mapping[tuple[str, str], Mapping[str, float]] = {}
        #: Nodelets whose connections are not known, and when to ask them.
        self.unknown: dict[str, float] = {}

    def world(self) -> World:
        """Return the world of this moment; only changes are read again. Safe from any thread."""
        # The revisions come first: a change meanwhile is read the next time.
        at = (self._library.revision, self._late, self._graph.revision, self._table.living)
        world, known_at, basis = self._known
        if known_at == at:
            return world
        records = self._graph.records
        if basis != at[:2]:
            world = World(self._library.ontology, self._descriptions(), self._late)
        lost = [each for each in records.values() if each.state is State.LOST]
        states = self._host.states() if lost else {}
        gone = {name for name, each in records.items() if each.state is State.FAILED}
        for each in lost:  # it may run on while its process does
            state = states.get(each.manager)
            if state is None or state.incarnation != each.incarnation:
                gone.add(each.name)
        world = world.read(records, at[3], records.keys() - gone)
        self._known = world, None if lost else at, at[:2]
        return world

    def _descriptions(self) -> dict[str, tuple[Transformation, ...]]:
        found: dict[str, tuple[Transformation, ...]] = {}
        for each in self._library.topics():
            topic = names.join(self._namespace, each.source)
            topic = each.source if each.source[:1] == "/" else topic
            found[topic] = (*found.get(topic, ()), each._replace(source=topic))
        return found

    def remember(self) -> None:
        """Store the bindings of nodelets with variables."""
        world = self.world()
        for name, heard in world.heard.items():
            known = world.records.get(name)
            if known is None or known.heard == heard or known.state is not State.RUNNING:
                continue
            with contextlib.suppress(Busy), self._graph.changing(
                name, patience=_PATIENCE
            ) as record:
                if record is not None and heard.topics in ((), ends_of(record).listening):
                    self._graph.put(replace(record, heard=heard))

    def connect(self, name: str, config: Config) -> None:
        """Connect ports of a nodelet, and show it in the graph at once."""
        for topic in config.values():
            self._guards.check_topic(topic)
        record = self._graph.records[name]
        if record.is_fixed:
            raise FixedTopics(name, record.manager)
        try:
            self._note(record, config)  # first: what is not answered may be done
            self._host.connect(name, config)
            self._show(name, config)
        except (HostError, Busy) as error:
            self.unknown[name] = now = self._clock()
            if isinstance(error, HostTimeout):
                new = {(name, port): {topic: now + _LATE} for port, topic in config.items()}
                known = {place: {**self._late.get(place, {}), **new[place]} for place in new}
                self._late = {**self._late, **known}
            raise
        self.remember()

    def ask(self) -> None:
        """Ask the nodelets whose connections are not known, and show these in the graph."""
        now = self._clock()
        hanging: set[str] = set()
        for name in sorted(self.unknown):
            record = self._graph.find(name)
            if record is None:
                self._settle(name)
            elif (
                record.state is State.RUNNING
                and self.unknown[name] <= now
                and record.manager not in hanging
            ):
                self.unknown[name] = now + _PAUSE
                try:
                    with self._graph.changing(name) as present:
                        if present is not None and present.state is State.RUNNING:
                            ports = self._host.ports(name)
                            self._graph.put(with_present_ports(present, ports))
                except HostTimeout:
                    hanging.add(record.manager)
                except DyKnowError:
                    continue  # it is polled again
                else:
                    self._settle(name, self._clock())

    def _note(self, record: Record, config: Config) -> None:
        """Remember where the user of a nodelet has the ports that are about to be moved."""
        if with_cut(record, config) == record:
            return
        with self._graph.changing(record.name, patience=_PATIENCE) as present:
            if present is not None:
                self._graph.put(with_cut(present, config))

    def _show(self, name: str, config: Config) -> None:
        with self._graph.changing(name, patience=_PATIENCE) as record:
            if record is None:
                return
            ports = tuple(
                replace(port, topic=config.get(port.name, port.topic)) for port in record.ports
            )
            topics = {**record.topics, **config}
            after = replace(record, topics=topics, ports=seen_ports(record, ports))
            after = without_cut(after, [p for p, topic in record.cut if config.get(p) == topic])
            if ends_of(after).listening != record.heard.topics:
                after = replace(after, heard=NOTHING_HEARD)
            self._graph.put(after)

    def _settle(self, name: str, now: float = float("inf")) -> None:
        """Forget connections that cannot arrive any more; without any, a nodelet is known."""
        late = {
            place: {
                topic: until for topic, until in topics.items() if place[0] != name or until > now
            }
            for place, topics in self._late.items()
        }
        self._late = {place: topics for place, topics in late.items() if topics}
        if not any(place[0] == name for place in self._late):
            self.unknown.pop(name, None)


@dataclass(frozen=True)
class ClaimContext:
    """The context that the parts of the reconciler share."""

    manager: Manager
    table: ClaimTable
    lock: ClaimLock
    connector: Connector
    monitor: StreamMonitor
    clock: Callable[[], float]
    sleep: Callable[[float], None]


class Transaction:
    """Spawns and connects nodelets for claims; everything that it did can be undone."""

    def __init__(self, context: ClaimContext) -> None:
        self._context = context
        self._graph = context.manager.graph
        self._connector = context.connector
        self.world = context.connector.world()  # the world after the latest change
        self.spawned: list[str] = []  # names of the nodelets that were made
        #: Names of those, and of the nodelets that were connected elsewhere.
        self.changed: set[str] = set()
        #: Label of the transformation of which no nodelet could be made; empty if there is none.
        self.failed_label = ""
        self._done: list[ReversibleStep] = []
        #: Connections that wait until consumers are disconnected.
        self._waiting: list[tuple[str, Mapping[str, str]]] = []

    def spawn(
        self, transformation: Transformation, request: SpawnRequest, near: Iterable[str]
    ) -> None:
        """Make a nodelet, close to the publishers of some topics.

        Consumers that would mismatch it are disconnected first. A request lets rounds pass
        meanwhile.
        """
        lifecycle, name = self._context.manager.lifecycle, request.name
        planned = Record(
            name,
            transformation,
            "",
            topics=request.config,
            claimed=True,
            parameters=request.parameters,
        )
        cut = self._make_way(planned, request.config)
        spawn = partial(lifecycle.spawn, transformation, request, True, near)
        step = ReversibleStep(f"spawning '{name}'", name, spawn, partial(lifecycle.destroy, name))
        try:
            with self._context.lock.pause():
                step.do()
        except NameTaken:
            self._connect_again(cut)
            raise
        except DyKnowError as error:
            if not timed_out(error):
                self.failed_label = transformation.label
            raise
        self._done.append(step)
        self.spawned.append(name)
        self.changed.add(name)
        self._connector.remember()
        self._connect_again(cut)
        self.world = self._connector.world()

    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet that are not connected so already.

        Consumers whose demand would not be met are disconnected first.
        """
        record = self._graph.records[name]
        before = {port: record.topics.get(port, "") for port in config}
        if before == dict(config) and name not in self._connector.unknown:
            return
        if (name, config) in self._waiting:
            raise HostError(f"{name} has to be disconnected first, and feeds itself")
        self._waiting.append((name, config))
        try:
            cut = self._make_way(record, config)
        finally:
            self._waiting.pop()
        connect = partial(self._connector.connect, name, config)
        undo = partial(self._reconnect, name, before)
        step = ReversibleStep(f"connecting '{name}'", name, connect, undo)
        self._done.append(step)  # without an answer it may have been done, too
        self.changed.add(name)
        step.do()
        self._connect_again(cut)
        self.world = self._connector.world()

    def reconfigure(self, name: str, ports: Mapping[str, str]) -> None:
        """Disconnect ports and connect them again: their nodelet forgets earlier messages.

        They stay disconnected if they do not fit together by then.
        """
        self.connect(name, dict.fromkeys(ports, ""))
        self.connect_if_fitting(self._graph.records[name], ports)

    def undo(self) -> None:
        """Undo everything, the latest change first; nodelets that claims use by now stay.

        A claim whose stream is broken may need one that died and had the same name.
        """
        claims = self._connector.world().claims
        active = [each for each in claims if each.state is ClaimState.ACTIVE]
        kept = {name for claim in active for name in claim.wiring if name in self.spawned}
        for trouble in take_back([step for step in self._done if step.subject not in kept]):
            _log.warning("undoing a plan: %s", trouble)

    def _make_way(self, record: Record, config: Mapping[str, str]) -> dict[str, Mapping[str, str]]:
        """Disconnect the consumers that would mismatch a connection; returns their topics.

        Those that only may remember something else are disconnected if they answer.
        """
        cut: dict[str, dict[str, str]] = {}
        silent: set[str] = set()
        is_forgetful = False
        while True:
            world = self._connector.world()
            world = world.forgetful if is_forgetful else world
            found = world.in_the_way(record, config, silent)
            more = {
                name: ports
                for name, ports in found.items()
                if ports.keys() - cut.get(name, {}).keys()
            }
            if not more:
                return dict(sorted(cut.items()))
            is_reachable = self._context.monitor.is_reachable
            reached = [name for name in sorted(more) if is_reachable(self._graph.records[name])]
            if not reached and not silent.issuperset(more):
                silent.update(more)
                continue
            if not reached:
                if is_forgetful or world.forgetful.in_the_way(record, config, silent):
                    first = self._graph.records[min(more)]
                    why = "has fixed topics" if first.is_fixed else "does not answer"
                    raise HostError(f"{first.name} has to be disconnected first, and {why}")
                is_forgetful = True  # they are reconfigured as soon as they answer
            for name in reached:
                topics = self._graph.records[name].topics
                try:
                    self.connect(name, more[name])
                except DyKnowError as error:
                    is_needed = name in silent or name in world.in_the_way(record, config, {name})
                    if is_needed or not timed_out(error):
                        raise
                    silent.add(name)
                    continue
                before = {port: topics.get(port, "") for port in more[name]}
                cut.setdefault(name, {}).update(before)

    def _connect_again(self, cut: Mapping[str, Mapping[str, str]]) -> None:
        """After a change, connect the ports that users connected, if they fit together again.

        Nodelets of claims are connected by their repair.
        """
        for name, ports in cut.items():
            record = self._graph.find(name)
            if record is not None and not record.claimed:
                self.connect_if_fitting(record, ports)

    def connect_if_fitting(self, record: Record, ports: Mapping[str, str]) -> None:
        """Connect ports of a nodelet, unless that must not be at present."""
        fits = self._connector.world().fitting(replace(record, topics={**record.topics, **ports}))
        if all(fits.get(port) == topic for port, topic in ports.items()):
            self.connect(record.name, ports)

    def _reconnect(self, name: str, before: dict[str, str]) -> None:
        record = self._graph.find(name)
        if record is None or name in self._connector.unknown:
            return  # it is polled, and connected as it should be then
        fits = self._connector.world().fitting(replace(record, topics=before))
        self._connector.connect(name, fits)


def timed_out(error: BaseException | None) -> bool:
    """Whether an error comes from a nodelet manager, or a nodelet, that did not answer."""
    while error is not None and not isinstance(error, HostTimeout):
        error = error.__cause__
    return error is not None
