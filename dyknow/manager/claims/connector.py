# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Connects ports for claims, so that no consumer receives what it does not demand.

Before a producer comes to a topic, consumers there whose demand it does not meet are disconnected.
A consumer never comes to a topic with a producer that does not meet its demand. A nodelet that
cannot be asked counts on each topic on which it may be.

A nodelet may remember what it has received. Before it receives the same variable from another
individual, all its in-ports that share the variable are disconnected, and connected again as one.

A connection that was not answered in time may be made later. Its nodelet is asked until it
answers, and for a while after that its ports count on the topics that they were sent to.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from typing import Callable, Dict, FrozenSet, Iterator, List, Mapping, Optional, Set, Tuple

from dyknow.errors import (
    Busy,
    DyKnowError,
    FixedTopics,
    HostError,
    HostTimeout,
    WrongStream,
)
from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.ends import Consumer, NodeletEnds, Producer, ends_of
from dyknow.manager.claims.topology import Topology
from dyknow.manager.manager import Manager
from dyknow.manager.record import NOTHING_HEARD, Record, seen_ports, topics_of, with_ports
from dyknow.manager.specifications.tags import Subsumption
from dyknow.model.graph import State

#: Seconds to wait for a look to be done with a nodelet.
_PATIENCE = 1.0
#: Seconds for which a connection that was not answered may still be made.
_LATE = 30.0
#: Seconds until a nodelet that did not answer is asked again.
_PAUSE = 1.0

Config = Mapping[str, str]
"""Topics by port; an empty topic disconnects."""


class Connector:
    """Connects ports, and knows the topology that results."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        ontology: Subsumption,
        clock: Callable[[], float],
    ) -> None:
        """Decide from now on how nodelets that are brought back are connected.

        Args:
            manager: knows the nodelets.
            table: knows the clients.
            ontology: what is a kind of what.
            clock: steady time, in seconds.
        """
        self._manager = manager
        self._graph = manager.graph
        self._table = table
        self._ontology = ontology
        self._clock = clock
        self._read: Dict[str, Tuple[Record, NodeletEnds]] = {}
        self._known: Optional[Tuple[object, Topology]] = None
        #: Topics that a port was sent to without an answer, and until when it may arrive there.
        self._late: Dict[Tuple[str, str], Dict[str, float]] = {}
        #: Nodelets whose connections are not known, and when to ask them.
        self._unknown: Dict[str, float] = {}
        manager.lifecycle.fitting = self.fitting

    # The topology

    def topology(
        self,
        changed: Optional[Record] = None,
        is_replaced: bool = False,
        is_forgetful: bool = False,
    ) -> Topology:
        """Return the topology of this moment.

        Args:
            changed: a nodelet as it would be; it counts besides what it is.
            is_replaced: whether it counts instead of what it is.
            is_forgetful: whether nodelets count as if they remembered nothing.
        """
        if changed is None and not is_forgetful:
            return self._present()
        nodelets = self._nodelets(changed.name if changed is not None and is_replaced else "")
        if changed is not None:
            ports = (
                replace(port, topic=changed.topics.get(port.name, port.topic))
                for port in changed.ports
            )
            nodelets.append(ends_of(replace(changed, ports=tuple(ports))))
        if is_forgetful:
            nodelets = [ends._replace(heard=()) for ends in nodelets]
        return self._topology(nodelets, self._claims())

    def fitting(self, record: Record) -> Dict[str, str]:
        """Return a nodelet's connections, without those that must not be made at present."""
        topics = dict(record.topics)
        made = {each.name for each in self._graph.all() if each.claimed}
        topology = self.topology(record)
        for topic, producer, consumer in topology.mismatches(set(topics.values()) - {""}):
            for end, other in ((producer, consumer), (consumer, producer)):
                # What people spawned and connected with each other is their own affair.
                is_client = other is consumer and not consumer.nodelet
                concerns_claims = record.claimed or is_client or other.nodelet in made
                if concerns_claims and _is_at(end, record.name, record.topics, topic):
                    topics[end.port] = ""
        if topology.dependent and self._misleads(replace(record, topics=topics), made):
            topics.update(dict.fromkeys(topology.listened_to(topics), ""))
        return topics

    def _misleads(self, record: Record, made: Set[str]) -> bool:
        """Whether others, of claims, would send what is not demanded because of a nodelet."""
        absent = replace(record, topics={}, ports=())
        before = set(self.topology(absent, is_replaced=True).mismatches())
        return any(
            record.name not in (producer.nodelet, consumer.nodelet)
            and (not consumer.nodelet or {producer.nodelet, consumer.nodelet} & made)
            for topic, producer, consumer in self.topology(record, is_replaced=True).mismatches()
            if (topic, producer, consumer) not in before
        )

    def in_the_way(
        self, record: Record, config: Config, is_forgetful: bool = False
    ) -> Dict[str, Dict[str, str]]:
        """List what has to be disconnected before a nodelet's ports may be connected so.

        Once that is done there may be more: it depends on what is left then.

        Args:
            record: the nodelet.
            config: topics by port.
            is_forgetful: whether nodelets count as if they remembered nothing.

        Returns:
            For each nodelet its ports, each with an empty topic.

        Raises:
            WrongStream: it must not be connected so, whatever is disconnected before.
        """
        changed = replace(record, topics={**record.topics, **config})
        cut: Dict[str, Dict[str, str]] = {}
        topics = set(config.values()) - {""}
        topology = self.topology(changed, is_forgetful=is_forgetful)
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

    def stale(self) -> Dict[str, Dict[str, str]]:
        """List the nodelets that receive another individual than they remember.

        Returns:
            For each nodelet its ports that share the variables, with their topics.
        """
        found: Dict[str, Dict[str, str]] = {}
        topology = self.topology()
        wrong = [each for each in topology.mismatches() if each[2].ends >= 0]
        if not wrong:
            return found
        forgetful = self.topology(is_forgetful=True)
        lasting = {(topic, *consumer[:2]) for topic, _, consumer in forgetful.mismatches()}
        for topic, _, consumer in wrong:
            if (topic, *consumer[:2]) not in lasting:
                topics = self._graph.get(consumer.nodelet).topics
                ports = {each: topics.get(each, "") for each in topology.ports_of(consumer)}
                found.setdefault(consumer.nodelet, {}).update(ports)
        return found

    def remember(self) -> None:
        """Note what nodelets with variables receive now."""
        for name, heard in self.topology().dependent.heard().items():
            known = self._graph.find(name)
            if known is None or known.heard == heard or known.state is not State.RUNNING:
                continue
            with contextlib.suppress(Busy), self._graph.changing(
                name, patience=_PATIENCE
            ) as record:
                if record is not None and heard.topics in ((), ends_of(record).listening):
                    self._graph.put(replace(record, heard=heard))

    def _first(self, changed: Record, is_forgetful: bool) -> List[Tuple[str, Producer, Consumer]]:
        """Return what ``_changed`` yields, without what the others of it feed; a circle entire."""
        found = list(self._changed(changed, is_forgetful))
        fed = {consumer.nodelet for _, one, consumer in found if one.nodelet != consumer.nodelet}
        return [each for each in found if each[1].nodelet not in fed] or found

    def _changed(
        self, changed: Record, is_forgetful: bool
    ) -> Iterator[Tuple[str, Producer, Consumer]]:
        """Yield each consumer of what would send something else from now on.

        Those whose nodelet sent nothing before, and clients, need not be cut if they want it.

        Args:
            changed: a nodelet as it would be.
            is_forgetful: whether nodelets count as if they remembered nothing.
        """
        before = self.topology(is_forgetful=is_forgetful)
        after = self.topology(changed, is_replaced=True, is_forgetful=is_forgetful)
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

    # Connecting

    def connect(self, name: str, config: Config) -> None:
        """Connect ports of a nodelet, and show it in the graph at once.

        Raises:
            DyKnowError: the nodelet refused, or did not answer.
        """
        for topic in config.values():
            self._manager.guards.check_topic(topic)
        record = self._graph.get(name)
        if record.is_fixed:
            raise FixedTopics(name, record.manager)
        try:
            self._manager.host.connect(name, config)
        except HostTimeout:
            for port, topic in config.items():
                self._late.setdefault((name, port), {})[topic] = self._clock() + _LATE
            self._unknown[name] = self._clock()
            raise
        except HostError:
            self._unknown[name] = self._clock()
            raise
        self._show(name, config)
        self.remember()

    @property
    def unknown(self) -> FrozenSet[str]:
        """Nodelets of which it is not known how they are connected."""
        return frozenset(self._unknown)

    def is_known(self, name: str) -> bool:
        """Whether it is known how a nodelet is connected."""
        return name not in self._unknown

    def ask(self) -> None:
        """Ask the nodelets whose connections are not known, and show these in the graph."""
        now = self._clock()
        hanging: Set[str] = set()
        for name in sorted(self._unknown):
            record = self._graph.find(name)
            if record is None:
                self._forget(name)
            elif (
                record.state is State.RUNNING
                and self._unknown[name] <= now
                and record.manager not in hanging
            ):
                self._unknown[name] = now + _PAUSE
                try:
                    self._ask(name)
                except HostTimeout:
                    hanging.add(record.manager)
                except DyKnowError:
                    continue  # it is asked again
                else:
                    self._note_answer(name)

    # Inside

    def _claims(self) -> List[Claim]:
        return [claim for claim in self._table.living() if claim.topic]

    def _topology(self, nodelets: List[NodeletEnds], claims: List[Claim]) -> Topology:
        described = self._manager.existing_topics()
        return Topology(nodelets, described, claims, dict(self._late), self._ontology)

    def _present(self) -> Topology:
        """Return the topology as everything is, made once for each state of it."""
        library, claims = self._manager.library.revision, self._claims()
        nodelets, late = self._nodelets(), dict(self._late)
        key = (library, claims, nodelets, late)
        if self._known is None or self._known[0] != key:
            self._known = (key, self._topology(nodelets, claims))
        return self._known[1]

    def _nodelets(self, but: str = "") -> List[NodeletEnds]:
        """Read the nodelets that may send or receive; a record is read again when it changed."""
        read: Dict[str, Tuple[Record, NodeletEnds]] = {}
        for record in self._acting():
            known = self._read.get(record.name)
            if known is None or known[0] is not record:
                known = (record, ends_of(record))
            read[record.name] = known
        self._read = read
        return [ends for name, (_, ends) in read.items() if name != but]

    def _acting(self) -> List[Record]:
        """Nodelets that run, and those that may run without having been seen."""
        records = [each for each in self._graph.all() if each.state is not State.FAILED]
        if any(record.state is State.LOST for record in records):
            incarnations = {each.name: each.incarnation for each in self._manager.host.managers()}
            return [
                record
                for record in records
                if record.state is not State.LOST
                or incarnations.get(record.manager) == record.incarnation
            ]
        return records

    def _show(self, name: str, config: Config) -> None:
        try:
            with self._graph.changing(name, patience=_PATIENCE) as record:
                if record is not None:
                    topics = {**record.topics, **config}
                    ports = tuple(
                        replace(port, topic=config.get(port.name, port.topic))
                        for port in record.ports
                    )
                    after = replace(record, topics=topics, ports=seen_ports(record, ports))
                    if ends_of(after).listening != record.heard.topics:
                        after = replace(after, heard=NOTHING_HEARD)
                    self._graph.put(after)
        except Busy:
            self._unknown[name] = self._clock()
            raise

    def _ask(self, name: str) -> None:
        ports = self._manager.host.ports(name)
        with self._graph.changing(name) as record:
            if record is not None and record.state is State.RUNNING:
                record = with_ports(record, ports)
                self._graph.put(replace(record, topics=topics_of(record)))

    def _note_answer(self, name: str) -> None:
        """A nodelet answered: its connections are known once none can arrive late any more."""
        now = self._clock()
        for place in [place for place in self._late if place[0] == name]:
            left = {topic: until for topic, until in self._late[place].items() if until > now}
            self._late[place] = left
            if not left:
                del self._late[place]
        if not any(place[0] == name for place in self._late):
            self._forget(name)

    def _forget(self, name: str) -> None:
        self._unknown.pop(name, None)
        for place in [place for place in self._late if place[0] == name]:
            del self._late[place]


def _is_at(end: Producer | Consumer, name: str, config: Config, topic: str) -> bool:
    return end.nodelet == name and config.get(end.port) == topic
