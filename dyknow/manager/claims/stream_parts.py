# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The places where the messages of one claim's stream can be counted, and what feeds what."""

from __future__ import annotations

from typing import Dict, List

from dyknow.manager.claim import Claim
from dyknow.manager.claims.flows import Place
from dyknow.manager.graph import Graph
from dyknow.model.graph import State
from dyknow.model.transformation import OUT


class StreamParts:
    """Out-ports and ordinary topics of a claim.

    Attributes:
        claim: whose stream it is.
        topics: where the messages of each place go.
    """

    def __init__(self, claim: Claim, graph: Graph) -> None:
        """Find the places at which messages can be counted now."""
        self.claim = claim
        self.topics: Dict[Place, str] = {("", topic): topic for topic in claim.sources}
        for name in claim.nodelets:
            record = graph.find(name)
            if (
                record is None
                or record.transformation is None
                or record.state is not State.RUNNING
            ):
                continue
            outs = {port.name for port in record.transformation.ports if port.direction == OUT}
            for port, topic in claim.wiring[name].items():
                if port in outs:
                    self.topics[(name, port)] = topic
        self._senders: Dict[str, List[Place]] = {}
        for place, topic in sorted(self.topics.items()):
            self._senders.setdefault(topic, []).append(place)

    @property
    def goal(self) -> Place:
        """What publishes where the client listens."""
        return goal_of(self.claim)

    def feeders(self, place: Place) -> List[List[Place]]:
        """List what feeds a place: the senders on the topic of each in-port of its nodelet."""
        name, _ = place
        topics = self.claim.wiring.get(name, {}).values()
        feeding = [
            [each for each in self._senders.get(topic, ()) if each[0] != name] for topic in topics
        ]
        return [senders for senders in feeding if senders]


def goal_of(claim: Claim) -> Place:
    """Return what publishes where a claim's client listens."""
    return claim.goal if claim.goal[0] else ("", claim.topic)


def name_of(place: Place) -> str:
    """Name of the nodelet, or of the topic where there is none."""
    return place[0] or place[1]


def described(place: Place) -> str:
    """Name a place for people."""
    return f"nodelet {place[0]}" if place[0] else f"topic {place[1]}"
