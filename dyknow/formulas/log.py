# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The reasons of verdicts: the atoms that decided them, with their values and times.

A log of an atom has an entry for each change of its truth, as far back as a verdict can depend on
it. From the logs the truth of any part of a formula can be computed again, so each operator can
name the part and the state that decided.
"""

from __future__ import annotations

from bisect import bisect_right
from itertools import islice
from typing import Callable, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

from dyknow.formulas.semantics import FALSE, NOT, TRUE, Trace, steps, truth, window
from dyknow.formulas.tree import (
    FUTURE,
    Atom,
    Binary,
    Node,
    Operator,
    Quantified,
    Unary,
    children,
    temporal,
    temporals,
)

#: Most truths that are computed in order to explain one verdict.
_PATIENCE = 10_000


class ChangedValue(NamedTuple):
    """From a state on an atom has had a truth; ``values`` says which values it had then."""

    state: int
    truth: int
    values: Tuple[str, ...]


class Log:
    """The truths of the atoms of a formula, and of its individuals': a ``Trace``."""

    __slots__ = ("_atoms", "_back", "_changes", "_formula", "_named", "_seen", "period")

    def __init__(
        self,
        formula: Node,
        period: int,
        atoms: Sequence[Atom],
        individuals: Callable[[Quantified, int], Iterable[Tuple[str, Log, int]]],
    ) -> None:
        """Make a log without entries.

        Args:
            formula: the formula to explain.
            period: nanoseconds between states.
            atoms: the atoms, by their numbers.
            individuals: returns name, log and number of the state for each individual.
        """
        self.period = period
        self._formula = formula
        self._atoms = atoms
        self._changes: List[List[ChangedValue]] = [[] for _ in atoms]
        self._named = individuals
        self._seen = 0
        self._back = reach(formula, period)

    def __len__(self) -> int:
        return self._seen

    def note(self, number: int, state: int, value: int, values: Tuple[str, ...]) -> None:
        """Add a change of the truth of the atom of a number."""
        self._changes[number].append(ChangedValue(state, value, values))

    def close(self, state: int) -> None:
        """Note that a state is over."""
        self._seen = state + 1

    def forget(self, first: int) -> None:
        """Drop what no verdict about the state ``first`` or a later one depends on."""
        oldest = first - self._back
        for changes in self._changes:
            while len(changes) > 1 and changes[1].state <= oldest:
                changes.pop(0)

    def atom(self, atom: Atom, state: int) -> int:
        return self._change(atom, state).truth

    def individuals(self, formula: Quantified, state: int) -> Iterator[Tuple[Trace, int]]:
        return ((log, number) for _, log, number in self._named(formula, state))

    def _change(self, atom: Atom, state: int) -> ChangedValue:
        changes = self._changes[self._atoms.index(atom)]
        found = bisect_right([each.state for each in changes], state) - 1
        return changes[max(0, found)]

    def why(self, state: int) -> str:
        """Write the values that decided the truth of the formula in a state."""
        decided = truth(self._formula, state, self)
        found = dict.fromkeys(self._reasons(self._formula, state, decided))
        return ", ".join(found)

    def _reasons(self, formula: Node, state: int, value: int) -> Iterator[str]:
        """Yield what made a formula have a truth in a state."""
        if state >= len(self):
            return
        if isinstance(formula, Quantified):
            for name, log, number in self._named(formula, state):
                if truth(formula.operand, number, log) == value:
                    for each in log._reasons(formula.operand, number, value):
                        yield f"{name}: {each}"
        elif not isinstance(formula, (Unary, Binary)):
            yield from self._change(formula, state).values
        elif formula.operator == "not":
            yield from self._reasons(children(formula)[0], state, NOT[value])
        elif temporal(formula) is not None:
            yield from self._elsewhere(formula, state, value)
        elif isinstance(formula, Binary):
            yield from self._parts(formula, state, value)

    def _parts(self, formula: Binary, state: int, value: int) -> Iterator[str]:
        """One part decides if it is the least of ``and`` or the greatest of ``or``; else both."""
        left = formula.left
        if formula.operator == "implies":
            left = Unary("not", left)
        found = [(part, truth(part, state, self)) for part in (left, formula.right)]
        alone = FALSE if formula.operator == "and" else TRUE
        deciding = [part for part, each in found if each == value]
        for part in deciding[:1] if value == alone else deciding:
            yield from self._reasons(part, state, value)

    def _elsewhere(self, formula: Operator, state: int, value: int) -> Iterator[str]:
        """Of the states that an operator looks at, the nearest one with the truth decides."""
        part = children(formula)[-1]
        found = window(formula.operator, formula.interval, state, self)
        near_first = iter(found if formula.operator in FUTURE else reversed(found))
        if _cost(formula, self.period, len(found)) > _PATIENCE:
            near_first = iter([state])
        chosen = None
        for each in islice(near_first, _PATIENCE):
            if each < len(self) and truth(part, each, self) == value:
                chosen = each
                break
        if chosen is None and found.stop > len(self):
            yield "no later state"
        elif chosen is None and isinstance(formula, Binary):
            yield from self._reasons(formula.left, state, value)
        else:
            yield from self._reasons(part, state if chosen is None else chosen, value)


def reach(formula: Node, period: int) -> int:
    """Return how many states a formula looks back; without bounds it is only its lower one."""
    back = max((reach(each, period) for each in children(formula)), default=0)
    operator = temporal(formula)
    if operator is not None:
        near, far = steps(operator.interval, period)
        back += near if far is None else far
    return back


def _cost(formula: Operator, period: int, states: int) -> int:
    """Estimate how many truths are computed to look for one in so many states."""
    for each in children(formula):
        for operator in temporals(each):
            near, far = steps(operator.interval, period)
            states *= 1 + (_PATIENCE if far is None else far - near)
    return states
