# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The AND/OR graph of the library, in numbers: demands and actions are numbered as they come.

Numbers make the planner fast: a library of 100,000 transformations is searched through lists of
integers. A demand is a pattern. The suppliers of a pattern are found by unification once, and
again after a transformation came or went that could change the answer. Where a search needs it,
a rule that supplies a pattern is *specialised*: what the pattern says of the rule's variables is
handed on to its in-ports, as magic sets do. A specialised rule is an action with a number of its
own.
"""

from __future__ import annotations

from typing import Dict, Iterable, List, Optional, Sequence, Set, Tuple

from dyknow.manager.planning.demands import Demands
from dyknow.manager.planning.heads import Heads, Offer, head_of
from dyknow.manager.planning.latency import microseconds
from dyknow.manager.planning.patterns import (
    Names,
    Pattern,
    Types,
    atoms_of,
    narrowed,
)
from dyknow.manager.planning.problem import New
from dyknow.manager.planning.ranks import Ranks
from dyknow.manager.planning.rules import Premise, Rule, pattern_of, rule_of
from dyknow.manager.planning.supply import Demand
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption, Term, read_tags
from dyknow.model.transformation import IN, OUT, TOPIC, Transformation

_Terms = Tuple[Term, ...]


class Network:
    """Transformations as actions, in-ports as demands; changes a little at a time."""

    def __init__(self, ontology: Subsumption = NO_ONTOLOGY) -> None:
        """Start empty."""
        self.ontology = ontology
        self.names = Names(ontology)
        # By the number of an action:
        self.labels: List[str] = []
        self.costs: List[int] = []
        self.needs: List[Tuple[int, ...]] = []
        self.inputs: List[Tuple[int, ...]] = []  # what in-ports demand, in the order written
        self.ports: List[Tuple[str, ...]] = []
        #: Latencies that out-ports state, in microseconds, by label and port.
        self.latencies: Dict[Tuple[str, str], int] = {}
        #: Rules of the actions whose in-ports have variables.
        self.rules: Dict[int, Rule] = {}
        #: Actions among these that join in-ports.
        self.joined: Set[int] = set()
        #: Actions that others specialise.
        self.general: Dict[int, int] = {}
        self._demands = Demands(self.names)
        # By the number of a demand:
        self.patterns = self._demands.patterns
        #: Actions that need it.
        self.users = self._demands.users
        #: Demands that want names of variables.
        self.wanting = self._demands.wanting
        #: Their suppliers, none of them specialised, as far as they were looked up.
        self.found: Dict[int, Dict[int, Tuple[Offer, ...]]] = {}
        self._specialised: Dict[Tuple[int, int], Tuple[int, ...]] = {}
        self._offers: Dict[Tuple[int, int], Tuple[Offer, ...]] = {}
        self._by_label: Dict[str, int] = {}
        self._by_text: Dict[Tuple[Tuple[str, ...], str], int] = {}
        self._by_premise: Dict[Tuple[object, ...], int] = {}
        self._by_types: Dict[Tuple[int, Tuple[Types, ...]], int] = {}
        self._types: Dict[int, Tuple[Types, ...]] = {}
        self._written: Dict[int, Demand] = {}
        self._heads = Heads(self.names)
        self._asked = 0  # demands that only goals had
        self._shared: Dict[Tuple[str, ...], Tuple[str, ...]] = {}
        self._ranks = Ranks()

    def __len__(self) -> int:
        """Count the transformations."""
        return len(self._by_label)

    @property
    def waste(self) -> int:
        """Numbers of actions that are gone or specialised, and of demands that only goals had."""
        return len(self.labels) - len(self._by_label) + self._asked

    def numbers(self, labels: Iterable[str]) -> Set[int]:
        """Return the actions of labels; unknown ones are left out."""
        by_label = self._by_label
        return {by_label[label] for label in labels if label in by_label}

    def base(self, action: int) -> int:
        """Return the action that another one specialises, or that one itself."""
        return self.general.get(action, action)

    def add(self, transformations: Iterable[Transformation]) -> None:
        """Add transformations; those of known labels are replaced. Topics are no actions."""
        for each in transformations:
            self.remove(each.label)
            if each.type != TOPIC:
                self._insert(each)

    def remove(self, label: str) -> None:
        """Forget a transformation, if it is known; its number is not used again."""
        action = self._by_label.pop(label, None)
        if action is None:
            return
        heads = self._heads.remove(action)
        self._demands.touch(heads)
        for head in heads if self.latencies else ():
            self.latencies.pop((label, head.source.port), None)

    def goal(self, demand: Demand, wanted: Sequence[str] = ()) -> int:
        """Return the number of what is asked for; what changed in the library is taken in.

        Args:
            demand: what is asked for.
            wanted: its variables of which every name matters.
        """
        self._demands.refresh()
        pattern = pattern_of(tuple(demand.tags), demand.datatype, self.names, wanted)
        pattern = pattern._replace(min_rate=demand.min_rate)
        self._asked += pattern not in self._demands
        return self._demands.number(pattern)

    def demand(self, number: int) -> Demand:
        """Return what in-ports demand as people write it: of equal demands the first one."""
        known = self._written.get(number)
        return known or min(self._as_written(number), key=str)

    def tags(self, action: int) -> List[Term]:
        """Return the tags of all out-ports of an action."""
        return [
            term for head in self._heads.of(self.base(action)) for term in read_tags(head.texts)
        ]

    def terms(self, label: str, port: str) -> _Terms:
        """Return the tags of an out-port."""
        heads = self._heads.of(self._by_label[label])
        return read_tags(next(each.texts for each in heads if each.source.port == port))

    def suppliers(self, number: int) -> Dict[int, Tuple[Offer, ...]]:
        """Return the actions that can supply a demand, each with its out-ports."""
        if number in self._demands.outdated:
            self.found[number] = self._heads.find(self.patterns[number], self.rules)
            self._demands.outdated.discard(number)
        return self.found[number]

    def specialised(self, number: int, action: int) -> Tuple[int, ...]:
        """Return what a supplier becomes for a demand that says more of its variables."""
        if action not in self.joined:
            return (action,)
        found = self._specialised.get((number, action))
        if found is None:
            offers: Dict[int, Tuple[Offer, ...]] = {}
            for offer in self.found[number][action]:
                special = self._with_types(action, offer.types)
                offers[special] = (*offers.get(special, ()), offer)
            found = self._specialised[number, action] = tuple(offers)
            for special, some in offers.items():
                self._offers[number, special] = some
        return found

    def offers(self, number: int, action: int) -> Tuple[Offer, ...]:
        """Return how an action supplies a demand."""
        if action in self.joined:
            return self._offers[number, action]
        return self.found[number][action]

    def ranks(self) -> Ranks:
        """Return the order of the actions by their labels."""
        self._ranks.update(self.labels, self.general)
        return self._ranks

    # Inside

    def _insert(self, transformation: Transformation) -> None:
        label, _, _, cost, _, ports, *_ = transformation
        action = self._append(label, cost)
        self._by_label[label] = action
        tagged = [port for port in ports if port.tags]
        variables: Tuple[str, ...] = ()
        if [port for port in tagged if port.direction == IN and "?" in "".join(port.tags)]:
            variables = self._bind_rule(action, transformation)
        else:
            names = []
            inputs = []
            for name, direction, datatype, tags, *_ in tagged:
                if direction == IN:
                    demand = self._demanded(tags, datatype)
                    if demand is not None:
                        names.append(name)
                        inputs.append(demand)
            self._need(action, tuple(inputs))
            in_ports = tuple(names)
            self.ports.append(self._shared.setdefault(in_ports, in_ports))
        heads = [
            head_of(New(label, port.name), port, variables, self.names)
            for port in tagged
            if port.direction == OUT
        ]
        self._heads.add(action, tuple(heads))
        for port in tagged:
            if port.latency:
                self.latencies[label, port.name] = microseconds(port.latency)
        self._demands.touch(heads)

    def _append(self, label: str, cost: int) -> int:
        self.labels.append(label)
        self.costs.append(cost)
        return len(self.labels) - 1

    def _as_written(self, number: int) -> Iterable[Demand]:
        """Yield what in-ports of transformations that are still there demand, as written."""
        for action in self.users[number]:
            base = self.base(action)
            if self._by_label.get(self.labels[base]) != base:
                continue
            rule = self.rules[action]
            for at, premise in enumerate(rule.premises):
                if self.inputs[action][at] == number:
                    terms = rule.shown(at, self._types.get(action, ()), self.names)
                    yield Demand(frozenset(terms), premise.datatype)

    def _need(self, action: int, inputs: Tuple[int, ...]) -> None:
        """Set the demands of an action."""
        self.inputs.append(inputs)
        needs = inputs if len(inputs) < 2 else tuple(dict.fromkeys(inputs))
        self.needs.append(needs)
        for need in needs:
            self.users[need].append(action)

    def _bind_rule(self, action: int, transformation: Transformation) -> Tuple[str, ...]:
        """Read the variables of a transformation; return those that its in-ports join."""
        tagged = [port for port in transformation.ports if port.tags]
        premises = [
            Premise(port.name, terms, port.datatype)
            for port in tagged
            for terms in [read_tags(port.tags)]
            if port.direction == IN and terms
        ]
        out = [term for port in tagged if port.direction == OUT for term in read_tags(port.tags)]
        names = self.names
        rule = rule_of(transformation, premises, out, names)
        self.ports.append(tuple(each.port for each in premises))
        self.rules[action] = rule
        if rule.joins:
            self.joined.add(action)
        inputs = []
        for _, terms, datatype in premises:
            key = terms, datatype, rule.variables, rule.types
            number = self._by_premise.get(key)
            if number is None:
                pattern = pattern_of(terms, datatype, names, rule.variables, rule.types)
                number = self._by_premise[key] = self._demands.number(pattern)
            inputs.append(number)
        self._need(action, tuple(inputs))
        return rule.variables

    def _demanded(self, texts: Tuple[str, ...], datatype: str) -> Optional[int]:
        """Return the number of what an in-port without variables demands; None without tags."""
        key = texts, datatype
        found = self._by_text.get(key)
        if found is None:
            terms = read_tags(texts)
            if not terms:
                return None
            if len(terms) > 1:
                terms = tuple(sorted(terms))
            pattern = Pattern(atoms_of(terms, (), self.names), datatype)
            found = self._by_text[key] = self._demands.number(pattern)
            new = Demand(frozenset(terms), datatype)
            known = self._written.setdefault(found, new)
            if known is not new:  # names of one entity
                self._written[found] = min(known, new, key=str)
        return found

    def _with_types(self, action: int, types: Tuple[Types, ...]) -> int:
        """Return the number of an action whose variables have further types."""
        if not any(types):
            return action
        found = self._by_types.get((action, types))
        if found is None:
            found = self._append(self.labels[action], self.costs[action])
            self._by_types[action, types] = found
            self._types[found] = types
            self.general[found] = action
            self.ports.append(self.ports[action])
            rule = self.rules[found] = self.rules[action]
            self.joined.add(found)
            inputs = list(self.inputs[action])
            for step in rule.joins:
                pattern = self.patterns[inputs[step.port]]
                inputs[step.port] = self._demands.number(
                    narrowed(pattern, [types[each] for each in step.variables], self.names)
                )
            self._need(found, tuple(inputs))
        return found
