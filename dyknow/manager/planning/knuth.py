# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Knuth's generalisation of Dijkstra's algorithm, over instances that it makes on the way.

D. E. Knuth, "A generalization of Dijkstra's algorithm", Information Processing Letters 6(1), 1977.
The value of an action is its cost plus the sum (or the maximum) of the values of its demands. Both
are superior functions, so actions are final in the order of their values. What a final action
supplies is matched with the demands that the goal can reach, and joined with what else an action
needs under the same bindings.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Optional, Tuple

from dyknow.manager.planning.instances import LIVE, Instances
from dyknow.manager.planning.joins import Join, Pairs, Partial
from dyknow.manager.planning.patterns import Theta

Chosen = Dict[int, int]
"""For each node the action that supplies it, or ``LIVE``."""


@dataclass
class Values:
    """What a search found.

    Attributes:
        value: cost of the cheapest way to each node.
        chosen: the action with which it ends.
        offers: all actions that supply a node, if everything was asked for.
        joins: what arrived at the in-ports of the actions that join them.
        reached: what was not found costs at least as much.
        is_complete: whether nothing was left out.
    """

    value: Dict[int, int] = field(default_factory=dict)
    chosen: Chosen = field(default_factory=dict)
    offers: Dict[int, List[int]] = field(default_factory=dict)
    joins: Dict[int, Join] = field(default_factory=dict)
    reached: int = 0
    is_complete: bool = True


def cheapest(
    instances: Instances,
    use_sum: bool = True,
    below: Optional[int] = None,
    most: Optional[int] = None,
) -> Values:
    """Value the nodes that can be met, up to the goal.

    Args:
        instances: what there is; grows.
        use_sum: use the sum over the inputs, the cost of a tree, in which shared parts are paid
            again; else the maximum over the inputs, which is a lower bound for every plan.
        below: go on beyond the goal, and value everything that costs less than this.
        most: actions after which the search ends, if it goes on beyond the goal.
    """
    return _Search(instances, use_sum, below, most).run()


class _Search:
    def __init__(
        self, instances: Instances, use_sum: bool, below: Optional[int], most: Optional[int]
    ) -> None:
        self._instances = instances
        self._combine: Callable[[Any], int] = sum if use_sum else max
        self._below = below
        self._most = most
        self._values = Values()
        self._heap: List[Tuple[Any, ...]] = []
        self._pushed = 0
        reach, needs = instances.reach, instances.needs
        self._missing = {action: len(needs[action]) for action in reach.served}

    def run(self) -> Values:
        values, instances = self._values, self._instances
        reach, labels, costs = instances.reach, instances.labels, instances.costs
        value, offers, served = values.value, values.offers, reach.served
        wanting, joined = reach.wanting, instances.network.joined
        heap, below, most, goal = self._heap, self._below, self._most, reach.goal
        pop = heapq.heappop
        for action, left in self._missing.items():
            if not left:
                heap.append((costs[action], labels[action], action))
            if action in joined:
                steps = instances.network.rules[action].joins
                values.joins[action] = Join(steps)
        heapq.heapify(heap)
        for each in reach.live:
            self._supply(each.demand, each.theta, instances.live(each), LIVE, 0)
        while heap and (below is not None or goal not in value):
            entry = pop(heap)
            price = entry[0]
            values.reached = price
            if below is not None:
                if price >= below:
                    break
                if most is not None:
                    most -= 1
                    if most < 0:
                        values.is_complete = False
                        break
            if len(entry) == 5:
                self._advance(price, entry[4])
                continue
            action = entry[2]
            for demand in served[action]:
                if demand in wanting:
                    self._offer(action, demand, (), action, price)
                    continue
                if below is not None:
                    offers.setdefault(demand, []).append(action)
                if demand not in value:
                    self._supply(demand, (), demand, action, price)
        return values

    def _supply(self, demand: int, theta: Theta, node: int, action: int, price: int) -> None:
        """Enter the first way to a node."""
        instances, missing, combine = self._instances, self._missing, self._combine
        value = self._values.value
        needs, costs, labels = instances.needs, instances.costs, instances.labels
        value[node] = price
        self._values.chosen[node] = action
        for user in instances.reach.consumers[demand]:
            if user < 0:
                self._arrive(~user, demand, Partial(price, theta, (node,)))
                continue
            left = missing[user] = missing[user] - 1
            if not left:
                inputs = combine([value[need] for need in needs[user]])
                heapq.heappush(self._heap, (costs[user] + inputs, labels[user], user))

    def _offer(self, rule: int, demand: int, theta: Theta, action: int, price: int) -> None:
        """Supply a demand with what a final action makes."""
        instances, values = self._instances, self._values
        network = instances.network
        pattern = network.patterns[demand]
        for offer in network.suppliers(demand)[rule]:
            for found in offer.of(pattern, theta, network.names):
                node = instances.node(demand, found)
                if self._below is not None:
                    known = values.offers.setdefault(node, [])
                    if action not in known[-1:]:
                        known.append(action)
                if node not in values.value:
                    self._supply(demand, found, node, action, price)

    def _arrive(self, rule: int, demand: int, one: Partial) -> None:
        """Let a node supply the in-ports of an action that joins them."""
        join = self._values.joins[rule]
        inputs = self._instances.network.inputs[rule]
        for step, (port, *_) in enumerate(join.steps):
            if inputs[port] == demand:
                if step:
                    self._push(rule, join.arrived(step, one))
                else:
                    self._extend(rule, 0, one)

    def _extend(self, rule: int, step: int, one: Partial) -> None:
        """Go on from a combination of the in-ports up to a step."""
        join = self._values.joins[rule]
        if not join.is_complete(step):
            self._push(rule, join.extended(step + 1, one))
            return
        price = one.value + self._instances.cost(rule, one.theta)
        self._pushed += 1
        entry = price, self._instances.labels[rule], one.theta, self._pushed, (rule, -1, one)
        heapq.heappush(self._heap, entry)

    def _push(self, rule: int, pairs: Pairs) -> None:
        if not pairs.is_empty:
            one = pairs.pop(self._combine)
            self._pushed += 1
            label = self._instances.labels[rule]
            entry = one.value, label, one.theta, self._pushed, (rule, pairs, one)
            heapq.heappush(self._heap, entry)

    def _advance(self, price: int, work: Tuple[int, Any, Partial]) -> None:
        """Go on with a combination whose turn it is."""
        rule, pairs, one = work
        instances = self._instances
        served = instances.reach.served[rule]
        if self._below is None:
            value, wanting = self._values.value, instances.reach.wanting
            if not [each for each in served if each in wanting or each not in value]:
                return  # all that it supplies is there
        if pairs != -1:
            self._push(rule, pairs)
            self._extend(rule, pairs.step, one)
            return
        action = instances.action(rule, one.theta, one.nodes)
        for demand in served:
            self._offer(rule, demand, one.theta, action, price)
