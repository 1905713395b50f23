# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Connects ports, one nodelet at a time or several changes as one.

A connection that was not answered in time may be made later. Its nodelet is polled until it
answers, and for a while after that its ports count on the topics that they were sent to.
"""

from __future__ import annotations

import contextlib
import logging
from dataclasses import replace
from functools import partial
from typing import AbstractSet, Callable, Iterable, Mapping

from dyknow.errors import Busy, DyKnowError, FixedTopics, HostError, HostTimeout
from dyknow.manager.claims.ends import ends_of
from dyknow.manager.claims.world import Config, WorldReader
from dyknow.manager.manager import Manager
from dyknow.manager.record import NOTHING_HEARD, Record, seen_ports
from dyknow.manager.steps import ReversibleStep, take_back
from dyknow.model.graph import SpawnRequest, State
from dyknow.model.transformation import Transformation

#: Seconds to wait for a look to be done with a nodelet.
_PATIENCE = 1.0
#: Seconds for which a connection that was not answered may still be made.
_LATE = 30.0
#: Seconds until a nodelet that did not answer is polled again.
_PAUSE = 1.0

_log = logging.getLogger("rosout.dyknow")


class Connector:
    """Connects ports, and asks the nodelets whose connections are not known."""

    def __init__(self, manager: Manager, worlds: WorldReader, clock: Callable[[], float]) -> None:
        self._manager = manager
        self._graph = manager.graph
        self._worlds = worlds
        self._clock = clock
        #: Returns the world of this moment.
        self.world = worlds.now
        #: Topics that a port was sent to without an answer, and until when it may arrive there.
        self._late: dict[tuple[str, str], dict[str, float]] = {}
        #: Nodelets whose connections are not known, and when to ask them.
        self._unknown: dict[str, float] = {}

    @property
    def unknown(self) -> frozenset[str]:
        """Nodelets of which it is not known how they are connected."""
        return frozenset(self._unknown)

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
            self._manager.guards.check_topic(topic)
        record = self._graph.get(name)
        if record.is_fixed:
            raise FixedTopics(name, record.manager)
        try:
            self._manager.host.connect(name, config)
            self._show(name, config)
        except (HostError, Busy) as error:
            self._unknown[name] = self._clock()
            if isinstance(error, HostTimeout):
                for port, topic in config.items():
                    self._late.setdefault((name, port), {})[topic] = self._clock() + _LATE
                self._worlds.expect(self._late)
            raise
        self.remember()

    def ask(self) -> None:
        """Ask the nodelets whose connections are not known, and show these in the graph."""
        now = self._clock()
        hanging: set[str] = set()
        for name in sorted(self._unknown):
            record = self._graph.find(name)
            if record is None:
                self._settle(name)
            elif (
                record.state is State.RUNNING
                and self._unknown[name] <= now
                and record.manager not in hanging
            ):
                self._unknown[name] = now + _PAUSE
                try:
                    self._manager.show_ports(name)
                except HostTimeout:
                    hanging.add(record.manager)
                except DyKnowError:
                    continue  # it is polled again
                else:
                    self._settle(name, self._clock())

    def _show(self, name: str, config: Config) -> None:
        with self._graph.changing(name, patience=_PATIENCE) as record:
            if record is None:
                return
            ports = tuple(
                replace(port, topic=config.get(port.name, port.topic)) for port in record.ports
            )
            topics = {**record.topics, **config}
            after = replace(record, topics=topics, ports=seen_ports(record, ports))
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
        self._worlds.expect(self._late)
        if not any(place[0] == name for place in self._late):
            self._unknown.pop(name, None)


class Transaction:
    """Spawns and connects nodelets; everything that it did can be undone."""

    def __init__(
        self, manager: Manager, connector: Connector, is_reachable: Callable[[Record], bool]
    ) -> None:
        self._manager = manager
        self._connector = connector
        self._is_reachable = is_reachable
        #: Names of the nodelets that were made.
        self.spawned: list[str] = []
        self._done: list[ReversibleStep] = []

    def make_way_for(
        self, transformation: Transformation, request: SpawnRequest
    ) -> dict[str, Mapping[str, str]]:
        """Disconnect the consumers that would mismatch a nodelet, for ``connect_again``."""
        planned = Record(
            request.name,
            transformation,
            "",
            topics=request.config,
            claimed=True,
            parameters=request.parameters,
        )
        return self._make_way(planned, request.config)

    def spawn(
        self, transformation: Transformation, request: SpawnRequest, near: Iterable[str]
    ) -> None:
        """Make a nodelet, close to the publishers of some topics."""
        lifecycle, name = self._manager.lifecycle, request.name
        spawn = partial(lifecycle.spawn, transformation, request, True, near)
        step = ReversibleStep(f"spawning '{name}'", name, spawn, partial(lifecycle.destroy, name))
        step.do()
        self._done.append(step)
        self.spawned.append(name)
        self._connector.remember()

    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet that are not connected so already.

        Consumers whose demand would not be met are disconnected first.
        """
        record = self._manager.graph.get(name)
        before = {port: record.topics.get(port, "") for port in config}
        if before == dict(config) and name not in self._connector.unknown:
            return
        cut = self._make_way(record, config)
        connect = partial(self._connector.connect, name, config)
        undo = partial(self._reconnect, name, before)
        step = ReversibleStep(f"connecting '{name}'", name, connect, undo)
        self._done.append(step)  # without an answer it may have been done, too
        step.do()
        self.connect_again(cut)

    def reconfigure(self, name: str, ports: Mapping[str, str]) -> None:
        """Disconnect ports and connect them again: their nodelet forgets earlier messages.

        They stay disconnected if they do not fit together by then.
        """
        self.connect(name, dict.fromkeys(ports, ""))
        self._connect_if_fitting(self._manager.graph.get(name), ports)

    def connect_again(self, cut: Mapping[str, Mapping[str, str]]) -> None:
        """After a change, connect the ports that users connected, if they fit together again.

        Nodelets of claims are connected by their repair.
        """
        for name, ports in cut.items():
            record = self._manager.graph.find(name)
            if record is not None and not record.claimed:
                self._connect_if_fitting(record, ports)

    def undo(self, needed: AbstractSet[str]) -> None:
        """Undo everything, the latest change first; nodelets that are ``needed`` by now stay."""
        kept = needed & set(self.spawned)
        for trouble in take_back([step for step in self._done if step.subject not in kept]):
            _log.warning("undoing a plan: %s", trouble)

    def _make_way(self, record: Record, config: Mapping[str, str]) -> dict[str, Mapping[str, str]]:
        """Disconnect the consumers that would mismatch a connection; returns their topics."""
        graph = self._manager.graph
        cut: dict[str, dict[str, str]] = {}
        is_forgetful = False
        while True:
            world = self._connector.world()
            world = world.forgetful if is_forgetful else world
            found = world.in_the_way(record, config)
            more = {
                name: ports
                for name, ports in found.items()
                if ports.keys() - cut.get(name, {}).keys()
            }
            if not more:
                return dict(sorted(cut.items()))
            reached = {
                name: ports for name, ports in more.items() if self._is_reachable(graph.get(name))
            }
            if not reached:
                if is_forgetful or world.forgetful.in_the_way(record, config):
                    first = graph.get(min(more))
                    why = "has fixed topics" if first.is_fixed else "does not answer"
                    raise HostError(f"{first.name} has to be disconnected first, and {why}")
                is_forgetful = True  # they are reconfigured as soon as they answer
            for name, ports in sorted(reached.items()):
                topics = graph.get(name).topics
                self.connect(name, ports)
                before = {port: topics.get(port, "") for port in ports}
                cut.setdefault(name, {}).update(before)

    def _connect_if_fitting(self, record: Record, ports: Mapping[str, str]) -> None:
        fits = self._connector.world().fitting(replace(record, topics={**record.topics, **ports}))
        if all(fits.get(port) == topic for port, topic in ports.items()):
            self.connect(record.name, ports)

    def _reconnect(self, name: str, before: dict[str, str]) -> None:
        record = self._manager.graph.find(name)
        if record is None or name in self._connector.unknown:
            return  # it is polled, and connected as it should be then
        fits = self._connector.world().fitting(replace(record, topics=before))
        self._connector.connect(name, fits)
