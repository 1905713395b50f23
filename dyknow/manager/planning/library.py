# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The library as actions: transformations with numbered variables, indexed by their supplies.

A library is a value that any thread may search: a change makes another one, which shares the
parts that did not change. Actions without tagged in-ports are *facts*, the rest *makers*.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple
from weakref import WeakValueDictionary

from dyknow.datatypes import types_fit
from dyknow.manager.planning.patterns import (
    NO_TYPES,
    Argument,
    Atom,
    Known,
    Names,
    Pattern,
    Theta,
    Types,
    atoms_of,
    known_args,
    matcher,
    pattern_of,
    pushed,
    solutions,
)
from dyknow.manager.planning.problem import New, Source
from dyknow.manager.specifications.tags import Term, read_tags, types_of
from dyknow.model.placeholders import variables_of
from dyknow.model.transformation import IN, OUT, Port, Transformation

#: Makers that are looked up by the names that a search knows, not all at once.
MANY = 300
#: Transformations whose variables are remembered: many have equal ones.
_REMEMBERED = 1_000

_Arguments = Tuple[Tuple[str, ...], Tuple[str, ...]]
"""Those of a term, and their types."""


@dataclass(eq=False)
class Head:
    """A tagged out-port of an action; compared by identity.

    Attributes:
        cost: the action's cost, as a fact.
        source: its source in a plan, without bindings.
        action: whose it is.
        texts: its tags as they are written.
        atoms: those that can supply something, with the variables numbered as the action's.
        datatype: its ROS type.
        rate: Hz that it states; 0 if it states none.
        latency: microseconds that it states.
    """

    __slots__ = ("action", "atoms", "cost", "datatype", "latency", "rate", "source", "texts")
    cost: int
    source: Source
    action: Operator
    texts: Tuple[str, ...]
    atoms: Tuple[Atom, ...]
    datatype: str
    rate: float
    latency: int

    @property
    def is_ground(self) -> bool:
        """Whether the atoms have no variables."""
        return not [arg for atom in self.atoms for arg in atom.args if isinstance(arg, int)]

    def goes_with(self, datatype: str) -> bool:
        """Whether messages of a type may come from it."""
        return self.datatype == datatype or types_fit(self.datatype, datatype)


@dataclass(eq=False)
class Operator:
    """A transformation, or the live streams of one nodelet; compared by identity.

    Variables that occur in one in-port alone are the affair of its pattern. The action has those
    that several in-ports share, or that out-ports or parameters expose.

    Attributes:
        label: of the transformation, or the name of the live nodelet.
        cost: the cost of a nodelet of it.
        heads: the tagged out-ports.
        ports: its tagged in-ports, in the order written.
        inputs: their patterns.
        needs: the same, each once.
        variables: the names of its variables.
        types: of the variables.
        shares: for each in-port those of the variables that its pattern wants, in that order.
        has_bindings: whether any in-port has a variable.
        slow: the same action with inputs of any rate, if its inputs have to be fast.
    """

    __slots__ = (
        "cost",
        "has_bindings",
        "heads",
        "inputs",
        "label",
        "needs",
        "ports",
        "shares",
        "slow",
        "types",
        "variables",
    )
    label: str
    cost: int
    heads: List[Head]
    ports: Tuple[Port, ...]
    inputs: Tuple[Pattern, ...]
    needs: Tuple[Pattern, ...]
    variables: Tuple[str, ...]
    types: Tuple[Types, ...]
    shares: Tuple[Tuple[int, ...], ...]
    has_bindings: bool
    slow: Optional[Operator]


class Offer(NamedTuple):
    """How a maker can supply a pattern.

    Attributes:
        head: the out-port.
        types: the pattern's types for the maker's variables, besides their own.
        places: values of the pattern's wanted variables, by the variables of the maker;
            None if it is known only when these are bound.
    """

    head: Head
    types: Tuple[Types, ...]
    places: Optional[Tuple[Argument, ...]]


def _by_order(head: Head) -> Tuple[int, str, str]:
    """Sort by cost, then by the attributes that distinguish heads."""
    return head.cost, head.source[0], head.source[1]


class Bucket:
    """The out-ports that have a tag of one functor and number of arguments; does not change."""

    def __init__(self, entries: List[Tuple[Head, Atom]]) -> None:
        self.entries = entries
        # Filled when they are first needed; it does not matter by which thread.
        self._by_args: Dict[Any, List[Head]] = {}
        self._by_place: Dict[int, Dict[Optional[str], List[Head]]] = {}
        self._by_cost: List[Head] = []

    def by_cost(self) -> List[Head]:
        """Return all, the cheapest first."""
        if not self._by_cost:
            heads = dict.fromkeys([head for head, _ in self.entries])
            self._by_cost = sorted(heads, key=_by_order)
        return self._by_cost

    def _index(self, place: int) -> Dict[Optional[str], List[Head]]:
        """Return the heads by the name in some place; None for a variable."""
        index = self._by_place.get(place)
        if index is None:
            index = {}
            for head, atom in self.entries:
                arg = atom.args[place]
                index.setdefault(arg if isinstance(arg, str) else None, []).append(head)
            self._by_place[place] = index
        return index

    def _with(self, args: Known) -> List[Head]:
        """Return the heads that have these names, or variables."""
        if not self._by_args:
            by_args: Dict[Any, List[Head]] = {}
            for head, atom in self.entries:
                key: Any = atom.args if all(isinstance(arg, str) for arg in atom.args) else None
                by_args.setdefault(key, []).append(head)
            for heads in by_args.values():
                heads.sort(key=_by_order)
            self._by_args = by_args
        found, others = self._by_args.get(args, []), self._by_args.get(None, [])
        return sorted({*found, *others}, key=_by_order) if found and others else found or others

    def find(self, known: Known, names: Names) -> List[Head]:
        """Return those that may match, the cheapest first."""
        if all(isinstance(each, str) for each in known):
            return self._with(known)
        best: Optional[List[Head]] = None
        fewest = len(self.entries)
        for place, each in enumerate(known):
            if each is None or fewest < 2:
                continue
            below = (each,) if isinstance(each, str) else names.below(each)
            if len(below) < fewest:
                index = self._index(place)
                found = [head for name in below for head in index.get(name, ())]
                found += index.get(None, ())
                if len(found) < fewest:
                    best, fewest = found, len(found)
        if best is None:
            return self.by_cost()
        return best if fewest < 2 else sorted(dict.fromkeys(best), key=_by_order)


Buckets = Dict[Tuple[str, int], Bucket]
"""By functor and number of arguments."""


def microseconds(seconds: float) -> int:
    """Return the nearest whole number of microseconds: sums of these are exact."""
    return round(seconds * 1e6)


class OperatorIndex:
    """The actions of a library."""

    def __init__(
        self, names: Names, actions: Dict[str, Operator], facts: Buckets, makers: Buckets
    ) -> None:
        self.names = names
        self.actions = actions
        self.facts = facts
        self.makers = makers
        # Results about the patterns of in-ports; it does not matter by which thread.
        self._offers: Dict[Pattern, Tuple[Offer, ...]] = {}
        self._makers: Dict[Pattern, Tuple[Operator, ...]] = {}
        self._cheapest: Dict[Pattern, Optional[Head]] = {}
        self._crowds: Dict[Pattern, Optional[int]] = {}

    def changed(self, removed: Iterable[str], added: Sequence[Operator]) -> OperatorIndex:
        """Make another library; actions of known labels are replaced."""
        actions = dict(self.actions)
        labels = [*removed, *[action.label for action in added]]
        gone = {actions.pop(label) for label in labels if label in actions}
        come = {action.label: action for action in added}
        actions.update(come)
        facts, makers = (
            _edited(
                buckets,
                [each for each in gone if bool(each.inputs) is is_maker],
                [each for each in come.values() if bool(each.inputs) is is_maker],
            )
            for buckets, is_maker in ((self.facts, False), (self.makers, True))
        )
        return OperatorIndex(self.names, actions, facts, makers)

    def offers(self, pattern: Pattern) -> Tuple[Offer, ...]:
        """Return how makers can supply a pattern."""
        found = self._offers.get(pattern)
        if found is None:
            found = tuple(self.look_up(pattern, ()))
            if pattern.is_kept:
                self._offers[pattern] = found
        return found

    def makers_of(self, pattern: Pattern) -> Tuple[Operator, ...]:
        """Return the makers that can supply a pattern, each once."""
        found = self._makers.get(pattern)
        if found is None:
            found = tuple(dict.fromkeys([offer.head.action for offer in self.offers(pattern)]))
            if pattern.is_kept:
                self._makers[pattern] = found
        return found

    def look_up(self, pattern: Pattern, known: Known) -> Iterator[Offer]:
        """Yield how makers can supply a pattern; known names rule some of them out."""
        # A result for an action holds for all whose out-ports look the same.
        seen: Dict[Tuple[object, ...], Optional[Tuple[Types, ...]]] = {}
        args = pattern.atoms[0].args
        wanted = [args.index(each) for each in pattern.wanted] if pattern.is_plain else []
        for head in candidates(self.makers, pattern, known, self.names):
            atoms, own = head.atoms, head.action.types
            if not head.goes_with(pattern.datatype):
                continue
            key = atoms, own
            if key not in seen:
                seen[key] = pushed(atoms, pattern, own, self.names)
            types = seen[key]
            if types is not None:
                if pattern.is_plain and len(atoms) == 1:
                    have = atoms[0].args
                    yield Offer(head, types, tuple([have[at] for at in wanted]))
                elif not head.is_ground or solutions(atoms, pattern, self.names):
                    yield Offer(head, types, None)

    def crowd(self, pattern: Pattern) -> Optional[int]:
        """Return the least cost of very many makers that may supply a pattern."""
        if pattern in self._crowds:
            return self._crowds[pattern]
        atom = pattern.atoms[0]
        functors = self.names.below(frozenset((atom.functor,)))
        found = [self.makers.get((functor, len(atom.args))) for functor in functors]
        buckets = [each for each in found if each is not None]
        is_crowd = pattern.wanted and sum([len(each.entries) for each in buckets]) > MANY
        least = min([each.by_cost()[0].cost for each in buckets]) if is_crowd else None
        if pattern.is_kept:
            self._crowds[pattern] = least
        return least

    def cheapest_fact(self, pattern: Pattern) -> Optional[Head]:
        """Return the cheapest fact that supplies a pattern."""
        if pattern in self._cheapest:
            return self._cheapest[pattern]
        heads = candidates(self.facts, pattern, (), self.names)
        found = next((head for head, _ in matching(heads, pattern, (), self.names)), None)
        if pattern.is_kept:
            self._cheapest[pattern] = found
        return found


def bucketed(heads: Iterable[Head]) -> Buckets:
    """Sort heads into buckets."""
    found: Dict[Tuple[str, int], List[Tuple[Head, Atom]]] = {}
    for head in heads:
        for atom in head.atoms:
            found.setdefault((atom.functor, len(atom.args)), []).append((head, atom))
    return {key: Bucket(entries) for key, entries in found.items()}


def _edited(old: Buckets, gone: List[Operator], come: List[Operator]) -> Buckets:
    """Return buckets without the heads of some actions, and with those of other actions."""
    left = set(gone)
    new = dict(old)
    more = bucketed([head for action in come for head in action.heads])
    for key in {*bucketed([head for action in gone for head in action.heads]), *more}:
        kept = old[key].entries if key in old else []
        if left:
            kept = [each for each in kept if each[0].action not in left]
        entries = kept + more[key].entries if key in more else kept
        if entries:
            new[key] = Bucket(entries)
        else:
            del new[key]
    return new


def candidates(
    buckets: Buckets, pattern: Pattern, known: Known, names: Names, is_local: bool = False
) -> Iterator[Head]:
    """Return the out-ports that may supply a pattern, the cheapest first; some may not.

    Args:
        buckets: where they are.
        pattern: the demand.
        known: of its wanted variables.
        names: how names are related.
        is_local: whether their names are not entered.
    """
    best: List[List[Head]] = []
    fewest = -1
    for atom in pattern.atoms:
        if is_local:
            functors: Sequence[str] = [
                each for each, _ in buckets if names.subsumes(atom.functor, each)
            ]
        else:
            functors = names.below(frozenset((atom.functor,)))
        lists = []
        limits: Optional[Known] = None
        for functor in functors:
            bucket = buckets.get((functor, len(atom.args)))
            if bucket is not None:
                if limits is None:
                    limits = known_args(pattern, known, atom, names)
                    if is_local:
                        limits = tuple([e if isinstance(e, str) else None for e in limits])
                lists.append(bucket.find(limits, names))
        count = sum(map(len, lists))
        if fewest < 0 or count < fewest:
            best, fewest = lists, count
        if not fewest:
            break
    if len(best) < 2:
        return iter(best[0] if best else ())
    return iter(dict.fromkeys(heapq.merge(*best, key=_by_order)))


def matching(
    heads: Iterable[Head], pattern: Pattern, known: Known, names: Names
) -> Iterator[Tuple[Head, Theta]]:
    """Yield the out-ports without variables that supply a pattern, with its wanted variables."""
    match = None
    for head in heads:
        if head.goes_with(pattern.datatype):
            match = match or matcher(pattern, known, names)
            for theta in match(head.atoms):
                yield head, theta


class Reader:
    """Reads transformations as actions, whose equal demands are one pattern."""

    def __init__(self, names: Names) -> None:
        self._names = names
        self._patterns: WeakValueDictionary[Any, Pattern] = WeakValueDictionary()
        self._by_text: Dict[Any, Pattern] = {}

    def read(self, transformations: Iterable[Transformation]) -> List[Operator]:
        """Read transformations."""
        found = [self._read(each) for each in transformations]
        self._by_text = {}  # patterns that no operator has are forgotten
        return found

    def _read(self, transformation: Transformation) -> Operator:
        tagged = [port for port in transformation.ports if port.tags]
        ports = [each for each in tagged if each.direction == IN and read_tags(each.tags)]
        variables: Tuple[str, ...] = ()
        types: Tuple[Types, ...] = ()
        shares: Tuple[Tuple[int, ...], ...] = ((),) * len(ports)
        has_bindings = "?" in "".join([text for port in ports for text in port.tags])
        if has_bindings:
            out = [t for port in tagged if port.direction == OUT for t in read_tags(port.tags)]
            written = [each.text for each in transformation.parameters]
            variables, of_names, shares = _variables(
                tuple([tuple([term[1:] for term in read_tags(port.tags)]) for port in ports]),
                tuple([term[1:] for term in out]),
                tuple([each for text in written for each in variables_of(text)]),
            )
            canonical = self._names.canonical
            types = tuple([frozenset(map(canonical, each)) for each in of_names])
        inputs = [self._pattern(port.tags, port.datatype, variables, types) for port in ports]
        action = Operator(
            transformation.label,
            transformation.cost,
            [],
            tuple(ports),
            tuple(inputs),
            tuple(dict.fromkeys(inputs)) if len(inputs) > 1 else tuple(inputs),
            variables,
            types,
            shares,
            has_bindings,
            None,
        )
        action.heads.extend([self._head(action, port) for port in tagged if port.direction == OUT])
        return action

    def _pattern(
        self,
        tags: Tuple[str, ...],
        datatype: str,
        variables: Tuple[str, ...],
        types: Tuple[Types, ...],
    ) -> Pattern:
        key = tags, datatype, variables, types
        found = self._by_text.get(key)
        if found is None:
            found = pattern_of(read_tags(tags), datatype, self._names, variables, types)
            found = self._by_text[key] = self._patterns.setdefault(found.key, found)
            found.is_kept = True
        return found

    def _head(self, action: Operator, port: Port) -> Head:
        """Read an out-port; tags with variables that no in-port binds supply nothing."""
        terms = read_tags(port.tags)
        if "?" in "".join(port.tags):
            terms = tuple([term for term in terms if {*term.variables} <= {*action.variables}])
        atoms = atoms_of(terms, action.variables, self._names)
        if not self._names.is_plain:
            for atom in atoms:
                for name in (atom.functor, *atom.args):
                    if isinstance(name, str):
                        self._names.enter(name)
        return Head(
            action.cost,
            New(action.label, port.name),
            action,
            port.tags,
            atoms,
            port.datatype,
            port.rate,
            microseconds(port.latency) if port.latency else 0,
        )


@lru_cache(maxsize=_REMEMBERED)
def _variables(
    premises: Tuple[Tuple[_Arguments, ...], ...],
    out: Tuple[_Arguments, ...],
    parameters: Tuple[str, ...],
) -> Tuple[Tuple[str, ...], Tuple[Types, ...], Tuple[Tuple[int, ...], ...]]:
    """Return the variables of an action, their types, and those of each in-port."""
    needed = [[Term("", *each) for each in premise] for premise in premises]
    supplied = [Term("", *each) for each in out]
    by_port = [{v: None for term in terms for v in term.variables} for terms in needed]
    counts = Counter([each for some in by_port for each in some])
    exposed = {each for term in supplied for each in term.variables}.union(parameters)
    found = [each for each, count in counts.items() if count > 1 or each in exposed]
    types = types_of([*[term for terms in needed for term in terms], *supplied])
    return (
        tuple(found),
        tuple([types.get(each, NO_TYPES) for each in found]),
        tuple([tuple([at for at, v in enumerate(found) if v in some]) for some in by_port]),
    )
