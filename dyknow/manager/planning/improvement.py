# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts shared parts once: from the cheapest tree to the cheapest plan, and a bound for it.

The problem is that of a Steiner arborescence with AND nodes, which is NP-hard; set cover is a case
of it. First every instance is left out that cannot be part of a cheaper plan, since no plan costs
less than the maximum over its inputs. On the rest landmark cuts are a lower bound, and a
branch-and-bound search is exact if it ends within the budget. It first tries the plans that differ
little from the best-looking choice at each step (W. D. Harvey and M. L. Ginsberg, "Limited
discrepancy search", IJCAI 1995), so it has found a good one if it does not end.

A solver for integer programs would do the same in fewer lines, but HiGHS in scipy holds the
interpreter's lock until it has ended, and the manager would stand still for as long.
"""

from __future__ import annotations

import sys
from bisect import bisect_left
from functools import reduce
from itertools import accumulate
from operator import or_
from typing import Callable, Iterable, NamedTuple, Sequence

from dyknow.manager.planning.and_or_graph import AndOrGraph, Draft, Instance, Node, Reach
from dyknow.manager.planning.request import NEVER
from dyknow.manager.planning.search import Search

#: Steps that are taken in a second, on a slow machine.
STEPS = 10_000_000
#: Instances beyond which a plan is not improved.
_MOST_INSTANCES = 1_000
#: Steps that it takes to copy a part of the search into a graph of its own, and to bound a demand.
_COPIED = 50
BOUNDED = 60
#: Parts in which the price of a cut is paid: several cuts share an action more evenly.
_PARTS = 4
#: Parts of a unit of cost in the prices of the first plan.
_FINE = 1_000
#: Steps that a branch of the exact search takes, and each set of actions or choice in it.
_BRANCH, _CHOICE = 35, 8
#: Steps of each search for a plan that is allowed.
_EACH_RISE = 5_000_000


class Budget:
    """Counts steps, so that equal problems have equal plans; the clock is the last resort."""

    def __init__(self, seconds: float, clock: Callable[[], float], spent: int = 0) -> None:
        """Begin with the steps of so many seconds, without those that were spent."""
        self._clock = clock
        self._seconds = seconds
        self._deadline: float | None = None
        self.steps = int(seconds * STEPS) - spent  # those that are left
        #: Whether the clock, which begins with the first step of the improvement, ended it.
        self.is_cut_short = False

    def spend(self, steps: int) -> bool:
        """Take steps; return whether they were left."""
        self.steps -= steps
        if self._deadline is None:
            self._deadline = self._clock() + self._seconds
        elif self.steps >= 0 and self._clock() >= self._deadline:
            self.is_cut_short = True
            self.steps = -1
        return self.steps >= 0


def allowed(reach: Reach, draft: Draft) -> tuple[Draft, bool, bool]:
    """Look for a draft that is sound and in time, instead of the cheapest tree.

    A fixed number of steps limits the search, not the clock, which must not decide whether there
    is a plan.

    Returns:
        The draft, or the soonest one that was found; whether it is sound and in time; and whether
        everything was tried.
    """
    request = reach.request
    cost, most = sum([draft.graph.costs[each] for each in draft.order]), sum(reach.costs)
    for below in (cost + 1, 2 * cost + 1, 4 * cost + 1, 8 * cost + sys.maxsize + most):
        found = Search(reach, below)
        found.run(_EACH_RISE)
        graph, is_proven = found.graph, found.is_complete
        every = range(len(graph.costs))
        way = graph.derive(every)
        is_sound = 0 in way and graph.drafted(way).is_sound
        if not is_sound and (request.demand.min_rate or request.scarce):
            solver = _Solver(graph, Budget(_EACH_RISE / STEPS, lambda: 0.0))
            plan, is_exact = solver.solve(0, [0 for _ in every], NEVER)
            is_proven = is_proven and is_exact
            way = solver.derive(plan)
            is_sound = 0 in way and graph.drafted(way).is_sound
        if is_sound:
            return graph.drafted(way), True, True
    way = graph.derive(every, is_late=True)
    if request.limit is not None and 0 in way:
        draft = graph.drafted(way)
    return draft, False, is_proven


def improve(reach: Reach, draft: Draft, budget: Budget) -> tuple[Draft, int]:
    """Return a draft of less cost, or the given one, and a cost that no plan is below."""
    floor = min(max(reach.forced, reach.floors.get(0, draft.cost)), draft.cost)
    if draft.cost == floor or len(draft.order) > _MOST_INSTANCES:
        return draft, floor
    if not budget.spend(BOUNDED * reach.size):
        return draft, floor
    found = Search(reach, draft.cost)
    budget.steps -= budget.steps // 2 - found.run(budget.steps // 2)
    #: No plan with parts that were not found costs less.
    bound = draft.cost if found.is_complete else min(found.reached, draft.cost)
    if 0 in found.value and budget.spend(_COPIED * sum(map(len, found.graph.makes))):
        draft, known = _Solver(found.graph, budget).improved(draft)
        bound = min(bound, known)
    elif 0 in found.value:
        bound = min(bound, found.value[0])
    return draft, max(floor, bound)


class _Solver:
    """Searches a graph for the cheapest plan."""

    def __init__(self, graph: AndOrGraph, budget: Budget) -> None:
        self._graph = graph
        self._budget = budget
        self._costs = graph.costs
        makers: list[list[Instance]] = [[] for _ in graph.patterns]
        #: Nodes that are made at no cost and at once, with their makers.
        self._given: dict[Node, Instance] = {}
        for instance, nodes in enumerate(graph.makes):
            is_free = not graph.costs[instance] and not graph.needs[instance]
            for node in nodes:
                makers[node].append(instance)
                if is_free and (
                    graph.request.limit is None or not graph.head(instance, node).latency
                ):
                    self._given.setdefault(node, instance)
        self._makers = makers
        #: Sets of numbers are bits.
        self._given_set = _set(self._given)
        self._makers_of = [_set(each) for each in makers]
        self._makes = [_set(each) for each in graph.makes]
        self._needs = [_set(each) & ~self._given_set for each in graph.needs]
        #: The instances of one nodelet, of which a plan has one.
        self._twins: dict[Instance, int] = {}
        if graph.request.demand.min_rate:
            nodelets: dict[object, int] = {}
            for each in range(len(graph.costs)):
                nodelet = graph.nodelet(each)
                nodelets[nodelet] = nodelets.get(nodelet, 0) | 1 << each
            self._twins = {each: nodelets[graph.nodelet(each)] for each in range(len(graph.costs))}
        self._size = sum(map(len, graph.needs)) + sum(map(len, graph.makes)) + len(graph.costs)

    def improved(self, draft: Draft) -> tuple[Draft, int]:
        """Improve a draft that may be of another graph; return it with a bound for its cost."""
        graph = self._graph
        bound, rest = self._cuts()
        best = self._first()
        below = min(draft.cost, graph.cost(best)) if best else draft.cost
        found, is_exact = self.solve(bound, rest, below)
        if found or below < draft.cost:
            draft = graph.drafted(self.derive(found or best))
        return draft, draft.cost if is_exact else min(bound, draft.cost)

    def _first(self) -> list[Instance]:
        """Return a tree of actions that are cheap for all that they make; none if it is late."""
        graph = self._graph
        made = [max(1, len(nodes)) for nodes in graph.makes]
        prices = [_FINE * cost // count for cost, count in zip(self._costs, made)]
        _, way, _ = graph.cheapest(prices, use_sum=True)
        actions = graph.drafted(way).order if 0 in way else []
        return self._pruned(actions) if 0 in self.derive(actions) else []

    def _pruned(self, actions: list[Instance]) -> list[Instance]:
        """Leave out actions that the goal is reached without, the dearest first."""
        for action in sorted(actions, key=lambda each: (-self._costs[each], each)):
            fewer = [each for each in actions if each != action]
            if self._budget.spend(_CHOICE * len(actions)) and 0 in self.derive(fewer):
                actions = fewer
        return actions

    def derive(self, actions: Iterable[Instance]) -> dict[Node, Instance]:
        """Make all nodes that actions can make, with the free ones."""
        actions = [*actions]
        needed = {0}.union(*[self._graph.needs[each] for each in actions])
        given = [self._given[node] for node in needed if node in self._given]
        return self._graph.derive({*actions, *given})

    # Landmark cuts

    def _cuts(self) -> tuple[int, list[int]]:
        """Return a bound that no plan is below, and the remaining price of each action.

        M. Helmert and C. Domshlak, "Landmarks, critical paths and abstractions: what's the
        difference anyway?", ICAPS 2009. Every plan has an action of each cut that separates the
        goal from the existing parts. A part of its cheapest action is paid, and all actions of the
        cut become cheaper by as much, until the goal costs nothing: in the terms of linear
        programming, dual ascent. A plan costs at least the bound and the remaining prices.
        """
        rest = list(self._costs)
        bound = 0
        while self._budget.spend(2 * self._size):
            cut = self._cut(rest)
            if not cut:
                break
            least = -(-min([rest[action] for action in cut]) // _PARTS)
            bound += least
            for action in cut:
                rest[action] -= least
        return bound, rest

    def _cut(self, rest: list[int]) -> list[Instance]:
        """Return the actions that lead from the existing parts to where the goal costs no more."""
        value, _, dearest = self._graph.cheapest(rest, use_sum=False)
        if not value.get(0):
            return []
        zone, waiting = {0}, [0]  # nodes from which the goal costs nothing
        border = set()
        for node in waiting:  # grows meanwhile
            for action in self._makers[node]:
                if rest[action]:
                    border.add(action)
                elif dearest[action] not in zone:
                    zone.add(dearest[action])
                    waiting.append(dearest[action])
        # Of these actions only those count that are reached without the zone.
        by_node: list[list[Instance]] = [[] for _ in self._makers]
        for action, node in enumerate(dearest):
            if node >= 0:
                by_node[node].append(action)
        reached = [action for action, node in enumerate(dearest) if node < 0]
        outside = set()
        for action in reached:  # grows meanwhile
            for node in self._graph.makes[action]:
                if node not in zone and node not in outside:
                    outside.add(node)
                    reached += by_node[node]
        return [action for action in reached if action in border]

    # Branch and bound

    def solve(self, bound: int, rest: Sequence[int], below: int) -> tuple[list[Instance], bool]:
        """Search all plans that may cost less than a known one.

        A plan that has some actions, but not others, needs one more of those that supply a node
        which is still open: it has the first, or lacks the first and has the second, and so on.
        The second is one discrepancy from the seemingly best, the third is two, and in each round
        plans may have twice as many of these.

        Every plan costs the bound at least, and besides the ``rest`` of its actions; the known one
        costs ``below``.

        Returns:
            The best plan that costs less, empty if none was found; and whether everything was
            tried.
        """
        graph, costs = self._graph, self._costs
        by_rest = sorted(range(len(costs)), key=rest.__getitem__)
        rests = [rest[each] for each in by_rest]
        #: Sets of the actions whose remaining costs are the least.
        least = list(accumulate([1 << each for each in by_rest], or_, initial=0))
        best: list[Instance] = []
        discrepancies, is_cut = 1, True
        stack: list[_Branch] = []
        while stack or is_cut:
            if not stack:
                stack.append(_Branch(discrepancies, 0, 0, 1 & ~self._given_set, 0, 0, 0))
                discrepancies, is_cut = 2 * discrepancies, False
            left, has, lacks, opened, made, paid, spent = stack.pop()
            slack = below - bound - spent
            if not self._budget.spend(_BRANCH):
                return best, False
            if paid >= below or slack <= 0:
                continue
            usable = least[bisect_left(rests, slack)] & ~lacks
            missing = opened
            if opened:
                sets = [self._makers_of[node] & usable for node in _members(opened)]
            else:
                missing = self._circular(has)
                if not missing:
                    best, below = _members(has), paid
                    continue
                every = [self._makers_of[node] for node in _members(missing)]
                sets = [reduce(or_, every) & usable & ~has]
            choices = _members(min(sets, key=_count))
            if not self._budget.spend(_CHOICE * (len(sets) + len(choices))):
                return best, False
            worth = {
                each: costs[each] / max(1, _count(missing & self._makes[each])) for each in choices
            }
            branches = []
            for rank, action in enumerate(sorted(choices, key=lambda each: (worth[each], each))):
                if rank > left:
                    is_cut = True
                    break
                more, there = has | 1 << action, made | self._makes[action]
                price = paid + costs[action]
                if graph.request.kept:
                    price = graph.cost(_members(more))
                branches.append(
                    _Branch(
                        left - rank,
                        more,
                        lacks | self._twins.get(action, 0),
                        (opened | self._needs[action]) & ~there,
                        there,
                        price,
                        spent + rest[action],
                    )
                )
                lacks |= 1 << action
            stack += reversed(branches)
        return best, True

    def _circular(self, has: int) -> int:
        """Return the nodes of which actions that supply each other lack one more maker.

        Some need each other in a circle: another supplier of their needs breaks it. Where some
        are too late, another supplier of anything that they need may be sooner.
        """
        actions = _members(has)
        way = self.derive(actions)
        if 0 in way:
            return 0
        needed = {0}.union(*[self._graph.needs[each] for each in actions]) - self._given.keys()
        return _set(needed - way.keys() if self._graph.request.limit is None else needed)


class _Branch(NamedTuple):
    """A part of the search: plans with some actions, but without others; sets are of bits."""

    left: int  # discrepancies that it may have
    has: int
    lacks: int
    opened: int  # the nodes that its actions need and do not make
    made: int  # the nodes that its actions make
    paid: int
    spent: int  # the remaining costs of its actions


def _set(numbers: Iterable[int]) -> int:
    return reduce(or_, [1 << each for each in numbers], 0)


def _members(numbers: int) -> list[int]:
    found = []
    while numbers:
        lowest = numbers & -numbers
        found.append(lowest.bit_length() - 1)
        numbers ^= lowest
    return found


def _count(numbers: int) -> int:
    return bin(numbers).count("1")
