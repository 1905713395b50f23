# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The reasons of verdicts: the atoms that decided them, with their values and times.

A log of an atom has an entry for each change of its truth, as far back as a verdict can depend on
it. From the logs the truth of any part of a formula can be computed again, so each operator can
name the part and the state that decided.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import Callable, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

from dyknow.formulas import tree
from dyknow.formulas.semantics import FALSE, NOT, TRUE, UNKNOWN, Trace, steps, truth, window

_PATIENCE = 5_000  # most truths that are computed in order to explain one verdict


class ChangedValue(NamedTuple):
    """From a state on an atom has had a truth; ``values`` says which values it had then."""

    state: int
    truth: int
    values: Tuple[str, ...]


_FORGOTTEN = ChangedValue(0, UNKNOWN, ())


class _TooLong(Exception):
    """An explanation takes more truths than there is patience for."""


class Log:
    """The truths of the atoms of a formula, and of its individuals': a ``Trace``."""

    __slots__ = (
        *("period", "_atoms", "_back", "_changes", "_formula", "_named", "_patience"),
        *("_seen", "oldest"),
    )

    def __init__(
        self,
        formula: tree.Node,
        period: int,
        atoms: Sequence[tree.Atom],
        individuals: Callable[[tree.Quantified, int], Iterable[Tuple[str, Log, int]]],
    ) -> None:
        """Make a log without entries; its atoms are numbered in their order.

        ``individuals`` returns name, log and number of the state for each individual.
        """
        self.period = period
        self._formula = formula
        self._atoms = atoms
        self._changes: List[List[ChangedValue]] = [[] for _ in atoms]
        self._named = individuals
        self._seen = 0
        self._back = reach(formula, period)
        self.oldest = 0
        self._patience = iter(range(_PATIENCE))  # shared with the individuals

    def __len__(self) -> int:
        if next(self._patience, None) is None:  # each truth of an atom or quantifier looks here
            raise _TooLong
        return self._seen

    @property
    def first(self) -> int:
        """The first state that operators without bounds look at: a forgotten one for all."""
        return max(0, self.oldest - 1)

    def note(self, number: int, state: int, value: int, values: Tuple[str, ...]) -> None:
        """Add a change of the truth of the atom of a number."""
        self._changes[number].append(ChangedValue(state, value, values))

    def close(self, state: int) -> None:
        """Note that a state is over."""
        self._seen = state + 1

    def forget(self, first: int) -> None:
        """Drop what no verdict about the state ``first`` or a later one depends on."""
        oldest = self.oldest = first - self._back
        for changes in self._changes:
            while len(changes) > 1 and changes[1].state <= oldest:
                changes.pop(0)

    def atom(self, atom: tree.Atom, state: int) -> int:
        return self._change(atom, state).truth

    def individuals(self, formula: tree.Quantified, state: int) -> Iterator[Tuple[Trace, int]]:
        return ((log, number) for _, log, number in self._those(formula, state))

    def _those(self, formula: tree.Quantified, state: int) -> Iterator[Tuple[str, Log, int]]:
        """Yield the individuals of a state, whose truths are counted with the formula's."""
        for name, log, number in self._named(formula, state):
            log._patience = self._patience
            yield name, log, number

    def _change(self, atom: tree.Atom, state: int) -> ChangedValue:
        if state < self.oldest:
            return _FORGOTTEN
        changes = self._changes[self._atoms.index(atom)]
        return changes[bisect_right(changes, (state + 1,)) - 1]

    def why(self, state: int, value: int) -> str:
        """Write the values that decided the truth of the formula in a state.

        If they take too long to find, or are forgotten, all values in this state are written.
        """
        self._patience = iter(range(_PATIENCE))
        try:
            found = list(self._reasons(self._formula, state, value))
            is_forgotten = value == UNKNOWN and not found
        except _TooLong:
            is_forgotten = True
        if is_forgotten:
            found = list(self._values(state))
        return ", ".join(dict.fromkeys(found))

    def _values(self, state: int) -> Iterator[str]:
        """Yield the values of all atoms in a state."""
        for atom in self._atoms:
            yield from self._change(atom, state).values
        for each in tree.quantifiers(self._formula):
            for name, log, number in self._named(each, state):
                yield from (f"{name}: {value}" for value in log._values(number))

    def _reasons(self, formula: tree.Node, state: int, value: int) -> Iterator[str]:
        """Yield what made a formula have a truth in a state."""
        if state >= self._seen and not isinstance(formula, (tree.Unary, tree.Binary)):
            return
        if isinstance(formula, tree.Quantified):
            for name, log, number in self._those(formula, state):
                if truth(formula.operand, number, log) == value:
                    for each in log._reasons(formula.operand, number, value):
                        yield f"{name}: {each}"
        elif not isinstance(formula, (tree.Unary, tree.Binary)):
            yield from self._change(formula, state).values
        elif formula.operator == "not":
            yield from self._reasons(tree.children(formula)[0], state, NOT[value])
        elif tree.temporal(formula) is not None:
            yield from self._elsewhere(formula, state, value)
        elif isinstance(formula, tree.Binary):
            yield from self._parts(formula, state, value)

    def _parts(self, formula: tree.Binary, state: int, value: int) -> Iterator[str]:
        """One part decides if it is the least of ``and`` or the greatest of ``or``; else both."""
        left = formula.left
        if formula.operator == "implies":
            left = tree.Unary("not", left)
        alone = FALSE if formula.operator == "and" else TRUE
        found: List[Tuple[tree.Node, int]] = []
        for part in (left, formula.right):
            each = truth(part, state, self)
            if each == value == alone:
                yield from self._reasons(part, state, value)
                return
            found.append((part, each))
        # No part has the truth if ``exact`` decided it: then both parts are unknown.
        for part, each in [pair for pair in found if pair[1] == value] or found:
            yield from self._reasons(part, state, each)

    def _elsewhere(self, formula: tree.Operator, state: int, value: int) -> Iterator[str]:
        """Of the states that an operator looks at, the nearest one with the truth decides."""
        part = tree.children(formula)[-1]
        found = window(formula.operator, formula.interval, state, self)
        if not found:
            yield "no earlier state"
            return
        if isinstance(formula, tree.Binary) and value != TRUE:
            broken = self._broken(formula, state, value, found)
            if broken is not None:
                yield from self._reasons(formula.left, broken, value)
                return
        chosen = None
        found = found if formula.operator in tree.FUTURE else found[::-1]
        for each in found:
            if each >= self._seen and value == UNKNOWN:
                break
            if truth(part, each, self) == value:
                chosen = each
                break
        if chosen is None and max(found[0], found[-1]) >= self._seen:
            yield "no later state"
        elif chosen is None and isinstance(formula, tree.Binary):
            yield from self._reasons(formula.left, state, value)
        else:
            yield from self._reasons(part, found[0] if chosen is None else chosen, value)

    def _broken(self, formula: tree.Binary, state: int, value: int, found: range) -> int | None:
        """Return the state whose left side rules out all states beyond it; None without one."""
        way = 1 if formula.operator in tree.FUTURE else -1
        for each in range(state, found[-1] if way > 0 else found[0], way):
            is_open = each >= self._seen and value == UNKNOWN
            if is_open or (each in found and truth(formula.right, each, self)):
                return None
            if truth(formula.left, each, self) == value:
                return each
        return None


def reach(formula: tree.Node, period: int) -> int:
    """Return how many states a formula looks back; without bounds it is only its lower one."""
    back = max((reach(each, period) for each in tree.children(formula)), default=0)
    operator = tree.temporal(formula)
    if operator is not None:
        near, far = steps(operator.interval, period)
        back += near if far is None else far
    return back
