# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What demands cost at least: found without bindings, in numbers alone.

What can be supplied under any bindings counts as supplied here, so that is as large as the part of
the library that the goal reaches, whatever individuals there are: of the facts that can supply a
demand the cheapest one is looked at. If no variable is shared these are the costs.

D. E. Knuth, "A generalization of Dijkstra's algorithm", Information Processing Letters 6(1), 1977.
"""

from __future__ import annotations

import heapq
from typing import Any, Callable, Dict, List, Optional, Tuple

from dyknow.manager.planning.library import Head
from dyknow.manager.planning.request import Request

#: Bits for the place of an action in the keys of the search.
_BITS = 32
_PLACE = (1 << _BITS) - 1


class Bounds:
    """What the goal can reach, and what that costs at least.

    Attributes:
        facts: for each demand the cheapest fact that supplies it.
        is_simple: whether no names are to be bound.
    """

    def __init__(self, request: Request, is_whole: bool = False) -> None:
        """Collect what the goal can reach.

        Args:
            request: the problem.
            is_whole: also what supplies a demand that is met at no cost.
        """
        self._request = request
        self.facts: Dict[int, Head] = {}
        self.is_simple = not request.pattern(request.goal).wanted
        rules, needs = request.library.rules, request.needs
        places: Dict[int, int] = {}
        #: Demands that very many actions may supply, and what these cost at least.
        self._crowds: Dict[int, int] = {}
        # By the place of an action: its number, what it costs, what it needs and supplies.
        self._actions: List[int] = []
        self._costs: List[int] = []
        self._needs: List[Tuple[int, ...]] = []
        self._serves: List[List[int]] = []
        #: For each demand the places of the actions that need it.
        self.users: Dict[int, List[int]] = {request.goal: []}
        users, serves = self.users, self._serves
        demands = [request.goal]
        for number in demands:  # grows meanwhile
            fact = request.cheapest_fact(number)
            if fact is not None:
                self.facts[number] = fact
                is_met = not is_whole and request.is_met(fact)
                if is_met and not request.pattern(number).wanted:
                    continue
            crowd = None if is_whole else request.many(number)
            if crowd is not None:  # they are looked at when more is known
                self._crowds[number] = crowd
                continue
            for action in request.makers(number):
                place = places.get(action)
                if place is not None:
                    serves[place].append(number)
                    continue
                place = places[action] = len(serves)
                serves.append([number])
                self._actions.append(action)
                self._costs.append(request.floor(action))
                below = needs(action)
                self._needs.append(below)
                rule = rules.get(action if action >= 0 else ~action)
                if rule is not None and rule.variables:
                    self.is_simple = False
                for need in below:
                    if need in users:
                        users[need].append(place)
                    else:
                        demands.append(need)
                        users[need] = [place]

    def __len__(self) -> int:
        """Count the actions that need something."""
        return len(self._actions)

    @property
    def most(self) -> int:
        """What all of them cost together, and the facts."""
        return sum(self._costs) + sum([each.cost for each in self.facts.values()])

    def least(
        self, use_sum: bool = True, below: Optional[int] = None
    ) -> Tuple[Dict[int, int], Dict[int, int]]:
        """Return what demands cost at least, and the action that supplies each so.

        Args:
            use_sum: use the sum over the inputs, the cost of a tree, in which shared parts are
                paid again; else the maximum over the inputs, which no plan is below.
            below: leave out what costs as much; None for no bound.

        Returns:
            Both by demand, without those that cannot be supplied.
        """
        combine: Callable[[Any], int] = sum if use_sum else max
        users = self.users
        actions, costs, needs = self._actions.copy(), self._costs.copy(), self._needs
        serves = self._serves.copy()
        places: Dict[int, int] = {}
        for number, head in self.facts.items():
            place = places.get(head.action)
            if place is None:
                place = places[head.action] = len(actions)
                actions.append(head.action)
                costs.append(head.cost)
                serves.append([])
            serves[place].append(number)
        first = [*places.values()]
        for number, cost in self._crowds.items():
            first.append(len(actions))
            actions.append(-1)
            costs.append(cost)
            serves.append([number])
        # Labels decide between equal costs, where it matters what supplies a demand.
        ranks, by_rank = list(range(len(actions))), list(range(len(actions)))
        if self.is_simple and use_sum:
            label = self._request.label
            by_rank.sort(key=lambda place: (label(actions[place]), actions[place] < 0))
            for rank, place in enumerate(by_rank):
                ranks[place] = rank
        missing = list(map(len, needs))
        heap = [costs[place] << _BITS | ranks[place] for place in first]
        heapq.heapify(heap)
        pop, push = heapq.heappop, heapq.heappush
        value: Dict[int, int] = {}
        chosen: Dict[int, int] = {}
        value_of = value.__getitem__
        while heap:
            key = pop(heap)
            price, place = key >> _BITS, by_rank[key & _PLACE]
            if below is not None and price >= below:
                break
            for number in serves[place]:
                if number in value:
                    continue
                value[number] = price
                chosen[number] = actions[place]
                for user in users[number]:
                    left = missing[user] = missing[user] - 1
                    if not left:
                        own = costs[user] + combine(map(value_of, needs[user]))
                        push(heap, own << _BITS | ranks[user])
        return value, chosen

    def above(self, least: Dict[int, int], below: int) -> Tuple[Dict[int, int], int]:
        """Return what a plan costs at least besides a demand, if it costs less than a bound.

        Args:
            least: what no plan for each demand is below.
            below: demands that only dearer plans need are left out.

        Returns:
            That, and what it costs besides a demand of which nothing is known.
        """
        found: Dict[int, int] = {}
        suppliers: Dict[int, List[int]] = {}
        for place, numbers in enumerate(self._serves):
            for number in numbers:
                suppliers.setdefault(number, []).append(place)
        floors = [
            max([least.get(need, below) for need in needs]) + cost
            for needs, cost in zip(self._needs, self._costs)
        ]
        heap = [(0, self._request.goal)]
        while heap:
            price, number = heapq.heappop(heap)
            if number in found:
                continue
            found[number] = price
            for place in suppliers.get(number, ()):
                if price + floors[place] < below:
                    down = price + self._costs[place]
                    for need in self._needs[place]:
                        if need not in found:
                            heapq.heappush(heap, (down, need))
        rest = min(
            [found[number] + cost for number, cost in self._crowds.items() if number in found]
            or [below]
        )
        if rest < below:
            found = {number: min(price, rest) for number, price in found.items()}
        return found, rest
