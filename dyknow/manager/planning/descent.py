# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a goal can reach, revealed while it is searched: first what the cheapest plans can need.

Costs in the abstract, where variables are not bound, are lower bounds for costs under bindings. So
a search that reveals in their order, and goes on by what is above each demand too, finds the same
trees as a search in everything. The search for the lightest derivation under such bounds is due
to P. F. Felzenszwalb and D. McAllester, "The generalized A* architecture", JAIR 29, 2007.
"""

from __future__ import annotations

import heapq
from typing import Dict, List, Optional, Sequence, Tuple

from dyknow.manager.planning.live_streams import LiveMatch
from dyknow.manager.planning.reach import Reach, Scope


class Descent(Reach):
    """What a goal can reach, revealed in the order of what plans with it cost at least.

    What such a plan costs is the sum of what is above an action, its own cost, and what its
    in-ports cost at least. Of an action all in-ports are revealed with it: a demand is discovered
    by the cheapest of the plans that it can be part of.
    """

    def __init__(
        self, scope: Scope, least: Sequence[int], costs: Sequence[int], is_special: bool
    ) -> None:
        """Begin with the goal.

        Args:
            scope: what may be used.
            least: what each demand of the network costs at least, in the abstract; -1 for what
                cannot be supplied.
            costs: of the actions of the network, in the abstract.
            is_special: whether these are of specialised actions.
        """
        super().__init__(scope.goal)
        self._scope = scope
        self._least = least
        self._costs = costs
        self._is_special = is_special
        #: What supplies each demand, the dearest first, with what it costs at least.
        self._sources: Dict[int, List[Tuple[int, int, Sequence[int]]]] = {}
        self._heap: List[Tuple[int, int]] = []  # demands by what plans with the next one cost
        self._new: List[LiveMatch] = []
        self._discover(self.goal, 0)
        self.live, self._new = self._new, []

    @property
    def pending(self) -> Optional[int]:
        """What a plan with something that is not revealed yet costs at least; None for nothing."""
        return self._heap[0][0] if self._heap else None

    def reveal(self) -> Tuple[List[Tuple[int, int]], List[LiveMatch]]:
        """Reveal what is next: actions, each with what it supplies, and live streams."""
        total, number = heapq.heappop(self._heap)
        sources, above = self._sources[number], self.above[number]
        network, known, serves, users = self._scope.network, self.above, self.serves, self.users
        found: List[Tuple[int, int]] = []
        while sources and above - sources[-1][0] == total:
            _, supplier, floors = sources.pop()
            for action in (
                (supplier,) if self._is_special else network.specialised(number, supplier)
            ):
                found.append((action, number))
                if action in serves:
                    serves[action].append(number)
                    continue
                serves[action] = [number]
                self.floors[action] = floors
                for need, floor in zip(network.inputs[action], floors):
                    if need not in known:
                        self._discover(need, total - floor)
                for need in network.needs[action]:
                    users[need].append(action)
        if sources:
            heapq.heappush(self._heap, (above - sources[-1][0], number))
        live, self._new = self._new, []
        self.live += live
        return found, live

    def _discover(self, number: int, above: int) -> None:
        """Look up what supplies a demand."""
        self.above[number] = above
        self.users[number] = []
        alive, is_met = self._scope.live(number)
        self._new += alive
        if is_met:
            return
        least, costs, inputs = self._least, self._costs, self._scope.network.inputs
        sources = []
        for supplier in self._scope.sources(number, self._is_special):
            floor = costs[supplier]
            floors: Sequence[int] = ()
            if inputs[supplier]:
                floors = [least[each] for each in inputs[supplier]]
                if min(floors) < 0:
                    continue
                floor += sum(floors)
            sources.append((-floor, supplier, floors))
        if sources:
            sources.sort()
            self._sources[number] = sources
            heapq.heappush(self._heap, (above - sources[-1][0], number))
