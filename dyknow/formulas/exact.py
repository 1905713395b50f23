# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What all completions agree on: each UNKNOWN atom is TRUE or FALSE, but the same everywhere.

Kleene's tables forget which atom is unknown, so ``p or not p`` is UNKNOWN where ``p`` is. Here a
truth is a *decision diagram* over the unknown atoms of the states that were seen: a formula that
asks one of them after the other, and shares equal ones. It is progressed state by state. Where
there are too many diagrams, Kleene decides about further unknown atoms.
"""

from __future__ import annotations

from typing import Any, Dict, List, Sequence, Tuple

from dyknow.formulas.compiler import AtomReader, Note, endless
from dyknow.formulas.log import reach
from dyknow.formulas.look_ahead import horizon
from dyknow.formulas.semantics import FALSE, NOT, TRUE, UNKNOWN, steps
from dyknow.formulas.tree import FUTURE, Binary, Node, Unary, temporal

_Diagram = int
"""A truth, or the number of a diagram that asks an atom."""

_ALL = ("always", "historically")
_FIRST = 4  # diagrams are numbered after the truths
_NEGATED = -1  # of the results, the one that has no other side
#: Most atoms that diagrams ask at a time: functions of diagrams call themselves for each.
_MOST_ASKED = 300


class _Diagrams:
    """The diagrams of one formula. Each is stored once: equal ones have one number."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._nodes: List[Tuple[int, _Diagram, _Diagram]] = []
        self._numbers: Dict[Tuple[int, _Diagram, _Diagram], _Diagram] = {}
        self._results: Dict[Tuple[_Diagram, _Diagram], _Diagram] = {}
        self._asked = 0
        self._alive = 0  # atoms asked since, or kept by, the last ``keep``

    def __len__(self) -> int:
        return len(self._nodes)

    @property
    def is_full(self) -> bool:
        """Whether no further atom is asked."""
        return len(self._nodes) >= self.limit or self._alive >= _MOST_ASKED

    def ask(self) -> _Diagram:
        """Return a diagram of a new atom; Kleene's truth if it is full."""
        if self.is_full:
            return UNKNOWN
        self._asked += 1
        self._alive += 1
        return self._make(self._asked, FALSE, TRUE)

    def negate(self, diagram: _Diagram) -> _Diagram:
        if diagram < _FIRST:
            return NOT[diagram]
        key = (diagram, _NEGATED)
        if key not in self._results:
            atom, low, high = self._nodes[diagram - _FIRST]
            self._results[key] = self._make(atom, self.negate(low), self.negate(high))
        return self._results[key]

    def least(self, left: _Diagram, right: _Diagram) -> _Diagram:
        """Return ``and`` of two diagrams."""
        if left > right:
            left, right = right, left
        if left in (FALSE, right):
            return left
        if left == TRUE:
            return right
        if right < _FIRST:
            return min(left, right)
        key = (left, right)
        if key not in self._results:
            atoms = [self._nodes[e - _FIRST][0] if e >= _FIRST else None for e in key]
            first = min(each for each in atoms if each is not None)
            (low, high), (other_low, other_high) = (self._halves(each, first) for each in key)
            self._results[key] = self._make(
                first, self.least(low, other_low), self.least(high, other_high)
            )
        return self._results[key]

    def _halves(self, diagram: _Diagram, atom: int) -> Tuple[_Diagram, _Diagram]:
        if diagram >= _FIRST and self._nodes[diagram - _FIRST][0] == atom:
            return self._nodes[diagram - _FIRST][1:]
        return diagram, diagram

    def _make(self, atom: int, low: _Diagram, high: _Diagram) -> _Diagram:
        if low == high:
            return low
        key = (atom, low, high)
        found = self._numbers.get(key)
        if found is None:
            if len(self._nodes) >= 4 * self.limit:
                return UNKNOWN
            found = self._numbers[key] = len(self._nodes) + _FIRST
            self._nodes.append(key)
        return found

    def keep(self, roots: Sequence[_Diagram]) -> Dict[_Diagram, _Diagram]:
        """Forget all but some diagrams and what these consist of; returns their new numbers."""
        nodes, new = self._nodes, {truth: truth for truth in (FALSE, UNKNOWN, TRUE)}
        self._nodes, self._numbers, self._results = [], {}, {}

        def moved(diagram: _Diagram) -> _Diagram:
            if diagram not in new:
                atom, low, high = nodes[diagram - _FIRST]
                new[diagram] = self._make(atom, moved(low), moved(high))
            return new[diagram]

        for root in roots:
            moved(root)
        self._alive = len({atom for atom, _, _ in self._nodes})
        return new


class ExactEvaluator:
    """As ``Evaluator``, over what UNKNOWN atoms could be; UNKNOWN where that makes a difference.

    A state is decided by the least and the greatest of its truths, as in
    ``dyknow.formulas.semantics``.
    """

    def __init__(self, formula: Node, period: int, note: Note | None, limit: int) -> None:
        """Compile a formula; at most ``limit`` diagrams are kept."""
        self._formula, _ = endless(formula)
        self._period = period
        self._reader = AtomReader(self._formula, period, note)
        self.inputs, self.atoms = self._reader.inputs, self._reader.atoms
        self.horizon = horizon(self._formula, period)
        self._reach = reach(self._formula, period)
        self._diagrams = _Diagrams(limit)
        self._atoms: Dict[Tuple[Node, int], _Diagram] = {}
        self._settled: Dict[Tuple[Node, int], _Diagram] = {}
        self._whole: Dict[Node, Dict[int, _Diagram]] = {}
        self._open: Dict[Tuple[Node, int, int], _Diagram] = {}
        self._seen = 0
        self._decided = 0

    def step(self, *inputs: Any) -> Sequence[int]:
        """Add a state, and return the truths of those that are decided by it, in order."""
        for part, truth in zip(self._reader.parts, self._reader.step(*inputs)):
            value = self._diagrams.ask() if truth == UNKNOWN else truth
            self._atoms[part, self._seen] = value
        self._seen += 1
        self._open.clear()
        decided: List[int] = []
        while self._decided < self._seen:
            least = self._value(self._formula, self._decided, FALSE)
            greatest = self._value(self._formula, self._decided, TRUE)
            is_over = self._decided + self.horizon < self._seen
            if not is_over and not (least == greatest and least in (FALSE, TRUE)):
                break
            decided.append(least if least in (FALSE, TRUE) else UNKNOWN)
            self._decided += 1
        self._forget()
        return decided

    def _forget(self) -> None:
        oldest = min(self._decided, self._seen - self.horizon) - self._reach - 1
        tables: List[Dict[Any, _Diagram]] = [self._atoms, self._settled, *self._whole.values()]
        for table in tables:
            for key in [key for key in table if (key[1] if type(key) is tuple else key) < oldest]:
                del table[key]
        if self._diagrams.is_full:
            new = self._diagrams.keep([each for table in tables for each in table.values()])
            for table in tables:
                table.update({key: new[value] for key, value in table.items()})

    def _value(self, formula: Node, state: int, later: int) -> _Diagram:
        """Return the truth of a formula in a state, if atoms in states to come are ``later``."""
        if not isinstance(formula, (Unary, Binary)):
            return self._atoms[formula, state] if state < self._seen else later
        key = (formula, state)
        found = self._settled.get(key)
        if found is None:
            found = self._open.get((*key, later))
        if found is None:
            found = self._computed(formula, state, later)
            if state + horizon(formula, self._period) < self._seen:
                self._settled[key] = found
            else:
                self._open[(*key, later)] = found
        return found

    def _computed(self, formula: Unary | Binary, state: int, later: int) -> _Diagram:
        diagrams, operator = self._diagrams, formula.operator
        if isinstance(formula, Unary) and operator == "not":
            return diagrams.negate(self._value(formula.operand, state, NOT[later]))
        if isinstance(formula, Binary) and temporal(formula) is None:
            left, right = formula.left, self._value(formula.right, state, later)
            if operator == "and":
                return diagrams.least(self._value(left, state, later), right)
            if operator == "implies":
                return self._or(diagrams.negate(self._value(left, state, NOT[later])), right)
            return self._or(self._value(left, state, later), right)
        return self._temporal(formula, state, later)

    def _temporal(self, formula: Unary | Binary, state: int, later: int) -> _Diagram:
        """Go through the states that the operator looks at, from the farthest to the nearest."""
        near, far = steps(formula.interval, self._period)
        sign = 1 if formula.operator in FUTURE else -1
        if far is None:
            found = self._endless(formula, state - near, later)
        else:
            found = TRUE if formula.operator in _ALL else FALSE
            for distance in range(far, near - 1, -1):
                where = state + sign * distance
                if where >= 0:
                    found = self._passed(formula, where, later, found)
        if isinstance(formula, Binary):
            for distance in range(near - 1, -1, -1):
                where = state + sign * distance
                if where < 0:
                    continue
                found = self._diagrams.least(found, self._value(formula.left, where, later))
        return found

    def _passed(
        self, formula: Unary | Binary, state: int, later: int, farther: _Diagram
    ) -> _Diagram:
        """Add a state to the finding of an operator about the states that are farther."""
        if isinstance(formula, Binary):
            farther = self._diagrams.least(farther, self._value(formula.left, state, later))
            return self._or(farther, self._value(formula.right, state, later))
        value = self._value(formula.operand, state, later)
        if formula.operator in _ALL:
            return self._diagrams.least(farther, value)
        return self._or(farther, value)

    def _endless(self, formula: Unary | Binary, state: int, later: int) -> _Diagram:
        """Return the truth of an operator that looks back without bounds, from a state on."""
        settled = self._whole.setdefault(formula, {})
        begin = state
        while begin >= 0 and begin not in settled:
            begin -= 1
        found = settled.get(begin, TRUE if formula.operator in _ALL else FALSE)
        for each in range(begin + 1, state + 1):
            found = self._passed(formula, each, later, found)
            if each + horizon(formula, self._period) < self._seen:
                settled[each] = found
        return found

    def _or(self, left: _Diagram, right: _Diagram) -> _Diagram:
        negate = self._diagrams.negate
        return negate(self._diagrams.least(negate(left), negate(right)))
