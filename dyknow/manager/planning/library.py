# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The library in numbers: transformations as actions, what their in-ports demand as patterns.

A library is a value that any thread may search: a change makes another one, which has the parts in
common that did not change. Lists that only grow are shared, since a library has no number of what
was entered later. Transformations without tagged in-ports are *facts*, the others *makers*.
"""

from __future__ import annotations

import heapq
from typing import (
    Dict,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from dyknow.datatypes import types_fit
from dyknow.manager.planning.patterns import (
    Argument,
    Atom,
    Known,
    Names,
    Pattern,
    Theta,
    Types,
    atoms_of,
    bounds_of,
    matcher,
    pattern_of,
    places_in,
    pushed,
)
from dyknow.manager.planning.problem import New, Source
from dyknow.manager.planning.rules import Premise, Rule, rule_of
from dyknow.manager.specifications.tags import Subsumption, Term, read_tags
from dyknow.model.transformation import IN, OUT, TOPIC, Port, Transformation

#: Makers that are looked up by the names that a search knows, not all at once.
MANY = 300

Key = Tuple[str, int]
"""A functor and its number of arguments."""


class Head(NamedTuple):
    """A tagged out-port of an action, or a live stream.

    Attributes:
        cost: what the action costs.
        source: what it is in a plan, unless the action has variables.
        action: its number.
        texts: its tags as they are written.
        atoms: those that can supply something, with the variables numbered as the rule's.
        datatype: its ROS type.
        is_ground: whether the atoms have no variables.
        rate: Hz that it states; 0 if it states none.
        latency: microseconds that it states.
    """

    cost: int
    source: Source
    action: int
    texts: Tuple[str, ...]
    atoms: Tuple[Atom, ...]
    datatype: str
    is_ground: bool = True
    rate: float = 0.0
    latency: int = 0

    def goes_with(self, datatype: str) -> bool:
        """Whether messages of a type may come from it."""
        return types_fit(self.datatype, datatype)


class Offer(NamedTuple):
    """How a maker supplies a pattern.

    Attributes:
        head: the out-port.
        solutions: what the wanted variables of the pattern stand for; None if that depends on
            the bindings of the maker.
        types: what the pattern demands of the maker's variables besides their own types.
        places: what the wanted variables stand for, by the variables of the maker; None if it is
            known only when these are bound.
    """

    head: Head
    solutions: Optional[Sequence[Theta]]
    types: Tuple[Types, ...] = ()
    places: Optional[Tuple[Argument, ...]] = None


class Bucket:
    """The out-ports that have a tag of one functor and number of arguments; does not change."""

    def __init__(self, entries: Dict[Tuple[Head, Atom], None]) -> None:
        """Keep them."""
        self.entries = entries
        # Made when they are needed first; it does not matter by which thread.
        self._by_place: Dict[int, Dict[Optional[str], List[Head]]] = {}
        self._by_cost: Optional[List[Head]] = None

    def by_cost(self) -> List[Head]:
        """Return all, the cheapest first."""
        found = self._by_cost
        if found is None:
            found = self._by_cost = sorted(dict.fromkeys([head for head, _ in self.entries]))
        return found

    def at(self, place: int, name: Optional[str]) -> List[Head]:
        """Return those with a name, or with a variable, in some place."""
        known = self._by_place.get(place)
        if known is None:
            known = {}
            for head, atom in self.entries:
                arg = atom.args[place]
                known.setdefault(arg if isinstance(arg, str) else None, []).append(head)
            self._by_place[place] = known
        return known.get(name, [])

    def find(self, bounds: Known, names: Names) -> Optional[List[Head]]:
        """Return those that may match, the cheapest first; None if that may be all of them."""
        if len(self.entries) < 2:
            return None
        best: Optional[List[Head]] = None
        fewest = len(self.entries)
        for place, each in enumerate(bounds):
            if each is None:
                continue
            below = (each,) if isinstance(each, str) else names.below(each)
            if len(below) >= fewest:
                continue
            found = [self.at(place, name) for name in below]
            count = sum(map(len, found)) + len(self.at(place, None))
            if count < fewest:
                fewest = count
                best = [head for some in (*found, self.at(place, None)) for head in some]
            if not fewest:
                break
        return None if best is None else sorted(dict.fromkeys(best))


Buckets = Dict[Key, Bucket]


def microseconds(seconds: float) -> int:
    """Return the nearest whole number of microseconds: sums of these are exact."""
    return round(seconds * 1e6)


class RuleLibrary:
    """What can be planned with."""

    def __init__(self, ontology: Subsumption) -> None:
        """Begin without a transformation."""
        self.names = Names(ontology)
        self.by_label: Dict[str, int] = {}
        self.facts: Buckets = {}
        self.makers: Buckets = {}
        # By the number of an action; they grow.
        self.labels: List[str] = []
        self.costs: List[int] = []
        self.heads: List[Tuple[Head, ...]] = []
        self.inputs: List[Tuple[int, ...]] = []  # what in-ports demand, in the order written
        self.needs: List[Tuple[int, ...]] = []  # the same, each once
        self.ports: List[Tuple[str, ...]] = []
        #: Rules of the actions whose in-ports have variables.
        self.rules: Dict[int, Rule] = {}
        # By the number of a demand; they grow.
        self.patterns: List[Pattern] = []
        self.written: List[Tuple[Tuple[Term, ...], str]] = []
        #: What was found out about demands; it does not matter by which thread.
        self.links: Dict[int, Tuple[Offer, ...]] = {}
        self.makers_of: Dict[int, Tuple[int, ...]] = {}
        self.cheapest: Dict[int, Optional[Head]] = {}
        self.crowds: Dict[int, Optional[int]] = {}

    def offers(self, pattern: Pattern, bounds: Known = ()) -> Tuple[Offer, ...]:
        """Return how makers can supply a pattern; with what is known, some of them may not."""
        names = self.names
        found: List[Offer] = []
        match = None
        # What follows for a rule follows for all whose out-ports look the same.
        known: Dict[Tuple[object, ...], Optional[Tuple[Types, ...]]] = {}
        for head in candidates(self.makers, pattern, bounds, names):
            if not head.goes_with(pattern.datatype):
                continue
            if head.is_ground:
                match = match or matcher(pattern, (), names)
                solved = match(head.atoms)
                if solved:
                    found.append(Offer(head, solved))
                continue
            types = self.rules[head.action].types
            key = head.atoms, types
            if key not in known:
                known[key] = pushed(head.atoms, pattern, types, names)
            more = known[key]
            if more is not None:
                found.append(Offer(head, None, more, places_in(pattern, head.atoms)))
        return tuple(found)

    def many(self, number: int) -> Optional[int]:
        """Return what the cheapest one costs of very many makers, if these may supply a demand."""
        if number not in self.crowds:
            pattern = self.patterns[number]
            key = [
                (name, len(pattern.atoms[0].args))
                for name in self.names.below(frozenset((pattern.atoms[0].functor,)))
            ]
            found = [self.makers[each] for each in key if each in self.makers]
            is_crowd = bool(pattern.wanted) and sum([len(each.entries) for each in found]) > MANY
            least = min([each.by_cost()[0].cost for each in found]) if is_crowd else None
            self.crowds[number] = least
        return self.crowds[number]

    def offers_to(self, number: int) -> Tuple[Offer, ...]:
        """Return how makers can supply a demand."""
        found = self.links.get(number)
        if found is None:
            found = self.links[number] = self.offers(self.patterns[number])
        return found


def candidates(
    buckets: Buckets, pattern: Pattern, known: Known, names: Names, is_local: bool = False
) -> Iterator[Head]:
    """Yield the out-ports that may supply a pattern, the cheapest first; some may not.

    Args:
        buckets: where they are.
        pattern: what is demanded.
        known: of its wanted variables.
        names: how names are related.
        is_local: whether their names are not entered.
    """
    best: List[Tuple[Bucket, Optional[List[Head]]]] = []
    fewest = -1
    for atom in pattern.atoms:
        found = []
        bounds = None
        if is_local:
            functors = [each for each, _ in buckets if names.subsumes(atom.functor, each)]
        else:
            functors = list(names.below(frozenset((atom.functor,))))
        for functor in functors:
            bucket = buckets.get((functor, len(atom.args)))
            if bucket is not None:
                if bounds is None:
                    bounds = bounds_of(pattern, known, atom, names)
                    if is_local:
                        bounds = tuple(
                            [each if isinstance(each, str) else None for each in bounds]
                        )
                found.append((bucket, bucket.find(bounds, names)))
        count = sum(len(bucket.entries) if some is None else len(some) for bucket, some in found)
        if fewest < 0 or count < fewest:
            best, fewest = found, count
    lists = [bucket.by_cost() if some is None else some for bucket, some in best]
    lists = [each for each in lists if each]
    if len(lists) < 2:
        return iter(lists[0] if lists else ())
    return _unique(heapq.merge(*lists))


def _unique(heads: Iterable[Head]) -> Iterator[Head]:
    last = None
    for head in heads:
        if head != last:
            yield head
        last = head


class LibraryWriter:
    """Makes libraries one after the other, each from the one before; one thread at a time."""

    def __init__(self, ontology: Subsumption) -> None:
        """Begin without a transformation."""
        self.library = RuleLibrary(ontology)
        self._by_functor: Dict[str, List[int]] = {}
        self._by_pattern: Dict[Pattern, int] = {}
        self._by_text: Dict[Tuple[Tuple[str, ...], str], int] = {}
        self._by_premise: Dict[Tuple[object, ...], int] = {}
        self._shared: Dict[Tuple[str, ...], Tuple[str, ...]] = {}

    @property
    def waste(self) -> int:
        """Numbers of actions that are gone."""
        return len(self.library.labels) - len(self.library.by_label)

    def change(self, removed: Iterable[str], added: Iterable[Transformation]) -> None:
        """Make another library; transformations of known labels are replaced."""
        old = self.library
        new = RuleLibrary.__new__(RuleLibrary)
        new.__dict__.update(old.__dict__)
        new.by_label = dict(old.by_label)
        new.facts, new.makers = dict(old.facts), dict(old.makers)
        edited: Dict[Tuple[bool, Key], Dict[Tuple[Head, Atom], None]] = {}

        def entries(is_maker: bool, atom: Atom) -> Dict[Tuple[Head, Atom], None]:
            key = atom.functor, len(atom.args)
            found = edited.get((is_maker, key))
            if found is None:
                bucket = (old.makers if is_maker else old.facts).get(key)
                found = edited[is_maker, key] = dict(bucket.entries) if bucket else {}
            return found

        def remove(label: str) -> None:
            action = new.by_label.pop(label, None)
            if action is not None:
                for head in new.heads[action]:
                    for atom in head.atoms:
                        entries(bool(new.inputs[action]), atom).pop((head, atom), None)

        for label in removed:
            remove(label)
        for each in added:
            remove(each.label)
            if each.type != TOPIC:
                action = self._insert(new, each)
                for head in new.heads[action]:
                    for atom in head.atoms:
                        entries(bool(new.inputs[action]), atom)[head, atom] = None
        touched: Set[int] = set()
        for (is_maker, key), found in edited.items():
            buckets = new.makers if is_maker else new.facts
            if found:
                buckets[key] = Bucket(found)
            else:
                buckets.pop(key, None)
            for functor in new.names.above(key[0]):
                touched.update(self._by_functor.get(functor, ()))
        new.links, new.makers_of = dict(old.links), dict(old.makers_of)
        new.cheapest, new.crowds = dict(old.cheapest), dict(old.crowds)
        for number in touched:
            new.links.pop(number, None)
            new.makers_of.pop(number, None)
            new.cheapest.pop(number, None)
            new.crowds.pop(number, None)
        self.library = new

    def _insert(self, library: RuleLibrary, transformation: Transformation) -> int:
        label, cost, ports = transformation.label, transformation.cost, transformation.ports
        names = library.names
        action = len(library.labels)
        tagged = [port for port in ports if port.tags]
        variables: Tuple[str, ...] = ()
        in_ports: List[str] = []
        inputs: List[int] = []
        if [port for port in tagged if port.direction == IN and "?" in "".join(port.tags)]:
            premises = [
                Premise(port.name, terms, port.datatype)
                for port in tagged
                for terms in [read_tags(port.tags)]
                if port.direction == IN and terms
            ]
            out = [t for port in tagged if port.direction == OUT for t in read_tags(port.tags)]
            rule = library.rules[action] = rule_of(transformation, premises, out, names)
            variables = rule.variables
            for name, terms, datatype in premises:
                in_ports.append(name)
                inputs.append(self._demanded(library, terms, datatype, rule))
        else:
            for each in tagged:
                if each.direction == IN:
                    known = self._by_text.get((each.tags, each.datatype))
                    if known is None:
                        terms = read_tags(each.tags)
                        if not terms:
                            continue
                        known = self._number(
                            library,
                            pattern_of(terms, each.datatype, names),
                            (terms, each.datatype),
                        )
                        self._by_text[each.tags, each.datatype] = known
                    in_ports.append(each.name)
                    inputs.append(known)
        heads = []
        for port in tagged:
            if port.direction == OUT:
                heads.append(_head(action, label, cost, port, variables, names))
        shared = tuple(in_ports)
        library.heads.append(tuple(heads))
        library.costs.append(cost)
        library.inputs.append(tuple(inputs))
        library.needs.append(tuple(dict.fromkeys(inputs)) if len(inputs) > 1 else tuple(inputs))
        library.ports.append(self._shared.setdefault(shared, shared))
        library.labels.append(label)
        library.by_label[label] = action
        return action

    def _demanded(
        self, library: RuleLibrary, terms: Tuple[Term, ...], datatype: str, rule: Rule
    ) -> int:
        key = terms, datatype, rule.variables, rule.types
        number = self._by_premise.get(key)
        if number is None:
            pattern = pattern_of(terms, datatype, library.names, rule.variables, rule.types)
            # The pattern wants the variables in the order of the rule.
            number = self._by_premise[key] = self._number(library, pattern, (terms, datatype))
        return number

    def _number(
        self, library: RuleLibrary, pattern: Pattern, written: Tuple[Tuple[Term, ...], str]
    ) -> int:
        found = self._by_pattern.get(pattern)
        if found is None:
            found = self._by_pattern[pattern] = len(library.patterns)
            library.patterns.append(pattern)
            library.written.append(written)
            for functor in dict.fromkeys([atom.functor for atom in pattern.atoms]):
                self._by_functor.setdefault(functor, []).append(found)
        elif written < library.written[found]:  # of names of one entity, whatever the order
            library.written[found] = written
        return found


def _head(
    action: int, label: str, cost: int, port: Port, variables: Tuple[str, ...], names: Names
) -> Head:
    """Read an out-port of an action whose in-ports bind some variables."""
    texts = port.tags
    terms = read_tags(texts)
    is_ground = "?" not in "".join(texts)
    if not is_ground:
        terms = tuple([term for term in terms if set(term.variables) <= set(variables)])
        is_ground = all(term.is_ground for term in terms)
    atoms = atoms_of(terms, variables, names)
    for atom in atoms:
        names.enter(atom.functor)
        for arg in atom.args:
            if type(arg) is str:
                names.enter(arg)
    return Head(
        cost,
        New(label, port.name),
        action,
        texts,
        atoms,
        port.datatype,
        is_ground,
        port.rate,
        microseconds(port.latency) if port.latency else 0,
    )
