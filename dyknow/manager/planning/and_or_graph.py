# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A small AND/OR graph: the instances that a cheaper plan than the one at hand can have."""

from __future__ import annotations

import heapq
from typing import (
    AbstractSet,
    Collection,
    Dict,
    Iterable,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from dyknow.manager.planning.request import Need, Request
from dyknow.manager.planning.search import Instance, Search


class Draft(NamedTuple):
    """A way to the goal.

    Attributes:
        chosen: the supplier of each node.
        order: the instances, suppliers first.
        cost: their cost.
    """

    chosen: Dict[Need, Instance]
    order: List[Instance]
    cost: int


def drafted(request: Request, chosen: Dict[Need, Instance]) -> Draft:
    """Follow choices, which have no cycle, from the goal."""
    order: Dict[Instance, None] = {}
    stack = [(chosen[Need(request.goal, ())], True)]
    entered = set()
    while stack:
        instance, is_new = stack.pop()
        if not is_new:
            order[instance] = None
        elif instance not in entered:
            entered.add(instance)
            stack.append((instance, False))
            stack += [(chosen[need], True) for need in reversed(instance.needs)]
    return Draft(chosen, list(order), sum([e.cost for e in order]) + unfree(request, order))


def unfree(request: Request, instances: Iterable[Instance]) -> int:
    """Return the costs of instances where only one nodelet of an action is free."""
    if not request.kept:
        return 0
    keys = {(each.action.slow or each.action, each.theta) for each in instances}
    free = [action for action, theta in keys if request.is_free(action, theta)]
    return sum([action.cost for action in free]) - sum([action.cost for action in {*free}])


class AndOrGraph:
    """Instances as actions and nodes, numbered from 0; the goal is node 0.

    Attributes:
        costs: of each action.
        needs: nodes that each action needs; nodes without cost are left out.
        makes: nodes that each action supplies.
        users: actions that need each node.
        offers: actions that supply each node.
        size: its number of edges, the unit in which effort is counted.
        limit: microseconds after which no node may be supplied; None for any.
    """

    def __init__(self, request: Request, search: Search) -> None:
        """Take the results of a search."""
        self._request = request
        self.limit = request.limit
        goal = Need(request.goal, ())
        self._there = {
            node: each
            for node, each in search.chosen.items()
            if node != goal and not each.cost and not each.needs and not self._latency(each, node)
        }
        # Equal problems have equal numbers here: by label and bindings.
        found = {each: None for offers in search.offers.values() for each in offers}
        order = sorted(found, key=lambda e: (e.action.label, e.theta, e.action.slow is None))
        self._instances = order
        self._numbers = {each.key: number for number, each in enumerate(order)}
        nodes: Dict[Need, int] = {goal: 0}
        for each in order:
            for need in each.needs:
                if need not in self._there:
                    nodes.setdefault(need, len(nodes))
        self._nodes = list(nodes)
        self.costs = [each.cost for each in order]
        self.needs = [
            list(dict.fromkeys([nodes[need] for need in each.needs if need in nodes]))
            for each in order
        ]
        self.offers = [
            sorted([self._numbers[each.key] for each in search.offers.get(node, ())])
            for node in nodes
        ]
        self.makes: List[List[int]] = [[] for _ in order]
        self.users: List[List[int]] = [[] for _ in nodes]
        for node, offers in enumerate(self.offers):
            for action in offers:
                self.makes[action].append(node)
        for action, needed in enumerate(self.needs):
            for node in needed:
                self.users[node].append(action)
        self._latencies = {
            (action, node): self._latency(order[action], self._nodes[node])
            for action, made in enumerate(self.makes if self.limit is not None else ())
            for node in made
        }
        self.size = len(order) + sum(map(len, self.needs)) + sum(map(len, self.makes))

    def _latency(self, instance: Instance, node: Need) -> int:
        """Return the contribution of an instance to the latency of a node, if there is a limit."""
        if self.limit is None:
            return 0
        return self._request.source(instance.action, instance.theta, node).latency

    def numbers(self, draft: Draft) -> List[int]:
        """Return the numbers here of a draft's instances; useless ones are left out."""
        return [self._numbers[each.key] for each in draft.order if each.key in self._numbers]

    def cost(self, actions: Collection[int]) -> int:
        """Sum up the costs of actions."""
        total = sum([self.costs[each] for each in actions])
        if self._request.kept:
            total += unfree(self._request, [self._instances[each] for each in actions])
        return total

    def drafted(self, way: Dict[int, int]) -> Draft:
        """Return the draft that chooses suppliers so."""
        chosen = dict(self._there)
        chosen.update((self._nodes[node], self._instances[each]) for node, each in way.items())
        return drafted(self._request, chosen)

    def _is_late(self, done: int) -> bool:
        return self.limit is not None and done > self.limit

    def derive(self, actions: AbstractSet[int]) -> Dict[int, int]:
        """Supply all nodes that some actions alone can supply.

        Returns:
            For each node that is reached its supplier, without a cycle; if there is a limit,
            the soonest one, and the nodes that are supplied in time.
        """
        if self.limit is not None:
            return self._soonest(actions)
        makes, users = self.makes, self.users
        missing = {action: len(self.needs[action]) for action in actions}
        way: Dict[int, int] = {}
        waiting = sorted([action for action, left in missing.items() if not left])
        for action in waiting:  # grows meanwhile
            for node in makes[action]:
                if node not in way:
                    way[node] = action
                    for user in users[node]:
                        left = missing.get(user, 0)
                        if left:
                            missing[user] = left - 1
                            if left == 1:
                                waiting.append(user)
        return way

    def _soonest(self, actions: AbstractSet[int]) -> Dict[int, int]:
        missing = {action: len(self.needs[action]) for action in actions}
        way: Dict[int, int] = {}
        heap = [(0, -1, action) for action, left in missing.items() if not left]
        heapq.heapify(heap)  # nodes by the times when they are supplied, and actions by theirs
        while heap:
            begun, node, action = heapq.heappop(heap)
            if node < 0:
                for made in self.makes[action]:
                    done = begun + self._latencies[action, made]
                    if made not in way and not self._is_late(done):
                        heapq.heappush(heap, (done, made, action))
            elif node not in way:
                way[node] = action
                for user in self.users[node]:
                    if user in missing:
                        missing[user] -= 1
                        if not missing[user]:
                            heapq.heappush(heap, (begun, -1, user))
        return way

    def cheapest(
        self, prices: Sequence[float], use_sum: bool = True
    ) -> Tuple[Dict[int, int], List[int], Optional[float]]:
        """Supply all nodes as cheaply as possible at some prices, by Knuth's algorithm.

        Args:
            prices: of the actions.
            use_sum: an action costs as much as all nodes that it needs, and the search ends at
                the goal; else as much as the dearest of them. The sum heeds the limit, but then
                there may be cheaper suppliers, and none may be found though there are some.

        Returns:
            The supplier of each node, the last node that was supplied of those that each action
            needs, the dearest one (-1 for none), and the price of the goal.
        """
        missing = list(map(len, self.needs))
        total = list(prices)
        begun = [0] * len(missing)
        last = [-1] * len(missing)
        heap = [(total[action], action) for action, left in enumerate(missing) if not left]
        heapq.heapify(heap)
        way: Dict[int, int] = {}
        goal = None
        while heap and not (use_sum and 0 in way):
            price, action = heapq.heappop(heap)
            for node in self.makes[action]:
                done = begun[action] + self._latencies.get((action, node), 0)
                if node in way or (use_sum and self._is_late(done)):
                    continue
                way[node] = action
                if not node:
                    goal = price
                for user in self.users[node]:
                    total[user] = price + (total if use_sum else prices)[user]
                    begun[user] = max(begun[user], done)
                    last[user] = node
                    missing[user] -= 1
                    if not missing[user]:
                        heapq.heappush(heap, (total[user], user))
        return way, last, goal

    def followed(self, way: Dict[int, int]) -> List[int]:
        """Return the actions that choices lead to from the goal."""
        waiting = [way[0]]
        found = {way[0]}
        for action in waiting:  # grows meanwhile
            for node in self.needs[action]:
                if way[node] not in found:
                    found.add(way[node])
                    waiting.append(way[node])
        return waiting
