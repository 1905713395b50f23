# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The world at one moment, and the consequences of a connection.

Before a producer comes to a topic, consumers there whose demand it does not meet are disconnected.
A consumer never comes to a topic with a producer that does not meet its demand. A nodelet that
does not answer counts on each topic on which it may be.

A nodelet may remember messages. Before it receives the same variable from another
individual, all its in-ports that share the variable are disconnected, and connected again as one.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Collection, Hashable, Iterable, Iterator, Mapping

from dyknow import names
from dyknow.errors import UnknownNodelet, WrongStream
from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.ends import Consumer, NodeletEnds, Producer, ends_of, is_relay
from dyknow.manager.claims.topology import Topology
from dyknow.manager.graph import Graph
from dyknow.manager.host import Host
from dyknow.manager.library import Library
from dyknow.manager.record import Record
from dyknow.model.graph import State
from dyknow.model.transformation import Transformation

Config = Mapping[str, str]
"""Topics by port; an empty topic disconnects."""


class World:
    """Nodelets, claims and descriptions of ordinary topics, at one moment."""

    def __init__(
        self,
        records: Mapping[str, Record],
        claims: tuple[Claim, ...],
        described: Mapping[str, tuple[Transformation, ...]],
        ends: Mapping[str, NodeletEnds],
        topology: Topology,
    ) -> None:
        self.records = records
        self.claims = claims
        self.described = described
        self.topology = topology
        self.ends = ends

    def get(self, name: str) -> Record:
        """Return the record of a nodelet; raises UnknownNodelet."""
        found = self.records.get(name)
        if found is None:
            raise UnknownNodelet(name, self.records)
        return found

    @cached_property
    def needed(self) -> frozenset[str]:
        """Nodelets that claims are made of."""
        return frozenset(name for claim in self.claims for name in claim.wiring)

    @cached_property
    def relays(self) -> frozenset[str]:
        """Nodelets that are relays."""
        return frozenset(
            name for name, each in self.records.items() if is_relay(each.transformation)
        )

    @cached_property
    def described_nodes(self) -> frozenset[str]:
        """Labels of the external nodes that run and that the library describes."""
        return frozenset(
            each.label
            for each in self.records.values()
            if each.is_described and each.state is State.RUNNING
        )

    @property
    def descriptions(self) -> list[Transformation]:
        """Transformations of type topic, with global topics."""
        return [each for found in self.described.values() for each in found]

    @cached_property
    def _made(self) -> frozenset[str]:
        """Nodelets that were made for claims."""
        return frozenset(name for name, each in self.records.items() if each.claimed)

    def taken_topics(self, but: str = "") -> set[str]:
        """Topics on which clients of claims, ``but`` one, listen."""
        return {each.topic for each in self.claims if each.topic and each.claim_id != but}

    # The world as it would be

    def with_nodelet(
        self, record: Record, is_replaced: bool = False, is_forgetful: bool = False
    ) -> Topology:
        """Return the topology if a nodelet were as a record says, besides its present or instead.

        With ``is_forgetful``, nodelets count as if they remembered nothing.
        """
        ports = (
            replace(port, topic=record.topics.get(port.name, port.topic)) for port in record.ports
        )
        new = ends_of(replace(record, ports=tuple(ports)))
        present = self.ends.get(record.name)
        gone = [present] if is_replaced and present is not None else []
        if is_forgetful:
            new = new._replace(heard=())
            gone = [each._replace(heard=()) for each in gone]
        base = self.forgetful if is_forgetful else self.topology
        return base.changed(gone, [new])

    @cached_property
    def forgetful(self) -> Topology:
        """The topology if nodelets remembered nothing."""
        remembering = [each for each in self.ends.values() if each.heard]
        return self.topology.changed(
            remembering,
            [each._replace(heard=()) for each in remembering],
            [each._replace(heard=()) for each in self.ends.values()],
        )

    # Consequences of a connection

    def fitting(self, record: Record) -> dict[str, str]:
        """Return a nodelet's connections, without those that must not be made at present."""
        topics = dict(record.topics)
        topology = self.with_nodelet(record)
        for topic, producer, consumer in topology.mismatches(set(topics.values()) - {""}):
            for end, other in ((producer, consumer), (consumer, producer)):
                # What people spawned and connected with each other is their own affair.
                is_client = other is consumer and not consumer.nodelet
                concerns_claims = record.claimed or is_client or other.nodelet in self._made
                if concerns_claims and _is_at(end, record.name, record.topics, topic):
                    topics[end.port] = ""
        if topology.dependent and self._misleads(replace(record, topics=topics)):
            topics.update(dict.fromkeys(topology.listened_to(topics), ""))
        return topics

    def _misleads(self, record: Record) -> bool:
        """Whether nodelets of claims would send wrong streams because of a nodelet."""
        absent = replace(record, topics={}, ports=())
        before = set(self.with_nodelet(absent, is_replaced=True).mismatches())
        return any(
            record.name not in (producer.nodelet, consumer.nodelet)
            and (not consumer.nodelet or {producer.nodelet, consumer.nodelet} & self._made)
            for topic, producer, consumer in self.with_nodelet(record, True).mismatches()
            if (topic, producer, consumer) not in before
        )

    def in_the_way(
        self, record: Record, config: Config, is_forgetful: bool = False
    ) -> dict[str, dict[str, str]]:
        """List the ports to disconnect, by nodelet, before a nodelet's ports may be connected so.

        Once that is done there may be more: it depends on the rest. Raises WrongStream if it must
        not be connected so in any case.
        """
        changed = replace(record, topics={**record.topics, **config})
        cut: dict[str, dict[str, str]] = {}
        topics = set(config.values()) - {""}
        topology = self.with_nodelet(changed, is_forgetful=is_forgetful)
        for topic, producer, consumer in topology.mismatches(topics):
            if _is_at(consumer, record.name, config, topic) or (
                not consumer.nodelet and _is_at(producer, record.name, config, topic)
            ):
                raise WrongStream(topic, producer.nodelet, consumer.nodelet)
            if _is_at(producer, record.name, config, topic):
                ports = dict.fromkeys(topology.ports_of(consumer), "")
                cut.setdefault(consumer.nodelet, {}).update(ports)
        if cut:
            return cut
        feeding = self._first(changed, is_forgetful) if topology.dependent else ()
        for topic, producer, consumer in feeding:
            if not consumer.nodelet or _is_at(consumer, record.name, config, topic):
                raise WrongStream(topic, producer.nodelet, consumer.nodelet)
            ports = dict.fromkeys(topology.ports_of(consumer), "")
            cut.setdefault(consumer.nodelet, {}).update(ports)
        return cut

    def stale(self) -> dict[str, dict[str, str]]:
        """List the nodelets that receive another individual than they remember.

        Returns for each its ports that share the variables, with their topics.
        """
        found: dict[str, dict[str, str]] = {}
        wrong = [each for each in self.topology.mismatches() if each[2].ends >= 0]
        if not wrong:
            return found
        lasting = {(topic, *consumer[:2]) for topic, _, consumer in self.forgetful.mismatches()}
        for topic, _, consumer in wrong:
            if (topic, *consumer[:2]) not in lasting:
                topics = self.records[consumer.nodelet].topics
                ports = {each: topics.get(each, "") for each in self.topology.ports_of(consumer)}
                found.setdefault(consumer.nodelet, {}).update(ports)
        return found

    def _first(self, changed: Record, is_forgetful: bool) -> list[tuple[str, Producer, Consumer]]:
        """Return the first of the ``_changed`` consumers along each stream; all of a circle."""
        found = list(self._changed(changed, is_forgetful))
        fed = {consumer.nodelet for _, one, consumer in found if one.nodelet != consumer.nodelet}
        return [each for each in found if each[1].nodelet not in fed] or found

    def _changed(
        self, changed: Record, is_forgetful: bool
    ) -> Iterator[tuple[str, Producer, Consumer]]:
        """Yield each consumer of a nodelet whose stream would change.

        Those whose nodelet sent nothing before, and clients, need not be cut if they want it.
        """
        before = self.forgetful if is_forgetful else self.topology
        after = self.with_nodelet(changed, True, is_forgetful)
        elsewhere = before.dependent.supplies()
        for place, possible in sorted(after.dependent.supplies().items()):
            known = elsewhere.get(place, possible)
            if possible == known or all(each.is_unbound for each in possible):
                continue
            was_silent = all(each.is_unbound for each in known)
            stays = {*before.dependent.topics_of(place)} & {*after.dependent.topics_of(place)}
            for topic in sorted(stays):
                for consumer in after.consumers(topic):
                    may_stay = was_silent or consumer.nodelet in ("", changed.name)
                    for producer in sorted(possible):
                        if not may_stay or not after.fits(producer, consumer):
                            yield topic, producer, consumer


class WorldReader:
    """Reads the world: unchanged parts are not read again."""

    def __init__(
        self, graph: Graph, table: ClaimTable, library: Library, host: Host, namespace: str
    ) -> None:
        self._graph = graph
        self._table = table
        self._library = library
        self._host = host
        self._namespace = namespace
        self._world = World({}, (), {}, {}, Topology((), {}, (), {}, library.ontology))
        self._world_at: Hashable = None
        self._basis: object = None
        self._described: Mapping[str, tuple[Transformation, ...]] = {}
        self._described_at: int | None = None
        self._perhaps: dict[tuple[str, str], tuple[str, ...]] = {}

    def now(self) -> World:
        """Return the world of this moment."""
        # The revisions come first: a change meanwhile is read the next time.
        at = (self._library.revision, self._graph.revision, self._table.living(), self._perhaps)
        if self._world_at == at:
            return self._world
        revision, _, claims, perhaps = at
        if self._described_at != revision:
            self._described, self._described_at = self._descriptions(), revision
        described, last = self._described, self._world
        records = {record.name: record for record in self._graph.all()}
        acting, is_certain = self._acting(records.values())
        ends = {
            name: (record is last.records.get(name) and last.ends.get(name)) or ends_of(record)
            for name, record in records.items()
            if name in acting
        }
        clients = [claim for claim in claims if claim.topic]
        listening = [(each.claim_id, each.topic, each.datatype, each.request) for each in clients]
        basis = (listening, described, perhaps)
        gone = [each for name, each in last.ends.items() if ends.get(name) != each]
        new = [each for name, each in ends.items() if last.ends.get(name) != each]
        topology = last.topology
        if self._basis != basis:
            ontology = self._library.ontology
            topology = Topology(ends.values(), described, clients, perhaps, ontology)
        elif gone or new:
            topology = topology.changed(gone, new, ends.values())
        self._basis = basis
        self._world = World(records, claims, described, ends, topology)
        self._world_at = at if is_certain else None
        return self._world

    def fitting(self, record: Record) -> dict[str, str]:
        """Return a nodelet's connections, without those that must not be made at present."""
        return self.now().fitting(record)

    def expect(self, perhaps: Mapping[tuple[str, str], Iterable[str]]) -> None:
        """Count ports on further topics: where late connections may put them."""
        self._perhaps = {place: tuple(topics) for place, topics in perhaps.items()}

    def _acting(self, records: Collection[Record]) -> tuple[set[str], bool]:
        """Nodelets that may run, and whether that is certain as long as no record changes."""
        names_ = {each.name for each in records if each.state is not State.FAILED}
        lost = [each for each in records if each.state is State.LOST]
        states = self._host.states() if lost else {}
        for each in lost:
            state = states.get(each.manager)
            if state is None or state.incarnation != each.incarnation:
                names_.discard(each.name)
        return names_, not lost

    def _descriptions(self) -> dict[str, tuple[Transformation, ...]]:
        found: dict[str, tuple[Transformation, ...]] = {}
        for each in self._library.topics():
            topic = names.join(self._namespace, each.source)
            topic = each.source if each.source[:1] == "/" else topic
            found[topic] = (*found.get(topic, ()), each._replace(source=topic))
        return found


def _is_at(end: Producer | Consumer, name: str, config: Config, topic: str) -> bool:
    return end.nodelet == name and config.get(end.port) == topic
