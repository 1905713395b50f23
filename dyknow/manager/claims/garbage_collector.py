# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Disconnects and destroys the remains of claims: unneeded nodelets, and second publishers."""

from __future__ import annotations

import logging
from functools import partial
from typing import AbstractSet, Callable, Iterable

from dyknow.backoff import Backoff
from dyknow.errors import DyKnowError
from dyknow.manager.claim import Claim
from dyknow.manager.claims.connector import ClaimContext, Transaction
from dyknow.manager.claims.ends import Consumer, Producer
from dyknow.manager.claims.world import Wire, wires_of
from dyknow.manager.record import Record, movable_ports
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import IN

_log = logging.getLogger("rosout.dyknow")

#: Seconds that a nodelet is kept after the last claim needed it.
_LINGER = 5.0
#: Seconds of the first pause after a nodelet could not be disconnected or destroyed.
_FIRST_PAUSE = 1.0


class GarbageCollector:
    """Collects garbage; nodelets that people spawned or protected are never destroyed."""

    def __init__(self, context: ClaimContext) -> None:
        self._context = context
        self._graph = context.manager.graph
        self._table = context.table
        self._lock = context.lock
        self._world = context.connector.world
        self._monitor = context.monitor
        self._is_reachable = context.monitor.is_reachable
        self._idle_since: dict[str, float] = {}
        # No failure is tolerated: a nodelet that hangs is not called twice in one round.
        self._failures = Backoff(context.clock, _FIRST_PAUSE, tolerated=0)
        #: Connections of nodelets that were replaced while they could not be reached.
        self._replaced: set[Wire] = set()

    def disconnect(self) -> None:
        """Disconnect ports that no claim needs connected, and those that do not fit together."""
        world = self._world()
        wires = world.wires
        for record in world.records.values():
            if not record.claimed or record.name in self._lock.reserved:
                continue
            is_needed = record.name in world.needed
            if record.is_protected and not is_needed:
                continue  # its user connects it
            unneeded = [
                port.name
                for port in movable_ports(record)
                if not is_needed or (port.direction == IN and port.tags)
                if (record.name, port.name, port.topic) not in wires
            ]
            self._disconnect(record, unneeded)
        for name, topics in sorted(self._world().stale().items()):
            stale = self._graph.find(name)  # people have put another individual on a topic
            if stale is not None and self._is_reachable(stale):
                self._try(stale, partial(Transaction(self._context).reconfigure, name, topics))
        for topic, producer, consumer in self._world().all_mismatches:
            self._separate(topic, producer, consumer, wires)

    def _separate(
        self, topic: str, producer: Producer, consumer: Consumer, wires: AbstractSet[Wire]
    ) -> None:
        """Part two that do not fit; a consumer stays where a claim needs it."""
        receiver = self._graph.find(consumer.nodelet)
        sender = self._graph.find(producer.nodelet)
        if receiver is not None and not receiver.claimed:
            return  # people connected it so
        stays = receiver is None or (receiver.name, consumer.port, topic) in wires
        if sender is not None:
            here = [port.name for port in sender.ports if port.topic == topic]
            if producer.port not in here:
                return  # it may come here, but has not yet
            if stays and self._disconnect(sender, [producer.port]):
                return
        if receiver is not None:
            self._disconnect(receiver, [consumer.port])

    def take_apart(self, claim: Claim) -> bool:
        """Disconnect what only a claim needs, and the claims whose clients listen on its topic.

        Returns whether none of it can send any more; a nodelet that hangs sends nothing.
        """
        done = True
        wires = wires_of(each for each in self._table.living if each.topic != claim.topic)
        for name, topics in sorted(claim.wiring.items()):
            record = self._graph.find(name)
            if record is not None and record.claimed and name not in self._lock.reserved:
                ports = [
                    port
                    for port in topics
                    if (name, port) == claim.goal or (name, port, topics[port]) not in wires
                ]
                is_silenced = self._disconnect(record, ports) or not self._is_reachable(record)
                done = done and is_silenced
        return done

    def clear_topics(self) -> None:
        """Leave the publishers of claims on their topics, and none where no stream is made.

        Claims on one topic have one publisher, but for a moment while the others follow the first.
        """
        claims = self._table.living
        goals: dict[str, set[str]] = {}
        for claim in claims:
            if claim.topic and not claim.is_made:
                goals.setdefault(claim.topic, set())
            elif claim.state is ClaimState.ACTIVE and claim.goal[0]:
                goals.setdefault(claim.topic, set()).add(claim.goal[0])
        # A publisher that cannot be reached was replaced: it is disconnected when it is back.
        self._replaced = {each for each in self._replaced if each[2] in goals} | {
            (record.name, port, topic)
            for record in self._world().records.values()
            if record.state is not State.RUNNING
            for port, topic in record.topics.items()
            if goals.get(topic) and record.name not in goals[topic]
        }
        for topic, ours in sorted(goals.items()):
            for record, ports in self._world().publishers(topic):
                is_ours = record.claimed or (record.is_described and ours)
                wires = self._replaced & {(record.name, port, topic) for port in ports}
                if record.name not in ours and record.name not in self._lock.reserved:
                    replaced = [port for _, port, _ in sorted(wires)]
                    self._disconnect(record, ports if is_ours else replaced)

    def give_back(self) -> None:
        """Move the ports of users that no claim needs back, except to topics with a client."""
        world = self._world()
        taken = {claim.topic for claim in self._table.living} - {""}
        for record in world.records.values():
            owed = record.owed
            if not owed or record.name in self._lock.reserved or not self._is_reachable(record):
                continue
            for port, topic in owed.items():
                is_needed = (record.name, port, record.topics.get(port)) in world.wires
                if topic not in taken and not is_needed:
                    connect = Transaction(self._context).connect_if_fitting
                    self._try(record, partial(connect, record, {port: topic}))

    def collect(self) -> None:
        """Destroy nodelets that were made for claims and that no claim has needed for a while."""
        now, world = self._context.clock(), self._world()
        names = world.idle(frozenset())
        records = reversed([*world.records.values()])
        idle = {record.name: record for record in records if record.name in names}
        self._idle_since = {name: self._idle_since.get(name, now) for name in idle}
        unfit = self._monitor.unfit()
        for name, record in idle.items():
            linger = 0.0 if name in unfit else _LINGER
            is_over = now - self._idle_since[name] >= linger
            is_free = name not in self._lock.reserved
            if is_over and is_free and record.state in (State.RUNNING, State.FAILED):
                self._try(record, partial(self._context.manager.lifecycle.destroy, name))

    def _disconnect(self, record: Record, ports: Iterable[str]) -> bool:
        """Disconnect those of a nodelet's ports that are connected; whether none is any more."""
        connected = {port.name for port in record.ports if port.topic}
        config = {port: "" for port in ports if port in connected}
        if not config:
            return True
        # With one sender gone, the others on its topic may bind variables of their consumers.
        action = partial(Transaction(self._context).connect, record.name, config)
        return self._is_reachable(record) and self._try(record, action)

    def _try(self, record: Record, action: Callable[[], None]) -> bool:
        """Do something with a nodelet, unless its pause is not over; whether it was done."""
        if not self._failures.allows(record.name):
            return False
        try:
            action()
        except DyKnowError as error:
            self._failures.failed(record.name)
            _log.warning("%s: %s", record.name, error)
            return False
        self._failures.forgive(record.name)
        return True
