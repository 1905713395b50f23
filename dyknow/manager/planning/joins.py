# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Joins the in-ports of an action on the variables that they share, cheapest combinations first.

What arrives comes in the order of its value. So the combinations of what arrives with what is
there already are tried in the order of theirs, and only as far as the search comes.
"""

from __future__ import annotations

from typing import Callable, Dict, List, NamedTuple, Sequence, Tuple

from dyknow.manager.planning.patterns import Theta
from dyknow.manager.planning.rules import JoinStep


class Partial(NamedTuple):
    """Bindings of some in-ports, the first ones in the order of the join.

    Attributes:
        value: what it costs to supply them.
        theta: what the variables that are bound stand for.
        nodes: what supplies them.
    """

    value: int
    theta: Theta
    nodes: Tuple[int, ...]


class Pairs:
    """Combinations of one arrival with its partners, in the order of their values."""

    def __init__(
        self, step: int, join: JoinStep, one: Partial, partners: Sequence[Partial], is_left: bool
    ) -> None:
        self.step = step
        self._join = join
        self._one = one
        self._partners = partners
        self._left = is_left
        self._end = len(partners)  # what arrives later finds this one
        self._next = 0

    def pop(self, combine: Callable[[Tuple[int, int]], int]) -> Partial:
        """Return the next combination."""
        other = self._partners[self._next]
        self._next += 1
        left, right = (self._one, other) if self._left else (other, self._one)
        added = tuple([right.theta[at] for at in self._join.added])
        value = combine((left.value, right.value))
        return Partial(value, left.theta + added, left.nodes + right.nodes)

    @property
    def is_empty(self) -> bool:
        """Whether there is no further combination."""
        return self._next == self._end


_Table = Dict[Theta, List[Partial]]


class Join:
    """What has arrived at the in-ports of one action."""

    def __init__(self, steps: Sequence[JoinStep], cost: int, rest: Sequence[int]) -> None:
        """Start without an arrival.

        Args:
            steps: the in-ports.
            cost: what the action costs at least.
            rest: for each step, what the in-ports after it cost at least.
        """
        self.steps = steps
        self.cost = cost
        self.rest = rest
        self._left: List[_Table] = [{} for _ in steps]
        self._right: List[_Table] = [{} for _ in steps]

    def is_complete(self, step: int) -> bool:
        """Whether a step is the last one."""
        return step == len(self.steps) - 1

    def arrived(self, step: int, one: Partial) -> Pairs:
        """Enter what supplies the in-port of a step other than the first."""
        join = self.steps[step]
        key = tuple([one.theta[at] for at in join.shared])
        self._right[step].setdefault(key, []).append(one)
        return Pairs(step, join, one, self._left[step].get(key, ()), False)

    def extended(self, step: int, one: Partial) -> Pairs:
        """Enter a combination that a step is to extend."""
        join = self.steps[step]
        key = tuple([one.theta[join.variables[at]] for at in join.shared])
        self._left[step].setdefault(key, []).append(one)
        return Pairs(step, join, one, self._right[step].get(key, ()), True)

    def unmatched(self) -> List[Tuple[int, Theta]]:
        """Return combinations that found nothing, each with the step that would extend it."""
        return sorted(
            {
                (step, one.theta)
                for step, table in enumerate(self._left)
                for key, found in table.items()
                if key not in self._right[step]
                for one in found
            }
        )
