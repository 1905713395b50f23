"""The AND/OR graph of the library, in numbers: demands and actions are counted as they come.

Numbers make the planner quick: a library of 100,000 transformations is searched through lists of
integers. Who supplies a demand is looked up once and remembered until a transformation that could
change the answer comes or goes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import AbstractSet, Dict, Iterable, List, Optional, Tuple

from dyknow.errors import InvalidTag
from dyknow.manager.planning import Action, Live, Need, New, Source
from dyknow.manager.supply import Demand, Supply
from dyknow.manager.tags import NO_ONTOLOGY, Subsumption, Term, parse_tag
from dyknow.manager.transformation import IN, OUT, TOPIC, Transformation

_Terms = Tuple[Term, ...]


@dataclass
class Reach:
    """The part of the network that a goal can reach.

    Attributes:
        goal: number of the demand that is asked for.
        demands: numbers of the demands, in the order of their discovery.
        served: for each action, the demands that it supplies and from which port, in that order.
        live: the best live stream for each demand that has one.
    """

    goal: int
    demands: List[int] = field(default_factory=list)
    served: Dict[int, List[Tuple[int, str]]] = field(default_factory=dict)
    live: Dict[int, Live] = field(default_factory=dict)


class Network:
    """Transformations as actions, in-ports as demands; changes a little at a time."""

    def __init__(self, ontology: Subsumption = NO_ONTOLOGY) -> None:
        """Start empty."""
        self.ontology = ontology
        self.labels: List[str] = []
        self.costs: List[int] = []
        self.needs: List[Tuple[int, ...]] = []
        self.demands: List[Demand] = []
        self._actions: List[Action] = []
        self._by_label: Dict[str, int] = {}
        self._by_demand: Dict[Demand, int] = {}
        self._suppliers: List[Tuple[int, List[Tuple[str, str, int]]]] = []
        self._functors: List[Tuple[str, ...]] = []
        self._changes: Dict[str, int] = {}
        self._supply: Supply[New] = Supply(ontology)
        self._given: Dict[str, List[Tuple[New, _Terms]]] = {}
        self._terms: Dict[str, Optional[Term]] = {}

    def __len__(self) -> int:
        """Count the transformations."""
        return len(self._by_label)

    def action(self, number: int) -> Action:
        """Return an action by its number."""
        return self._actions[number]

    def source(self, number: int, port: str) -> New:
        """Name the out-port of an action."""
        return New(self.labels[number], port)

    def add(self, transformations: Iterable[Transformation]) -> None:
        """Add transformations; those of known labels are replaced. Topics are no actions."""
        for each in transformations:
            self.remove(each.label)
            if each.type == TOPIC:
                continue
            needs = []
            given = []
            for port in each.ports:
                terms = self.terms(port.tags)
                if not terms:
                    continue
                if port.direction == IN:
                    needs.append(Need(port.name, Demand(frozenset(terms), port.datatype)))
                elif port.direction == OUT:
                    given.append((New(each.label, port.name), terms))
                    self._supply.add(given[-1][0], terms, port.datatype)
                    self._changed(terms)
            self._by_label[each.label] = len(self.labels)
            self._given[each.label] = given
            self.labels.append(each.label)
            self.costs.append(each.cost)
            self.needs.append(tuple(dict.fromkeys(self.number(need.demand) for need in needs)))
            self._actions.append(Action(each.label, each.cost, tuple(needs)))

    def remove(self, label: str) -> None:
        """Forget a transformation, if it is known; its number is not used again."""
        if self._by_label.pop(label, None) is None:
            return
        for source, terms in self._given.pop(label):
            self._supply.remove(source, terms)
            self._changed(terms)

    def terms(self, tags: Iterable[str]) -> _Terms:
        """Read tags; what is no term says nothing to the planner."""
        found = []
        for text in tags:
            if text not in self._terms:
                try:
                    self._terms[text] = parse_tag(text)
                except InvalidTag:
                    self._terms[text] = None
            term = self._terms[text]
            if term is not None:
                found.append(term)
        return tuple(found)

    def number(self, demand: Demand) -> int:
        """Return the number of a demand."""
        found = self._by_demand.get(demand)
        if found is None:
            found = self._by_demand[demand] = len(self.demands)
            self.demands.append(demand)
            self._suppliers.append((-1, []))
            self._functors.append(tuple({term.functor for term in demand.tags}))
        return found

    def suppliers(self, number: int) -> List[Tuple[str, str, int]]:
        """Who supplies a demand: label, port and number of each, sorted."""
        changes = 0
        for functor in self._functors[number]:
            changes += self._changes.get(functor, 0)
        known_since, found = self._suppliers[number]
        if known_since != changes:
            by_label = self._by_label
            sources = self._supply.suppliers(self.demands[number])
            found = sorted((label, port, by_label[label]) for label, port in sources)
            self._suppliers[number] = (changes, found)
        return found

    def reach(self, goal: Demand, streams: Supply[Live], exclude: AbstractSet[str]) -> Reach:
        """Collect what the goal can reach; where a live stream is, nothing more is needed."""
        reach = Reach(self.number(goal))
        served = reach.served
        needs = self.needs
        demands = reach.demands
        demands.append(reach.goal)
        seen = {reach.goal}
        for number in demands:  # grows while it is walked through
            if streams:
                alive = streams.suppliers(self.demands[number])
                if alive:
                    reach.live[number] = min(alive)
                    continue
            for label, port, action in self.suppliers(number):
                places = served.get(action)
                if places is not None:
                    places.append((number, port))
                    continue
                if exclude and label in exclude:
                    continue
                served[action] = [(number, port)]
                for need in needs[action]:
                    if need not in seen:
                        seen.add(need)
                        demands.append(need)
        return reach

    def _changed(self, terms: _Terms) -> None:
        for term in terms:
            for functor in self.ontology.names_above(term.functor):
                self._changes[functor] = self._changes.get(functor, 0) + 1


Chosen = Dict[int, Tuple[int, str]]
"""For each demand the action, or -1 for a live stream, and the port that supplies it."""


def source_of(network: Network, reach: Reach, chosen: Chosen, demand: int) -> Source:
    """Name what was chosen for a demand."""
    action, port = chosen[demand]
    return reach.live[demand] if action < 0 else network.source(action, port)
