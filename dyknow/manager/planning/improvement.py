# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts shared parts once: from the cheapest tree to the cheapest plan, and a bound for it.

The problem is that of a Steiner arborescence with AND nodes, which is NP-hard; set cover is a case
of it. First every instance is left out that cannot be part of a cheaper plan, since no plan costs
less than the maximum over its inputs. On the others landmark cuts are a lower bound
(``landmarks``), a branch-and-bound search is exact if it ends within its share of the budget
(``branching``), and if it does not, a large neighbourhood search improves the plan: it takes some
actions out of the plan and completes it again by the cheapest tree, at prices that vary.

A solver for integer programs would do the same in fewer lines, but HiGHS in scipy holds the
interpreter's lock until it has ended, and the manager would stand still for as long.
"""

from __future__ import annotations

import random
import sys
from typing import List, NamedTuple, Tuple

from dyknow.manager.planning.and_or_graph import AndOrGraph, Draft, drafted
from dyknow.manager.planning.bounds import Bounds
from dyknow.manager.planning.branching import search
from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.landmarks import landmark_bound
from dyknow.manager.planning.request import Need, Request
from dyknow.manager.planning.search import Search

#: Instances beyond which a plan is not improved.
_MOST_INSTANCES = 1_000
#: Steps that it takes to copy a part of the search into a graph of its own, and to bound a demand.
_COPIED = 50
_BOUNDED = 60
#: Part of the budget that the exact search may take.
_EXACT = 0.25
#: Most actions that are taken out of a plan at once.
_MOST_OUT = 6
#: How often a dearer plan is gone on with.
_WORSE = 0.02
#: Steps of each search for a plan that is in time.
_EACH_RISE = 5_000_000


class Improved(NamedTuple):
    """A draft, and what is known about its cost.

    Attributes:
        draft: the best one.
        least_cost: no plan costs less.
        is_cut_short: whether the clock ended the improvement, not the count of its steps.
    """

    draft: Draft
    least_cost: int
    is_cut_short: bool


def soonest(request: Request, bounds: Bounds, draft: Draft) -> Tuple[Draft, bool]:
    """Return a rather cheap draft that is in time, or the soonest one; and whether it is in time.

    It is not all that is searched if that would take more than a fixed number of steps; the clock
    has no say, since it must not decide whether there is a plan.

    Args:
        request: the problem.
        bounds: what the goal can reach.
        draft: the cheapest tree, which is too late.
    """
    least, _ = bounds.least(False)
    goal = Need(request.goal, ())
    cost = draft.cost
    for below in (cost + 1, 2 * cost + 1, 4 * cost + 1, 8 * cost + sys.maxsize + bounds.most):
        found = Search(request, bounds, least, False, below)
        found.run(_EACH_RISE)
        graph = AndOrGraph(request, found, goal)
        way = graph.cheapest_tree(graph.costs)
        if way is not None:
            break
    every = set(range(len(graph.costs)))
    way = way or graph.derive(every)
    is_in_time = 0 in way
    if not is_in_time:
        graph.limit = sys.maxsize
        way = graph.derive(every)
    if 0 not in way:  # not everything was searched
        return draft, False
    return drafted(request, graph.chosen(way), goal), is_in_time


def improve(request: Request, bounds: Bounds, draft: Draft, budget: Budget) -> Improved:
    """Return a draft of less cost, or the given one.

    Args:
        request: the problem.
        bounds: what the goal can reach.
        draft: the cheapest tree, or one that is in time.
        budget: what the improvement may take.
    """
    if not draft.cost:
        return Improved(draft, 0, False)
    if not budget.spend(_BOUNDED * len(bounds)):
        return Improved(draft, 0, False)
    goal = Need(request.goal, ())
    least, _ = bounds.least(False, draft.cost)
    floor = least.get(request.goal, draft.cost)
    if draft.cost <= floor:
        return Improved(draft, draft.cost, False)
    if len(draft.order) > _MOST_INSTANCES:
        return Improved(draft, floor, False)
    found = Search(request, bounds, least, False, draft.cost)
    budget.steps -= budget.steps // 2 - found.run(budget.steps // 2)
    if goal in found.value:
        floor = min(draft.cost, max(floor, found.value[goal]))
    elif found.is_complete:
        return Improved(draft, draft.cost, False)
    else:
        floor = min(draft.cost, max(floor, found.reached))
    edges = sum(map(len, found.offers.values()))
    if goal not in found.value or not budget.spend(_COPIED * edges):
        return Improved(draft, floor, budget.is_cut_short)
    if request.limit is None:
        other = drafted(request, found.chosen, goal)
        draft = other if other.cost < draft.cost else draft
    if draft.cost <= floor:
        return Improved(draft, draft.cost, budget.is_cut_short)
    graph = AndOrGraph(request, found, goal)
    return _Improvement(request, graph, found.is_complete, budget).run(draft, floor)


class _Improvement:
    def __init__(
        self, request: Request, graph: AndOrGraph, is_complete: bool, budget: Budget
    ) -> None:
        self._request = request
        self._graph = graph
        self._is_complete = is_complete
        self._budget = budget
        self._chance = random.Random(0)  # equal problems have equal plans

    def run(self, draft: Draft, floor: int) -> Improved:
        """Improve a draft that costs more than a bound."""
        graph, budget = self._graph, self._budget
        cuts, rest = landmark_bound(graph, budget)
        # What was left out because the search was too large could be cheaper than these cuts.
        bound = min(draft.cost, max(cuts, floor) if self._is_complete else floor)
        best = sorted(graph.numbers(draft))
        if 0 not in graph.derive(set(best)):  # some of it cannot be part of a cheaper plan
            every = set(range(len(graph.costs)))
            way = graph.cheapest_tree(graph.costs) or graph.derive(every)
            if 0 not in way:  # what is cheaper is too late
                bound = draft.cost if self._is_complete else bound
                return Improved(draft, bound, budget.is_cut_short)
            best = sorted(graph.followed(way))
        best = graph.pruned(best, sorted(best, key=lambda each: -graph.costs[each]), budget)
        least = min(draft.cost, graph.cost(best))
        if bound < least:
            left = int(budget.steps * (1 - _EXACT))
            found, is_exact = search(graph, cuts, rest, least, budget, left)
            best = found or best
            if is_exact and self._is_complete:
                bound = min(least, graph.cost(best))
            else:
                best = self._varied(best, bound)
        if graph.cost(best) < draft.cost:
            chosen = graph.chosen(graph.derive(set(best)))
            draft = drafted(self._request, chosen, Need(self._request.goal, ()))
        return Improved(draft, bound, budget.is_cut_short)

    def _varied(self, best: List[int], bound: int) -> List[int]:
        """Search the neighbourhoods of plans, as long as the budget lasts."""
        graph, budget, chance = self._graph, self._budget, self._chance
        costs = graph.costs
        least = graph.cost(best)
        present, price = best, least
        while least > bound and budget.spend(6 * graph.size):
            out = set(chance.sample(present, chance.randint(1, min(_MOST_OUT, len(present)))))
            kept = [action for action in present if action not in out]
            derived = graph.derive(set(kept))
            prices = [
                costs[action]
                * (1 + chance.random())
                / max(1, sum([node not in derived for node in graph.makes[action]]))
                for action in range(len(costs))
            ]
            for action in kept:
                prices[action] = 0
            way = graph.cheapest_tree(prices)
            if way is None:
                continue
            found = {*kept, *graph.followed(way)}
            order = sorted(found, key=lambda each: (-costs[each] * chance.random(), each))
            plan = graph.pruned(found, order, budget)
            cost = graph.cost(plan)
            if cost <= price:
                present, price = plan, cost
                if cost < least:
                    best, least = plan, cost
            elif chance.random() < _WORSE:
                present, price = plan, cost
        return best
