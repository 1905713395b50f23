# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The part of the network that a goal can reach, from the goal downwards.

In the *abstract* the variables of actions are not bound: what can be supplied under any bindings
counts as supplied, so costs there are lower bounds, and nothing has to be specialised. With such
bounds only what is *worthwhile* is reached, and specialised: what can be part of a plan that costs
no more than a bound. The search for the lightest derivation under such bounds is due to
P. F. Felzenszwalb and D. McAllester, "The generalized A* architecture", JAIR 29, 2007.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import AbstractSet, Callable, Dict, Iterable, List, Mapping, Optional, Sequence, Union

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.live_streams import LiveMatch, LiveStreams
from dyknow.manager.planning.network import Network

#: Steps of a budget that a demand takes, and an action.
_EFFORT = 20


@dataclass
class Reach:
    """What a goal can reach.

    Attributes:
        goal: number of the demand that is asked for.
        is_abstract: whether variables are not bound.
        demands: those reached.
        actions: those reached.
        live: the best live streams.
        serves: for each action, what it supplies.
        above: for each demand of the network, what a plan costs at least besides it.
        above_actions: the same for each action: besides it and what it needs.
        floors: for each action, what its in-ports cost at least; empty if that is not known.
        beyond: the least cost of a plan with something that was left out; None if nothing was.
        offered: for each demand, the actions that supply it; only if costs were known.
    """

    goal: int
    is_abstract: bool
    demands: List[int]
    actions: List[int]
    live: List[LiveMatch]
    serves: Union[Sequence[List[int]], Mapping[int, List[int]]]
    above: List[int]
    above_actions: List[int]
    floors: Mapping[int, Sequence[int]] = field(default_factory=dict)
    beyond: Optional[int] = None
    offered: Mapping[int, Sequence[int]] = field(default_factory=dict)


class Scope:
    """What one request may be planned with."""

    def __init__(
        self, network: Network, goal: int, streams: LiveStreams, exclude: AbstractSet[str]
    ) -> None:
        """Set it up.

        Args:
            network: the library.
            goal: number of what is asked for.
            streams: what is live.
            exclude: labels of which nothing new is made.
        """
        self.network = network
        self._goal = goal
        self._streams = streams
        self._excluded = network.numbers(exclude)

    def small(self, most: int) -> Optional[Reach]:
        """Collect all that the goal can reach under bindings, if it is not much."""
        reach = self.everything(False, most)
        return reach if len(reach.actions) <= most else None

    def everything(self, is_abstract: bool, most: Optional[int] = None) -> Reach:
        """Collect all that the goal can reach; a demand with a live stream needs nothing else.

        Args:
            is_abstract: whether variables are not bound.
            most: actions beyond which nothing more is collected; None for no limit.
        """
        network, streams, excluded = self.network, self._streams, self._excluded
        patterns, needs, joined = network.patterns, network.needs, network.joined
        live: List[LiveMatch] = []
        actions: List[int] = []
        reached = {self._goal: None}
        used = bytearray(len(needs))
        served: Dict[int, List[int]] = {}
        demands = [self._goal]
        any_live = len(streams) > 0
        for number in demands:  # grows meanwhile
            if most is not None and len(actions) > most:
                break
            if any_live:
                alive = streams.matches(number, patterns[number])
                live += alive
                if alive and not patterns[number].wanted:
                    continue
            for supplier in network.suppliers(number):
                if excluded and supplier in excluded:
                    continue
                is_plain = is_abstract or supplier not in joined
                for action in (supplier,) if is_plain else network.specialised(number, supplier):
                    if action >= len(used):
                        used += bytes(len(needs) - len(used))
                    if not is_abstract:
                        served.setdefault(action, []).append(number)
                    if used[action]:
                        continue
                    used[action] = 1
                    actions.append(action)
                    for need in needs[action]:
                        if need not in reached:
                            reached[need] = None
                            demands.append(need)
        above = [0] * len(patterns), [0] * len(needs)
        return Reach(
            self._goal,
            is_abstract,
            demands,
            actions,
            live,
            network.serves if is_abstract else served,
            *above,
        )

    def worthwhile(
        self,
        bound: int,
        least: Sequence[int],
        costs: Sequence[int],
        use_sum: bool,
        within: Optional[Reach] = None,
        budget: Optional[Budget] = None,
    ) -> Optional[Reach]:
        """Collect what can be part of a plan that costs no more than a bound.

        Args:
            bound: what the plan may cost.
            least: what each demand of the network costs at least, in the abstract; -1 for what
                cannot be supplied.
            costs: of the actions of the network, in the abstract.
            use_sum: whether all in-ports of an action count, or the dearest one.
            within: what was worthwhile by costs that were less precise; those of specialised
                actions are known now.
            budget: what it may take.

        Returns:
            What can be, or nothing if the budget did not last.
        """
        network, streams, excluded = self.network, self._streams, self._excluded
        patterns, needs = network.patterns, network.needs
        any_live = len(streams) > 0
        combine: Callable[[Iterable[int]], int] = sum if use_sum else max
        live: List[LiveMatch] = []
        above: Dict[int, int] = {}
        above_actions: Dict[int, int] = {}
        offered: Dict[int, List[int]] = {}
        served: Dict[int, List[int]] = {}
        inputs_cost: Dict[int, List[int]] = {}
        beyond: Optional[int] = None
        pushed = 0
        heap = [(0, 0, self._goal)]  # equal prices in the order of discovery
        while heap:
            price, _, number = heapq.heappop(heap)
            if number in above:
                continue
            above[number] = price
            if any_live:
                alive = streams.matches(number, patterns[number])
                live += alive
                if alive and not patterns[number].wanted:
                    continue
            some = network.suppliers(number) if within is None else within.offered[number]
            if budget is not None and not budget.spend(_EFFORT + len(some)):
                return None
            offered[number] = []
            for supplier in some:
                if excluded and supplier in excluded:
                    continue
                floors = [least[each] for each in needs[supplier]]
                if floors and min(floors) < 0:
                    continue
                own = costs[supplier]
                floor = own + combine(floors) if floors else own
                if price + floor > bound:
                    if beyond is None or price + floor < beyond:
                        beyond = price + floor
                    continue
                inputs = network.inputs[supplier]
                for action in (
                    network.specialised(number, supplier) if within is None else (supplier,)
                ):
                    offered[number].append(action)
                    served.setdefault(action, []).append(number)
                    if action in above_actions:
                        continue
                    above_actions[action] = price
                    inputs_cost[action] = [least[each] for each in inputs]
                    if budget is not None:
                        budget.spend(_EFFORT)
                    for need, general in zip(network.inputs[action], inputs):
                        if need not in above:
                            pushed += 1
                            rest = floor - least[general] if use_sum else own
                            heapq.heappush(heap, (price + rest, pushed, need))
        return Reach(
            self._goal,
            False,
            list(above),
            list(above_actions),
            live,
            served,
            _listed(above, len(patterns)),
            _listed(above_actions, len(needs)),
            inputs_cost,
            beyond,
            offered,
        )


def _listed(numbers: Dict[int, int], count: int) -> List[int]:
    found = [0] * count
    for number, value in numbers.items():
        found[number] = value
    return found
