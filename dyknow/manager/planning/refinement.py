# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Searches in the abstract first, where variables are not bound, then under bindings.

The abstract problem is as large as the part of the library that the goal reaches, whatever
individuals there are. What it costs there is a lower bound. So the search under bindings, which is
about instances, takes what is worthwhile at that bound, and more only if that is not sufficient.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Iterator, Mapping, NamedTuple, Optional, Tuple

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.instances import Instances
from dyknow.manager.planning.knuth import cheapest
from dyknow.manager.planning.reach import Reach, Scope
from dyknow.manager.planning.values import Values
from dyknow.manager.specifications.tags import Bindings

#: Actions that are searched under bindings at once.
SMALL = 100
#: Bounds that are tried before everything is searched.
_MOST_BOUNDS = 12
#: Seconds, as steps, of each search in `rising`.
_EACH_RISE = 0.5

Found = Tuple[Instances, Values]


class Cheaper(NamedTuple):
    """What can be part of a cheaper plan than a known one.

    Attributes:
        instances: its numbers.
        values: it.
        floor: no plan costs less.
    """

    instances: Instances
    values: Values
    floor: int


class Refinement:
    """The searches for one request."""

    def __init__(
        self, scope: Scope, free: Mapping[str, Bindings], charges: Mapping[str, int]
    ) -> None:
        """Collect what the goal can reach.

        Args:
            scope: what may be used.
            free: nodelets that cost nothing: label and bindings that they keep.
            charges: what has to be paid besides the costs, by label.
        """
        self._scope = scope
        self._free = free
        self._charges = charges
        small = scope.small(SMALL)
        reach = small or scope.everything(True)
        self._abstract = self._instances(reach)
        # Without an action that joins in-ports there are no bindings to be found.
        self._is_simple = bool(small) or scope.network.joined.isdisjoint(reach.actions)
        reach.is_abstract = not self._is_simple
        self._reach = reach  # of the trees

    def trees(self) -> Found:
        """Find the cheapest tree; or everything that can be met, if the goal cannot."""
        values, goal = cheapest(self._abstract), self._abstract.reach.goal
        if self._is_simple:
            return self._abstract, values
        first = bound = values.value[goal]
        for _ in range(_MOST_BOUNDS if values.is_met(goal) else 0):
            reach, least = self._worthwhile(bound, values)
            self._reach = reach
            if reach.beyond is None or 0 <= least <= bound:
                instances = self._instances(reach)
                trees = cheapest(instances, below=reach.beyond and reach.beyond + 1)
                if trees.is_met(goal):
                    return instances, trees
                if reach.beyond is None:
                    break
            bound = max(reach.beyond, 2 * bound - first, bound + bound // 4)
            values = cheapest(self._abstract, below=bound + 1, is_all=True)
        self._reach = self._scope.everything(False)
        instances = self._instances(self._reach)
        return instances, cheapest(instances)

    def rising(self, cost: int) -> Iterator[Found]:
        """Find what can be part of trees of up to a cost, of more, and at last everything.

        It is not all if that would take more than a fixed number of steps; the clock has no say,
        since it must not decide whether there is a plan.
        """
        for bound in (cost, 2 * cost, 4 * cost):
            instances = self._again()
            if not self._is_simple:
                values = cheapest(self._abstract, below=bound + 1, is_all=True)
                instances = self._instances(self._worthwhile(bound, values)[0])
            allowed = Budget(_EACH_RISE, lambda: 0.0)
            yield instances, cheapest(instances, below=bound + 1, is_all=True, budget=allowed)
        instances = self._again()
        if not self._is_simple:
            instances = self._instances(self._scope.everything(False))
        allowed = Budget(_EACH_RISE, lambda: 0.0)
        yield instances, cheapest(instances, is_all=True, budget=allowed)

    def cheaper(self, cost: int, budget: Budget) -> Cheaper:
        """Find what can be part of a plan of less cost: everything, if the budget lasts."""
        instances, scope = self._again(), self._scope
        floor: Optional[int] = None
        if not self._is_simple:
            values = cheapest(instances, use_sum=False, below=cost, is_all=True, budget=budget)
            floor = values.floors[instances.reach.goal]
            known = values.floors, instances.costs
            reach = scope.worthwhile(cost - 1, *known, use_sum=False, budget=budget)
            if reach is None:
                reach = _plain(self._reach)
            else:
                floor = None
            instances = self._instances(reach)
        values = cheapest(instances, use_sum=False, below=cost, is_all=True, budget=budget)
        goal = instances.reach.goal
        if floor is not None:
            values.is_complete = False
        elif values.is_met(goal):
            floor = values.value[goal]
        else:
            floor = cost if values.is_complete else values.reached or 0
        return Cheaper(instances, values, min(floor, cost))

    def _worthwhile(self, bound: int, values: Values) -> Tuple[Reach, int]:
        """Collect what a tree can have, and what the goal costs if variables are not bound."""
        scope, costs = self._scope, self._abstract.costs
        reach = scope.worthwhile(bound, values.floors, costs, True)
        assert reach is not None
        relaxed = self._instances(_plain(reach, True))
        special = cheapest(relaxed, below=bound + 1, is_all=True)
        closer = scope.worthwhile(bound, special.floors, relaxed.costs, True, reach)
        assert closer is not None
        limits = [each for each in (reach.beyond, closer.beyond) if each is not None]
        closer.beyond = min(limits, default=None)
        return closer, special.value[reach.goal]

    def _again(self) -> Instances:
        """Number instances again: another search may find other inputs for them first."""
        return self._instances(self._abstract.reach)

    def _instances(self, reach: Reach) -> Instances:
        return Instances(self._scope.network, reach, self._free, self._charges)


def _plain(reach: Reach, is_abstract: bool = False) -> Reach:
    """Leave out what is known about costs."""
    return replace(
        reach,
        is_abstract=is_abstract,
        above=[0] * len(reach.above),
        above_actions=[0] * len(reach.above_actions),
        floors={},
    )
