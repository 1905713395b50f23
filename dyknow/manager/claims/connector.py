"""Connects ports for claims: the one place that sees to it that nobody hears what does not fit.

Before a sender comes to a topic, listeners there whose demand it does not meet are cut off; a
listener never comes to a topic with a sender that does not meet its demand. Who cannot be asked
counts as being wherever it may be.

A connection that was not answered in time may be made later. Its nodelet is asked until it
answers, and its ports count as being where they were sent for a while after that.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Dict, List, Mapping, Optional, Set, Tuple

from dyknow.errors import Busy, DyKnowError, HostError, HostTimeout, WrongStream
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.topology import Consumer, Producer, Topology
from dyknow.manager.manager import Manager
from dyknow.manager.record import Record, seen_ports, topics_of
from dyknow.manager.specifications.tags import Subsumption
from dyknow.model.graph import State

#: Seconds to wait for a look to be done with a nodelet.
_PATIENCE = 1.0
#: Seconds for which a connection that was not answered may still be made.
_LATE = 30.0
#: Seconds until a nodelet that did not answer is asked again.
_PAUSE = 1.0

Config = Mapping[str, str]


class Connector:
    """Knows who may hear whom, and connects ports accordingly."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        ontology: Subsumption,
        clock: Callable[[], float],
    ) -> None:
        """Connect nothing yet; what is brought back from now on is not connected wrongly.

        Args:
            manager: knows the nodelets.
            table: knows the clients.
            ontology: what is a kind of what.
            clock: seconds, steady.
        """
        self._manager = manager
        self._graph = manager.graph
        self._table = table
        self._ontology = ontology
        self._clock = clock
        self._late: Dict[Tuple[str, str], Dict[str, float]] = {}
        self._unknown: Dict[str, float] = {}  # nodelets to be asked, and when
        manager.lifecycle.fitting = self.fitting

    # Who hears whom

    def topology(self, changed: Optional[Record] = None) -> Topology:
        """Look at who may be where.

        Args:
            changed: a nodelet as it is to be; it counts beside what it is.
        """
        records = self._acting()
        if changed is not None:
            records.append(changed)
        return Topology(
            records,
            self._manager.existing_topics(),
            [claim for claim in self._table.living() if claim.topic],
            lambda name, port: self._late.get((name, port), ()),
            self._ontology,
        )

    def fitting(self, record: Record) -> Dict[str, str]:
        """Return a nodelet's connections, without those that must not be made as things are."""
        topics = dict(record.topics)
        made = {each.name for each in self._graph.all() if each.claimed}
        mismatches = self.topology(record).mismatches(set(topics.values()) - {""})
        for topic, sender, listener in mismatches:
            for end, other in ((sender, listener), (listener, sender)):
                # What people made by hand and connected with each other is their own affair.
                is_client = other is listener and not listener.nodelet
                concerns_claims = record.claimed or is_client or other.nodelet in made
                if concerns_claims and _is_at(end, record.name, record.topics, topic):
                    topics[end.port] = ""
        return topics

    def in_the_way(self, record: Record, config: Config) -> Dict[str, Dict[str, str]]:
        """List what has to be disconnected before a nodelet's ports may be connected so.

        Returns:
            For each nodelet its ports, each with no topic.

        Raises:
            WrongStream: it must not be connected so, whatever is disconnected before.
        """
        changed = replace(record, topics={**record.topics, **config})
        cut: Dict[str, Dict[str, str]] = {}
        topics = set(config.values()) - {""}
        for topic, sender, listener in self.topology(changed).mismatches(topics):
            if _is_at(listener, record.name, config, topic) or (
                not listener.nodelet and _is_at(sender, record.name, config, topic)
            ):
                raise WrongStream(topic, sender.nodelet, listener.nodelet)
            if _is_at(sender, record.name, config, topic):
                cut.setdefault(listener.nodelet, {})[listener.port] = ""
        return cut

    # Connecting

    def connect(self, name: str, config: Config) -> None:
        """Connect ports of a nodelet, and let the graph know at once.

        Raises:
            DyKnowError: the nodelet refused, or nobody knows what became of it.
        """
        for topic in config.values():
            self._manager.guards.check_topic(topic)
        if self._graph.get(name).rewired_by_reload:
            self._manager.lifecycle.reload(name, config)
            return
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
        self._follow(name, config)

    def is_known(self, name: str) -> bool:
        """Whether it is known how a nodelet is connected."""
        return name not in self._unknown

    def ask(self) -> None:
        """Ask nodelets of which nobody knows how they are connected; the graph follows."""
        now = self._clock()
        hanging: Set[str] = set()
        for name in sorted(self._unknown):
            record = self._graph.find(name)
            if record is None or record.rewired_by_reload:
                self._forget(name)
            elif (
                record.state is State.RUNNING
                and self._unknown[name] <= now
                and record.manager not in hanging
            ):
                self._unknown[name] = now + _PAUSE
                try:
                    self._see(name)
                except HostTimeout:
                    hanging.add(record.manager)
                except DyKnowError:
                    continue  # next time
                else:
                    self._settle(name)

    # Inside

    def _acting(self) -> List[Record]:
        """Nodelets that may send or receive: those that run, and those of which nobody knows."""
        records = [each for each in self._graph.all() if each.state is not State.FAILED]
        if any(record.state is State.LOST for record in records):
            there = {state.name: state.incarnation for state in self._manager.host.managers()}
            return [
                record
                for record in records
                if record.state is not State.LOST
                or there.get(record.manager) == record.incarnation
            ]
        return records

    def _follow(self, name: str, config: Config) -> None:
        try:
            with self._graph.changing(name, patience=_PATIENCE) as record:
                if record is not None:
                    topics = {**record.topics, **config}
                    ports = tuple(
                        replace(port, topic=config.get(port.name, port.topic))
                        for port in record.ports
                    )
                    self._graph.put(
                        replace(record, topics=topics, ports=seen_ports(record, ports))
                    )
        except Busy:
            self._unknown[name] = self._clock()
            raise

    def _see(self, name: str) -> None:
        ports = self._manager.host.ports(name)
        with self._graph.changing(name) as record:
            if record is not None and record.state is State.RUNNING:
                record = replace(record, ports=seen_ports(record, ports))
                self._graph.put(
                    replace(record, topics=topics_of(record)),
                    durable=record.transformation is not None,
                )

    def _settle(self, name: str) -> None:
        """It answered: it is known, once nothing can come late any more."""
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
