# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Demands, numbered as they come: equal patterns are one demand."""

from __future__ import annotations

from typing import Dict, Iterable, List, Set

from dyknow.manager.planning.heads import Head
from dyknow.manager.planning.patterns import Names, Pattern


class Demands:
    """Grows; knows whose suppliers have to be looked up after the library has changed."""

    def __init__(self, names: Names) -> None:
        """Start without a demand."""
        self._names = names
        # By the number of a demand:
        self.patterns: List[Pattern] = []
        #: Actions that need it.
        self.users: List[List[int]] = []
        #: Demands that want names of variables.
        self.wanting: Set[int] = set()
        #: Demands whose suppliers are to be looked up.
        self.outdated: Set[int] = set()
        self._by_pattern: Dict[Pattern, int] = {}
        self._by_functor: Dict[str, List[int]] = {}
        self._touched: Set[str] = set()

    def __contains__(self, pattern: Pattern) -> bool:
        """Whether a pattern has a number."""
        return pattern in self._by_pattern

    def number(self, pattern: Pattern) -> int:
        """Return the number of a pattern, which may be new."""
        found = self._by_pattern.get(pattern)
        if found is None:
            found = self._by_pattern[pattern] = len(self.patterns)
            self.patterns.append(pattern)
            self.users.append([])
            self.outdated.add(found)
            if pattern.wanted:
                self.wanting.add(found)
            for functor in dict.fromkeys([atom.functor for atom in pattern.atoms]):
                if functor in self._by_functor:
                    self._by_functor[functor].append(found)
                else:
                    self._by_functor[functor] = [found]
        return found

    def touch(self, heads: Iterable[Head]) -> None:
        """Note out-ports that came or went."""
        self._touched.update([atom.functor for head in heads for atom in head.atoms])

    def refresh(self) -> None:
        """Let the demands be outdated that such out-ports may supply."""
        for functor in self._touched:
            for name in self._names.above(functor):
                self.outdated.update(self._by_functor.get(name, ()))
        self._touched.clear()
