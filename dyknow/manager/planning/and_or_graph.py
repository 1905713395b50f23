# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A small AND/OR graph: the instances that a cheaper plan than the one at hand can have."""

from __future__ import annotations

import heapq
from typing import Collection, Iterable, NamedTuple, Sequence

from dyknow.manager.planning.library import Operator
from dyknow.manager.planning.patterns import Theta
from dyknow.manager.planning.request import Need, Request
from dyknow.manager.planning.search import Instance, Search


class Draft(NamedTuple):
    """A way to the goal: the supplier of each node, the instances, suppliers first, their cost."""

    chosen: dict[Need, Instance]
    order: list[Instance]
    cost: int


def drafted(request: Request, chosen: dict[Need, Instance]) -> Draft:
    """Follow choices, which have no cycle, from the goal."""
    order: list[Instance] = []
    stack = [(chosen[Need(request.goal, ())], True)]
    entered = set()
    while stack:
        instance, is_new = stack.pop()
        if not is_new:
            order.append(instance)
        elif instance not in entered:
            entered.add(instance)
            stack.append((instance, False))
            stack += [(chosen[need], True) for need in reversed(instance.needs)]
    return Draft(chosen, order, _cost(request, order))


def is_sound(request: Request, draft: Draft) -> bool:
    """Whether no nodelet is both an instance with fast inputs and one with others."""
    nodelets = [_nodelet(request, each) for each in draft.order if request.demand.min_rate]
    return len({*nodelets}) == len(nodelets)


def _nodelet(request: Request, instance: Instance) -> tuple[Operator, Theta]:
    """Return what is equal for instances that are one nodelet.

    Private variables distinguish nodelets, but are bound only where a plan is written.
    """
    is_base = request.is_strict or not instance.action.has_private
    return instance.action.base if is_base else instance.action, instance.theta


def _cost(request: Request, instances: Iterable[Instance]) -> int:
    """Sum up the costs of instances, of which only one can use the free nodelet of an action."""
    total = sum([each.cost for each in instances])
    if request.kept:
        free = [each.action.base for each in instances if request.is_free(*each.key)]
        total += sum([each.cost for each in free]) - sum([each.cost for each in {*free}])
    return total


class AndOrGraph:
    """Instances as actions and nodes, numbered from 0; the goal is node 0.

    Attributes:
        costs: of each action.
        needs: nodes that each action needs; nodes without cost are left out.
        makes: nodes that each action supplies.
        users: actions that need each node.
        offers: actions that supply each node.
        twins: for each action, those that are the same nodelet, of which a plan has one.
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
        order = sorted(found, key=lambda e: (e.action.label, e.theta, e.action is e.action.base))
        self._instances = order
        self._numbers = {each.key: number for number, each in enumerate(order)}
        needed = [need for each in order for need in each.needs if need not in self._there]
        self._nodes = list(dict.fromkeys([goal, *needed]))
        numbers = {node: number for number, node in enumerate(self._nodes)}
        self.costs = [each.cost for each in order]
        self.needs = [
            list(dict.fromkeys([numbers[need] for need in each.needs if need in numbers]))
            for each in order
        ]
        self.offers = [
            sorted([self._numbers[each.key] for each in search.offers.get(node, ())])
            for node in self._nodes
        ]
        self.makes = _turned(self.offers, len(order))
        self.users = _turned(self.needs, len(self._nodes))
        by_nodelet: dict[tuple[Operator, Theta], list[int]] = {}
        for number, each in enumerate(order):
            by_nodelet.setdefault(_nodelet(request, each), []).append(number)
        self.twins = [
            [twin for twin in by_nodelet[_nodelet(request, each)] if twin != number]
            for number, each in enumerate(order)
        ]
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

    def numbers(self, draft: Draft) -> list[int]:
        """Return the numbers here of a draft's instances; useless ones are left out."""
        return [self._numbers[each.key] for each in draft.order if each.key in self._numbers]

    def cost(self, actions: Collection[int]) -> int:
        return _cost(self._request, [self._instances[each] for each in actions])

    def drafted(self, way: dict[int, int]) -> Draft:
        """Return the draft that chooses suppliers so."""
        chosen = dict(self._there)
        chosen.update((self._nodes[node], self._instances[each]) for node, each in way.items())
        return drafted(self._request, chosen)

    def _is_late(self, done: int) -> bool:
        return self.limit is not None and done > self.limit

    def derive(self, actions: Iterable[int]) -> dict[int, int]:
        """Supply all nodes that some actions alone can supply in time.

        Of twins the one with fast inputs is taken, which supplies all that the other one does.

        Returns:
            For each node that is reached its soonest supplier, without a cycle.
        """
        missing = {action: len(self.needs[action]) for action in actions}
        for action in [each for each in missing if self.twins[each]]:
            if self._instances[action].action.slow is not None:
                missing.pop(self.twins[action][0], None)
        if self.limit is not None:
            return self._soonest(missing)
        way: dict[int, int] = {}
        waiting = sorted([action for action, left in missing.items() if not left])
        for action in waiting:  # grows meanwhile
            for node in self.makes[action]:
                if node not in way:
                    way[node] = action
                    waiting += self._met(node, missing)
        return way

    def _soonest(self, missing: dict[int, int]) -> dict[int, int]:
        way: dict[int, int] = {}
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
                for user in self._met(node, missing):
                    heapq.heappush(heap, (begun, -1, user))
        return way

    def _met(self, node: int, missing: dict[int, int]) -> list[int]:
        """Supply a node; return the users that miss nothing any more."""
        found = []
        for user in self.users[node]:
            left = missing.get(user, 0)
            if left:
                missing[user] = left - 1
                if left == 1:
                    found.append(user)
        return found

    def cheapest(
        self, prices: Sequence[float], use_sum: bool = True
    ) -> tuple[dict[int, int], list[int], float | None]:
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
        way: dict[int, int] = {}
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

    def followed(self, way: dict[int, int]) -> list[int]:
        """Return the actions that choices lead to from the goal; none if it is not reached."""
        waiting = [way[0]] if 0 in way else []
        found = {*waiting}
        for action in waiting:  # grows meanwhile
            for node in self.needs[action]:
                if way[node] not in found:
                    found.add(way[node])
                    waiting.append(way[node])
        return waiting


def _turned(edges: list[list[int]], count: int) -> list[list[int]]:
    """Turn edges round, to so many ends."""
    found: list[list[int]] = [[] for _ in range(count)]
    for begin, ends in enumerate(edges):
        for end in ends:
            found[end].append(begin)
    return found
