# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The streams of one moment, and which of them supply a demand."""

from __future__ import annotations

from typing import Dict, Iterable, List, NamedTuple, Set, Tuple

from dyknow.manager.planning.heads import goes_with
from dyknow.manager.planning.index import AtomIndex
from dyknow.manager.planning.patterns import Atom, Names, Pattern, Theta, atoms_of, solutions
from dyknow.manager.planning.problem import Live
from dyknow.manager.specifications.tags import Term

_Terms = Tuple[Term, ...]


class LiveMatch(NamedTuple):
    """A live stream that supplies a pattern under bindings of its wanted variables."""

    demand: int
    theta: Theta
    stream: Live


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
            if goes_with(self._streams[each].datatype, self._streams[each].rate, pattern)
            and any(True for _ in solutions(self._atoms[each], pattern, self._names))
        }

    def matches(self, number: int, pattern: Pattern) -> List[LiveMatch]:
        """Return the best stream for each binding of the wanted variables."""
        best: Dict[Theta, Live] = {}
        for each in self._index.find(pattern):
            stream = self._streams[each]
            if goes_with(stream.datatype, stream.rate, pattern):
                for theta in solutions(self._atoms[each], pattern, self._names):
                    best[theta] = min(best.get(theta, stream), stream)
        return [LiveMatch(number, theta, best[theta]) for theta in sorted(best)]
