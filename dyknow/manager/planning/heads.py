# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The tagged out-ports of the library, and which of them supply a pattern, by unification."""

from __future__ import annotations

from typing import Dict, Iterable, Mapping, NamedTuple, Optional, Tuple

from dyknow.datatypes import types_fit
from dyknow.manager.planning.index import AtomIndex
from dyknow.manager.planning.patterns import (
    Argument,
    Atom,
    Names,
    Pattern,
    Theta,
    Types,
    atoms_of,
    matcher,
    places_in,
    pushed,
    solutions,
)
from dyknow.manager.planning.problem import New
from dyknow.manager.planning.rules import Rule
from dyknow.manager.specifications.tags import read_tags
from dyknow.model.transformation import Port


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
        types: what the pattern demands of the action's variables besides their own types.
        places: what the wanted variables stand for, by the variables of the action, if these
            types decide whether the pattern is met; else None.
    """

    head: Head
    solutions: Optional[Tuple[Theta, ...]]
    types: Tuple[Types, ...] = ()
    places: Optional[Tuple[Argument, ...]] = None

    def of(self, pattern: Pattern, theta: Theta, names: Names) -> Iterable[Theta]:
        """Return what the wanted variables stand for, if the action is bound."""
        if self.solutions is not None:
            return self.solutions
        return solutions([atom.ground(theta) for atom in self.head.atoms], pattern, names)

    def of_special(self, pattern: Pattern, theta: Theta, names: Names) -> Iterable[Theta]:
        """Return the same for an action that is specialised for the pattern."""
        if self.places is None:
            return self.of(pattern, theta, names)
        return (tuple([each if type(each) is str else theta[each] for each in self.places]),)  # type: ignore[index]


class Heads:
    """The out-ports of actions; grows and shrinks."""

    def __init__(self, names: Names) -> None:
        """Start empty."""
        self._names = names
        self._index: AtomIndex[Tuple[int, int]] = AtomIndex(names)
        self._of: Dict[int, Tuple[Head, ...]] = {}

    def of(self, action: int) -> Tuple[Head, ...]:
        """Return the out-ports of an action."""
        return self._of[action]

    def add(self, action: int, heads: Tuple[Head, ...]) -> None:
        """Enter the out-ports of an action."""
        self._of[action] = heads
        for at, head in enumerate(heads):
            for atom in head.atoms:
                self._index.add((action, at), atom)

    def remove(self, action: int) -> Tuple[Head, ...]:
        """Remove the out-ports of an action, and return them."""
        heads = self._of.pop(action)
        for at, head in enumerate(heads):
            for atom in head.atoms:
                self._index.remove((action, at), atom)
        return heads

    def find(self, pattern: Pattern, rules: Mapping[int, Rule]) -> Dict[int, Tuple[Offer, ...]]:
        """Return the actions that can supply a pattern, each with its out-ports."""
        found: Dict[int, Tuple[Offer, ...]] = {}
        names, of = self._names, self._of
        candidates = sorted(self._index.find(pattern))
        if not candidates:
            return found
        match = matcher(pattern, names)
        # What follows for a rule follows for all whose out-ports look the same.
        known: Dict[Tuple[object, ...], Optional[Tuple[Types, ...]]] = {}
        for action, at in candidates:
            head = of[action][at]
            if not goes_with(head.datatype, head.rate, pattern):
                continue
            if head.is_ground:
                solved = match(head.atoms)
                if solved:
                    offer = Offer(head, solved)
                    found[action] = (*found[action], offer) if action in found else (offer,)
                continue
            types = rules[action].types
            key = head.atoms, types
            if key not in known:
                known[key] = pushed(head.atoms, pattern, types, names)
            more = known[key]
            if more is not None:
                offer = Offer(head, None, more, places_in(pattern, head.atoms))
                found[action] = (*found[action], offer) if action in found else (offer,)
        return found


def head_of(source: New, port: Port, variables: Tuple[str, ...], names: Names) -> Head:
    """Read an out-port of an action whose in-ports bind some variables."""
    texts = port.tags
    terms = read_tags(texts)
    is_ground = "?" not in "".join(texts)
    if not is_ground:
        terms = tuple([term for term in terms if set(term.variables) <= set(variables)])
        is_ground = all(term.is_ground for term in terms)
    atoms = atoms_of(terms, variables, names)
    return Head(source, texts, atoms, port.datatype, is_ground, port.rate)


def goes_with(datatype: str, rate: float, pattern: Pattern) -> bool:
    """Whether a stream of a type, and of a rate that is stated or 0, may supply a pattern."""
    if rate and rate < pattern.min_rate:
        return False
    return types_fit(datatype, pattern.datatype)
