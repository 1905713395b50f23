"""Knuth's generalisation of Dijkstra's algorithm.

D. E. Knuth, "A generalization of Dijkstra's algorithm", Information Processing Letters 6(1), 1977.
The value of an action is its cost plus the sum (or the maximum) of the values of its demands. Both
are superior functions, so actions are final in the order of their values.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import AbstractSet, Dict, List, Optional, Tuple

from dyknow.manager.planning.network import Chosen, Network, Reach

LIVE = -1
"""Stands for a live stream where an action could be."""


@dataclass
class Values:
    """What the cheapest way to each demand costs, and how it begins."""

    value: Dict[int, int] = field(default_factory=dict)
    chosen: Chosen = field(default_factory=dict)


def cheapest(
    network: Network,
    reach: Reach,
    free: AbstractSet[int] = frozenset(),
    banned: AbstractSet[int] = frozenset(),
    use_sum: bool = True,
    until: Optional[int] = None,
    below: Optional[int] = None,
) -> Values:
    """Value the demands that can be met.

    Args:
        network: the numbers.
        reach: the part to look at.
        free: actions that cost nothing.
        banned: actions that must not be used.
        use_sum: price of a tree, in which shared parts are paid again; else the maximum over the
            inputs, which no plan can undercut.
        until: stop once this demand is valued.
        below: stop at this value: what costs as much is not valued.
    """
    values = Values()
    value, chosen = values.value, values.chosen
    costs, needs, labels = network.costs, network.needs, network.labels
    consumers, served = reach.consumers, reach.served
    combine = sum if use_sum else max
    missing: Dict[int, int] = {}
    heap: List[Tuple[int, str, int]] = []
    for action in served:
        missing[action] = len(needs[action])
        if not missing[action] and action not in banned:
            heap.append((0 if action in free else costs[action], labels[action], action))
    heapq.heapify(heap)
    ready = list(reach.live)
    value.update(dict.fromkeys(ready, 0))
    chosen.update(dict.fromkeys(ready, LIVE))
    value_of = value.__getitem__
    while True:
        while ready:
            for action in consumers[ready.pop()]:
                left = missing[action] = missing[action] - 1
                if not left and action not in banned:
                    own = 0 if action in free else costs[action]
                    inputs = combine(map(value_of, needs[action]))
                    heapq.heappush(heap, (own + inputs, labels[action], action))
        if not heap or until in value:
            return values
        price, _, action = heapq.heappop(heap)
        if below is not None and price >= below:
            return values
        for demand in served[action]:
            if demand not in value:
                value[demand] = price
                chosen[demand] = action
                ready.append(demand)
