# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets with variables: what they send follows from what they receive.

Where it is not certain what a nodelet receives, each possibility counts. What it has received
since it was connected as it is binds its variables, even if nothing sends there any more. As long
as a variable of an out-port is unbound, the nodelet has received nothing and sends nothing there.
What people connect to a topic of which nothing is known may receive anything there.
"""

from __future__ import annotations

import itertools
import math
from typing import Callable, Dict, FrozenSet, Iterable, List, Optional, Sequence, Tuple

from dyknow.manager.claims.bound_tags import Inlet, Sent, Way, supplied, ways_to_bind
from dyknow.manager.claims.ends import Consumer, NodeletEnds, Producer
from dyknow.manager.planning.supply import Demand, ways_to_meet
from dyknow.manager.record import NOTHING_HEARD, Heard
from dyknow.manager.specifications.tags import Subsumption, Term

#: Possibilities that are told apart; beyond, nothing is known to be supplied.
_MOST_POSSIBILITIES = 16
#: What may be anything.
_UNKNOWN: Tuple[Sent, ...] = (((), ""),)
#: An in-port that does not receive what it demands.
_CONFUSED = Inlet(Demand(frozenset((Term("nothing"),))), _UNKNOWN)

_Key = Tuple[int, str]
"""Number of a nodelet, and its port."""


class DependentNodelets:
    """What nodelets with variables may send; they are numbered as they come."""

    def __init__(
        self, producers: Callable[[str], Sequence[Producer]], ontology: Subsumption
    ) -> None:
        """Begin with none.

        Args:
            producers: returns all producers of a topic.
            ontology: what is a kind of what.
        """
        self._producers = producers
        self._ontology = ontology
        self._nodelets: List[NodeletEnds] = []
        self._inputs: List[Dict[str, Tuple[Consumer, Tuple[str, ...]]]] = []
        self._places: Dict[str, List[_Key]] = {}
        self._possible: Dict[_Key, Tuple[Producer, ...]] = {}
        self._beside: Dict[_Key, List[List[Way]]] = {}

    def __len__(self) -> int:
        """Count the nodelets."""
        return len(self._nodelets)

    def add(self, ends: NodeletEnds) -> int:
        """Add a nodelet; returns its number. Its ends are placed on topics one by one."""
        self._nodelets.append(ends)
        self._inputs.append({})
        return len(self._nodelets) - 1

    def place_consumer(self, consumer: Consumer, topics: Tuple[str, ...]) -> None:
        """Say where an in-port may be."""
        self._inputs[consumer.ends][consumer.port] = consumer, topics

    def place_producer(self, number: int, port: str, topic: str) -> None:
        """Say that an out-port with variables may be on a topic."""
        self._places.setdefault(topic, []).append((number, port))

    @property
    def topics(self) -> FrozenSet[str]:
        """Topics on which out-ports with variables may be."""
        return frozenset(self._places)

    def on(self, topic: str) -> List[Producer]:
        """Return what out-ports with variables may send on a topic."""
        return [each for key in self._places.get(topic, ()) for each in self._possible[key]]

    def bind(self) -> None:
        """Bind the variables of nodelets, from the sources on."""
        self._beside.clear()
        self._possible = {
            (number, producer.port): (producer._replace(tags=(), is_unbound=True),)
            for number, ends in enumerate(self._nodelets)
            for producer, _ in ends.producers
            if any(not tag.is_ground for tag in producer.tags)
        }
        numbers = sorted({number for number, _ in self._possible})
        for _ in range(len(numbers) + 1):
            if not [number for number in numbers if self._bind_one(number)]:
                return
        for key, found in self._possible.items():  # it feeds itself, and never settles
            self._possible[key] = (found[0]._replace(tags=(), is_unbound=False),)

    def _bind_one(self, number: int) -> bool:
        """Bind the variables of one nodelet; whether that changed what it sends."""
        ends = self._nodelets[number]
        possible = [self._ways(number, inlets) for inlets in self._inlets(number)]
        is_changed = False
        for pattern, _ in ends.producers:
            key = number, pattern.port
            if key in self._possible:
                found = tuple(dict.fromkeys(_bound(pattern, ways) for ways in possible))
                is_changed = is_changed or found != self._possible[key]
                self._possible[key] = found
        return is_changed

    def _ways(self, number: int, inlets: Iterable[Inlet]) -> List[Way]:
        return ways_to_bind(self._nodelets[number].known, inlets, self._ontology)

    def _inlets(self, number: int, but: str = "") -> List[Tuple[Inlet, ...]]:
        """List what the in-ports of a nodelet, ``but`` one, may receive at the same time."""
        choices: List[List[Optional[Inlet]]] = []
        for port, (consumer, topics) in self._inputs[number].items():
            if port == but or not consumer.variables:
                continue
            found: Dict[Tuple[Sent, ...], None] = {}
            for topic in topics:
                if self._nodelets[number].is_by_hand and not self._producers(topic):
                    found[_UNKNOWN] = None
                else:
                    found.update(dict.fromkeys(self._sent(topic)))
            choices.append([Inlet(consumer.demand, sent) if sent else None for sent in found])
        if math.prod(len(each) or 1 for each in choices) > _MOST_POSSIBILITIES:
            return [(_CONFUSED,)]
        return [
            tuple(inlet for inlet in combination if inlet is not None)
            for combination in itertools.product(*(each or [None] for each in choices))
        ]

    def _sent(self, topic: str) -> List[Tuple[Sent, ...]]:
        """List what may be sent on a topic at the same time."""
        by_source: Dict[Tuple[str, str], Dict[Producer, None]] = {}
        for producer in self._producers(topic):
            by_source.setdefault(producer[:2], {})[producer] = None
        if math.prod(map(len, by_source.values())) > _MOST_POSSIBILITIES:
            return [_UNKNOWN]
        return [
            tuple((each.tags, each.datatype) for each in combination if not each.is_unbound)
            for combination in itertools.product(*by_source.values())
        ]

    def topics_of(self, place: Tuple[str, str]) -> List[str]:
        """Return the topics on which an out-port with variables may be: nodelet and port."""
        return [
            topic
            for topic, keys in sorted(self._places.items())
            if any(self._possible[key][0][:2] == place for key in keys)
        ]

    def supplies(self) -> Dict[Tuple[str, str], FrozenSet[Producer]]:
        """Return what the out-ports with variables may send, by nodelet and port."""
        found: Dict[Tuple[str, str], FrozenSet[Producer]] = {}
        for possible in self._possible.values():
            place = possible[0].nodelet, possible[0].port
            found[place] = found.get(place, frozenset()).union(possible)
        return found

    def ways(self, nodelet: str) -> Optional[List[Way]]:
        """Return the ways in which a nodelet's variables are bound; None if nobody can tell."""
        numbers = [
            number
            for number, inputs in enumerate(self._inputs)
            if any(consumer.nodelet == nodelet for consumer, _ in inputs.values())
        ]
        possible = [inlets for number in numbers for inlets in self._inlets(number)]
        return self._ways(numbers[0], possible[0]) if len(possible) == 1 else None

    def heard(self) -> Dict[str, Heard]:
        """Return what each nodelet has received by now, where that is certain."""
        found: Dict[str, Heard] = {}
        for number, ends in enumerate(self._nodelets):
            possible = self._inlets(number) if ends.listening else []
            ways = self._ways(number, possible[0]) if len(possible) == 1 else []
            if ways:
                name = next(iter(self._inputs[number].values()))[0].nodelet
                bound = tuple(tuple(sorted(way.items())) for way in ways)
                is_more = ways != [ends.given]
                found[name] = Heard(ends.listening, bound) if is_more else NOTHING_HEARD
        return found

    def ports_beside(self, consumer: Consumer) -> List[str]:
        """Return the in-ports that have to be changed with one, since they share variables."""
        variables, size = consumer.variables, -1
        inputs = [each for each, topics in self._inputs[consumer.ends].values() if topics]
        while len(variables) > size:
            size = len(variables)
            for each in inputs:
                if each.variables & variables:
                    variables |= each.variables
        return [each.port for each in inputs if each.variables & variables]

    def fits(self, producer: Producer, consumer: Consumer) -> bool:
        """Whether a producer sends what an in-port demands, beside what its nodelet receives."""
        key = consumer.ends, consumer.port
        if key not in self._beside:
            known = list(self._nodelets[consumer.ends].known)
            others = self._inlets(*key)
            self._beside[key] = [self._ways(key[0], inlets) or known for inlets in others]
        tags, datatype, demand = producer.tags, producer.datatype, consumer.demand
        return all(
            any(
                next(ways_to_meet(tags, datatype, demand, self._ontology, way), None) is not None
                for way in ways
            )
            for ways in self._beside[key]
        )


def _bound(pattern: Producer, ways: List[Way]) -> Producer:
    tags = supplied(pattern.tags, ways)
    is_open = any(not tag.substitute(way).is_ground for way in ways[:1] for tag in pattern.tags)
    return pattern._replace(tags=tags, is_unbound=is_open)
