"""What is wrong with a claim's stream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import AbstractSet, Callable, Mapping, Optional

from dyknow.errors import UnknownTransformation
from dyknow.manager.claim import Claim
from dyknow.manager.claims.relay import is_relay
from dyknow.manager.claims.topology import Topology
from dyknow.manager.library import Library
from dyknow.manager.manager import Manager
from dyknow.manager.record import Record
from dyknow.model.graph import State


@dataclass(frozen=True)
class Fault:
    """Why a stream has to be mended.

    Attributes:
        what: in words.
        severed: nothing can flow as it is; else it may flow, but is not to be relied on.
    """

    what: str
    severed: bool = True


def diagnose(
    manager: Manager,
    claim: Claim,
    silent: Mapping[str, str],
    unresponsive: AbstractSet[str],
    published: AbstractSet[str],
    topology: Callable[[], Topology],
) -> Optional[Fault]:
    """Look at every part of a claim's stream.

    Args:
        manager: knows the nodelets.
        claim: whose stream it is.
        silent: nodelets and topics that are silent, and what to say about it.
        unresponsive: nodelets that do not answer.
        published: topics of ordinary nodes that have a publisher.
        topology: tells who hears whom.
    """
    if not claim.topic:
        return Fault("it has no stream yet")
    if not claim.is_made:
        return Fault("it has no stream")
    for topic in claim.sources:
        if topic not in published:
            return Fault(f"topic {topic} is not published any more")
        if not _is_what_it_was(topic, claim, topology()):
            return Fault(f"topic {topic} is not described any more as what is needed")
    doubts = []
    for name in claim.nodelets:
        record = manager.graph.find(name)
        if record is None or record.transformation is None:
            return Fault(f"nodelet {name} is gone")
        if record.state is not State.RUNNING:
            return Fault(record.detail or f"nodelet {name} is {record.state.name.lower()}")
        for port, topic in claim.wiring[name].items():
            if record.topics.get(port, "") != topic:
                return Fault(f"port {port} of {name} was connected elsewhere")
        if name in silent:
            doubts.append(silent[name])
        elif name in unresponsive:
            doubts.append(f"nodelet {name} does not answer")
        elif record.claimed and not is_current(manager.library, record):
            doubts.append(f"transformation {record.label} was removed")
    for topic in claim.sources:
        if topic in silent:
            doubts.append(silent[topic])
    return Fault(doubts[0], severed=False) if doubts else None


def _is_what_it_was(topic: str, claim: Claim, topology: Topology) -> bool:
    """Whether the library still says of a topic what the claim's parts, or its client, need."""
    concerned = [
        listener.demand
        for listener in topology.listeners(topic)
        if claim.wiring.get(listener.nodelet, {}).get(listener.port) == topic
        or listener.port == claim.claim_id
    ]
    senders = topology.senders(topic)
    return topology.is_described(topic) and all(
        topology.serves(sender, demand) for sender in senders for demand in concerned
    )


def is_current(library: Library, record: Record) -> bool:
    """Whether the library still has what a nodelet was made from, perhaps in a newer version."""
    if is_relay(record.transformation):
        return True
    try:
        library.get(record.label)
    except UnknownTransformation:
        return False
    return True
