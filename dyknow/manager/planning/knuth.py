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
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple, Union

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.instances import LIVE, Instances
from dyknow.manager.planning.joins import Join, Pairs, Partial
from dyknow.manager.planning.patterns import Theta

Chosen = Union[Mapping[int, int], Sequence[int]]
"""For each node the action that supplies it, or ``LIVE``."""

#: Values of nodes that the goal does not reach, and of those that are not met yet.
_CLOSED, _OPEN = -2, -1
#: Bits for the rank of a label below a cost, in the keys by which the search goes on.
_BITS = 32
#: Steps of a budget that a final action, and an arrival at an in-port that is joined, take.
_EFFORT = 20
_RANK = (1 << _BITS) - 1


@dataclass
class Values:
    """What a search found.

    Attributes:
        value: cost of the cheapest way to each node that was met, -1 for others.
        chosen: the action with which it ends.
        offers: all actions that supply a node, if everything was asked for.
        joins: what arrived at the in-ports of the actions that join them.
        reached: what was not found costs at least as much.
        is_complete: whether nothing was left out.
    """

    value: List[int]
    chosen: List[int]
    offers: Dict[int, List[int]] = field(default_factory=dict)
    joins: Dict[int, Join] = field(default_factory=dict)
    reached: int = 0
    is_complete: bool = True

    def is_met(self, node: int) -> bool:
        """Whether there is a way to a node."""
        return self.value[node] >= 0


def cheapest(
    instances: Instances,
    use_sum: bool = True,
    below: Optional[int] = None,
    budget: Optional[Budget] = None,
) -> Values:
    """Value the nodes that can be met, up to the goal.

    Args:
        instances: what there is; grows.
        use_sum: use the sum over the inputs, the cost of a tree, in which shared parts are paid
            again; else the maximum over the inputs, which is a lower bound for every plan.
        below: go on beyond the goal, and value everything that costs less than this.
        budget: what the search may take, if it goes on beyond the goal: half of what is left.
    """
    return _Search(instances, use_sum, below, budget).run()


class _Search:
    def __init__(
        self,
        instances: Instances,
        use_sum: bool,
        below: Optional[int],
        budget: Optional[Budget],
    ) -> None:
        network, reach = instances.network, instances.reach
        self._instances = instances
        self._combine: Callable[[Any], int] = sum if use_sum else max
        self._below = below
        self._budget = budget
        self._spent = 0  # steps since the budget was asked last
        self._missing = reach.missing.copy()
        self._ranks, self._by_rank = network.ranks()
        count = instances.node_count
        self._values = Values([_CLOSED] * count, [LIVE] * count)
        value = self._values.value
        for demand in reach.demands:
            value[demand] = _OPEN
        for node in range(len(network.patterns), count):
            value[node] = _OPEN
        for action in network.joined.intersection(reach.actions):
            self._values.joins[action] = Join(network.rules[action].joins)
        # Actions by cost and rank; combinations of actions that join, by these and bindings.
        self._heap: List[int] = []
        self._partial: List[Tuple[int, Theta, int, int, Optional[Pairs], Partial]] = []
        self._pushed = 0

    def run(self) -> Values:
        """Search."""
        values, instances, heap, partial = (
            self._values,
            self._instances,
            self._heap,
            self._partial,
        )
        network, reach, costs = instances.network, instances.reach, instances.costs
        value, offers, chosen = values.value, values.offers, values.chosen
        serves, wanting, users = (
            network.serves,
            network.wanting,
            network.users,
        )
        needs, missing, combine = instances.needs, self._missing, self._combine
        ranks, by_rank = self._ranks, self._by_rank
        below, budget, goal = self._below, self._budget, reach.goal
        left = budget.steps // 2 if budget is not None else 0
        pop, push = heapq.heappop, heapq.heappush
        value_of = value.__getitem__
        for action in reach.actions:
            if not needs[action]:
                heap.append(costs[action] << _BITS | ranks[action])
        heapq.heapify(heap)
        for each in reach.live:
            self._supply(each.demand, each.theta, self._known(instances.live(each)), LIVE, 0)
        while heap or partial:
            if below is None and value[goal] >= 0:
                break
            is_partial = bool(partial) and (not heap or partial[0][0] < heap[0])
            key = partial[0][0] if is_partial else heap[0]
            price = key >> _BITS
            values.reached = price
            if below is not None:
                if price >= below:
                    break
                if budget is not None:
                    if not budget.spend(_EFFORT + self._spent) or budget.steps < left:
                        values.is_complete = False
                        break
                    self._spent = 0
            if is_partial:
                self._advance(price)
                continue
            action = by_rank[pop(heap) & _RANK]
            for demand in serves[action]:
                if value[demand] >= 0 and below is None:
                    continue
                if demand in wanting:
                    self._offer(action, demand, (), action, price)
                    continue
                if below is not None and value[demand] != _CLOSED:
                    offers.setdefault(demand, []).append(action)
                if value[demand] != _OPEN:
                    continue
                value[demand] = price
                chosen[demand] = action
                for user in users[demand]:
                    if user < 0:
                        self._arrive(~user, demand, Partial(price, (), (demand,)))
                        continue
                    lacking = missing[user] = missing[user] - 1
                    if not lacking:
                        own = costs[user] + combine(map(value_of, needs[user]))
                        push(heap, own << _BITS | ranks[user])
        return values

    def _known(self, node: int) -> int:
        """Make room for a node that may be new."""
        if node == len(self._values.value):
            self._values.value.append(_OPEN)
            self._values.chosen.append(LIVE)
        return node

    def _supply(self, demand: int, theta: Theta, node: int, action: int, price: int) -> None:
        """Enter the first way to a node."""
        instances, missing, value = self._instances, self._missing, self._values.value
        needs = instances.needs
        value[node] = price
        self._values.chosen[node] = action
        for user in instances.network.users[demand]:
            if user < 0:
                self._arrive(~user, demand, Partial(price, theta, (node,)))
                continue
            left = missing[user] = missing[user] - 1
            if not left:
                own = instances.costs[user] + self._combine([value[each] for each in needs[user]])
                heapq.heappush(self._heap, own << _BITS | self._ranks[user])

    def _offer(self, rule: int, demand: int, theta: Theta, action: int, price: int) -> None:
        """Supply a demand with what a final action makes."""
        instances, values = self._instances, self._values
        network, value = instances.network, values.value
        if value[demand] == _CLOSED:
            return
        pattern = network.patterns[demand]
        for offer in network.suppliers(demand)[rule]:
            for found in offer.of(pattern, theta, network.names):
                node = self._known(instances.node(demand, found))
                if self._below is not None:
                    known = values.offers.setdefault(node, [])
                    if action not in known[-1:]:
                        known.append(action)
                if value[node] == _OPEN:
                    self._supply(demand, found, node, action, price)

    def _arrive(self, rule: int, demand: int, one: Partial) -> None:
        """Let a node supply the in-ports of an action that joins them."""
        self._spent += _EFFORT
        join = self._values.joins.get(rule)
        if join is None:
            return  # the goal does not reach it
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
        if join.is_complete(step):
            self._enter(one.value + self._instances.cost(rule, one.theta), rule, None, one)
        else:
            self._push(rule, join.extended(step + 1, one))

    def _push(self, rule: int, pairs: Pairs) -> None:
        if not pairs.is_empty:
            one = pairs.pop(self._combine)
            self._enter(one.value, rule, pairs, one)

    def _enter(self, price: int, rule: int, pairs: Optional[Pairs], one: Partial) -> None:
        self._pushed += 1
        key = price << _BITS | self._ranks[self._instances.network.base(rule)]
        heapq.heappush(self._partial, (key, one.theta, self._pushed, rule, pairs, one))

    def _advance(self, price: int) -> None:
        """Go on with the combination whose turn it is."""
        _, _, _, rule, pairs, one = heapq.heappop(self._partial)
        instances = self._instances
        network, value = instances.network, self._values.value
        serves = network.serves[rule]
        if self._below is None and not any(
            value[each] == _OPEN or each in network.wanting for each in serves
        ):
            return  # all that it supplies is there
        if pairs is not None:
            self._push(rule, pairs)
            self._extend(rule, pairs.step, one)
            return
        action = instances.action(rule, one.theta, one.nodes)
        for demand in serves:
            self._offer(rule, demand, one.theta, action, price)
