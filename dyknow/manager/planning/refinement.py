# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Searches in the abstract first, where variables are not bound, then under bindings.

What demands cost at least in the abstract guides the search under bindings, which is about
instances: it begins with what can be part of the cheapest plans. Where few actions join in-ports,
these are specialised first, which makes such bounds closer.
"""

from __future__ import annotations

from typing import Iterator, List, Mapping, NamedTuple, Optional, Tuple

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.costs import Costs
from dyknow.manager.planning.descent import Descent
from dyknow.manager.planning.domains import useful_names
from dyknow.manager.planning.instances import Instances
from dyknow.manager.planning.knuth import cheapest
from dyknow.manager.planning.reach import Reach, Scope
from dyknow.manager.planning.unbound import cheapest_unbound, least_costs
from dyknow.manager.planning.values import Values
from dyknow.manager.specifications.tags import Bindings

#: Actions that join in-ports and are specialised at once.
SMALL = 100
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
        self._costs = Costs(scope.network, free, charges)
        small = scope.small(SMALL)
        self._is_special = small is not None
        self._whole = small or scope.everything(True)
        # Without an action that joins in-ports there are no bindings to be found.
        self._is_simple = scope.network.joined.isdisjoint(self._whole.serves)
        self._cheapest = cheapest_unbound if self._is_simple else cheapest
        self._reach = self._whole  # of the trees
        if small and not self._is_simple:
            scope.narrow(useful_names(scope.network, small))
        self._least: List[int] = []

    def trees(self) -> Found:
        """Find the cheapest tree; or everything that can be met, if the goal cannot."""
        if not self._is_simple:
            self._least = least_costs(self._instances(self._whole))
            if self._least[self._scope.goal] >= 0:
                self._reach = self._descent()
                instances = self._instances(self._reach)
                trees = cheapest(instances)
                if self._scope.goal in trees.value:
                    return instances, trees
            self._reach = self._scope.everything(False)
        instances = self._instances(self._reach)
        return instances, self._cheapest(instances)

    def rising(self, cost: int) -> Iterator[Found]:
        """Find what can be part of trees of up to a cost, of more, and at last everything.

        It is not all if that would take more than a fixed number of steps; the clock has no say,
        since it must not decide whether there is a plan.
        """
        for below in (cost + 1, 2 * cost + 1, 4 * cost + 1, None):
            instances = self._instances(self._whole if self._is_simple else self._descent())
            allowed = Budget(_EACH_RISE, lambda: 0.0)
            yield instances, self._cheapest(instances, True, below, True, allowed)

    def cheaper(self, cost: int, budget: Budget) -> Cheaper:
        """Find what can be part of a plan of less cost: everything, if the budget lasts."""
        scope, costs, goal = self._scope, self._costs.floors(), self._scope.goal
        floor: Optional[int] = None
        reach: Optional[Reach] = self._whole
        if not self._is_simple:
            least = least_costs(self._instances(self._whole), False, cost, budget)
            reach = scope.worthwhile(cost - 1, least, costs, self._is_special, budget)
            if reach is None:
                floor = least[goal]
        instances = self._instances(reach or self._reach.plain())
        values = self._cheapest(instances, False, cost, True, budget)
        if floor is not None:
            values.is_complete = False
        elif goal in values.value:
            floor = values.value[goal]
        else:
            floor = cost if values.is_complete else values.reached or 0
        return Cheaper(instances, values, min(floor, cost))

    def _descent(self) -> Descent:
        return Descent(self._scope, self._least, self._costs.floors(), self._is_special)

    def _instances(self, reach: Reach) -> Instances:
        return Instances(self._scope.network, reach, self._costs)
