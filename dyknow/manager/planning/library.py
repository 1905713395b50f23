# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The library as actions: transformations with numbered variables, indexed by their supplies.

A library is a value that any thread may search: a change makes another one, which shares the
parts that did not change. Actions without tagged in-ports are *facts*, the rest *makers*.

There may be 100,000 transformations, and each full garbage collection visits every object that
is not a plain tuple of plain values. So an action holds few.
"""

from __future__ import annotations

import heapq
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby, islice
from operator import itemgetter
from typing import Any, Dict, Iterable, Iterator, NamedTuple, Sequence, Tuple

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
    limits_of,
    pattern_of,
    pushed,
    solutions,
)
from dyknow.manager.planning.problem import Live
from dyknow.manager.specifications.tags import Term, parse_tag, read_tags, types_of
from dyknow.model.placeholders import variables_of
from dyknow.model.transformation import IN, OUT, Port, Requirement, Transformation

#: Transformations whose variables are remembered: many have equal ones.
_REMEMBERED = 1_000

_Arguments = Tuple[Tuple[str, ...], Tuple[str, ...]]
"""Those of a term, and their types."""


@dataclass(eq=False)
class Head:
    """A tagged out-port of an action, or a live stream; compared by identity."""

    __slots__ = ("action", "atoms", "cost", "live", "port")
    action: Operator
    cost: int  # the action's cost, as a fact
    port: Port  # the out-port as it is written, or as it would be
    #: The tags that can supply something, with variables numbered as the action's.
    atoms: tuple[Atom, ...]
    live: Live | None  # the stream, if it exists

    @property
    def label(self) -> str:
        """The label of its transformation."""
        return self.action.label if self.live is None else self.live.label

    @property
    def latency(self) -> int:
        """Whole microseconds that it states, of which sums are exact."""
        return round(self.port.latency * 1e6) if self.port.latency else 0

    @property
    def is_ground(self) -> bool:
        return not [arg for atom in self.atoms for arg in atom if isinstance(arg, int)]

    def has_type(self, pattern: Pattern) -> bool:
        """Whether messages of a type that a pattern demands may come from it."""
        has, wanted = self.port.datatype, pattern.datatype
        return (has == wanted or types_fit(has, wanted)) and has not in pattern.refused


@dataclass(eq=False)
class Operator:
    """A transformation, or the live streams of one nodelet; compared by identity.

    Variables that occur in one in-port alone are the affair of its pattern. The action has those
    that several in-ports share, or that out-ports, parameters or required verdicts expose.
    """

    __slots__ = (
        "cost",
        "has_private",
        "heads",
        "inputs",
        "label",
        "shares",
        "slow",
        "transformation",
        "types",
        "variables",
    )
    label: str  # of the transformation, or the name of the live nodelet
    cost: int
    transformation: Transformation | None  # None for live streams
    inputs: tuple[Pattern, ...]  # the patterns of the tagged in-ports, in the order written
    variables: tuple[str, ...]  # the names of its variables, with their types
    types: tuple[Types, ...]
    #: For each in-port those of the variables that its pattern wants, in that order.
    shares: tuple[tuple[int, ...], ...]
    heads: tuple[Head, ...]  # the tagged out-ports
    has_private: bool  # whether a variable occurs in one in-port alone
    slow: Operator | None  # the same action with inputs of any rate, if its inputs have to be fast

    @property
    def base(self) -> Operator:
        """The action whose nodelet it is."""
        return self.slow or self

    @property
    def requires(self) -> tuple[Requirement, ...]:
        """The verdicts on which its transformation depends."""
        return self.transformation.requires if self.transformation is not None else ()

    @property
    def in_ports(self) -> list[Port]:
        """The tagged in-ports, in the order written."""
        ports = self.transformation.ports if self.transformation is not None else ()
        return [port for port in ports if port.direction == IN and read_tags(port.tags)]


class Offer(NamedTuple):
    """How an action that needs something can supply a pattern."""

    action: Operator
    head: Head  # the out-port
    types: tuple[Types, ...]  # the pattern's types for the action's variables, besides their own
    #: Values of the pattern's wanted variables, by the variables of the action; None if it is
    #: known only when these are bound.
    places: tuple[Argument, ...] | None


def _by_order(head: Head) -> tuple[int, str, str]:
    """Sort by cost, then by the attributes that distinguish heads."""
    return head.cost, head.action.label, head.port.name


class Bucket:
    """The out-ports that have a tag of one functor and number of arguments; does not change."""

    def __init__(self, functor: str, size: int, heads: Iterable[Head]) -> None:
        self._functor = functor
        self._size = size
        self.heads = sorted(heads, key=_by_order)  # the cheapest first
        #: By place and name, or None for a variable; filled when first needed, by any thread.
        self._by_place: dict[int, dict[str | None, list[Head]]] = {}

    def _index(self, place: int) -> dict[str | None, list[Head]]:
        index = self._by_place.get(place)
        if index is None:
            index = {}
            for head in self.heads:
                for atom in head.atoms:
                    if atom[0] == self._functor and len(atom) == self._size:
                        arg = atom[place]
                        heads = index.setdefault(arg if isinstance(arg, str) else None, [])
                        if not heads or heads[-1] is not head:
                            heads.append(head)
            self._by_place[place] = index
        return index

    def find(self, limits: Known, names: Names) -> list[Head]:
        """Return those whose arguments may meet the limits, the cheapest first."""
        best = [self.heads]
        fewest = len(self.heads)
        for place, each in enumerate(limits, 1):
            if each is None or fewest < 2:
                continue
            below = (each,) if isinstance(each, str) else names.below(each)
            if len(below) < fewest:
                index = self._index(place)
                found = [index[name] for name in (*below, None) if name in index]
                count = sum(map(len, found))
                if count < fewest:
                    best, fewest = found, count
        if len(best) == 1:
            return best[0]
        return sorted({head for heads in best for head in heads}, key=_by_order)


_Key = Tuple[str, int, bool]
"""A functor, the length of the atom, and whether they are makers, not facts."""
Buckets = Dict[_Key, Bucket]


class OperatorIndex:
    """The actions of a library."""

    def __init__(
        self,
        names: Names,
        actions: dict[str, Operator],
        buckets: Buckets,
        guarded: frozenset[Operator] = frozenset(),
    ) -> None:
        """Take over the parts; ``guarded`` are the actions that require verdicts."""
        self.names = names
        self.actions = actions
        self.guarded = guarded
        self.buckets = buckets
        # Results about the patterns of in-ports; it does not matter by which thread.
        self._offers: dict[Pattern, tuple[Offer, ...]] = {}
        self._cheapest: dict[Pattern, tuple[Head, ...]] = {}

    def changed(self, gone: set[Operator], added: Sequence[Operator]) -> OperatorIndex:
        """Make another library without some actions, and with other ones."""
        actions = dict(self.actions)
        for action in gone:
            del actions[action.label]
        actions.update({action.label: action for action in added})
        guarded = self.guarded.difference(gone).union([each for each in added if each.requires])
        return OperatorIndex(self.names, actions, _edited(self.buckets, gone, added), guarded)

    def cheapest_facts(self, pattern: Pattern) -> tuple[Head, ...]:
        """Return the two cheapest facts that supply a pattern, as far as there are any."""
        found = self._cheapest.get(pattern)
        if found is None:
            heads = candidates(self.buckets, pattern, (), self.names)
            found = cheapest(matching(heads, pattern, (), self.names))
            if pattern.uses:
                self._cheapest[pattern] = found
        return found

    def offers(self, pattern: Pattern) -> tuple[Offer, ...]:
        """Return how makers can supply a pattern."""
        found = self._offers.get(pattern)
        if found is None:
            found = tuple(self.look_up(pattern, ()))
            if pattern.uses:
                self._offers[pattern] = found
        return found

    def look_up(self, pattern: Pattern, known: Known) -> Iterator[Offer]:
        """Yield how makers can supply a pattern; known names rule some of them out."""
        wanted = [pattern.atoms[0].index(each) for each in pattern.wanted if pattern.is_plain]
        for head in candidates(self.buckets, pattern, known, self.names, is_maker=True):
            atoms, action = head.atoms, head.action
            if not head.has_type(pattern):
                continue
            types = pushed(atoms, pattern, action.types, self.names)
            if types is None:
                continue
            if pattern.is_plain and len(atoms) == 1:
                yield Offer(action, head, types, tuple([atoms[0][at] for at in wanted]))
            elif not head.is_ground or solutions(atoms, pattern, self.names):
                yield Offer(action, head, types, None)

    def count_makers(self, pattern: Pattern) -> tuple[int, int]:
        """Return how many makers may supply a pattern, and a bound that none of them is below."""
        atom = pattern.atoms[0]
        functors = self.names.below(frozenset((str(atom[0]),)))
        found = [self.buckets.get((each, len(atom), True)) for each in functors]
        buckets = [bucket for bucket in found if bucket is not None]
        count = sum([len(each.heads) for each in buckets])
        return count, min([each.heads[0].cost for each in buckets], default=0)


def bucketed(heads: Iterable[Head]) -> Buckets:
    """Sort heads into buckets."""
    return {key: Bucket(*key[:2], some) for key, some in _by_key(heads).items()}


def _by_key(heads: Iterable[Head]) -> dict[_Key, dict[Head, None]]:
    found: dict[_Key, dict[Head, None]] = {}
    for head in heads:
        is_maker = bool(head.action.inputs)
        for atom in head.atoms:
            found.setdefault((str(atom[0]), len(atom), is_maker), {})[head] = None
    return found


def _edited(old: Buckets, gone: set[Operator], come: Iterable[Operator]) -> Buckets:
    """Return buckets without the heads of some actions, and with those of other actions."""
    new = dict(old)
    less = _by_key([head for action in gone for head in action.heads])
    more = _by_key([head for action in come for head in action.heads])
    for key in {*less, *more}:
        heads = {**dict.fromkeys(old[key].heads if key in old else ()), **more.get(key, {})}
        for head in less.get(key, ()):
            heads.pop(head, None)
        if heads:
            new[key] = Bucket(*key[:2], heads)
        else:
            del new[key]
    return new


def candidates(
    buckets: Buckets,
    pattern: Pattern,
    known: Known,
    names: Names,
    is_maker: bool = False,
    is_local: bool = False,
) -> Iterator[Head]:
    """Return the facts, or makers, that may supply a pattern, the cheapest first; some may not.

    Names of live streams, which are local to a request, are not entered.
    """
    best: list[list[Head]] | None = None
    fewest = 0
    for atom in pattern.atoms:
        functor, size = str(atom[0]), len(atom)
        if is_local:
            keys = [e for e in buckets if e[1] == size and names.subsumes(functor, e[0])]
        else:
            keys = [(each, size, is_maker) for each in names.below(frozenset((functor,)))]
        found = [buckets[key] for key in keys if key in buckets]
        limits: Known = ()
        if found:
            limits = limits_of(pattern, known, atom, names)
            if is_local:
                limits = tuple([each if isinstance(each, str) else None for each in limits])
        heads = [bucket.find(limits, names) for bucket in found]
        count = sum(map(len, heads))
        if best is None or count < fewest:
            best, fewest = heads, count
        if not fewest:
            break
    if not best or len(best) == 1:
        return iter(best[0] if best else ())
    return iter(dict.fromkeys(heapq.merge(*best, key=_by_order)))


def matching(
    heads: Iterable[Head], pattern: Pattern, known: Known, names: Names
) -> Iterator[tuple[Head, Theta]]:
    """Yield the out-ports without variables that supply a pattern, with its wanted variables."""
    for head in heads:
        if head.has_type(pattern):
            for theta in solutions(head.atoms, pattern, names):
                if names.agrees(theta, known):
                    yield head, theta


def cheapest(facts: Iterable[tuple[Head, Theta]]) -> tuple[Head, ...]:
    """Return the first two out-ports of facts that supply a pattern, as far as there are any."""
    return tuple(islice((head for head, _ in groupby(facts, itemgetter(0))), 2))


class Reader:
    """Reads transformations as actions, whose equal demands are one pattern."""

    def __init__(self, names: Names) -> None:
        self._names = names
        self._patterns: dict[Any, Pattern] = {}
        #: Patterns by the texts that were read: most are written in the same way.
        self._by_text: dict[Any, Pattern] = {}
        self._types: dict[tuple[Types, ...], tuple[Types, ...]] = {}

    def forget(self, actions: Iterable[Operator]) -> None:
        """Forget the patterns of actions that other actions do not have."""
        for pattern in [each for action in actions for each in action.inputs]:
            pattern.uses -= 1
            if not pattern.uses:
                del self._patterns[pattern.key]
                self._by_text.clear()

    def read(self, transformation: Transformation) -> Operator:
        ports = [e for e in transformation.ports if e.direction == IN and read_tags(e.tags)]
        outs = [port for port in transformation.ports if port.direction == OUT and port.tags]
        variables: tuple[str, ...] = ()
        types: tuple[Types, ...] = ()
        shares: tuple[tuple[int, ...], ...] = ((),) * len(ports)
        has_private = False
        if "?" in "".join([text for port in ports for text in port.tags]):
            variables, of_names, shares, has_private = _variables(
                tuple([tuple([term[1:] for term in read_tags(port.tags)]) for port in ports]),
                tuple([term[1:] for port in outs for term in read_tags(port.tags)]),
                (
                    *[e for each in transformation.parameters for e in variables_of(each.text)],
                    *[
                        e
                        for each in transformation.requires
                        for e in parse_tag(each.tag).variables
                    ],
                ),
            )
            canonical = self._names.canonical
            types = tuple([frozenset(map(canonical, e)) if e else NO_TYPES for e in of_names])
            types = self._types.setdefault(types, types)
        inputs = [
            self._pattern(port, [variables[at] for at in share], [types[at] for at in share])
            for port, share in zip(ports, shares)
        ]
        action = Operator(
            transformation.label,
            transformation.cost,
            transformation,
            tuple(inputs),
            variables,
            types,
            shares,
            (),
            has_private,
            None,
        )
        action.heads = tuple([self._head(action, port) for port in outs])
        return action

    def _pattern(self, port: Port, wanted: Sequence[str], types: Sequence[Types]) -> Pattern:
        text = port.tags, port.datatype, tuple(wanted), tuple(types)
        found = self._by_text.get(text)
        if found is None:
            found = pattern_of(read_tags(port.tags), port.datatype, self._names, wanted, types)
            found = self._patterns.setdefault(found.key, found)
            self._by_text[text] = found
        found.uses += 1
        return found

    def _head(self, action: Operator, port: Port) -> Head:
        """Read an out-port; tags with variables that no in-port binds supply nothing."""
        terms = read_tags(port.tags)
        if "?" in "".join(port.tags):
            terms = tuple([term for term in terms if {*term.variables} <= {*action.variables}])
        atoms = atoms_of(terms, action.variables, self._names)
        for name in [arg for atom in atoms for arg in atom if isinstance(arg, str)]:
            self._names.enter(name)
        return Head(action, action.cost, port, atoms, None)


@lru_cache(maxsize=_REMEMBERED)
def _variables(
    premises: tuple[tuple[_Arguments, ...], ...],
    out: tuple[_Arguments, ...],
    parameters: tuple[str, ...],
) -> tuple[tuple[str, ...], tuple[Types, ...], tuple[tuple[int, ...], ...], bool]:
    """Return an action's variables, their types, each in-port's, and whether there are others."""
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
        len(found) < len(counts),
    )
