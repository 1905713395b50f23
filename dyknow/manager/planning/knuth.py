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
from typing import (
    AbstractSet,
    Any,
    Callable,
    Dict,
    Iterable,
    List,
    Optional,
    Sequence,
    Tuple,
)

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.instances import LIVE, Instances
from dyknow.manager.planning.joins import Join, Pairs, Partial
from dyknow.manager.planning.patterns import Theta
from dyknow.manager.planning.values import Values

#: Values of nodes that the goal does not reach, and of those that are not met yet.
_CLOSED, _OPEN = -2, -1
#: Bits for the rank of a label in the keys by which the search goes on.
_BITS = 32
#: Steps of a budget that a final action, and an arrival at an in-port that is joined, take.
_EFFORT = 20
_RANK = (1 << _BITS) - 1
_NONE: AbstractSet[int] = frozenset()


def cheapest(
    instances: Instances,
    use_sum: bool = True,
    below: Optional[int] = None,
    is_all: bool = False,
    budget: Optional[Budget] = None,
) -> Values:
    """Value the nodes that can be met, up to the goal.

    Args:
        instances: what there is; grows.
        use_sum: use the sum over the inputs, the cost of a tree, in which shared parts are paid
            again; else the maximum over the inputs, which is a lower bound for every plan.
        below: value what costs less than this.
        is_all: go on beyond the goal.
        budget: what the search may take: half of what is left.
    """
    return _Search(instances, use_sum, below, is_all, budget).run()


class _Search:
    """Goes on with the action whose plan costs least, by what the reach knows is *above* it.

    The keys are integers: what such a plan costs, of equal ones first what is nearer to the goal,
    then the rank of the label. An action that supplies several demands has its turn for each.
    """

    def __init__(
        self,
        instances: Instances,
        use_sum: bool,
        below: Optional[int],
        is_all: bool,
        budget: Optional[Budget],
    ) -> None:
        network, reach = instances.network, instances.reach
        self._instances = instances
        self._combine: Callable[[Any], int] = sum if use_sum else max
        self._below = below
        self._is_all = is_all
        self._budget = budget
        self._spent = 0  # steps since the budget was asked last
        self._needs, self._serves = instances.needs, reach.serves
        self._wanting = network.wanting if not reach.is_abstract else _NONE
        self._missing = [0] * len(network.needs)
        for action in reach.actions:
            self._missing[action] = len(network.needs[action])
        # In the abstract, specialised actions too are plain ones, and ties decide nothing.
        self._ranks: Sequence[int] = range(len(network.labels))
        self._by_rank: Sequence[int] = self._ranks
        if not reach.is_abstract:
            ranks = network.ranks()
            self._ranks, self._by_rank = ranks.of, ranks.ordered
        # Demands that were specialised since have numbers too, and are closed.
        count = max(instances.node_count, len(network.patterns))
        self._values = Values([_CLOSED] * count, [LIVE] * count)
        value = self._values.value
        for demand in reach.demands:
            value[demand] = _OPEN
        for node in range(len(network.patterns), count):
            value[node] = _OPEN
        highest = max([reach.above[each] for each in reach.demands])
        self._bits = highest.bit_length()
        self._shift = _BITS + self._bits
        self._above = self._keys(reach.above, reach.demands)
        self._above_actions = self._keys(reach.above_actions, reach.actions)
        self._joins: Dict[int, Optional[Join]] = {}
        if not reach.is_abstract:
            self._joins = dict.fromkeys(network.joined.intersection(reach.actions))
        # Actions by their keys; combinations of actions that join, by these and bindings.
        self._heap: List[int] = []
        self._partial: List[Tuple[int, Theta, int, int, Optional[Pairs], Partial]] = []
        self._pushed = 0

    def _keys(self, above: List[int], numbers: Iterable[int]) -> List[int]:
        if not self._bits:
            return above  # zeros
        found = [0] * len(above)
        for each in numbers:
            found[each] = above[each] << self._shift | above[each] << _BITS
        return found

    def _join(self, action: int) -> Join:
        """Return what has arrived at the in-ports of an action."""
        join = self._joins[action]
        if join is None:
            instances = self._instances
            steps = instances.network.rules[action].joins
            known = instances.reach.floors.get(action)
            floors = [known[step.port] if known else 0 for step in steps]
            rest = [self._combine([0, *floors[at + 1 :]]) for at in range(len(steps))]
            join = self._joins[action] = Join(steps, instances.floor(action), rest)
            self._values.joins[action] = join
        return join

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
        serves, wanting, users, joins = self._serves, self._wanting, network.users, self._joins
        needs, missing, combine = self._needs, self._missing, self._combine
        ranks, by_rank, above, bits = self._ranks, self._by_rank, self._above, self._bits
        above_actions, shift = self._above_actions, self._shift
        below, budget, goal = self._below, self._budget, reach.goal
        is_all = self._is_all
        gathers = is_all and not reach.is_abstract
        left = budget.steps // 2 if budget is not None else 0
        pop, push = heapq.heappop, heapq.heappush
        value_of = value.__getitem__
        for action in reach.actions:
            if not needs[action]:
                heap.append((costs[action] << shift) + above_actions[action] + ranks[action])
        heapq.heapify(heap)
        for each in reach.live:
            self._supply(each.demand, each.theta, self._known(instances.live(each)), LIVE, 0)
        while heap or partial:
            if not is_all and value[goal] >= 0:
                break
            is_partial = bool(partial) and (not heap or partial[0][0] < heap[0])
            key = partial[0][0] if is_partial else heap[0]
            values.reached = price = key >> shift
            if below is not None and price >= below:
                break
            if budget is not None:
                if not budget.spend(_EFFORT + self._spent) or budget.steps < left:
                    values.is_complete = False
                    break
                self._spent = 0
            if is_partial:
                self._advance(key)
                continue
            pop(heap)
            action = by_rank[key & _RANK]
            if bits:
                price -= key >> _BITS & (1 << bits) - 1
            plain = (price << shift) + (key & _RANK)
            later = 0
            for demand in serves[action]:
                if value[demand] == _CLOSED or (value[demand] >= 0 and not gathers):
                    continue
                if bits and plain + above[demand] != key:
                    if plain + above[demand] > key and not 0 < later <= plain + above[demand]:
                        later = plain + above[demand]
                    continue
                if demand in wanting:
                    self._offer(action, demand, (), action, price)
                    continue
                if gathers:
                    offers.setdefault(demand, []).append(action)
                if value[demand] != _OPEN:
                    continue
                value[demand] = price
                chosen[demand] = action
                for user in users[demand]:
                    if user in joins:
                        self._arrive(user, demand, Partial(price, (), (demand,)))
                        continue
                    lacking = missing[user] = missing[user] - 1
                    if not lacking:
                        own = costs[user] + combine(map(value_of, needs[user]))
                        push(heap, (own << shift) + above_actions[user] + ranks[user])
            if later:
                push(heap, later)
        else:
            values.reached = None
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
        needs, joins = instances.needs, self._joins
        value[node] = price
        self._values.chosen[node] = action
        for user in instances.network.users[demand]:
            if user in joins:
                self._arrive(user, demand, Partial(price, theta, (node,)))
                continue
            left = missing[user] = missing[user] - 1
            if not left:
                own = instances.costs[user] + self._combine([value[each] for each in needs[user]])
                key = (own << self._shift) + self._above_actions[user] + self._ranks[user]
                heapq.heappush(self._heap, key)

    def _offer(self, rule: int, demand: int, theta: Theta, action: int, price: int) -> None:
        """Supply a demand with what a final action makes."""
        instances, values = self._instances, self._values
        network, value = instances.network, values.value
        pattern = network.patterns[demand]
        for offer in network.offers(demand, rule):
            for found in offer.of(pattern, theta, network.names):
                node = self._known(instances.node(demand, found))
                if self._is_all:
                    known = values.offers.setdefault(node, [])
                    if action not in known[-1:]:
                        known.append(action)
                if value[node] == _OPEN:
                    self._supply(demand, found, node, action, price)

    def _arrive(self, rule: int, demand: int, one: Partial) -> None:
        """Let a node supply the in-ports of an action that joins them."""
        self._spent += _EFFORT
        join = self._join(rule)
        inputs = self._instances.network.inputs[rule]
        for step, (port, *_) in enumerate(join.steps):
            if inputs[port] == demand:
                if step:
                    self._push(rule, join.arrived(step, one))
                else:
                    self._extend(rule, 0, one)

    def _extend(self, rule: int, step: int, one: Partial) -> None:
        """Go on from a combination of the in-ports up to a step."""
        join = self._join(rule)
        if join.is_complete(step):
            own = one.value + self._instances.cost(rule, one.theta)
            self._enter(own, rule, None, one._replace(value=own))
        else:
            self._push(rule, join.extended(step + 1, one))

    def _push(self, rule: int, pairs: Pairs) -> None:
        if not pairs.is_empty:
            one = pairs.pop(self._combine)
            join = self._join(rule)
            floor = self._combine((one.value, join.rest[pairs.step])) + join.cost
            self._enter(floor, rule, pairs, one)

    def _enter(self, price: int, rule: int, pairs: Optional[Pairs], one: Partial) -> None:
        self._pushed += 1
        key = (price << self._shift) + self._above_actions[rule] + self._ranks[rule]
        heapq.heappush(self._partial, (key, one.theta, self._pushed, rule, pairs, one))

    def _advance(self, key: int) -> None:
        """Go on with the combination whose turn it is."""
        _, theta, pushed, rule, pairs, one = heapq.heappop(self._partial)
        instances, value = self._instances, self._values.value
        wanting, serves = self._wanting, self._serves[rule]
        if not self._is_all and not any(
            value[each] == _OPEN or each in wanting for each in serves
        ):
            return  # all that it supplies is there
        if pairs is not None:
            self._push(rule, pairs)
            self._extend(rule, pairs.step, one)
            return
        action = instances.action(rule, theta, one.nodes)
        plain = (one.value << self._shift) + self._ranks[rule]
        later = []
        for demand in serves:
            turn = plain + self._above[demand]
            if value[demand] != _CLOSED and turn == key:
                self._offer(rule, demand, theta, action, one.value)
            elif value[demand] != _CLOSED and turn > key:
                later.append(turn)
        if later:
            heapq.heappush(self._partial, (min(later), theta, pushed, rule, pairs, one))
