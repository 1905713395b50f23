# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The meaning of formulas: an interpreter that is read, not one that is fast.

A truth is FALSE, UNKNOWN or TRUE, with Kleene's tables: ``and`` is the least of two truths, ``or``
the greatest. A formula has a truth in each state. States to come are FALSE, UNKNOWN or TRUE as the
caller assumes: a truth that is the same for FALSE and for TRUE is *decided*.
"""

from __future__ import annotations

from typing import Iterable, Protocol

from dyknow.formulas.tree import Atom, Binary, Interval, Node, Quantified, Unary

# Two bits: the lower one for "possible", the upper one for "certain".
FALSE, UNKNOWN, TRUE = 0, 1, 3
NOT = {FALSE: TRUE, UNKNOWN: UNKNOWN, TRUE: FALSE}


class Trace(Protocol):
    """The states seen so far, ``period`` nanoseconds apart."""

    period: int

    @property
    def first(self) -> int:
        """The first state that operators without bounds look at."""
        return 0

    def __len__(self) -> int: ...

    def atom(self, atom: Atom, state: int) -> int:
        """Truth of an atom in a state that was seen."""

    def individuals(self, formula: Quantified, state: int) -> Iterable[tuple[Trace, int]]:
        """The individuals of a state: a trace of each, and the state's number in it."""


def truth(formula: Node, state: int, trace: Trace, later: int = UNKNOWN) -> int:
    """Return the truth of a formula in a state, if atoms in states to come are ``later``."""
    if not isinstance(formula, (Unary, Binary)):
        if state >= len(trace):
            return later
        if not isinstance(formula, Quantified):
            return trace.atom(formula, state)
        found = [
            truth(formula.operand, number, of_one, later)
            for of_one, number in trace.individuals(formula, state)
        ]
        return min([TRUE, *found]) if formula.quantifier == "every" else max([FALSE, *found])
    operator = formula.operator
    if isinstance(formula, Unary):
        if operator == "not":
            return NOT[truth(formula.operand, state, trace, NOT[later])]
        found = [
            truth(formula.operand, each, trace, later)
            for each in window(operator, formula.interval, state, trace)
        ]
        is_all = operator in ("always", "historically")
        return min([TRUE, *found]) if is_all else max([FALSE, *found])
    if operator in ("until", "since"):
        found = [
            min(
                truth(formula.right, each, trace, later),
                *(truth(formula.left, one, trace, later) for one in between(state, each)),
            )
            if each != state
            else truth(formula.right, each, trace, later)
            for each in window(operator, formula.interval, state, trace)
        ]
        return max([FALSE, *found])
    right = truth(formula.right, state, trace, later)
    if operator == "implies":
        return max(NOT[truth(formula.left, state, trace, NOT[later])], right)
    left = truth(formula.left, state, trace, later)
    return min(left, right) if operator == "and" else max(left, right)


def window(operator: str, interval: Interval, state: int, trace: Trace) -> range:
    """Return the states that an operator looks at; none lies before the first one."""
    near, far = steps(interval, trace.period)
    if operator in ("always", "eventually", "until"):
        return range(state + near, len(trace) if far is None else state + far + 1)
    return range(trace.first if far is None else max(0, state - far), state - near + 1)


def between(state: int, other: int) -> range:
    """Return the states from ``state`` to the one before ``other``, in either direction."""
    return range(state, other) if state < other else range(other + 1, state + 1)


def steps(interval: Interval, period: int) -> tuple[int, int | None]:
    """Return the bounds of an interval in states: all that lie within it."""
    near = -(-interval.lower // period)
    return near, None if interval.upper is None else interval.upper // period
