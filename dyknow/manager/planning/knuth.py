# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

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
    """Cost of the cheapest way to each demand, and the action with which it ends."""

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
        network: the library.
        reach: the part of it to value.
        free: actions that cost nothing.
        banned: actions that must not be used.
        use_sum: use the sum over the inputs, the cost of a tree, in which shared parts are paid
            again; else the maximum over the inputs, which is a lower bound for every plan.
        until: stop after this demand.
        below: value only what costs less than this.
    """
    values = Values()
    value, chosen = values.value, values.chosen
    costs, needs, labels = network.costs, network.needs, network.labels
    consumers, served, live = reach.consumers, reach.served, reach.live
    combine = sum if use_sum else max
    push, pop = heapq.heappush, heapq.heappop
    value_of = value.__getitem__
    missing = dict(zip(served, map(len, map(needs.__getitem__, served))))
    heap: List[Tuple[int, str, int]] = [(0, "", LIVE)] if live else []
    for action in [each for each, left in missing.items() if not left and each not in banned]:
        heap.append((0 if action in free else costs[action], labels[action], action))
    heapq.heapify(heap)
    while heap and until not in value:
        price, _, action = pop(heap)
        if below is not None and price >= below:
            break
        for demand in live if action == LIVE else served[action]:
            if demand in value:
                continue
            value[demand] = price
            chosen[demand] = action
            for user in consumers[demand]:
                left = missing[user] = missing[user] - 1
                if not left and user not in banned:
                    inputs = combine(map(value_of, needs[user]))
                    own = 0 if user in free else costs[user]
                    push(heap, (own + inputs, labels[user], user))
    return values
