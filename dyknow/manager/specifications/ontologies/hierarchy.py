# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Subsumption among classes, as statements about classes entail it.

A union is a superclass of each of its parts, and a subclass of all superclasses that its parts
share. An intersection is a subclass of each of its parts, and contains the individuals that are in
all of them. Queries follow these rules; only the superclasses that the parts of a union share are
found in advance, so a large ontology loads quickly.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Iterable, Iterator, Mapping


class Hierarchy:
    """Classes by their keys, with the statements about them; cycles are allowed."""

    def __init__(self) -> None:
        self._above: dict[str, set[str]] = {}
        self._below: dict[str, set[str]] = defaultdict(set)
        #: Each intersection, with the number of its parts.
        self._intersections: list[tuple[str, int]] = []
        self._intersections_of: dict[str, list[int]] = defaultdict(list)
        #: One part of each intersection: all individuals of the whole are in it.
        self._parts: dict[str, list[str]] = defaultdict(list)
        self._unions: list[tuple[str, list[str]]] = []

    def __contains__(self, name: str) -> bool:
        return name in self._above

    def __iter__(self) -> Iterator[str]:
        return iter(self._above)

    def add(self, name: str) -> None:
        self._above.setdefault(name, set())

    def add_subclass(self, lower: str, upper: str) -> None:
        self.add(lower)
        self.add(upper)
        self._above[lower].add(upper)
        self._below[upper].add(lower)

    def add_intersection(self, whole: str, parts: Iterable[str]) -> None:
        parts = sorted(set(parts))
        for part in parts:
            self.add_subclass(whole, part)
            self._intersections_of[part].append(len(self._intersections))
        self._intersections.append((whole, len(parts)))
        self._parts[whole] += parts[:1]

    def add_union(self, whole: str, parts: Iterable[str]) -> None:
        parts = sorted(set(parts))
        for part in parts:
            self.add_subclass(part, whole)
        if parts:
            self._unions.append((whole, parts))

    def complete_unions(self, visits: int) -> bool:
        """Make each union a subclass of the superclasses that its parts share.

        Returns False if that would visit more classes; only some superclasses were found then.
        """
        changed = True
        while changed:
            changed = False
            for whole, parts in self._unions:
                known = self.above((whole,))
                common: set[str] = set()
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

    def above(self, names: Iterable[str]) -> set[str]:
        """Return the classes of an individual that is in each of the given classes."""
        reached = set(names)
        waiting = list(reached)
        missing: dict[int, int] = {}
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
        return other in self.above((one,)) and one in self.above((other,))

    def below(self, name: str) -> tuple[set[str], set[str]]:
        """Return the classes whose individuals may be in a class.

        Returns:
            Its subclasses, itself included; then the parts of intersections below it, of whose
            individuals only those that are in the other parts too are in the class.
        """
        certain = _reachable(name, self._below)
        return certain, _reachable(name, self._below, self._parts) - certain


def _reachable(start: str, *relations: Mapping[str, Iterable[str]]) -> set[str]:
    reached = {start}
    waiting = [start]
    while waiting:
        name = waiting.pop()
        for relation in relations:
            found = set(relation.get(name, ())) - reached
            reached |= found
            waiting.extend(found)
    return reached
