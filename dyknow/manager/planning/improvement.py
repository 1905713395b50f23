# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts shared parts once: from the cheapest tree to the cheapest plan, and a bound for it.

The problem is that of a Steiner arborescence with AND nodes, which is NP-hard; set cover is a case
of it. First every instance is left out that cannot be part of a cheaper plan, since no plan costs
less than the maximum over its inputs. On the others landmark cuts are a lower bound, a
branch-and-bound search is exact if it ends within its share of the budget, and if it does not, a
large neighbourhood search improves the plan: it takes some actions out of the plan and completes
it again by the cheapest tree, at prices that vary.

A solver for integer programs would do the same in fewer lines, but HiGHS in scipy holds the
interpreter's lock until it has ended, and the manager would stand still for as long.
"""

from __future__ import annotations

import random
import sys
from typing import Callable, Iterable, NamedTuple, Sequence

from dyknow.manager.planning.and_or_graph import AndOrGraph, Draft, drafted, is_sound
from dyknow.manager.planning.bounds import Bounds
from dyknow.manager.planning.request import Need, Request
from dyknow.manager.planning.search import Search

#: Steps that are taken in a second, on a slow machine.
STEPS = 10_000_000
#: Instances beyond which a plan is not improved.
_MOST_INSTANCES = 1_000
#: Steps that it takes to copy a part of the search into a graph of its own, and to bound a demand.
_COPIED = 50
_BOUNDED = 60
#: Part of the budget that the exact search may take.
_EXACT = 0.25
#: Parts in which the price of a cut is paid: several cuts share an action more evenly.
_PARTS = 4
#: Most actions that are taken out of a plan at once.
_MOST_OUT = 6
#: How often a dearer plan is gone on with.
_WORSE = 0.02
#: Steps of each search for a plan that is allowed.
_EACH_RISE = 5_000_000


class Budget:
    """Counts steps, so that equal problems have equal plans; the clock is the last resort."""

    def __init__(self, seconds: float, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._deadline = clock() + seconds
        self.steps = int(seconds * STEPS)
        #: Whether the clock ended it.
        self.is_cut_short = False

    def spend(self, steps: int) -> bool:
        """Take steps; return whether they were left."""
        self.steps -= steps
        if self.steps >= 0 and self._clock() >= self._deadline:
            self.is_cut_short = True
            self.steps = -1
        return self.steps >= 0


class Improved(NamedTuple):
    """The best draft, a cost that no plan is below, and whether the clock ended the search."""

    draft: Draft
    least_cost: int
    is_cut_short: bool = False


class Allowed(NamedTuple):
    """A draft that is sound and in time if there is one, else the soonest one that was found."""

    draft: Draft
    is_found: bool
    is_proven: bool = True


def allowed(request: Request, bounds: Bounds, draft: Draft) -> Allowed:
    """Return a rather cheap draft that is sound and in time, instead of the cheapest tree.

    A fixed number of steps limits the search, not the clock, which must not decide whether there
    is a plan.
    """
    least, _ = bounds.least(False)
    cost = draft.cost
    for below in (cost + 1, 2 * cost + 1, 4 * cost + 1, 8 * cost + sys.maxsize + bounds.most):
        found = Search(request, bounds, least, below)
        found.run(_EACH_RISE)
        is_proven = found.is_complete
        graph = AndOrGraph(request, found)
        way = graph.derive(graph.followed(graph.cheapest(graph.costs)[0]))
        if 0 not in way and any(graph.twins):
            improvement = _Improvement(graph, False, Budget(_EACH_RISE / STEPS, lambda: 0.0))
            no_rest = [0] * len(graph.costs)
            plan, is_exact = improvement.branched(0, no_rest, sum(graph.costs) + 1, 0)
            is_proven = is_proven and is_exact
            way = graph.derive(plan)
        if 0 in way:
            return Allowed(graph.drafted(way), True)
    if request.limit is not None:
        every = range(len(graph.costs))
        for limit in (request.limit, sys.maxsize):
            graph.limit = limit
            way = graph.derive(every)
            if 0 in way:
                return Allowed(graph.drafted(way), limit == request.limit, is_proven)
    return Allowed(draft, False, is_proven)


def improve(request: Request, bounds: Bounds, draft: Draft, budget: Budget) -> Improved:
    """Return a draft of less cost, or the given one."""
    if not draft.cost or not budget.spend(_BOUNDED * bounds.size):
        return Improved(draft, 0)
    goal = Need(request.goal, ())
    least, _ = bounds.least(False, draft.cost)
    floor = least.get(request.goal, draft.cost)
    if draft.cost <= floor or len(draft.order) > _MOST_INSTANCES:
        return Improved(draft, min(floor, draft.cost))
    found = Search(request, bounds, least, draft.cost)
    budget.steps -= budget.steps // 2 - found.run(budget.steps // 2)
    if goal in found.value:
        floor = max(floor, found.value[goal])
    else:
        floor = draft.cost if found.is_complete else max(floor, found.reached)
    floor = min(floor, draft.cost)
    edges = sum(map(len, found.offers.values()))
    if floor < draft.cost and goal in found.value and budget.spend(_COPIED * edges):
        if request.limit is None:
            cheap = drafted(request, found.chosen)
            draft = min(draft, cheap, key=lambda each: (not is_sound(request, each), each.cost))
        if floor < draft.cost:
            graph = AndOrGraph(request, found)
            return _Improvement(graph, found.is_complete, budget).run(draft, floor)
    return Improved(draft, floor, budget.is_cut_short)


class _Improvement:
    def __init__(self, graph: AndOrGraph, is_complete: bool, budget: Budget) -> None:
        self._graph = graph
        self._is_complete = is_complete
        self._budget = budget
        self._chance = random.Random(0)  # equal problems have equal plans

    def run(self, draft: Draft, floor: int) -> Improved:
        """Improve a draft that costs more than a bound."""
        graph, budget = self._graph, self._budget
        cuts, rest = self._cuts()
        # Parts that a large search left out could be cheaper than these cuts.
        bound = min(draft.cost, max(cuts, floor) if self._is_complete else floor)
        best = self._first(draft)
        least = min(draft.cost, graph.cost(best)) if best else draft.cost
        if bound < least:
            left = int(budget.steps * (1 - _EXACT))
            found, is_exact = self.branched(cuts, rest, least, left)
            best = found or best
            if is_exact and self._is_complete:
                bound = graph.cost(found) if found else least
            elif best:
                best = self._varied(best, bound)
        if best and graph.cost(best) < draft.cost:
            draft = graph.drafted(graph.derive(best))
        return Improved(draft, bound, budget.is_cut_short)

    def _first(self, draft: Draft) -> list[int]:
        """Return a plan to begin with; none if all that is cheaper is too late or unsound."""
        graph = self._graph
        # Some of the draft may be without use for a cheaper plan, and so not be there.
        for actions in (
            graph.numbers(draft),
            graph.followed(graph.cheapest(graph.costs)[0]),
            range(len(graph.costs)),
        ):
            best = graph.followed(graph.derive(actions))
            if best:
                order = sorted(best, key=lambda each: (-graph.costs[each], each))
                return self._pruned(best, order)
        return []

    def _pruned(self, actions: Iterable[int], order: Sequence[int]) -> list[int]:
        """Leave out actions that the goal is reached without, as far as the budget lasts."""
        graph = self._graph
        kept = set(graph.followed(graph.derive(actions)))
        for action in order:
            if action in kept and not self._is_alone(action, kept):
                if not self._budget.spend(4 * len(kept)):
                    break
                kept = set(graph.followed(graph.derive(kept - {action}))) or kept
        return sorted(kept)

    def _is_alone(self, action: int, kept: set[int]) -> bool:
        """Whether an action is the only one to supply a node that other actions need."""
        graph = self._graph
        return any(
            len(kept.intersection(graph.offers[node])) == 1
            and (not node or not kept.isdisjoint(graph.users[node]))
            for node in graph.makes[action]
        )

    # Landmark cuts

    def _cuts(self) -> tuple[int, list[int]]:
        """Return a bound that no plan is below, and the remaining cost of each action.

        M. Helmert and C. Domshlak, "Landmarks, critical paths and abstractions: what's the
        difference anyway?", ICAPS 2009. Every plan has an action of each cut that separates the
        goal from the existing parts. A part of its cheapest action is paid, and all actions of the
        cut become cheaper by as much, until the goal costs nothing: in the terms of linear
        programming, dual ascent. A plan costs at least the bound and the remaining costs.
        """
        rest = list(self._graph.costs)
        bound = 0
        while self._budget.spend(2 * self._graph.size):
            cut = self._cut(rest)
            if not cut:
                break
            least = -(-min([rest[action] for action in cut]) // _PARTS)
            bound += least
            for action in cut:
                rest[action] -= least
        return bound, rest

    def _cut(self, rest: list[int]) -> list[int]:
        """Return the actions that lead from the existing parts to where the goal costs no more."""
        graph = self._graph
        _, dearest, price = graph.cheapest(rest, use_sum=False)
        if not price:
            return []
        zone, waiting = {0}, [0]  # nodes from which the goal costs nothing
        border = set()
        for node in waiting:  # grows meanwhile
            for action in graph.offers[node]:
                if rest[action]:
                    border.add(action)
                elif dearest[action] not in zone:
                    zone.add(dearest[action])
                    waiting.append(dearest[action])
        # Of these actions only those count that are reached without the zone.
        by_node: list[list[int]] = [[] for _ in graph.offers]
        for action, node in enumerate(dearest):
            if node >= 0:
                by_node[node].append(action)
        reached = [action for action, node in enumerate(dearest) if node < 0]
        outside = set()
        for action in reached:  # grows meanwhile
            for node in graph.makes[action]:
                if node not in zone and node not in outside:
                    outside.add(node)
                    reached += by_node[node]
        return [action for action in reached if action in border]

    # Branch and bound

    def branched(
        self, bound: int, rest: Sequence[int], below: int, left: int
    ) -> tuple[list[int], bool]:
        """Search all plans that may cost less than a known one.

        A plan that has some actions, but not others, needs one more of those that supply a node
        which is still open: it has the first, or lacks the first and has the second, and so on.

        Args:
            bound: a bound for the cost of every plan.
            rest: least costs of the actions of a plan besides.
            below: cost of the known plan.
            left: steps that the search leaves over.

        Returns:
            The best plan that costs less, empty if none was found; and whether everything was
            tried.
        """
        graph, budget = self._graph, self._budget
        costs = graph.costs
        best: list[int] = []
        stack: list[tuple[frozenset[int], frozenset[int]]] = [(frozenset(), frozenset())]
        while stack:
            has, lacks = stack.pop()
            if budget.steps < left or not budget.spend(4 * len(has) + 20):
                return best, False
            paid = graph.cost(has)
            if paid >= below or bound + sum([rest[action] for action in has]) >= below:
                continue
            choices = self._choices(has, lacks)
            if choices is None:
                best, below = sorted(has), paid
                continue
            budget.spend(2 * len(choices))
            branches = []
            if choices and paid + min([costs[action] for action in choices]) < below:
                for action in sorted(choices, key=lambda each: (rest[each], costs[each], each)):
                    branches.append((has | {action}, lacks.union(graph.twins[action])))
                    lacks = lacks | {action}
            stack += reversed(branches)
        return best, True

    def _choices(self, has: frozenset[int], lacks: frozenset[int]) -> list[int] | None:
        """Return a set of actions, one of which is in every plan with `has` but without `lacks`.

        None if `has` is a plan.
        """
        graph = self._graph
        needed = {0}.union(*[graph.needs[action] for action in has])
        open_nodes = [node for node in sorted(needed) if has.isdisjoint(graph.offers[node])]
        if open_nodes:
            allowed = [[e for e in graph.offers[node] if e not in lacks] for node in open_nodes]
            return min(allowed, key=len)
        way = graph.derive(has)
        if 0 in way:
            return None
        # Some need each other in a circle: another supplier of their needs breaks it. Where
        # some are too late, another supplier of anything that they need may be sooner.
        circular = needed - way.keys() if graph.limit is None else needed
        others = {action for node in circular for action in graph.offers[node]}
        return sorted(others - has - lacks)

    # Large neighbourhoods

    def _varied(self, best: list[int], bound: int) -> list[int]:
        """Search the neighbourhoods of plans, as long as the budget lasts."""
        graph, budget, chance = self._graph, self._budget, self._chance
        costs = graph.costs
        least = graph.cost(best)
        present, price = best, least
        while least > bound and budget.spend(6 * graph.size):
            out = set(chance.sample(present, chance.randint(1, min(_MOST_OUT, len(present)))))
            kept = [action for action in present if action not in out]
            derived = graph.derive(kept)
            prices: list[float] = [
                cost
                * (1 + chance.random())
                / max(1, sum([node not in derived for node in graph.makes[action]]))
                for action, cost in enumerate(costs)
            ]
            for action in kept:
                prices[action] = 0
            found = {*kept, *graph.followed(graph.cheapest(prices)[0])}
            order = sorted(found, key=lambda each: (-costs[each] * chance.random(), each))
            plan = self._pruned(found, order)
            if not plan:
                continue
            cost = graph.cost(plan)
            if cost <= price or chance.random() < _WORSE:
                present, price = plan, cost
                if cost < least:
                    best, least = plan, cost
        return best
