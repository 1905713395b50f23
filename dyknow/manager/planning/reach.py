# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The reach of a goal without bindings: each pattern is a node, and each action an instance.

A pattern counts as supplied here if it can be supplied under any bindings, and only the cheapest
fact that supplies it is looked at. So the work is proportional to the part of the library that
the goal reaches, for any individuals. The prices are lower bounds for the search, and exact if no
variable is shared.
"""

from __future__ import annotations

import heapq
from functools import cached_property

from dyknow.manager.planning.and_or_graph import AndOrGraph, Instance, Node
from dyknow.manager.planning.library import Operator
from dyknow.manager.planning.patterns import Pattern
from dyknow.manager.planning.request import Request


class Reach(AndOrGraph):
    """The reach of the goal.

    Attributes:
        numbers: the node of each pattern that is reached.
        size: how many actions that need something are reached.
        is_simple: whether no names are to be bound.
    """

    def __init__(self, request: Request) -> None:
        """Collect it; that of a whole request also where a demand is met at no cost."""
        super().__init__(request)
        self.size = 0
        self.is_simple = not request.goal.wanted
        self.numbers = {request.goal: self.add_node(request.goal, ())}
        self._instances: dict[Operator, int] = {}
        #: Nodes that one instance alone can make, if no names are to be bound.
        self._single: dict[Node, int] = {}
        for node, pattern in enumerate(self.patterns):  # grows meanwhile
            facts = request.cheapest_facts(pattern)
            makers = [self._maker(node, head.action, head.cost) for head in facts[:1]]
            if not request.is_whole:
                if facts and not pattern.wanted and request.is_met(pattern, facts[0]):
                    continue
                crowd = request.crowd(pattern) if pattern.wanted else None
                if crowd is not None:  # they are looked at when more is known
                    self.add_maker(node, self.add_instance(None, (), crowd, ()))
                    continue
            for offer in request.offers(pattern):
                makers.append(self._maker(node, offer.action, request.floor(offer.action)))
            if len(makers) + len(facts[1:]) == 1:
                self._single[node] = makers[0]

    def _maker(self, node: Node, action: Operator, cost: int) -> int:
        """Let an action, which may be new, make a node."""
        instance = self._instances.get(action)
        if instance is None:
            instance = self._instances[action] = self.add_instance(action, (), cost, ())
            if action.inputs:
                self.size += 1
                self.is_simple = self.is_simple and not action.variables
                for need in action.inputs:
                    if need not in self.numbers:
                        self.numbers[need] = self.add_node(need, ())
                self.needs[instance] = tuple([self.numbers[need] for need in action.inputs])
        made = self.makes[instance]
        if not made or made[-1] != node:
            self.add_maker(node, instance)
        return instance

    @cached_property
    def trees(self) -> tuple[dict[Node, int], dict[Node, Instance]]:
        """The price of the cheapest tree for each node that can be made, and its maker."""
        value, way, _ = self.cheapest(self.costs, use_sum=True)
        return value, way

    @cached_property
    def floors(self) -> dict[Node, int]:
        """A cost for each node that can be made, which no plan for it is below."""
        return self.cheapest(self.costs, use_sum=False)[0]

    def forced(self) -> int:
        """Return the cost of the instances that every plan has, if no names are to be bound."""
        found = {}
        waiting = [0]
        for node in waiting:  # grows meanwhile
            instance = self._single.get(node, -1)
            if instance >= 0 and instance not in found:
                found[instance] = self.costs[instance]
                waiting += self.needs[instance]
        return sum(found.values())

    def above(self, below: int) -> tuple[dict[Pattern, int], int]:
        """Return the least cost of a plan besides each demand, if it costs less than a bound.

        Returns:
            That, and its cost besides a demand of which nothing is known.
        """
        found: dict[Pattern, int] = {}
        least, rest = self.floors, below
        floors = [
            cost + max([least.get(need, below) for need in needs], default=0)
            for cost, needs in zip(self.costs, self.needs)
        ]
        makers: list[list[int]] = [[] for _ in self.patterns]
        for instance, nodes in enumerate(self.makes):
            for node in nodes:
                makers[node].append(instance)
        heap = [(0, 0)]
        while heap:
            price, node = heapq.heappop(heap)
            if self.patterns[node] in found:
                continue
            found[self.patterns[node]] = price
            for instance in makers[node]:
                cost = price + self.costs[instance]
                if self.actions[instance] is None:
                    rest = min(rest, cost)
                elif price + floors[instance] < below:
                    for need in self.needs[instance]:
                        if self.patterns[need] not in found:
                            heapq.heappush(heap, (cost, need))
        if rest < below:
            found = {pattern: min(price, rest) for pattern, price in found.items()}
        return found, rest
