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

from dataclasses import dataclass, field
from operator import attrgetter
from typing import AbstractSet, Dict, Iterable, List, NamedTuple, Optional, Set, Tuple

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
from dyknow.manager.planning.problem import Action, Live
from dyknow.manager.planning.rules import InPort, Rule, pattern_of, rule_of
from dyknow.manager.planning.supply import ANY, Demand
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption, Term, read_tags
from dyknow.model.transformation import IN, OUT, TOPIC, Transformation

_Terms = Tuple[Term, ...]
_is_ground = attrgetter("is_ground")
_CLOSED: Tuple[Theta, ...] = ((),)


class Head(NamedTuple):
    """A tagged out-port of an action.

    Attributes:
        port: its name.
        atoms: its tags; the variables are numbered as those of the rule.
        datatype: its ROS type.
        is_ground: whether the tags have no variables.
    """

    port: str
    atoms: Tuple[Atom, ...]
    datatype: str
    is_ground: bool


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
        consumers: for each demand the actions that need it; demands in the order of discovery.
            A rule that joins its in-ports is there as its complement, a negative number.
        served: for each action, the demands that it supplies, in that order.
        wanting: the demands among these that have wanted variables.
        live: the best live streams.
    """

    goal: int
    consumers: Dict[int, List[int]] = field(default_factory=dict)
    served: Dict[int, List[int]] = field(default_factory=dict)
    wanting: Set[int] = field(default_factory=set)
    live: List[LiveMatch] = field(default_factory=list)


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

    def matches(self, number: int, pattern: Pattern) -> List[LiveMatch]:
        """Return the best stream for each binding of the wanted variables."""
        best: Dict[Theta, Live] = {}
        for each in self._index.find(pattern):
            stream = self._streams[each]
            if _goes_with(stream.datatype, pattern):
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
        self.inputs: List[Tuple[int, ...]] = []
        self.ports: List[Tuple[str, ...]] = []
        self.actions: List[Action] = []
        #: Rules of the actions whose in-ports have variables.
        self.rules: Dict[int, Rule] = {}
        #: Actions among these that join in-ports.
        self.joined: Set[int] = set()
        #: Actions that others specialise.
        self.general: Dict[int, int] = {}
        # By the number of a demand:
        self.patterns: List[Pattern] = []
        self._shown: List[Demand] = []
        self._suppliers: List[Optional[Dict[int, Tuple[Offer, ...]]]] = []
        self._by_label: Dict[str, int] = {}
        self._by_pattern: Dict[Pattern, int] = {}
        self._by_text: Dict[Tuple[Tuple[str, ...], str], int] = {}
        self._by_functor: Dict[str, List[int]] = {}
        self._by_types: Dict[Tuple[int, Tuple[Types, ...]], int] = {}
        self._special: Dict[int, List[int]] = {}
        self._touched: Set[str] = set()
        self._heads: AtomIndex[Tuple[int, int]] = AtomIndex(self.names)
        self._given: Dict[int, Tuple[Head, ...]] = {}
        self._terms: Dict[Tuple[int, str], _Terms] = {}
        self._asked = 0  # demands that only goals had
        self._shared: Dict[Tuple[str, ...], Tuple[str, ...]] = {}

    def __len__(self) -> int:
        """Count the transformations."""
        return len(self._by_label)

    @property
    def waste(self) -> int:
        """Numbers of actions that are gone or specialised, and of demands that only goals had."""
        return len(self.labels) - len(self._by_label) + self._asked

    def numbers(self, labels: Iterable[str]) -> Set[int]:
        """Return the actions of labels, specialised ones too; unknown labels are left out."""
        by_label = self._by_label
        found = {by_label[label] for label in labels if label in by_label}
        for each in list(found):
            found.update(self._special.get(each, ()))
        return found

    def action(self, label: str) -> int:
        """Return the action of a label."""
        return self._by_label[label]

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
            self._shown.append(shown)
            self._suppliers.append(None)
            for functor in {atom.functor for atom in pattern.atoms}:
                self._by_functor.setdefault(functor, []).append(found)
        elif pattern.types and str(shown) < str(self._shown[found]):
            self._shown[found] = shown  # of equal demands the first in the alphabet is told
        return found

    def demand(self, number: int) -> Demand:
        """Return a demand as people write it."""
        return self._shown[number]

    def terms(self, action: int, port: str) -> _Terms:
        """Return the tags of an out-port."""
        return self._terms[self.base(action), port]

    def suppliers(self, number: int) -> Dict[int, Tuple[Offer, ...]]:
        """Return the actions that supply a demand, by label, each with its out-ports."""
        found = self._suppliers[number]
        if found is None:
            found = self._suppliers[number] = self._find(self.patterns[number])
        return found

    def reach(self, goal: Demand, streams: LiveStreams, exclude: AbstractSet[str]) -> Reach:
        """Collect what the goal can reach; a demand with a live stream needs nothing else."""
        self._forget_suppliers()
        pattern = pattern_of(tuple(goal.tags), goal.datatype, self.names)
        self._asked += pattern not in self._by_pattern
        reach = Reach(self.number(pattern, goal))
        consumers, served, needs, wanting = (
            reach.consumers,
            reach.served,
            self.needs,
            reach.wanting,
        )
        known, joined, patterns = self._suppliers, self.joined, self.patterns
        excluded = self.numbers(exclude)
        any_live = len(streams) > 0
        consumers[reach.goal] = []
        waiting = [reach.goal]
        for number in waiting:  # grows meanwhile
            pattern = patterns[number]
            if pattern.wanted:
                wanting.add(number)
            if any_live:
                alive = streams.matches(number, pattern)
                reach.live += alive
                if alive and not pattern.wanted:
                    continue
            for action in known[number] or self.suppliers(number):
                if action in served:
                    served[action].append(number)
                elif self.general.get(action, action) not in excluded:
                    served[action] = [number]
                    user = ~action if action in joined else action
                    for need in needs[action]:
                        if need in consumers:
                            consumers[need].append(user)
                        else:
                            consumers[need] = [user]
                            waiting.append(need)
        return reach

    # Inside

    def _insert(self, transformation: Transformation) -> None:
        label, _, _, cost, parameters, ports = transformation
        in_ports: List[InPort] = []
        outs: List[Tuple[str, _Terms, str]] = []
        texts: List[Tuple[str, ...]] = []
        has_variables = False
        for name, direction, datatype, tags in ports:
            if not tags:
                continue
            terms = read_tags(tags)
            if not terms:
                continue
            if direction == IN:
                in_ports.append(InPort(name, terms, datatype))
                texts.append(tags)
                has_variables = has_variables or not all(map(_is_ground, terms))
            elif direction == OUT:
                outs.append((name, terms, datatype))
        rule = None
        variables: Tuple[str, ...] = ()
        if has_variables:
            out_terms = tuple(term for _, terms, _ in outs for term in terms)
            rule = rule_of(transformation, in_ports, out_terms, self.names)
            variables = rule.variables
        action = self._append(label, cost)
        self._by_label[label] = action
        if rule is not None:
            self.rules[action] = rule
            self._bind(action, rule, [NO_TYPES] * len(variables))
        else:
            self.inputs.append(
                tuple([self._demanded(text, port) for text, port in zip(texts, in_ports)])
            )
            self.needs.append(tuple(dict.fromkeys(self.inputs[-1])))
        names = tuple([port.name for port in in_ports])
        self.ports.append(self._shared.setdefault(names, names))
        heads: List[Head] = []
        for name, terms, datatype in outs:
            self._terms[action, name] = terms
            kept = [
                term for term in terms if term.is_ground or set(term.variables) <= set(variables)
            ]
            if kept:
                is_ground = all(map(_is_ground, kept))
                head = Head(name, atoms_of(kept, variables, self.names), datatype, is_ground)
                for atom in head.atoms:
                    self._heads.add((action, len(heads)), atom)
                    self._touched.add(atom.functor)
                heads.append(head)
        self._given[action] = tuple(heads)

    def _append(self, label: str, cost: int) -> int:
        self.labels.append(label)
        self.costs.append(cost)
        self.actions.append(Action(label, cost))
        return len(self.labels) - 1

    def _bind(self, action: int, rule: Rule, more: Iterable[Types]) -> None:
        """Set the demands of an action whose variables have further types."""
        inputs = []
        more = tuple(more)
        for at, port in enumerate(rule.in_ports):
            shown = Demand(frozenset(rule.shown(at, more, self.names)), port.datatype)
            inputs.append(self.number(rule.pattern(at, more, self.names), shown))
        self.inputs.append(tuple(inputs))
        self.needs.append(tuple(dict.fromkeys(inputs)))
        if rule.joins:
            self.joined.add(action)

    def _demanded(self, texts: Tuple[str, ...], port: InPort) -> int:
        """Return the number of what an in-port without variables demands."""
        key = texts, port.datatype
        found = self._by_text.get(key)
        if found is None:
            terms = tuple(sorted(port.terms)) if len(port.terms) > 1 else port.terms
            pattern = Pattern(atoms_of(terms, (), self.names), port.datatype)
            shown = Demand(frozenset(terms), port.datatype)
            found = self._by_text[key] = self.number(pattern, shown)
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
            if not _goes_with(head.datatype, pattern):
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
            found = self._by_types[action, more] = self._append(
                self.labels[action], self.costs[action]
            )
            self.general[found] = action
            self.rules[found] = rule
            self._special.setdefault(action, []).append(found)
            self.ports.append(self.ports[action])
            self._bind(found, rule, more)
        return found

    def _forget_suppliers(self) -> None:
        """Forget the suppliers of the demands that a change may concern."""
        for functor in self._touched:
            for name in self.names.above(functor):
                for number in self._by_functor.get(name, ()):
                    self._suppliers[number] = None
        self._touched.clear()


def _goes_with(datatype: str, pattern: Pattern) -> bool:
    return pattern.datatype in ANY or datatype in (*ANY, pattern.datatype)
