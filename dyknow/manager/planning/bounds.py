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
from typing import Dict, List, NamedTuple, Optional, Tuple

from dyknow.manager.planning.library import Operator
from dyknow.manager.planning.patterns import Pattern
from dyknow.manager.planning.request import Request

#: Bits for the rank of a supplier in the keys of the heap.
_BITS = 32
_RANK = (1 << _BITS) - 1


class _Supplier(NamedTuple):
    """An action, or many makers that were not looked at: its cost, needs and supplies."""

    action: Optional[Operator]
    cost: int
    needs: Tuple[Pattern, ...]
    serves: List[Pattern]


class Bounds:
    """The reach of the goal, and its least costs.

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
        self.users: Dict[Pattern, List[int]] = {request.goal: []}
        self._suppliers: List[_Supplier] = []
        users, suppliers = self.users, self._suppliers
        found: Dict[Operator, _Supplier] = {}
        patterns = [request.goal]
        for pattern in patterns:  # grows meanwhile
            fact = request.cheapest_fact(pattern)
            if fact is not None:
                known = found.get(fact.action)
                if known is None:
                    known = found[fact.action] = _Supplier(fact.action, fact.cost, (), [])
                    suppliers.append(known)
                known.serves.append(pattern)
            if not is_whole:
                if fact is not None and not pattern.wanted and request.is_met(pattern, fact):
                    continue
                crowd = request.crowd(pattern) if pattern.wanted else None
                if crowd is not None:  # they are looked at when more is known
                    suppliers.append(_Supplier(None, crowd, (), [pattern]))
                    continue
            for action, _ in request.offers(pattern):
                supplier = found.get(action)
                if supplier is not None:
                    if supplier.serves[-1] is not pattern:
                        supplier.serves.append(pattern)
                    continue
                needs = action.inputs
                if len(needs) > 1:
                    needs = tuple(dict.fromkeys(needs))
                if action.variables:
                    self.is_simple = False
                for need in needs:
                    if need in users:
                        users[need].append(len(suppliers))
                    else:
                        patterns.append(need)
                        users[need] = [len(suppliers)]
                supplier = found[action] = _Supplier(
                    action, request.floor(action), needs, [pattern]
                )
                suppliers.append(supplier)
        self.size = len([each for each in suppliers if each.needs])
        self.most = sum([each.cost for each in suppliers])

    def least(
        self, use_sum: bool = True, below: Optional[int] = None
    ) -> Tuple[Dict[Pattern, int], Dict[Pattern, Operator]]:
        """Return the least costs of demands, and the action that supplies each so.

        Args:
            use_sum: use the sum over the inputs, the cost of a tree, in which shared parts are
                paid again; else the maximum over the inputs, which no plan is below.
            below: leave out actions that cost as much; None for no bound.

        Returns:
            Both by pattern, without those that cannot be supplied.
        """
        suppliers, users = self._suppliers, self.users
        by_rank = list(range(len(suppliers)))
        if self.is_simple and use_sum:
            # Labels decide between equal costs, where the supplier of a demand matters.
            actions = [each.action for each in suppliers]
            labels = [
                each.label + "\0" * (each.slow is not None) if each else "" for each in actions
            ]
            by_rank.sort(key=labels.__getitem__)
        ranks = [0] * len(suppliers)
        for rank, place in enumerate(by_rank):
            ranks[place] = rank
        missing = [len(each.needs) for each in suppliers]
        total = [each.cost for each in suppliers]
        heap = [
            total[place] << _BITS | ranks[place] for place, left in enumerate(missing) if not left
        ]
        heapq.heapify(heap)
        pop, push = heapq.heappop, heapq.heappush
        value: Dict[Pattern, int] = {}
        chosen: Dict[Pattern, Operator] = {}
        while heap:
            key = pop(heap)
            price, supplier = key >> _BITS, suppliers[by_rank[key & _RANK]]
            if below is not None and price >= below:
                break
            for pattern in supplier.serves:
                if pattern in value:
                    continue
                value[pattern] = price
                chosen[pattern] = supplier.action  # type: ignore[assignment]
                for user in users[pattern]:
                    # Patterns come in the order of their values: the last is the maximum.
                    total[user] = price + (total[user] if use_sum else suppliers[user].cost)
                    missing[user] -= 1
                    if not missing[user]:
                        push(heap, total[user] << _BITS | ranks[user])
        return value, chosen

    def above(self, least: Dict[Pattern, int], below: int) -> Tuple[Dict[Pattern, int], int]:
        """Return the least cost of a plan besides a demand, if it costs less than a bound.

        Args:
            least: what no plan for each demand is below.
            below: demands that only dearer plans need are left out.

        Returns:
            That, and its cost besides a demand of which nothing is known.
        """
        found: Dict[Pattern, int] = {}
        rest = below
        suppliers: Dict[Pattern, List[Tuple[int, _Supplier]]] = {}
        for each in self._suppliers:
            floor = max([least.get(need, below) for need in each.needs], default=0) + each.cost
            for pattern in each.serves:
                suppliers.setdefault(pattern, []).append((floor, each))
        heap = [(0, 0, self._goal)]
        pushed = 0
        while heap:
            price, _, pattern = heapq.heappop(heap)
            if pattern in found:
                continue
            found[pattern] = price
            for floor, each in suppliers.get(pattern, ()):
                if each.action is None:
                    rest = min(rest, price + each.cost)
                elif price + floor < below:
                    for need in each.needs:
                        if need not in found:
                            pushed += 1
                            heapq.heappush(heap, (price + each.cost, pushed, need))
        if rest < below:
            found = {pattern: min(price, rest) for pattern, price in found.items()}
        return found, rest
