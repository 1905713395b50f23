# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The AND/OR graph of the library, in numbers: demands and actions are numbered as they come.

Numbers make the planner fast: a library of 100,000 transformations is searched through lists of
integers. A demand is a pattern. The suppliers of a pattern are found by unification once, and
again after a transformation came or went that could change the answer. A rule that supplies a
pattern is *specialised*: what the pattern says of the rule's variables is handed on to its
in-ports, as magic sets do. A specialised rule is an action with a number of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import AbstractSet, Dict, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

from dyknow.manager.planning.index import AtomIndex
from dyknow.manager.planning.patterns import (
    NO_TYPES,
    Atom,
    Names,
    Pattern,
    Theta,
    Types,
    atoms_of,
    pushed,
    solutions,
)
from dyknow.manager.planning.problem import Live, New
from dyknow.manager.planning.rules import Premise, Rule, pattern_of, rule_of
from dyknow.manager.planning.supply import ANY, Demand
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption, Term, read_tags
from dyknow.model.transformation import IN, OUT, TOPIC, Port, Transformation

_Terms = Tuple[Term, ...]
_CLOSED: Tuple[Theta, ...] = ((),)


class Head(NamedTuple):
    """A tagged out-port of an action.

    Attributes:
        source: what it is in a plan, unless the action has variables.
        texts: its tags as they are written.
        atoms: those that can supply something, with the variables numbered as the rule's.
        datatype: its ROS type.
        is_ground: whether the atoms have no variables.
        rate: Hz that it states; 0 if it states none.
    """

    source: New
    texts: Tuple[str, ...]
    atoms: Tuple[Atom, ...]
    datatype: str
    is_ground: bool
    rate: float = 0.0


class Offer(NamedTuple):
    """How an action supplies a pattern.

    Attributes:
        head: the out-port.
        solutions: what the wanted variables of the pattern stand for; None if that depends on
            the bindings of the action.
    """

    head: Head
    solutions: Optional[Tuple[Theta, ...]]

    def of(self, pattern: Pattern, theta: Theta, names: Names) -> Iterable[Theta]:
        """Return what the wanted variables stand for, if the action is bound."""
        if self.solutions is not None:
            return self.solutions
        return solutions([atom.ground(theta) for atom in self.head.atoms], pattern, names)


class LiveMatch(NamedTuple):
    """A live stream that supplies a pattern under bindings of its wanted variables."""

    demand: int
    theta: Theta
    stream: Live


@dataclass
class Reach:
    """The part of the network that a goal can reach.

    Attributes:
        goal: number of the demand that is asked for.
        demands: those reached, in the order of discovery.
        actions: those reached.
        missing: for each action of the network, how many demands it needs; 0 if not reached.
        live: the best live streams.
    """

    goal: int
    demands: List[int]
    actions: List[int]
    missing: List[int]
    live: List[LiveMatch]


class LiveStreams:
    """The streams of one moment, indexed."""

    def __init__(self, names: Names) -> None:
        """Start without a stream."""
        self._names = names
        self._index: AtomIndex[int] = AtomIndex(names)
        self._streams: List[Live] = []
        self._atoms: List[Tuple[Atom, ...]] = []
        self.terms: Dict[Live, _Terms] = {}

    def __len__(self) -> int:
        """Count the streams."""
        return len(self._streams)

    def add(self, stream: Live, terms: Iterable[Term]) -> None:
        """Add a stream; its tags with variables supply nothing."""
        ground = tuple(term for term in terms if term.is_ground)
        atoms = atoms_of(ground, (), self._names)
        for atom in atoms:
            self._index.add(len(self._streams), atom)
        self._streams.append(stream)
        self._atoms.append(atoms)
        self.terms[stream] = self.terms.get(stream, ()) + ground

    def labels(self, pattern: Pattern) -> Set[str]:
        """Return the labels of the streams that supply a pattern."""
        return {
            self._streams[each].label
            for each in self._index.find(pattern)
            if _goes_with(self._streams[each].datatype, self._streams[each].rate, pattern)
            and any(True for _ in solutions(self._atoms[each], pattern, self._names))
        }

    def matches(self, number: int, pattern: Pattern) -> List[LiveMatch]:
        """Return the best stream for each binding of the wanted variables."""
        best: Dict[Theta, Live] = {}
        for each in self._index.find(pattern):
            stream = self._streams[each]
            if _goes_with(stream.datatype, stream.rate, pattern):
                for theta in solutions(self._atoms[each], pattern, self._names):
                    best[theta] = min(best.get(theta, stream), stream)
        return [LiveMatch(number, theta, best[theta]) for theta in sorted(best)]


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
        self.serves: List[List[int]] = []  # what an action supplies, as far as it was asked for
        #: Rules of the actions whose in-ports have variables.
        self.rules: Dict[int, Rule] = {}
        #: Actions among these that join in-ports.
        self.joined: Set[int] = set()
        #: Actions that others specialise.
        self.general: Dict[int, int] = {}
        # By the number of a demand:
        self.patterns: List[Pattern] = []
        #: Actions that need it; one that joins in-ports is there as its complement.
        self.users: List[List[int]] = []
        #: Demands that want names of variables.
        self.wanting: Set[int] = set()
        self._shown: List[Demand] = []
        #: Their suppliers, as far as they were looked up.
        self.found: List[Dict[int, Tuple[Offer, ...]]] = []
        self._outdated: Set[int] = set()  # demands whose suppliers are to be looked up
        self._by_label: Dict[str, int] = {}
        self._by_pattern: Dict[Pattern, int] = {}
        self._by_text: Dict[Tuple[Tuple[str, ...], str], int] = {}
        self._by_functor: Dict[str, List[int]] = {}
        self._by_types: Dict[Tuple[int, Tuple[Types, ...]], int] = {}
        self._touched: Set[str] = set()
        self._heads: AtomIndex[Tuple[int, int]] = AtomIndex(self.names)
        self._given: Dict[int, Tuple[Head, ...]] = {}
        self._asked = 0  # demands that only goals had
        self._shared: Dict[Tuple[str, ...], Tuple[str, ...]] = {}
        self._ranks: List[int] = []
        self._by_rank: List[int] = []

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
        for at, head in enumerate(self._given.pop(action)):
            for atom in head.atoms:
                self._heads.remove((action, at), atom)
                self._touched.add(atom.functor)

    def number(self, pattern: Pattern, shown: Demand) -> int:
        """Return the number of a demand."""
        found = self._by_pattern.get(pattern)
        if found is None:
            found = self._by_pattern[pattern] = len(self.patterns)
            self.patterns.append(pattern)
            self.users.append([])
            self._shown.append(shown)
            self.found.append({})
            self._outdated.add(found)
            if pattern.wanted:
                self.wanting.add(found)
            for functor in dict.fromkeys([atom.functor for atom in pattern.atoms]):
                if functor in self._by_functor:
                    self._by_functor[functor].append(found)
                else:
                    self._by_functor[functor] = [found]
        elif pattern.types and str(shown) < str(self._shown[found]):
            self._shown[found] = shown  # of equal demands the first in the alphabet is told
        return found

    def demand(self, number: int) -> Demand:
        """Return a demand as people write it."""
        return self._shown[number]

    def tags(self, action: int) -> List[Term]:
        """Return the tags of all out-ports of an action."""
        return [term for head in self._given[self.base(action)] for term in read_tags(head.texts)]

    def terms(self, label: str, port: str) -> _Terms:
        """Return the tags of an out-port."""
        heads = self._given[self._by_label[label]]
        return read_tags(next(each.texts for each in heads if each.source.port == port))

    def suppliers(self, number: int) -> Dict[int, Tuple[Offer, ...]]:
        """Return the actions that supply a demand, by label, each with its out-ports."""
        if number in self._outdated:
            before = self.found[number]
            found = self.found[number] = self._find(self.patterns[number])
            for action in found:
                if action not in before:
                    self.serves[action].append(number)
            self._outdated.discard(number)
        return self.found[number]

    def ranks(self) -> Tuple[List[int], List[int]]:
        """Return the rank of each action by its label, and the actions by their ranks."""
        if len(self._ranks) < len(self.labels):
            labels = self.labels
            self._by_rank += range(len(self._ranks), len(labels))
            self._by_rank.sort(key=labels.__getitem__)
            self._ranks = [0] * len(labels)
            for rank, action in enumerate(self._by_rank):
                self._ranks[action] = rank
        return self._ranks, self._by_rank

    def reach(
        self,
        goal: Demand,
        streams: LiveStreams,
        exclude: AbstractSet[str],
        wanted: Sequence[str] = (),
    ) -> Reach:
        """Collect what the goal can reach; a demand with a live stream needs nothing else.

        Args:
            goal: what is asked for.
            streams: what is there.
            exclude: labels that must not be used.
            wanted: variables of the goal of which every name matters.
        """
        self._forget_suppliers()
        pattern = pattern_of(tuple(goal.tags), goal.datatype, self.names, wanted)
        pattern = pattern._replace(min_rate=goal.min_rate)
        self._asked += pattern not in self._by_pattern
        first = self.number(pattern, goal)
        live: List[LiveMatch] = []
        actions: List[int] = []
        needs, patterns, known, outdated = (
            self.needs,
            self.patterns,
            self.found,
            self._outdated,
        )
        excluded = self.numbers(exclude)
        any_live = len(streams) > 0
        is_reached = bytearray(len(patterns))
        is_used = bytearray(len(needs))
        is_reached[first] = 1
        demands = [first]
        for number in demands:  # grows meanwhile
            if any_live:
                alive = streams.matches(number, patterns[number])
                live += alive
                if alive and not patterns[number].wanted:
                    continue
            if number in outdated:
                self.suppliers(number)  # may specialise rules
                is_reached += bytes(len(patterns) - len(is_reached))
                is_used += bytes(len(needs) - len(is_used))
            for action in known[number]:
                if not is_used[action]:
                    is_used[action] = 1
                    if excluded and self.base(action) in excluded:
                        continue
                    actions.append(action)
                    for need in needs[action]:
                        if not is_reached[need]:
                            is_reached[need] = 1
                            demands.append(need)
        missing = [0] * len(needs)
        for action in actions:
            missing[action] = len(needs[action])
        return Reach(first, demands, actions, missing, live)

    # Inside

    def _insert(self, transformation: Transformation) -> None:
        label, _, _, cost, _, ports = transformation
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
        heads: List[Head] = []
        for port in tagged:
            if port.direction == OUT:
                head = self._head(New(label, port.name), port, variables)
                for atom in head.atoms:
                    self._heads.add((action, len(heads)), atom)
                    self._touched.add(atom.functor)
                heads.append(head)
        self._given[action] = tuple(heads)

    def _head(self, source: New, port: Port, variables: Tuple[str, ...]) -> Head:
        texts = port.tags
        terms = read_tags(texts)
        is_ground = "?" not in "".join(texts)
        if not is_ground:
            terms = tuple([term for term in terms if set(term.variables) <= set(variables)])
            is_ground = all(term.is_ground for term in terms)
        atoms = atoms_of(terms, variables, self.names)
        return Head(source, texts, atoms, port.datatype, is_ground, port.rate)

    def _append(self, label: str, cost: int) -> int:
        self.labels.append(label)
        self.costs.append(cost)
        self.serves.append([])
        return len(self.labels) - 1

    def _need(self, action: int, inputs: Tuple[int, ...]) -> None:
        """Set the demands of an action."""
        self.inputs.append(inputs)
        needs = inputs if len(inputs) < 2 else tuple(dict.fromkeys(inputs))
        self.needs.append(needs)
        user = ~action if action in self.joined else action
        for need in needs:
            self.users[need].append(user)

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
        rule = rule_of(transformation, premises, out, self.names)
        self.ports.append(tuple(each.port for each in premises))
        self._bind(action, rule, [NO_TYPES] * len(rule.variables))
        return rule.variables

    def _bind(self, action: int, rule: Rule, more: Sequence[Types]) -> None:
        """Let an action be a rule whose variables have further types."""
        self.rules[action] = rule
        if rule.joins:
            self.joined.add(action)
        inputs = []
        for at, premise in enumerate(rule.premises):
            shown = Demand(frozenset(rule.shown(at, more, self.names)), premise.datatype)
            inputs.append(self.number(rule.pattern(at, more, self.names), shown))
        self._need(action, tuple(inputs))

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
            found = self._by_text[key] = self.number(pattern, Demand(frozenset(terms), datatype))
        return found

    def _find(self, pattern: Pattern) -> Dict[int, Tuple[Offer, ...]]:
        found: Dict[int, Tuple[Offer, ...]] = {}
        heads = self._heads.find(pattern)
        order = list(heads)
        if len(order) > 1:
            order.sort(key=lambda each: (self.labels[each[0]], each[1]))
        is_simple = not pattern.types and len(pattern.atoms) == 1 and pattern.datatype in ANY
        for action, at in order:
            head = self._given[action][at]
            if not _goes_with(head.datatype, head.rate, pattern):
                continue
            if head.is_ground:
                known = _CLOSED if is_simple else tuple(solutions(head.atoms, pattern, self.names))
                if known:
                    found[action] = (*found.get(action, ()), Offer(head, known))
                continue
            rule = self.rules[action]
            more = pushed(head.atoms, pattern, rule.types, self.names)
            if more is not None:
                special = self._specialised(action, rule, more)
                found[special] = (*found.get(special, ()), Offer(head, None))
        return found

    def _specialised(self, action: int, rule: Rule, more: Tuple[Types, ...]) -> int:
        """Return the number of an action whose variables have further types."""
        if not any(more):
            return action
        found = self._by_types.get((action, more))
        if found is None:
            found = self._append(self.labels[action], self.costs[action])
            self._by_types[action, more] = found
            self.general[found] = action
            self.ports.append(self.ports[action])
            self._bind(found, rule, more)
        return found

    def _forget_suppliers(self) -> None:
        """Forget the suppliers of the demands that a change may concern."""
        for functor in self._touched:
            for name in self.names.above(functor):
                self._outdated.update(self._by_functor.get(name, ()))
        self._touched.clear()


def _goes_with(datatype: str, rate: float, pattern: Pattern) -> bool:
    if rate and rate < pattern.min_rate:
        return False
    return pattern.datatype in ANY or datatype in (*ANY, pattern.datatype)
