# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas that look ahead: the truths of all states that are not decided yet, at once.

The truths of a formula in consecutive states are bits of an integer, the oldest one the lowest.
Two integers say where the formula is certain and where it is possible, and each of them has a
least and a greatest value: an atom in a state to come is not certain at least and certain at
most, so its least integer ends with zeros and its greatest one with infinitely many ones. Shifts
move truths between states. A state is decided where least and greatest agree.
"""

from __future__ import annotations

from operator import lshift, rshift
from typing import Callable, List, Sequence, Tuple

from dyknow.formulas.semantics import FALSE, TRUE, UNKNOWN, steps
from dyknow.formulas.tree import FUTURE, Binary, Node, Unary, children, temporal, temporals

Bits = Callable[[bool, bool], int]
"""Returns the bits of a formula: certain or possible, greatest or least."""

Move = Callable[[int, int], int]
"""Brings each state the bit of a later one (``rshift``), or of an earlier one (``lshift``)."""

_EVERYWHERE = -1


def looks_ahead(formula: Node) -> bool:
    """Whether the truth of a state depends on later ones."""
    return any(each.operator in FUTURE for each in temporals(formula))


def horizon(formula: Node, period: int) -> int:
    """Return how many states later a state is decided at the latest."""
    within = max((horizon(each, period) for each in children(formula)), default=0)
    operator = temporal(formula)
    if operator is not None and operator.operator in FUTURE:
        return within + (steps(operator.interval, period)[1] or 0)
    return within


class LookAhead:
    """Decides the states of one formula."""

    def __init__(self, formula: Node, period: int, leaf: Callable[[Node], int]) -> None:
        """Prepare the decisions for states that are ``period`` nanoseconds apart.

        ``leaf`` is given each part whose truth is not computed here, and returns the place of this
        truth among the arguments of ``step``.
        """
        self._period = period
        self._horizon = horizon(formula, period)
        self._certain: List[int] = []
        self._possible: List[int] = []
        self._known: List[int] = []
        self._states = 0
        self._first = 0  # the first state that is not decided
        self._recalled: List[_Recall] = []
        self._leaf = leaf
        self._bits, self._reach = self._build(formula, False)
        self._is_sharp = True

    def step(self, *leaves: int | Sequence[int]) -> Sequence[int]:
        """Add a state, and return the truths of those that are decided by it, in order.

        A leaf is given as its truth in this state or, if it looks ahead itself, as its truths in
        the next states for which they are decided.
        """
        for number, truths in enumerate(leaves):
            for truth in (truths,) if isinstance(truths, int) else truths:
                if truth:
                    bit = 1 << self._known[number]
                    self._possible[number] |= bit
                    if truth == TRUE:
                        self._certain[number] |= bit
                    else:
                        self._is_sharp = False
                self._known[number] += 1
        self._states += 1
        certain, open_ = self._bits(True, False), self._bits(True, True)
        possible = certain
        if self._is_sharp:
            open_ ^= certain
        else:
            possible = self._bits(False, False)
            open_ = (open_ ^ certain) | (self._bits(False, True) ^ possible)
        open_ >>= self._first
        count = self._states - self._first
        if open_:
            count = min(count, (open_ & -open_).bit_length() - 1)
        if not count:
            return ()
        certain, possible = certain >> self._first, possible >> self._first
        decided = [
            TRUE if certain >> each & 1 else UNKNOWN if possible >> each & 1 else FALSE
            for each in range(count)
        ]
        self._first += count
        self._forget()
        return decided

    def _forget(self) -> None:
        """Drop the bits that no open state depends on."""
        count = min(self._first - self._reach, *self._known)
        for each in self._recalled:
            count = min(count, self._states - self._horizon - each.reach)
        if count <= 0:
            return
        carried = [each.carried(count) for each in self._recalled]
        for each, carry in zip(self._recalled, carried):
            each.carry, each.skipped = carry, each.reach
        self._certain = [bits >> count for bits in self._certain]
        self._possible = [bits >> count for bits in self._possible]
        self._known = [known - count for known in self._known]
        self._states -= count
        self._first -= count
        self._is_sharp = self._certain == self._possible and all(
            each.carry[0] == each.carry[1] for each in self._recalled
        )

    # Bits of formulas

    def _build(self, formula: Node, below: bool) -> Tuple[Bits, int]:
        """Return the bits of a formula, and how many states it looks back.

        Below an operator that looks ahead, past operators are bits as well: their truth in a
        state to come may be known already.
        """
        is_open = looks_ahead(formula) or (below and any(temporals(formula)))
        if not is_open or not isinstance(formula, (Unary, Binary)):
            return self._leaf_bits(self._leaf(formula)), 0
        is_future = formula.operator in FUTURE
        parts = [self._build(each, below or is_future) for each in children(formula)]
        right, back = parts[-1][0], max(reach for _, reach in parts)
        left: Bits = parts[0][0] if len(parts) == 2 else lambda *_: _EVERYWHERE
        if formula.operator == "not":
            return _not(right), back
        if temporal(formula) is None:
            return _combine(formula.operator, left, right), back
        is_all = formula.operator in ("always", "historically")
        if is_all:
            right = _not(right)
        near, far = steps(formula.interval, self._period)
        if is_future:
            found = _reached(left, right, near, far or 0, rshift)
        elif far is None:
            recall = _Recall(left, right, back, lambda: self._states + self._horizon)
            self._recalled.append(recall)
            found, back = _after(left, recall.bits, near), back + near
        else:
            found, back = _reached(left, right, near, far, lshift), back + far
        return _not(found) if is_all else found, back

    def _leaf_bits(self, number: int) -> Bits:
        if number == len(self._known):
            self._certain.append(0)
            self._possible.append(0)
            self._known.append(0)

        def bits(certain: bool, greatest: bool) -> int:
            found = (self._certain if certain else self._possible)[number]
            return found | (-1 << self._known[number]) if greatest else found

        return bits


class _Recall:
    """``since`` without bounds: its truth in the last state that was forgotten is carried on."""

    def __init__(self, left: Bits, right: Bits, reach: int, width: Callable[[], int]) -> None:
        self._left = left
        self._right = right
        self._width = width
        self.reach = reach  # how many states its operands look back
        self.skipped = 0  # of how many of the states that are kept these are not known any more
        self.carry = (0, 0)  # whether it was possible, and certain, in the last of these

    def bits(self, certain: bool, greatest: bool) -> int:
        """Spread the right side over the states after it, as long as the left side holds."""
        left = self._left(certain, greatest) >> self.skipped << 1 | 1
        right = self._right(certain, greatest) >> self.skipped << 1 | self.carry[certain]
        done, width = 1, self._width() + 1
        while done < width:
            right |= left & (right << done)
            left &= left << done
            done *= 2
        return right >> 1 << self.skipped

    def carried(self, count: int) -> Tuple[int, int]:
        """Return the next ``carry`` if that many states are forgotten."""
        last = count + self.reach - 1
        return self.bits(False, False) >> last & 1, self.bits(True, False) >> last & 1


def _combine(operator: str, left: Bits, right: Bits) -> Bits:
    if operator == "and":
        return lambda certain, greatest: left(certain, greatest) & right(certain, greatest)
    if operator == "implies":
        left = _not(left)
    return lambda certain, greatest: left(certain, greatest) | right(certain, greatest)


def _not(bits: Bits) -> Bits:
    return lambda certain, greatest: ~bits(not certain, not greatest)


def _reached(left: Bits, right: Bits, near: int, far: int, move: Move) -> Bits:
    """``right`` holds ``near`` to ``far`` states away, and ``left`` in all states before that."""

    def bits(certain: bool, greatest: bool) -> int:
        p, q = left(certain, greatest), right(certain, greatest)
        found, done, width = q, 1, far - near + 1
        while done < width:
            more = min(done, width - done)
            found |= _all(p, more, move) & move(found, more)
            done += more
        return _all(p, near, move) & move(found, near)

    return bits


def _after(left: Bits, inner: Bits, near: int) -> Bits:
    """``near`` states after ``inner``, if ``left`` has held since."""
    if not near:
        return inner
    return lambda certain, greatest: _all(left(certain, greatest), near, lshift) & (
        inner(certain, greatest) << near
    )


def _all(bits: int, width: int, move: Move) -> int:
    """Where ``bits`` holds in ``width`` states: each and the ones that ``move`` brings there."""
    if bits == _EVERYWHERE or not width:
        return _EVERYWHERE
    broken, done = ~bits, 1  # states before the first one break nothing
    while done < width:
        more = min(done, width - done)
        broken |= move(broken, more)
        done += more
    return ~broken
