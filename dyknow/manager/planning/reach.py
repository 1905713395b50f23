# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The part of the network that a goal can reach, from the goal downwards.

In the *abstract* the variables of actions are not bound: what can be supplied under any bindings
counts as supplied, so costs there are lower bounds. By such bounds it is known what is above a
demand, and what is too dear to be *worthwhile* for a plan of less cost than a known one.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import AbstractSet, Dict, FrozenSet, Iterable, List, Mapping, Optional, Sequence, Tuple

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.heads import Offer
from dyknow.manager.planning.live_streams import LiveMatch, LiveStreams
from dyknow.manager.planning.network import Network
from dyknow.manager.planning.patterns import Domains

#: Steps of a budget that a demand takes, and an action.
_EFFORT = 20


@dataclass
class Reach:
    """What a goal can reach; grows as it is collected.

    Attributes:
        goal: number of the demand that is asked for.
        above: for each demand, what a plan costs at least besides it, in the order of discovery.
        serves: for each action, what it supplies.
        users: for each demand, the actions that need it.
        floors: for each action, what its in-ports cost at least; empty if that is not known.
        live: the best live streams.
    """

    goal: int
    above: Dict[int, int] = field(default_factory=dict)
    serves: Dict[int, List[int]] = field(default_factory=dict)
    users: Dict[int, List[int]] = field(default_factory=dict)
    floors: Dict[int, Sequence[int]] = field(default_factory=dict)
    live: List[LiveMatch] = field(default_factory=list)

    @property
    def pending(self) -> Optional[int]:
        """What a plan with something that is not revealed yet costs at least; None for nothing."""
        return None

    def reveal(self) -> Tuple[List[Tuple[int, int]], List[LiveMatch]]:
        """Reveal what is next: actions, each with what it supplies, and live streams."""
        raise AssertionError("everything is revealed")

    def plain(self) -> Reach:
        """Leave out what is known about costs."""
        return Reach(
            self.goal,
            dict.fromkeys(self.above, 0),
            self.serves,
            self.users,
            live=self.live,
        )


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
        self.goal = goal
        self._streams = streams
        self._excluded = network.numbers(exclude)
        self._useful: Mapping[int, Domains] = {}
        self._sources: Dict[int, List[int]] = {}  # specialised, of demands that were asked for

    def narrow(self, useful: Mapping[int, Domains]) -> None:
        """Let only those specialised actions be sources that supply useful names."""
        self._useful = useful

    def live(self, number: int) -> Tuple[List[LiveMatch], bool]:
        """Return live streams that supply a demand, and whether it needs nothing else."""
        if not len(self._streams):
            return [], False
        pattern = self.network.patterns[number]
        alive = self._streams.matches(number, pattern)
        return alive, bool(alive) and not pattern.wanted

    def small(self, most: int) -> Optional[Reach]:
        """Collect all that the goal can reach, specialised, if few actions join in-ports."""
        reach = self.everything(False, most)
        return reach if len(self.network.joined.intersection(reach.serves)) <= most else None

    def everything(self, is_abstract: bool, most: Optional[int] = None) -> Reach:
        """Collect all that the goal can reach; a demand with a live stream needs nothing else.

        Args:
            is_abstract: whether variables are not bound.
            most: actions that join in-ports beyond which nothing more is collected; None for no
                limit.
        """
        network, excluded = self.network, self._excluded
        needs, joined, any_live = network.needs, network.joined, len(self._streams) > 0
        reach = Reach(self.goal)
        above, serves, users = reach.above, reach.serves, reach.users
        above[self.goal] = 0
        users[self.goal] = []
        demands = [self.goal]
        joining = 0
        for number in demands:  # grows meanwhile
            if any_live:
                alive, is_met = self.live(number)
                reach.live += alive
                if is_met:
                    continue
            for supplier in network.suppliers(number):
                if excluded and supplier in excluded:
                    continue
                is_plain = is_abstract or supplier not in joined
                for action in (supplier,) if is_plain else network.specialised(number, supplier):
                    if action in serves:
                        serves[action].append(number)
                        continue
                    serves[action] = [number]
                    joining += not is_plain
                    for need in needs[action]:
                        if need in above:
                            users[need].append(action)
                        else:
                            above[need] = 0
                            demands.append(need)
                            users[need] = [action]
            if most is not None and joining > most:
                break
        return reach

    def sources(self, number: int, is_special: bool) -> Iterable[int]:
        """Return the actions that can supply a demand, and may be needed.

        Args:
            number: the demand.
            is_special: whether they are specialised.
        """
        network, excluded = self.network, self._excluded
        found: Iterable[int] = network.suppliers(number)
        if excluded:
            found = [each for each in found if each not in excluded]
        if not is_special:
            return found
        known = self._sources.get(number)
        if known is None:
            useful = self._useful.get(number, ())
            checked = [(at, names) for at, names in enumerate(useful) if names is not None]
            if checked:
                offers = network.suppliers(number)
                found = [each for each in found if _is_useful(offers[each], checked)]
            known = [each for some in found for each in network.specialised(number, some)]
            self._sources[number] = known
        return known

    def worthwhile(
        self,
        bound: int,
        least: Sequence[int],
        costs: Sequence[int],
        is_special: bool,
        budget: Budget,
    ) -> Optional[Reach]:
        """Collect what can be part of a plan that costs no more than a bound.

        What an action needs costs at least as much as the dearest of its in-ports.

        Args:
            bound: what the plan may cost.
            least: what each demand of the network costs at least, in the abstract; -1 for what
                cannot be supplied.
            costs: of the actions of the network, in the abstract.
            is_special: whether these are of specialised actions.
            budget: what it may take.

        Returns:
            What can be, or nothing if the budget did not last.
        """
        network = self.network
        reach = Reach(self.goal)
        pushed = 0
        heap = [(0, 0, self.goal)]  # equal prices in the order of discovery
        while heap:
            price, _, number = heapq.heappop(heap)
            if number in reach.above:
                continue
            reach.above[number] = price
            reach.users.setdefault(number, [])
            alive, is_met = self.live(number)
            reach.live += alive
            if not budget.spend(_EFFORT):
                return None
            for supplier in () if is_met else self.sources(number, is_special):
                if not budget.spend(1):
                    return None
                inputs = network.inputs[supplier]
                floors = [least[each] for each in inputs]
                own = costs[supplier]
                if floors and (min(floors) < 0 or price + own + max(floors) > bound):
                    continue
                if price + own > bound:
                    continue
                specialised = (supplier,) if is_special else network.specialised(number, supplier)
                for action in specialised:
                    reach.serves.setdefault(action, []).append(number)
                    if len(reach.serves[action]) > 1:
                        continue
                    reach.floors[action] = floors
                    budget.spend(_EFFORT)
                    for need in network.needs[action]:
                        reach.users.setdefault(need, []).append(action)
                        if need not in reach.above:
                            pushed += 1
                            heapq.heappush(heap, (price + own, pushed, need))
        return reach


def _is_useful(offers: Iterable[Offer], checked: Sequence[Tuple[int, FrozenSet[str]]]) -> bool:
    """Whether an action can supply a demand with useful names in some places."""
    for offer in offers:
        if offer.solutions is None:
            return True
        for theta in offer.solutions:
            for at, names in checked:
                if theta[at] not in names:
                    break
            else:
                return True
    return False
