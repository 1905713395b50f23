# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Lower bounds for the costs of demands, found without bindings.

A pattern counts as supplied here if it can be supplied under any bindings, and only the cheapest
fact that supplies it is looked at. So the work is proportional to the part of the library that
the goal reaches, for any individuals. If no variable is shared, the bounds are exact.

D. E. Knuth, "A generalization of Dijkstra's algorithm", Information Processing Letters 6(1), 1977.
"""

from __future__ import annotations

import heapq

from dyknow.manager.planning.library import Operator
from dyknow.manager.planning.patterns import Pattern
from dyknow.manager.planning.request import Request

#: Bits for the rank of a supplier in the keys of the heap.
_BITS = 32
_RANK = (1 << _BITS) - 1


class Bounds:
    """The reach of the goal, and its least costs.

    Suppliers are actions, or many makers that were not looked at. They have places in several
    lists: an object for each would have to be visited by the garbage collector.

    Attributes:
        users: for each pattern that is reached, the places of the suppliers that need it.
        size: how many actions that need something are reached.
        most: what everything that is reached costs together.
        is_simple: whether no names are to be bound.
    """

    def __init__(self, request: Request, is_whole: bool = False) -> None:
        """Collect the reach of the goal; as a whole, also where a demand is met at no cost."""
        self._goal = request.goal
        self.is_simple = not request.goal.wanted
        self.users: dict[Pattern, list[int]] = {request.goal: []}
        self._actions: list[Operator | None] = []
        self._costs: list[int] = []
        self._needs: list[tuple[Pattern, ...]] = []
        #: What a supplier serves: the first pattern, and more where there are any.
        self._first: list[Pattern] = []
        self._more: dict[int, list[Pattern]] = {}
        users = self.users
        places: dict[Operator, int] = {}
        patterns = [request.goal]
        for pattern in patterns:  # grows meanwhile
            fact = request.cheapest_fact(pattern)
            if fact is not None:
                self._serve(pattern, places, fact.action, fact.cost, ())
            if not is_whole:
                if fact is not None and not pattern.wanted and request.is_met(pattern, fact):
                    continue
                crowd = request.crowd(pattern) if pattern.wanted else None
                if crowd is not None:  # they are looked at when more is known
                    self._add(pattern, None, crowd, ())
                    continue
            for action, _ in request.offers(pattern):
                needs = action.inputs
                if len(needs) > 1:
                    needs = tuple(dict.fromkeys(needs))
                if not self._serve(pattern, places, action, request.floor(action), needs):
                    continue
                if action.variables:
                    self.is_simple = False
                for need in needs:
                    if need not in users:
                        patterns.append(need)
                        users[need] = []
                    users[need].append(places[action])
        self.size = len([each for each in self._needs if each])
        self.most = sum(self._costs)

    def _serve(
        self,
        pattern: Pattern,
        places: dict[Operator, int],
        action: Operator,
        cost: int,
        needs: tuple[Pattern, ...],
    ) -> bool:
        """Let an action supply a pattern; return whether it is new."""
        place = places.get(action)
        if place is None:
            places[action] = len(self._costs)
            self._add(pattern, action, cost, needs)
        elif pattern is not self._first[place]:
            more = self._more.setdefault(place, [])
            if not more or more[-1] is not pattern:
                more.append(pattern)
        return place is None

    def _add(
        self,
        pattern: Pattern,
        action: Operator | None,
        cost: int,
        needs: tuple[Pattern, ...],
    ) -> None:
        self._first.append(pattern)
        self._actions.append(action)
        self._costs.append(cost)
        self._needs.append(needs)

    def _served(self, place: int) -> tuple[Pattern, ...]:
        return (self._first[place], *self._more.get(place, ()))

    def least(
        self, use_sum: bool = True, below: int | None = None
    ) -> tuple[dict[Pattern, int], dict[Pattern, Operator]]:
        """Return the least costs of demands, and the action that supplies each so.

        Args:
            use_sum: use the sum over the inputs, the cost of a tree, in which shared parts are
                paid again; else the maximum over the inputs, which no plan is below.
            below: leave out actions that cost as much; None for no bound.

        Returns:
            Both by pattern, without those that cannot be supplied.
        """
        actions, costs, users = self._actions, self._costs, self.users
        by_rank = list(range(len(actions)))
        if self.is_simple and use_sum:
            # Labels decide between equal costs, where the supplier of a demand matters.
            labels = [
                each.label + "\0" * (each.slow is not None) if each else "" for each in actions
            ]
            by_rank.sort(key=labels.__getitem__)
        ranks = [0] * len(actions)
        for rank, place in enumerate(by_rank):
            ranks[place] = rank
        missing = list(map(len, self._needs))
        total = list(costs)
        heap = [
            total[place] << _BITS | ranks[place] for place, left in enumerate(missing) if not left
        ]
        heapq.heapify(heap)
        pop, push = heapq.heappop, heapq.heappush
        value: dict[Pattern, int] = {}
        chosen: dict[Pattern, Operator] = {}
        while heap:
            key = pop(heap)
            price, place = key >> _BITS, by_rank[key & _RANK]
            if below is not None and price >= below:
                break
            for pattern in self._served(place):
                if pattern in value:
                    continue
                value[pattern] = price
                chosen[pattern] = actions[place]  # type: ignore[assignment]
                for user in users[pattern]:
                    # Patterns come in the order of their values: the last is the maximum.
                    total[user] = price + (total[user] if use_sum else costs[user])
                    missing[user] -= 1
                    if not missing[user]:
                        push(heap, total[user] << _BITS | ranks[user])
        return value, chosen

    def above(self, least: dict[Pattern, int], below: int) -> tuple[dict[Pattern, int], int]:
        """Return the least cost of a plan besides a demand, if it costs less than a bound.

        Args:
            least: what no plan for each demand is below.
            below: demands that only dearer plans need are left out.

        Returns:
            That, and its cost besides a demand of which nothing is known.
        """
        found: dict[Pattern, int] = {}
        rest = below
        suppliers: dict[Pattern, list[tuple[int, int]]] = {}
        for place, needs in enumerate(self._needs):
            floor = max([least.get(need, below) for need in needs], default=0)
            for pattern in self._served(place):
                suppliers.setdefault(pattern, []).append((floor + self._costs[place], place))
        heap = [(0, 0, self._goal)]
        pushed = 0
        while heap:
            price, _, pattern = heapq.heappop(heap)
            if pattern in found:
                continue
            found[pattern] = price
            for floor, place in suppliers.get(pattern, ()):
                cost = price + self._costs[place]
                if self._actions[place] is None:
                    rest = min(rest, cost)
                elif price + floor < below:
                    for need in self._needs[place]:
                        if need not in found:
                            pushed += 1
                            heapq.heappush(heap, (cost, pushed, need))
        if rest < below:
            found = {pattern: min(price, rest) for pattern, price in found.items()}
        return found, rest
