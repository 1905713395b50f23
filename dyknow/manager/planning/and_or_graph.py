# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A small AND/OR graph: what may be part of a plan that is cheaper than the one at hand."""

from __future__ import annotations

import heapq
from typing import AbstractSet, Dict, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.request import Need, Request, base
from dyknow.manager.planning.search import Instance, Search


class Draft(NamedTuple):
    """A way to the goal.

    Attributes:
        chosen: what supplies each node.
        order: the instances, suppliers first.
        cost: what they cost.
    """

    chosen: Dict[Need, Instance]
    order: List[Instance]
    cost: int


def drafted(request: Request, chosen: Dict[Need, Instance], goal: Need) -> Draft:
    """Follow choices, which have no cycle, from the goal."""
    order: List[Instance] = []
    entered = set()
    stack: List[Tuple[Instance, bool]] = [(chosen[goal], True)]
    while stack:
        instance, is_new = stack.pop()
        if not is_new:
            order.append(instance)
        elif instance not in entered:
            entered.add(instance)
            stack.append((instance, False))
            for node in reversed(instance.needs):  # the first is followed first
                below = chosen[node]
                if below not in entered:
                    stack.append((below, True))
    return Draft(chosen, order, sum([each.cost for each in order]) + unfree(request, order))


def unfree(request: Request, instances: Iterable[Instance]) -> int:
    """Return what instances cost because one nodelet that is free is there but once."""
    if not request.kept:
        return 0
    count: Dict[int, int] = {}
    for each in {each.key for each in instances}:
        if request.is_free(*each):
            count[base(each[0])] = count.get(base(each[0]), 0) + 1
    return sum([(many - 1) * request.library.costs[action] for action, many in count.items()])


class AndOrGraph:
    """Instances as actions and nodes, numbered from 0; the goal is node 0.

    Attributes:
        costs: of each action.
        needs: nodes that each action needs; what is there at no cost is left out.
        makes: nodes that each action supplies.
        users: actions that need each node.
        offers: actions that supply each node.
        size: its number of edges, the unit in which effort is counted.
        limit: microseconds after which no node may be supplied; None if that does not matter.
    """

    def __init__(self, request: Request, search: Search, goal: Need) -> None:
        """Take from a search what it found.

        Args:
            request: the problem.
            search: with everything that is worthwhile.
            goal: the node that is asked for.
        """
        self._request = request
        self._there = {
            node: instance
            for node, instance in search.chosen.items()
            if node != goal and self._is_there(instance, node)
        }
        # Equal problems have equal numbers here: by label and bindings.
        found = {each: None for offers in search.offers.values() for each in offers}
        order = sorted(
            found, key=lambda each: (request.label(each.action), each.theta, -each.action < 0)
        )
        self._actions = order
        nodes: Dict[Need, int] = {goal: 0}
        self.costs = [each.cost for each in order]
        self.needs = [
            list(
                dict.fromkeys(
                    [
                        nodes.setdefault(need, len(nodes))
                        for need in each.needs
                        if need not in self._there
                    ]
                )
            )
            for each in order
        ]
        self._nodes = list(nodes)
        self.offers: List[List[int]] = [[] for _ in nodes]
        self.makes: List[List[int]] = [[] for _ in order]
        self.users: List[List[int]] = [[] for _ in nodes]
        number_of = {each: number for number, each in enumerate(order)}
        self._number_of = {each.key: number for number, each in enumerate(order)}
        for node, number in nodes.items():
            for action in sorted([number_of[each] for each in search.offers.get(node, ())]):
                self.offers[number].append(action)
                self.makes[action].append(number)
        for action, needed in enumerate(self.needs):
            for at in needed:
                self.users[at].append(action)
        self.limit = request.limit
        self._latencies: Dict[Tuple[int, int], int] = {}  # of actions and nodes
        for action, made in enumerate(self.makes if self.limit is not None else ()):
            for at in made:
                latency = request.source(
                    order[action].action, order[action].theta, self._nodes[at]
                )
                self._latencies[action, at] = latency.latency
        self.size = len(order) + sum(map(len, self.needs)) + sum(map(len, self.makes))

    def _is_there(self, instance: Instance, node: Need) -> bool:
        if instance.cost or instance.needs:
            return False
        if self._request.limit is None:
            return True
        return not self._request.source(instance.action, instance.theta, node).latency

    def numbers(self, draft: Draft) -> List[int]:
        """Return the numbers here of a draft's instances; what is not worthwhile is left out."""
        number_of = self._number_of
        return [number_of[each.key] for each in draft.order if each.key in number_of]

    def cost(self, actions: Iterable[int]) -> int:
        """Sum up what actions cost."""
        if self._request.kept:
            actions = list(actions)
            more = unfree(self._request, [self._actions[each] for each in actions])
            return more + sum([self.costs[each] for each in actions])
        return sum([self.costs[each] for each in actions])

    def chosen(self, way: Dict[int, int]) -> Dict[Need, Instance]:
        """Write choices as those of the search."""
        found = dict(self._there)
        found.update((self._nodes[node], self._actions[action]) for node, action in way.items())
        return found

    def derive(self, actions: AbstractSet[int]) -> Dict[int, int]:
        """Supply what can be supplied with some actions alone.

        Returns:
            For each node that is reached its supplier, without a cycle; if there is a limit,
            the soonest one, and the nodes that are supplied in time.
        """
        if self.limit is not None:
            return self._soonest(actions)
        needs, makes, users = self.needs, self.makes, self.users
        missing = {action: len(needs[action]) for action in actions}
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
                    done = begun + self._latencies.get((action, made), 0)
                    if made not in way and self._is_in_time(done):
                        heapq.heappush(heap, (done, made, action))
            elif node not in way:
                way[node] = action
                for user in self.users[node]:
                    left = missing.get(user, 0)
                    if left:
                        missing[user] = left - 1
                        if left == 1:
                            heapq.heappush(heap, (begun, -1, user))
        return way

    def _is_in_time(self, done: int) -> bool:
        return self.limit is None or done <= self.limit

    def followed(self, way: Dict[int, int]) -> List[int]:
        """Return the actions that choices lead to from the goal."""
        found = {way[0]: None}
        waiting = [way[0]]
        for action in waiting:  # grows meanwhile
            for node in self.needs[action]:
                below = way[node]
                if below not in found:
                    found[below] = None
                    waiting.append(below)
        return waiting

    def pruned(self, actions: Iterable[int], order: Sequence[int], budget: Budget) -> List[int]:
        """Leave out actions that the goal is reached without, as far as the budget lasts."""
        kept = set(self.followed(self.derive(set(actions))))
        for action in order:
            if action not in kept or self._is_alone(action, kept):
                continue
            if budget.spend(4 * len(kept)):
                way = self.derive(kept - {action})
                if 0 in way:
                    kept = set(self.followed(way))
        return sorted(kept)

    def _is_alone(self, action: int, kept: Set[int]) -> bool:
        """Whether an action is the only one to supply a node that others need."""
        return any(
            len(kept.intersection(self.offers[node])) == 1
            and (not node or not kept.isdisjoint(self.users[node]))
            for node in self.makes[action]
        )

    def cheapest_tree(self, prices: Sequence[float]) -> Optional[Dict[int, int]]:
        """Choose the cheapest tree, by Knuth's algorithm, at other prices.

        If there is a limit, it is a tree that is in time, but there may be cheaper ones, and none
        may be found though there are some.
        """
        needs, makes, users, latencies = self.needs, self.makes, self.users, self._latencies
        missing = list(map(len, needs))
        total = list(prices)
        begun = [0] * len(needs)
        heap: List[Tuple[float, int]] = [
            (total[action], action) for action, left in enumerate(missing) if not left
        ]
        heapq.heapify(heap)
        way: Dict[int, int] = {}
        while heap:
            price, action = heapq.heappop(heap)
            for node in makes[action]:
                done = begun[action] + latencies.get((action, node), 0)
                if node not in way and self._is_in_time(done):
                    way[node] = action
                    if not node:
                        return way
                    for user in users[node]:
                        total[user] += price
                        begun[user] = max(begun[user], done)
                        left = missing[user] = missing[user] - 1
                        if not left:
                            heapq.heappush(heap, (total[user], user))
        return None
