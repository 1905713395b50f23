"""Knuth's generalisation of Dijkstra's algorithm, on the part of the graph a demand can reach.

D. E. Knuth, "A generalization of Dijkstra's algorithm", Information Processing Letters 6(1), 1977.
The value of an action is its cost plus the sum (or the maximum) of the values of its demands; both
are superior functions, so actions are final in the order of their values.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import AbstractSet, Dict, List, Set, Tuple

from dyknow.manager.planning import NO_LABELS, Action, Choice, Live, New, Source
from dyknow.manager.supply import Demand


@dataclass
class Problem:
    """The part of the AND/OR graph that a demand can reach.

    Attributes:
        demand: what is asked for.
        sources: who supplies each demand, live streams first, sorted.
        actions: the transformations among them, by label.
    """

    demand: Demand
    sources: Dict[Demand, List[Source]] = field(default_factory=dict)
    actions: Dict[str, Action] = field(default_factory=dict)


@dataclass
class Solution:
    """The cheapest source for each demand that can be met, and what it costs."""

    value: Dict[Demand, int] = field(default_factory=dict)
    best: Choice = field(default_factory=dict)


def cheapest(
    problem: Problem,
    banned: AbstractSet[str] = NO_LABELS,
    sunk: AbstractSet[str] = NO_LABELS,
    use_sum: bool = True,
) -> Solution:
    """Value every demand.

    Args:
        problem: what can be reached.
        banned: labels that must not be used.
        sunk: labels that cost nothing.
        use_sum: price of a tree, in which shared parts are paid again; else the maximum over the
            inputs, which no plan can undercut.
    """
    solution = Solution()
    consumers: Dict[Demand, List[str]] = {}
    served: Dict[str, List[Tuple[Demand, New]]] = {}
    missing: Dict[str, int] = {}
    cost: Dict[str, int] = {}
    inputs: Dict[str, int] = {}
    heap: List[Tuple[int, str]] = []
    for label, action in problem.actions.items():
        if label in banned:
            continue
        demands = {need.demand for need in action.needs}
        missing[label] = len(demands)
        cost[label] = 0 if label in sunk else action.cost
        inputs[label] = 0
        for demand in demands:
            consumers.setdefault(demand, []).append(label)
        if not demands:
            heap.append((cost[label], label))
    ready: List[Demand] = []
    for demand, sources in problem.sources.items():
        if sources and isinstance(sources[0], Live):
            solution.value[demand] = 0
            solution.best[demand] = sources[0]
            ready.append(demand)
            continue
        for source in sources:
            if isinstance(source, New) and source.label in missing:
                served.setdefault(source.label, []).append((demand, source))
    heapq.heapify(heap)
    done: Set[str] = set()
    while True:
        while ready:
            demand = ready.pop()
            value = solution.value[demand]
            for label in consumers.get(demand, ()):
                inputs[label] = inputs[label] + value if use_sum else max(inputs[label], value)
                missing[label] -= 1
                if not missing[label]:
                    heapq.heappush(heap, (cost[label] + inputs[label], label))
        if not heap:
            return solution
        value, label = heapq.heappop(heap)
        if label in done:
            continue
        done.add(label)
        for demand, source in served.get(label, ()):
            if demand not in solution.value:
                solution.value[demand] = value
                solution.best[demand] = source
                ready.append(demand)
