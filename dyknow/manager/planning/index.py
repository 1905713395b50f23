# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""An index of suppliers by the atoms of their streams.

Ground atoms are found by one look-up for each name that a demand allows in each place, others by
the place where a demand allows the fewest names. Nothing is entered under the names above it.
"""

from __future__ import annotations

import itertools
from typing import Collection, Dict, Generic, Hashable, List, Optional, Tuple, TypeVar

from dyknow.manager.planning.patterns import Atom, Names, Pattern, Types

Supplier = TypeVar("Supplier", bound=Hashable)

#: Look-ups that are made for one atom before the index by places is used.
_MOST_LOOKUPS = 64

_Names = List[Optional[Collection[str]]]


class _Functor(Generic[Supplier]):
    """The atoms of one functor and number of arguments."""

    def __init__(self) -> None:
        self.entries: Dict[Tuple[Supplier, Atom], None] = {}
        self._places: Dict[int, Dict[Optional[str], Dict[Supplier, None]]] = {}

    def add(self, supplier: Supplier, atom: Atom) -> None:
        self.entries[supplier, atom] = None
        for position, by_name in self._places.items():
            by_name.setdefault(_name(atom, position), {})[supplier] = None

    def remove(self, supplier: Supplier, atom: Atom) -> None:
        self.entries.pop((supplier, atom), None)
        for position, by_name in self._places.items():
            by_name.get(_name(atom, position), {}).pop(supplier, None)

    def find(self, allowed: _Names) -> Dict[Supplier, None]:
        """Return those that may match: they do in the place where the fewest names are."""
        known = [(len(each), at) for at, each in enumerate(allowed) if each is not None]
        if not known or min(known)[0] >= len(self.entries):
            return dict.fromkeys([supplier for supplier, _ in self.entries])
        position = min(known)[1]
        by_name = self._places.get(position)
        if by_name is None:
            by_name = self._places[position] = {}
            for supplier, atom in self.entries:
                by_name.setdefault(_name(atom, position), {})[supplier] = None
        found = dict(by_name.get(None, {}))
        for name in allowed[position] or ():
            found.update(by_name.get(name, {}))
        return found


def _name(atom: Atom, position: int) -> Optional[str]:
    arg = atom.args[position]
    return arg if isinstance(arg, str) else None


class AtomIndex(Generic[Supplier]):
    """Grows and shrinks."""

    def __init__(self, names: Names, most_lookups: int = _MOST_LOOKUPS) -> None:
        """Start empty.

        Args:
            names: how names are related.
            most_lookups: look-ups for one atom before the index by places is used.
        """
        self._names = names
        self._most_lookups = most_lookups
        self._exact: Dict[Atom, Dict[Supplier, None]] = {}
        self._ground: Dict[Tuple[str, int], List[Atom]] = {}
        self._by_functor: Dict[Tuple[str, int], _Functor[Supplier]] = {}
        self._open: Dict[Tuple[str, int], _Functor[Supplier]] = {}

    def add(self, supplier: Supplier, atom: Atom) -> None:
        """Add an atom of a supplier's stream."""
        names = self._names
        names.enter(atom.functor)
        key = atom.functor, len(atom.args)
        is_open = False
        for arg in atom.args:
            if type(arg) is str:
                names.enter(arg)
            else:
                is_open = True
        if is_open:
            self._open.setdefault(key, _Functor()).add(supplier, atom)
            return
        if atom in self._exact:
            self._exact[atom][supplier] = None
        else:
            self._exact[atom] = {supplier: None}
            if key in self._ground:
                self._ground[key].append(atom)
            else:
                self._ground[key] = [atom]
        if key in self._by_functor:
            self._by_functor[key].add(supplier, atom)

    def remove(self, supplier: Supplier, atom: Atom) -> None:
        """Remove what was added."""
        key = atom.functor, len(atom.args)
        for index in (self._open, self._by_functor):
            if key in index:
                index[key].remove(supplier, atom)
        self._exact.get(atom, {}).pop(supplier, None)

    def find(self, pattern: Pattern) -> Collection[Supplier]:
        """Return the suppliers that may meet all of a pattern; some of them may not."""
        found: Optional[Dict[Supplier, None]] = None
        for atom in pattern.atoms:
            one = self._of_atom(atom, pattern.types)
            found = one if found is None else {each: None for each in found if each in one}
            if not found:
                break
        return found or {}

    def _of_atom(self, demanded: Atom, types: Tuple[Types, ...]) -> Dict[Supplier, None]:
        below = self._names.below
        functors = below(frozenset((demanded.functor,)))
        allowed: _Names = []
        lookups = 1
        for arg in demanded.args:
            bounds = frozenset((arg,)) if isinstance(arg, str) else types[arg]
            names = below(bounds) if bounds else None
            allowed.append(names)
            lookups = 0 if names is None else lookups * len(names)
        found: Dict[Supplier, None] = {}
        is_exact = all(each is not None for each in allowed) and lookups <= self._most_lookups
        for functor in functors:
            key = functor, len(allowed)
            if is_exact:
                for args in itertools.product(*[each or () for each in allowed]):
                    found.update(self._exact.get(Atom(functor, args), {}))
            elif key in self._ground:
                found.update(self._grouped(key).find(allowed))
            if key in self._open:
                found.update(self._open[key].find(allowed))
        return found

    def _grouped(self, key: Tuple[str, int]) -> _Functor[Supplier]:
        """Return the ground atoms of a functor, by an index that is made at the first call."""
        found = self._by_functor.get(key)
        if found is None:
            found = self._by_functor[key] = _Functor()
            for atom in self._ground[key]:
                for supplier in self._exact.get(atom, ()):
                    found.add(supplier, atom)
        return found
