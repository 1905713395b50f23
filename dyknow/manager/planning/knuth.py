# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Knuth's generalisation of Dijkstra's algorithm, over instances that it makes on the way.

D. E. Knuth, "A generalization of Dijkstra's algorithm", Information Processing Letters 6(1), 1977.
The value of an action is its cost plus the sum (or the maximum) of the values of its demands. Both
are superior functions, so actions are final in the order of their values. What a final action
supplies is matched with the demands that the goal can reach, and joined with what else an action
needs under the same bindings. Of what supplies a node only the cheapest that is known waits for
its turn.
"""

from __future__ import annotations

import heapq
from typing import Any, Callable, Dict, Iterable, List, Optional, Sequence, Tuple

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.instances import LIVE, Instances
from dyknow.manager.planning.joins import Arrivals, Join, Pairs, Partial
from dyknow.manager.planning.live_streams import LiveMatch
from dyknow.manager.planning.patterns import Theta
from dyknow.manager.planning.values import Values

#: Bits for each part of the keys by which the search goes on, but for the first.
_BITS = 32
_MOST = (1 << _BITS) - 1
#: Steps of a budget that a final action, and an arrival at an in-port that is joined, take.
_EFFORT = 20

_Entry = Tuple[int, Theta, int, int, Optional[Pairs], Sequence[int], Partial]
"""Key, bindings, a number that is larger for each entry, rule, what follows, nodes, and inputs."""


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
        is_all: go on beyond the goal, and collect all that supplies a node.
        budget: what the search may take: half of what is left.
    """
    return _Search(instances, use_sum, below, is_all, budget).run()


class _Search:
    """Goes on with the action whose plan costs least, by what the reach knows is *above* it.

    The keys are integers: what such a plan costs, of equal ones first what is nearer to the goal,
    then the rank of the label. An action that supplies several
    demands has its turn for each.
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
        self._reach = reach
        self._serves, self._users = reach.serves, reach.users
        self._combine: Callable[[Any], int] = sum if use_sum else max
        self._below = below
        self._is_all = is_all
        self._budget = budget
        self._spent = 0  # steps since the budget was asked last
        self._wanting = network.wanting
        self._costs = instances.costs.floors()
        ranks = network.ranks()
        self._ranks, self._by_rank = ranks.of, ranks.ordered
        #: What keys have for a demand besides the price and the rank.
        self._order: Dict[int, int] = {}
        self._is_guided = reach.pending is not None or any(reach.above.values())
        self._shift = 2 * _BITS if self._is_guided else _BITS
        #: What plain actions cost with all that they need, and how many nodes others still lack.
        self._prices: Dict[int, int] = {}
        self._missing: Dict[int, int] = {}
        self._values = Values()
        self._joins = self._values.joins
        #: The demands with which other actions begin to join: nothing has arrived there.
        self._waiting: Dict[int, int] = {}
        #: The lowest key by which a node is supplied, as far as it is known.
        self._best: Dict[int, int] = {}
        #: Nodes of the demands of in-ports that are joined.
        self._met: Dict[int, Arrivals] = {}
        # For what is revealed later: of rules what was joined completely, and what was given up
        # since all that it could supply was there.
        self._joined: Dict[int, List[Partial]] = {}
        self._idle: Dict[int, List[_Entry]] = {}
        # Actions by their keys; combinations of actions that join, by these and bindings.
        self._heap: List[int] = []
        self._partial: List[_Entry] = []
        self._pushed = 0

    def run(self) -> Values:
        """Search."""
        values, reach, heap, partial = self._values, self._reach, self._heap, self._partial
        value, serves, order, prices = values.value, self._serves, self._order, self._prices
        by_rank, wanting, shift = self._by_rank, self._wanting, self._shift
        below, budget, is_all, goal = self._below, self._budget, self._is_all, reach.goal
        left = budget.steps // 2 if budget is not None else 0
        self._open([(each, demand) for each in serves for demand in serves[each]], reach.live)
        while is_all or goal not in value:
            is_partial = bool(partial) and (not heap or partial[0][0] < heap[0])
            key = partial[0][0] if is_partial else heap[0] if heap else None
            pending = reach.pending
            if (
                pending is not None
                and (key is None or pending <= key >> shift)
                and (below is None or pending < below)
            ):
                self._open(*reach.reveal())
                continue
            if key is None:
                values.reached = pending
                break
            values.reached = price = key >> shift
            if below is not None and price >= below:
                break
            if budget is not None:
                if not budget.spend(_EFFORT + self._spent) or budget.steps < left:
                    values.is_complete = False
                    break
                self._spent = 0
            if is_partial:
                self._advance(heapq.heappop(partial))
                continue
            heapq.heappop(heap)
            rank = key & _MOST
            action = by_rank[rank]
            price = prices[action]
            for demand in serves[action]:
                if (price << shift) + order[demand] + rank != key:
                    continue
                if demand in wanting:
                    self._offer(action, demand, price)
                    continue
                if is_all:
                    values.offers.setdefault(demand, []).append(action)
                if demand not in value:
                    self._supply(demand, (), demand, action, price)
        return values

    def _open(self, found: Sequence[Tuple[int, int]], live: Iterable[LiveMatch]) -> None:
        """Take in actions, each with what it supplies, and live streams."""
        network, value, order = self._instances.network, self._values.value, self._order
        needs, missing, joined = network.needs, self._missing, network.joined
        for _, demand in found:
            if demand not in order:
                order[demand] = self._order_of(demand)
        for action, demand in found:
            if action in missing:
                if not missing[action]:
                    self._finish(action)
            elif action not in joined:
                lacking = [need for need in needs[action] if need not in value]
                missing[action] = len(lacking)
                if not lacking:
                    self._finish(action)
            elif action in self._joins or action in self._waiting:
                for one in self._joined.get(action, ()):
                    self._propose(action, [demand], one)
                for entry in self._idle.pop(action, ()):
                    heapq.heappush(self._partial, entry)
            else:
                self._wait(action)
        for each in live:
            node = self._instances.live(each)
            self._supply(each.demand, each.theta, node, LIVE, 0)

    def _order_of(self, demand: int) -> int:
        if not self._is_guided:
            return 0
        above = self._reach.above[demand]
        return above << self._shift | min(above, _MOST) << _BITS

    def _finish(self, action: int) -> None:
        """Let an action without joined in-ports wait for its turn: all that it needs is there."""
        value, needs = self._values.value, self._instances.network.needs[action]
        price = self._costs[action]
        if needs:
            price += self._combine([value[each] for each in needs])
        self._prices[action] = price
        key = (price << self._shift) + self._ranks[action]
        order, best, is_all, wanting = self._order, self._best, self._is_all, self._wanting
        for demand in self._serves[action]:
            turn = key + order[demand]
            if is_all or demand in wanting:
                heapq.heappush(self._heap, turn)
            elif demand not in best or turn < best[demand]:
                best[demand] = turn
                heapq.heappush(self._heap, turn)

    def _supply(self, demand: int, theta: Theta, node: int, action: int, price: int) -> None:
        """Enter the first way to a node."""
        values, missing = self._values, self._missing
        joins, waiting = self._joins, self._waiting
        values.value[node] = price
        values.chosen[node] = action
        users = self._users[demand]
        if not users:
            return
        met = self._met.get(demand)
        one = Partial(price, theta, (node,))
        if met is not None:
            met.add(one)
        for user in users:
            if user in joins:
                join = joins[user]
                for step in join.at[demand]:
                    if step:
                        self._push(user, join, join.arrived(step, one))
                    else:
                        self._extend(user, join, 0, one)
            elif user in waiting:
                if self._met[waiting[user]].all:
                    self._begin(user)
            else:
                left = missing[user] = missing[user] - 1
                if not left:
                    self._finish(user)

    def _offer(self, action: int, demand: int, price: int) -> None:
        """Supply a demand under bindings with what an action without joined in-ports makes."""
        instances, values = self._instances, self._values
        network = instances.network
        for offer in network.offers(demand, action):
            for found in offer.of(network.patterns[demand], (), network.names):
                node = instances.node(demand, found)
                if self._is_all:
                    values.offers.setdefault(node, []).append(action)
                if node not in values.value:
                    self._supply(demand, found, node, action, price)

    # Actions that join in-ports

    def _wait(self, rule: int) -> None:
        """Let an action that joins its in-ports begin with the first arrival."""
        network, value, met = self._instances.network, self._values.value, self._met
        for need in network.needs[rule]:
            if need not in met:
                met[need] = Arrivals()
                if need in value:  # others needed it before
                    met[need].add(Partial(value[need], (), (need,)))
        first = network.inputs[rule][network.rules[rule].joins[0].port]
        self._waiting[rule] = first
        if met[first].all:
            self._begin(rule)

    def _begin(self, rule: int) -> None:
        """Join what has arrived at the in-ports of an action."""
        del self._waiting[rule]
        instances = self._instances
        steps = instances.network.rules[rule].joins
        inputs = instances.network.inputs[rule]
        known = self._reach.floors.get(rule)
        floors = [known[step.port] if known else 0 for step in steps]
        rest = [self._combine(floors[at + 1 :]) for at in range(len(steps) - 1)]
        cost = instances.costs.floor(rule)
        join = Join(steps, [inputs[step.port] for step in steps], self._met, cost, [*rest, 0])
        self._joins[rule] = join
        for one in join.first.all:
            self._extend(rule, join, 0, one)

    def _rank(self, rule: int) -> int:
        return self._ranks[self._instances.network.base(rule)]

    def _extend(self, rule: int, join: Join, step: int, one: Partial) -> None:
        """Go on from a combination of the in-ports up to a step."""
        if step < join.last:
            self._push(rule, join, join.extended(step + 1, one))
            return
        own = one.value + self._instances.costs.bound(rule, one.theta)
        one = one._replace(value=own)
        if self._is_guided:
            self._joined.setdefault(rule, []).append(one)
        self._propose(rule, self._serves[rule], one)

    def _propose(self, rule: int, demands: Sequence[int], one: Partial) -> None:
        """Let an action under bindings wait for its turns to supply demands."""
        instances, best = self._instances, self._best
        network = instances.network
        plain = (one.value << self._shift) + self._rank(rule)
        turns: Dict[int, List[int]] = {}
        for demand in demands:
            key = plain + self._order[demand]
            for offer in network.offers(demand, rule):
                pattern = network.patterns[demand]
                for found in offer.of_special(pattern, one.theta, network.names):
                    node = instances.node(demand, found)
                    if self._is_all or key <= best.get(node, key):
                        best[node] = key
                        turns.setdefault(key, []).append(node)
        for key, nodes in turns.items():
            self._enter(key, rule, None, nodes, one)

    def _push(self, rule: int, join: Join, pairs: Optional[Pairs]) -> None:
        if pairs is None or pairs.is_empty:
            return
        self._spent += _EFFORT
        one = pairs.pop(self._combine)
        floor = self._combine((one.value, join.rest[pairs.step])) + join.cost
        nearest = self._order[self._serves[rule][0]]
        key = (floor << self._shift) + nearest + self._rank(rule)
        self._enter(key, rule, pairs, (), one)

    def _enter(
        self, key: int, rule: int, pairs: Optional[Pairs], nodes: Sequence[int], one: Partial
    ) -> None:
        self._pushed += 1
        heapq.heappush(self._partial, (key, one.theta, self._pushed, rule, pairs, nodes, one))

    def _advance(self, entry: _Entry) -> None:
        """Go on with the combination whose turn it is."""
        _, theta, _, rule, pairs, nodes, one = entry
        instances, values = self._instances, self._values
        if pairs is not None:
            wanting = self._wanting
            if not self._is_all and not any(
                each not in values.value or each in wanting for each in self._serves[rule]
            ):
                self._idle.setdefault(rule, []).append(entry)
                return
            join = self._joins[rule]
            self._push(rule, join, pairs)
            self._extend(rule, join, pairs.step, one)
            return
        nodes = [each for each in nodes if self._is_all or each not in values.value]
        if not nodes:
            return
        action = instances.action(rule, theta, one.nodes)
        for node in nodes:
            if self._is_all:
                values.offers.setdefault(node, []).append(action)
            if node not in values.value:
                self._supply(*instances.demand(node), node, action, one.value)
