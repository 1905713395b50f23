# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Joins the in-ports of an action on the variables that they share, cheapest combinations first.

What arrives comes in the order of its value. So the combinations of what arrives with what is
there already are tried in the order of theirs, and only as far as the search comes.
"""

from __future__ import annotations

from functools import lru_cache
from operator import itemgetter
from typing import Callable, Dict, Hashable, List, Mapping, NamedTuple, Optional, Sequence, Tuple

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


Table = Dict[Hashable, List[Partial]]
"""What has arrived, by the names of the variables that it is joined on."""


@lru_cache(maxsize=None)
def _names_at(places: Tuple[int, ...]) -> Callable[[Theta], Hashable]:
    return itemgetter(*places) if places else lambda theta: ()


class Arrivals:
    """The nodes of one demand, in the order of their values."""

    def __init__(self) -> None:
        """Start without a node."""
        self.all: List[Partial] = []
        self._tables: Dict[Tuple[int, ...], Table] = {}

    def add(self, one: Partial) -> None:
        """Enter a node."""
        self.all.append(one)
        for places, table in self._tables.items():
            table.setdefault(_names_at(places)(one.theta), []).append(one)

    def by(self, places: Tuple[int, ...]) -> Table:
        """Return the nodes by some of their names, now and in future."""
        found = self._tables.get(places)
        if found is None:
            found = self._tables[places] = {}
            for one in self.all:
                found.setdefault(_names_at(places)(one.theta), []).append(one)
        return found


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
        if not is_left and partners[-1] is one:
            self._end -= 1  # it has been combined with itself
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


class Join:
    """How what arrives at the in-ports of one action is combined."""

    def __init__(
        self,
        steps: Sequence[JoinStep],
        demands: Sequence[int],
        met: Mapping[int, Arrivals],
        cost: int,
        rest: Sequence[int],
    ) -> None:
        """Start without an arrival.

        Args:
            steps: the in-ports.
            demands: for each step, that of its in-port.
            met: what arrives, by demand.
            cost: what the action costs at least.
            rest: for each step, what the in-ports after it cost at least.
        """
        self.steps = steps
        self.cost = cost
        self.rest = rest
        self.last = len(steps) - 1
        self.first = met[demands[0]]
        #: The steps of each demand.
        self.at = {
            each: [step for step, demand in enumerate(demands) if demand == each]
            for each in demands
        }
        self._right = [met[each].by(step.shared) for each, step in zip(demands, steps)]
        # What the second in-port extends is what arrives at the first.
        self._left: List[Table] = [{} for _ in steps]
        if self.last:
            self._left[1] = self.first.by(steps[1].bound)

    def arrived(self, step: int, one: Partial) -> Optional[Pairs]:
        """Combine what supplies the in-port of a step other than the first."""
        partners = self._left[step].get(_names_at(self.steps[step].shared)(one.theta))
        return Pairs(step, self.steps[step], one, partners, False) if partners else None

    def extended(self, step: int, one: Partial) -> Optional[Pairs]:
        """Combine what a step is to extend."""
        key = _names_at(self.steps[step].bound)(one.theta)
        if step > 1:
            self._left[step].setdefault(key, []).append(one)
        partners = self._right[step].get(key)
        return Pairs(step, self.steps[step], one, partners, True) if partners else None

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
