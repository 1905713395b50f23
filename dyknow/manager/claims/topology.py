"""Who hears whom: every out-port beside the in-ports and clients that listen on its topic.

A port counts on each topic on which it may be: where it was seen last, where it should be, and
where a connection would put it of which nobody knows yet whether it was made.
"""

from __future__ import annotations

from typing import (
    AbstractSet,
    Callable,
    Collection,
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Tuple,
)

from dyknow.manager.claim import Claim
from dyknow.manager.claims.demands import demand_of
from dyknow.manager.claims.relay import is_relay
from dyknow.manager.planning.supply import Demand, meets
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import Subsumption, Term, read_tags
from dyknow.model.transformation import IN, OUT, Port, Transformation


class Producer(NamedTuple):
    """An out-port, or the ordinary nodes that publish a topic.

    Attributes:
        nodelet: its name; empty for ordinary nodes.
        port: its out-port; empty for ordinary nodes.
        tags: what its messages are about, whatever the library says now.
        datatype: ROS type of its messages.
    """

    nodelet: str
    port: str
    tags: Tuple[Term, ...] = ()
    datatype: str = ""


class Consumer(NamedTuple):
    """A tagged in-port, or the client of a claim.

    Attributes:
        nodelet: its name; empty for a client.
        port: its in-port, or the id of the claim.
        demand: what it is to receive, and nothing else.
    """

    nodelet: str
    port: str
    demand: Demand


class Topology:
    """Senders and listeners by topic, at one moment."""

    def __init__(
        self,
        records: Iterable[Record],
        described: Iterable[Transformation],
        claims: Iterable[Claim],
        perhaps: Callable[[str, str], Collection[str]],
        ontology: Subsumption,
    ) -> None:
        """Look at who is where.

        Args:
            records: nodelets that may send or receive.
            described: transformations of type topic.
            claims: those whose clients listen.
            perhaps: further topics on which a nodelet's port may be.
            ontology: what is a kind of what.
        """
        records = list(records)
        self._ontology = ontology
        self._senders: Dict[str, List[Producer]] = {}
        self._listeners: Dict[str, List[Consumer]] = {}
        for claim in claims:
            client = Consumer("", claim.claim_id, demand_of([claim]))
            self._listeners.setdefault(claim.topic, []).append(client)
        places = [
            (topic, record.name, port)
            for record in records
            for port in _ports(record)
            for topic in sorted({*_topics(record, port.name), *perhaps(record.name, port.name)})
            if topic
        ]
        used = self._listeners.keys() | {topic for topic, _, _ in places}
        for each in described:
            if each.source in used:
                port = each.ports[0]
                known = self._senders.get(each.source, [Producer("", "")])[0]
                tags = known.tags + read_tags(port.tags)
                sender = Producer("", "", tags, known.datatype or port.datatype)
                self._senders[each.source] = [sender]
        said = set(self._senders)
        for topic, name, port in places:
            self._enter(name, port, topic, topic in said)
        self._distrust({each.name for each in records if is_relay(each.transformation)})

    def _enter(self, name: str, port: Port, topic: str, is_described: bool) -> None:
        tags = read_tags(port.tags)
        if port.direction == IN and tags:
            listener = Consumer(name, port.name, Demand(frozenset(tags), port.datatype))
            self._listeners.setdefault(topic, []).append(listener)
        elif port.direction == OUT and (tags or not is_described):
            sender = Producer(name, port.name, tags, port.datatype)
            self._senders.setdefault(topic, []).append(sender)

    def _distrust(self, relays: AbstractSet[str]) -> None:
        """What a relay says of its stream holds only as long as it hears nothing else."""
        misled: AbstractSet[str] = relays
        while relays and misled:
            hearing = {listener.nodelet for _, _, listener in self.mismatches()}
            misled, relays = relays & hearing, relays - hearing
            for senders in self._senders.values():
                senders[:] = [
                    each._replace(tags=()) if each.nodelet in misled else each for each in senders
                ]

    def senders(self, topic: str) -> List[Producer]:
        """Who may send on a topic; what is said of it stands for senders without tags."""
        return self._senders.get(topic, [])

    def is_described(self, topic: str) -> bool:
        """Whether anybody says what ordinary nodes send on a topic."""
        return any(not sender.nodelet for sender in self.senders(topic))

    def listeners(self, topic: str) -> List[Consumer]:
        """Who may listen on a topic."""
        return self._listeners.get(topic, [])

    def serves(self, sender: Producer, demand: Demand) -> bool:
        """Whether a sender is what is demanded."""
        return meets(sender.tags, sender.datatype, demand, self._ontology)

    def mismatches(
        self, topics: Optional[Iterable[str]] = None
    ) -> Iterator[Tuple[str, Producer, Consumer]]:
        """Everybody who may hear what was not asked for: topic, sender and listener."""
        for topic in sorted(set(self._listeners if topics is None else topics)):
            for listener in self.listeners(topic):
                for sender in self.senders(topic):
                    if not self.serves(sender, listener.demand):
                        yield topic, sender, listener

    def common_tags(self, topic: str, tags: Tuple[Term, ...]) -> Tuple[Term, ...]:
        """Those of a stream's tags that hold for everything that is sent on its topic."""
        senders = self.senders(topic)
        return tuple(
            tag
            for tag in tags
            if all(self.serves(each, Demand(frozenset((tag,)))) for each in senders)
        )


def _ports(record: Record) -> List[Port]:
    """Ports of a nodelet, with the tags that it was made with and the types that were seen."""
    seen = {port.name: port for port in record.ports}
    declared = record.transformation.ports if record.transformation is not None else ()
    names = {port.name for port in declared}
    found = [
        port._replace(datatype=seen[port.name].datatype or port.datatype)
        if port.name in seen
        else port
        for port in declared
    ]
    found += [
        Port(port.name, port.direction, port.datatype)
        for port in record.ports
        if port.name not in names
    ]
    return found


def _topics(record: Record, port: str) -> List[str]:
    seen = [each.topic for each in record.ports if each.name == port]
    return [record.topics.get(port, ""), *seen]
