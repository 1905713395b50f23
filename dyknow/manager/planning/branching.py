# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Branch and bound: the cheapest plan of a small graph, if the budget lasts."""

from __future__ import annotations

from typing import FrozenSet, List, Optional, Sequence, Tuple

from dyknow.manager.planning.and_or_graph import AndOrGraph
from dyknow.manager.planning.budget import Budget

_Actions = FrozenSet[int]


def search(
    graph: AndOrGraph, bound: int, rest: Sequence[int], below: int, budget: Budget, left: int
) -> Tuple[List[int], bool]:
    """Search all plans that may cost less than a known one.

    A plan that has some actions and lacks others needs one more of those that supply a node
    which is still open: it has the first, or lacks the first and has the second, and so on.

    Args:
        graph: what may be part of a plan.
        bound: a bound for the cost of every plan.
        rest: what the actions of a plan cost at least besides.
        below: cost of the known plan.
        budget: what the search may take.
        left: steps that the search leaves over.

    Returns:
        The best plan that costs less, empty if none was found; and whether everything was tried.
    """
    best: List[int] = []
    stack: List[Tuple[_Actions, _Actions]] = [(frozenset(), frozenset())]
    while stack:
        has, lacks = stack.pop()
        if budget.steps < left or not budget.spend(4 * len(has) + 20):
            return best, False
        paid = graph.cost(has)
        if paid >= below or bound + sum([rest[action] for action in has]) >= below:
            continue
        choices = _choices(graph, has, lacks)
        if choices is None:
            best, below = sorted(has), paid
            continue
        if choices:
            budget.spend(2 * len(choices))
            if paid + min(graph.costs[action] for action in choices) >= below:
                continue
        branches = []
        for action in sorted(choices, key=lambda each: (rest[each], graph.costs[each], each)):
            branches.append((has | {action}, lacks))
            lacks = lacks | {action}
        stack += reversed(branches)
    return best, True


def _choices(graph: AndOrGraph, has: _Actions, lacks: _Actions) -> Optional[List[int]]:
    """Return actions of which every plan has one that has some and lacks others.

    None if the former are a plan.
    """
    fewest: Optional[List[int]] = None
    needed = {0}.union(*[graph.needs[action] for action in has])
    for node in sorted(needed):
        offers = graph.offers[node]
        if has.isdisjoint(offers):
            allowed = [action for action in offers if action not in lacks]
            if fewest is None or len(allowed) < len(fewest):
                fewest = allowed
    if fewest is not None:
        return fewest
    way = graph.derive(has)
    if 0 in way:
        return None
    # Some need each other in a circle: another supplier of what they need breaks it. Where some
    # are too late, another supplier of anything that they need may be sooner.
    circular = needed - way.keys() if graph.limit is None else needed
    return sorted(
        {
            action
            for node in circular
            for action in graph.offers[node]
            if action not in has and action not in lacks
        }
    )
