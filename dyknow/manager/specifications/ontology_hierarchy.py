# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Subsumption among classes, as statements about classes entail it.

A union is a superclass of each of its parts, and a subclass of all that its parts have in common.
An intersection is a subclass of each of its parts, and contains the individuals that are in all of
them. These rules are followed from the queried classes; only the common superclasses of unions are
found in advance, so a large ontology loads quickly.
"""

from __future__ import annotations

from typing import Dict, Iterable, Iterator, List, Mapping, Set, Tuple

_Edges = Dict[str, Set[str]]
#: Most classes to visit when the common superclasses of unions are found.
VISITS = 5_000_000


class Hierarchy:
    """Classes by their keys, with the statements about them; cycles are allowed."""

    def __init__(self) -> None:
        self._above: _Edges = {}
        self._below: _Edges = {}
        self._intersections: List[Tuple[str, int]] = []
        self._intersections_of: Dict[str, List[int]] = {}
        self._parts: Dict[str, List[str]] = {}
        self._unions: List[Tuple[str, List[str]]] = []

    def __contains__(self, name: str) -> bool:
        """Whether there is such a class."""
        return name in self._above

    def __iter__(self) -> Iterator[str]:
        """The classes."""
        return iter(self._above)

    def add(self, name: str) -> None:
        """Add a class."""
        self._above.setdefault(name, set())
        self._below.setdefault(name, set())

    def add_subclass(self, lower: str, upper: str) -> None:
        """State that one class is a subclass of another."""
        self.add(lower)
        self.add(upper)
        self._above[lower].add(upper)
        self._below[upper].add(lower)

    def add_intersection(self, whole: str, parts: Iterable[str]) -> None:
        """State that a class is the intersection of its parts."""
        parts = sorted(set(parts))
        for part in parts:
            self.add_subclass(whole, part)
            self._intersections_of.setdefault(part, []).append(len(self._intersections))
        self._intersections.append((whole, len(parts)))
        # Its individuals are in each part, so one part leads to all candidates.
        self._parts.setdefault(whole, []).extend(parts[:1])

    def add_union(self, whole: str, parts: Iterable[str]) -> None:
        """State that a class is the union of its parts."""
        parts = sorted(set(parts))
        for part in parts:
            self.add_subclass(part, whole)
        if parts:
            self._unions.append((whole, parts))

    def complete_unions(self, visits: int = VISITS) -> bool:
        """Make each union a subclass of what all its parts are subclasses of.

        Args:
            visits: the classes to visit at most.

        Returns:
            Whether that was enough; else only some of these subclasses were found.
        """
        changed = True
        while changed:
            changed = False
            for whole, parts in self._unions:
                known = self.above((whole,))
                common: Set[str] = set()
                for part in parts:
                    found = self.above((part,))
                    visits -= len(found)
                    common = common & found if common else found
                    if visits < 0:
                        return False
                    if len(common) == len(known):  # a superclass of the union is above each part
                        break
                for upper in common - known:
                    self.add_subclass(whole, upper)
                    changed = True
        return True

    def above(self, names: Iterable[str]) -> Set[str]:
        """Return every class that contains all that is in each of the given classes."""
        reached = set(names)
        waiting = list(reached)
        missing: Dict[int, int] = {}
        while waiting:
            name = waiting.pop()
            found = set(self._above.get(name, ()))
            for number in self._intersections_of.get(name, ()):
                whole, count = self._intersections[number]
                missing[number] = missing.get(number, count) - 1
                if not missing[number]:
                    found.add(whole)
            found -= reached
            reached |= found
            waiting.extend(found)
        return reached

    def are_equivalent(self, one: str, other: str) -> bool:
        """Whether two classes are subclasses of each other."""
        return other in self.above((one,)) and one in self.above((other,))

    def below(self, name: str) -> Tuple[Set[str], Set[str]]:
        """Return the classes in which to look for the instances of a class.

        Returns:
            Those whose instances all are instances of the class, itself included, and those of
            which some may be: the instances that are in other classes too.
        """
        certain = _reachable(name, self._below)
        return certain, _reachable(name, self._below, self._parts) - certain


def _reachable(start: str, *relations: Mapping[str, Iterable[str]]) -> Set[str]:
    reached = {start}
    waiting = [start]
    while waiting:
        name = waiting.pop()
        for relation in relations:
            found = set(relation.get(name, ())) - reached
            reached |= found
            waiting.extend(found)
    return reached
