# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Knuth's algorithm where variables are not bound (see ``knuth``), over demands alone.

If no action joins in-ports, that is all. Else it is the *abstract* problem: what can be supplied
under any bindings counts as supplied, so costs are lower bounds. It is as large as the part of the
library that the goal reaches, whatever individuals there are.
"""

from __future__ import annotations

import heapq
from typing import Any, Callable, List, Optional, Union

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.instances import LIVE, Instances
from dyknow.manager.planning.values import Values

#: Bits for the rank of a label, and for the number of a demand, in the keys of the search.
_BITS = 32
_NUMBER = (1 << _BITS) - 1
#: Steps of a budget that a demand takes, and an action that needs it.
_EFFORT, _EACH = 20, 5


def least_costs(
    instances: Instances,
    use_sum: bool = True,
    below: Optional[int] = None,
    budget: Optional[Budget] = None,
) -> List[int]:
    """Return what each demand of the network costs at least; -1 for what cannot be supplied.

    Args:
        instances: what there is.
        use_sum: use the sum over the inputs; else the maximum, a lower bound for every plan.
        below: value what costs less than this; the rest costs at least as much.
        budget: what the search may take: half of what is left.
    """
    values = _search(instances, True, use_sum, below, True, budget)
    rest = -1 if values.reached is None else values.reached
    found = [rest] * len(instances.network.patterns)
    for demand, value in values.value.items():
        found[demand] = value
    return found


def cheapest_unbound(
    instances: Instances,
    use_sum: bool = True,
    below: Optional[int] = None,
    is_all: bool = False,
    budget: Optional[Budget] = None,
) -> Values:
    """Value the demands that can be met, up to the goal; see ``knuth.cheapest``."""
    return _search(instances, False, use_sum, below, is_all, budget)


def _search(
    instances: Instances,
    is_abstract: bool,
    use_sum: bool,
    below: Optional[int],
    is_all: bool,
    budget: Optional[Budget],
) -> Values:
    network, reach = instances.network, instances.reach
    serves, users, needs = reach.serves, reach.users, network.needs
    costs = instances.costs.floors()
    # In the abstract ties decide nothing, and it does not matter what supplies a demand.
    ranks = None if is_abstract else network.ranks().of
    has_offers = is_all and not is_abstract
    combine: Callable[[Any], int] = sum if use_sum else max
    values = Values()
    offers = values.offers
    value, chosen = [-1] * len(network.patterns), [LIVE] * len(network.patterns)
    value_of = value.__getitem__
    # The lowest key by which a demand is supplied, as far as it is known; -1 once that is final.
    best: List[Union[int, float]] = [float("inf")] * len(network.patterns)
    missing = [0] * len(needs)
    shift = 2 * _BITS if ranks else _BITS
    left = budget.steps // 2 if budget is not None else 0
    pop, push = heapq.heappop, heapq.heappush
    heap: List[int] = []
    ready = []
    for action in serves:
        missing[action] = len(needs[action])
        if not missing[action]:
            ready.append(action)
    met = list(dict.fromkeys([match.demand for match in reach.live]))
    for match in reach.live:
        instances.streams[match.demand] = match.stream
    price = 0
    while True:
        for demand in met:
            value[demand] = price
            best[demand] = -1
            for user in users[demand]:
                lacking = missing[user] = missing[user] - 1
                if not lacking:
                    ready.append(user)
        if value[reach.goal] >= 0 and not is_all:
            break
        for action in ready:
            own = costs[action]
            if needs[action]:
                own += combine(map(value_of, needs[action]))
            key = (own << _BITS | ranks[action] if ranks else own) << _BITS
            for demand in serves[action]:
                if key < best[demand]:
                    best[demand] = key
                    chosen[demand] = action
                    push(heap, key | demand)
                if has_offers and (below is None or own < below):
                    offers.setdefault(demand, []).append(action)
        ready = []
        while heap:
            key = pop(heap)
            if value[key & _NUMBER] < 0:
                break
        else:
            values.reached = None
            break
        values.reached = price = key >> shift
        if below is not None and price >= below:
            break
        demand = key & _NUMBER
        turn, met = key - demand, [demand]
        # All that the action supplies, before what that makes possible: numbers decide no ties.
        if ranks and len(serves[chosen[demand]]) > 1:
            met = [each for each in serves[chosen[demand]] if best[each] == turn]
        if budget is not None:
            effort = _EFFORT + _EACH * sum([len(users[each]) for each in met])
            if not budget.spend(effort) or budget.steps < left:
                values.is_complete = False
                break
    values.value = {demand: price for demand, price in enumerate(value) if price >= 0}
    values.chosen = {demand: chosen[demand] for demand in values.value}
    return values
