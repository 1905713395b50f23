# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The AND/OR graph of the library, in numbers: demands and actions are numbered as they come.

Numbers make the planner fast: a library of 100,000 transformations is searched through lists of
integers. The suppliers of a demand are looked up once, and again after a transformation came or
went that could change the answer.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import AbstractSet, Dict, Iterable, List, Optional, Set, Tuple

from dyknow.manager.planning.problem import Action, Live, Need, New, Source
from dyknow.manager.planning.supply import Demand, Supply
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption, Term, read_tags
from dyknow.model.transformation import IN, OUT, TOPIC, Port, Transformation

Chosen = Dict[int, int]
"""For each demand the action that supplies it, or -1 for a live stream."""
_Terms = Tuple[Term, ...]


@dataclass
class Reach:
    """The part of the network that a goal can reach.

    Attributes:
        goal: number of the demand that is asked for.
        consumers: for each demand the actions that need it; demands in the order of discovery.
        served: for each action, the demands that it supplies, in that order.
        live: the best live stream for each demand that has one.
    """

    goal: int
    consumers: Dict[int, List[int]] = field(default_factory=dict)
    served: Dict[int, List[int]] = field(default_factory=dict)
    live: Dict[int, Live] = field(default_factory=dict)


class Network:
    """Transformations as actions, in-ports as demands; changes a little at a time."""

    def __init__(self, ontology: Subsumption = NO_ONTOLOGY) -> None:
        """Start empty."""
        self.ontology = ontology
        self.labels: List[str] = []
        self.costs: List[int] = []
        self.needs: List[Tuple[int, ...]] = []
        self.actions: List[Action] = []
        self.ports: List[Tuple[str, ...]] = []
        self.inputs: List[List[int]] = []
        self.demands: List[Demand] = []
        self._by_label: Dict[str, int] = {}
        self._by_demand: Dict[Demand, int] = {}
        self._by_text: Dict[Tuple[Tuple[str, ...], str], int] = {}
        self._by_functor: Dict[str, List[int]] = {}
        self._suppliers: List[Optional[Dict[int, New]]] = []
        self._touched: Set[str] = set()
        self._supply: Supply[New] = Supply(ontology)
        self._asked = 0  # demands that only goals had
        self._given: Dict[str, List[Tuple[New, _Terms]]] = {}
        self._shared: Dict[Tuple[str, ...], Tuple[str, ...]] = {}

    def __len__(self) -> int:
        """Count the transformations."""
        return len(self._by_label)

    @property
    def waste(self) -> int:
        """Numbers of actions that are gone, and of demands that only one request had."""
        return len(self.labels) - len(self._by_label) + self._asked

    def numbers(self, labels: AbstractSet[str]) -> Set[int]:
        """Return the actions of labels; unknown ones are left out."""
        by_label = self._by_label
        return {by_label[label] for label in labels if label in by_label}

    def add(self, transformations: Iterable[Transformation]) -> None:
        """Add transformations; those of known labels are replaced. Topics are no actions."""
        for each in transformations:
            self.remove(each.label)
            if each.type != TOPIC:
                self._insert(each.label, each.cost, each.ports)

    def remove(self, label: str) -> None:
        """Forget a transformation, if it is known; its number is not used again."""
        if self._by_label.pop(label, None) is None:
            return
        for source, terms in self._given.pop(label):
            self._supply.remove(source, terms)
            self._touched.update([term.functor for term in terms])

    def number(self, demand: Demand) -> int:
        """Return the number of a demand."""
        found = self._by_demand.get(demand)
        if found is None:
            found = self._by_demand[demand] = len(self.demands)
            self.demands.append(demand)
            self._suppliers.append(None)
            for functor in {term.functor for term in demand.tags}:
                self._by_functor.setdefault(functor, []).append(found)
        return found

    def suppliers(self, number: int) -> Dict[int, New]:
        """Return the actions that supply a demand, by label, each with its out-port."""
        found = self._suppliers[number]
        if found is None:
            found = {}
            for source in sorted(self._supply.suppliers(self.demands[number])):
                found.setdefault(self._by_label[source.label], source)
            self._suppliers[number] = found
        return found

    def reach(self, goal: Demand, streams: Supply[Live], exclude: AbstractSet[str]) -> Reach:
        """Collect what the goal can reach; a demand with a live stream needs nothing else."""
        self._forget_suppliers()
        self._asked += goal not in self._by_demand
        reach = Reach(self.number(goal))
        consumers, served, needs = reach.consumers, reach.served, self.needs
        known = self._suppliers
        excluded = self.numbers(exclude)
        any_live = len(streams) > 0
        consumers[reach.goal] = []
        waiting = [reach.goal]
        for number in waiting:  # grows meanwhile
            if any_live:
                alive = streams.suppliers(self.demands[number])
                if alive:
                    reach.live[number] = min(alive)
                    continue
            for action in known[number] or self.suppliers(number):
                if action in served:
                    served[action].append(number)
                elif action not in excluded:
                    served[action] = [number]
                    for need in needs[action]:
                        if need in consumers:
                            consumers[need].append(action)
                        else:
                            consumers[need] = [action]
                            waiting.append(need)
        return reach

    def sources(self, reach: Reach, chosen: Chosen) -> Dict[int, Source]:
        """Return the source that was chosen for each demand."""
        known, live = self._suppliers, reach.live
        return {
            demand: live[demand] if action < 0 else (known[demand] or {})[action]
            for demand, action in chosen.items()
        }

    def _insert(self, label: str, cost: int, ports: Iterable[Port]) -> None:
        needs = []
        names = []
        inputs = []
        given = []
        for name, direction, datatype, tags in ports:
            if not tags:
                continue
            if direction == IN:
                demand = self._demanded(tags, datatype)
                if demand is not None:
                    names.append(name)
                    inputs.append(demand)
                    needs.append(Need(name, self.demands[demand]))
            elif direction == OUT:
                terms = read_tags(tags)
                if terms:
                    source = New(label, name)
                    given.append((source, terms))
                    self._supply.add(source, terms, datatype)
                    self._touched.update([term.functor for term in terms])
        self._by_label[label] = len(self.labels)
        self._given[label] = given
        self.labels.append(label)
        self.costs.append(cost)
        self.needs.append(tuple(dict.fromkeys(inputs)))
        in_ports = tuple(names)
        self.ports.append(self._shared.setdefault(in_ports, in_ports))
        self.inputs.append(inputs)
        self.actions.append(Action(label, cost, tuple(needs)))

    def _demanded(self, tags: Tuple[str, ...], datatype: str) -> Optional[int]:
        """Return the number of an in-port's demand; None if it has no tags."""
        key = tags, datatype
        found = self._by_text.get(key)
        if found is None:
            terms = read_tags(tags)
            if not terms:
                return None
            found = self._by_text[key] = self.number(Demand(frozenset(terms), datatype))
        return found

    def _forget_suppliers(self) -> None:
        """Forget the suppliers of the demands that a change may concern."""
        for functor in self._touched:
            for name in self.ontology.names_above(functor):
                for number in self._by_functor.get(name, ()):
                    self._suppliers[number] = None
        self._touched.clear()
