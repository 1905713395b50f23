# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A lower bound for the cost of every plan: landmark cuts.

M. Helmert and C. Domshlak, "Landmarks, critical paths and abstractions: what's the difference
anyway?", ICAPS 2009. Every plan has an action of each cut that separates the goal from what is
there. A part of its cheapest action is paid, and all actions of the cut become cheaper by as much,
until the goal costs nothing. In the terms of linear programming, that is dual ascent.
"""

from __future__ import annotations

import heapq
from typing import List, Optional, Tuple

from dyknow.manager.planning.and_or_graph import AndOrGraph
from dyknow.manager.planning.budget import Budget

#: Parts in which the price of a cut is paid: several cuts share an action more evenly.
_PARTS = 4


def landmark_bound(graph: AndOrGraph, budget: Budget) -> Tuple[int, List[int]]:
    """Return a bound that no plan is below.

    Returns:
        The bound, and what is left of the cost of each action. A plan costs at least the bound
        and what is left of its actions' costs.
    """
    rest = list(graph.costs)
    bound = 0
    while budget.spend(2 * graph.size):
        dearest = _dearest(graph, rest)
        if dearest is None:
            break
        cut = _cut(graph, rest, dearest)
        least = -(-min([rest[action] for action in cut]) // _PARTS)
        bound += least
        for action in cut:
            rest[action] -= least
    return bound, rest


def _dearest(graph: AndOrGraph, rest: List[int]) -> Optional[List[int]]:
    """Return for each action the node that it needs and that costs most, -1 without needs.

    A node costs what the cheapest action costs that supplies it, an action its own cost and that
    of its dearest node. None if the goal costs nothing.
    """
    missing = list(map(len, graph.needs))
    dearest = [-1] * len(rest)
    heap = [(rest[action], action) for action, left in enumerate(missing) if not left]
    heapq.heapify(heap)
    known = [False] * len(graph.offers)
    while heap:
        price, action = heapq.heappop(heap)
        for node in graph.makes[action]:
            if known[node]:
                continue
            known[node] = True
            if not node and not price:
                return None
            for user in graph.users[node]:
                missing[user] -= 1
                if not missing[user]:  # nodes come in the order of their costs
                    dearest[user] = node
                    heapq.heappush(heap, (price + rest[user], user))
    return dearest


def _cut(graph: AndOrGraph, rest: List[int], dearest: List[int]) -> List[int]:
    """Return the actions that lead from what is there to where the goal costs no more."""
    zone = {0}  # nodes from which the goal costs nothing
    waiting = [0]
    border = set()
    while waiting:
        for action in graph.offers[waiting.pop()]:
            if rest[action]:
                border.add(action)
            elif dearest[action] not in zone:
                assert dearest[action] >= 0
                zone.add(dearest[action])
                waiting.append(dearest[action])
    # Of these actions only those count that are reached without the zone.
    by_node: List[List[int]] = [[] for _ in graph.offers]
    reached = []
    for action, node in enumerate(dearest):
        if node < 0:
            reached.append(action)
        else:
            by_node[node].append(action)
    outside = set()
    found = []
    for action in reached:  # grows meanwhile
        if action in border:
            found.append(action)
        for node in graph.makes[action]:
            if node not in zone and node not in outside:
                outside.add(node)
                reached += by_node[node]
    return found
