"""Counts shared parts once: from the cheapest tree to the cheapest plan.

The problem is that of a Steiner arborescence with AND nodes, so exactness has its price. What
cannot be part of a cheaper plan is left out first: no plan undercuts the maximum over its inputs.
On the rest a search with bounds is exact when it ends within its budget; what it cannot finish, an
exchange of single parts improves. The budget counts steps and not seconds, so equal problems have
equal plans on fast and slow machines.
"""

from __future__ import annotations

from typing import AbstractSet, Dict, List, NamedTuple, Optional, Set, Tuple

from dyknow.manager.planning.knuth import LIVE, cheapest
from dyknow.manager.planning.network import Chosen, Network, Reach

#: Actions beyond which a search through all choices is not begun.
_SEARCHABLE = 2_000
#: Actions beyond which nobody would run the plan anyway.
_REASONABLE = 10_000


class PlanDraft(NamedTuple):
    """A way to the goal: what is chosen, the actions with suppliers first, and their cost."""

    chosen: Chosen
    actions: List[int]
    cost: int


def drafted(
    network: Network, reach: Reach, chosen: Chosen, free: AbstractSet[int]
) -> Optional[PlanDraft]:
    """Follow a choice from the goal; None if it has a cycle."""
    needs, costs = network.needs, network.costs
    order: List[int] = []
    if chosen[reach.goal] == LIVE:
        return PlanDraft(chosen, order, 0)
    done: Dict[int, bool] = {}  # False: its inputs are being followed
    stack = [chosen[reach.goal]]  # actions to enter; ~action to leave it again
    while stack:
        action = stack.pop()
        if action < 0:
            done[~action] = True
            order.append(~action)
        elif action not in done:
            done[action] = False
            stack.append(~action)
            for demand in reversed(needs[action]):  # the first is followed first
                below = chosen[demand]
                if below == LIVE:
                    continue
                known = done.get(below)
                if known is None:
                    stack.append(below)
                elif not known:
                    return None
    paid = [action for action in order if action not in free] if free else order
    return PlanDraft(chosen, order, sum(map(costs.__getitem__, paid)))


def improve(
    network: Network, reach: Reach, draft: PlanDraft, free: AbstractSet[int], steps: int
) -> PlanDraft:
    """Find a way of less cost, or return the given one.

    Args:
        network: the numbers.
        reach: what the goal can reach.
        draft: the cheapest tree.
        free: actions that cost nothing.
        steps: how much may be tried.
    """
    if len(draft.actions) > _REASONABLE:
        return draft
    bound = cheapest(network, reach, free, use_sum=False, below=draft.cost)
    floor = bound.value.get(reach.goal)
    if floor is None:
        return draft
    other = drafted(network, reach, bound.chosen, free)
    if other is not None and other.cost < draft.cost:
        draft = other
    if draft.cost <= floor:
        return draft
    part = _worthwhile(network, reach, bound.value)
    if len(part.served) <= _SEARCHABLE:
        draft, complete = _search(network, part, bound.value, draft, free, floor, steps)
        if complete:
            return draft
    return _exchange(network, part, draft, free, floor, steps)


def _worthwhile(network: Network, reach: Reach, bound: Dict[int, int]) -> Reach:
    """Leave out what needs something that alone costs as much as the plan at hand."""
    part = Reach(reach.goal, live=reach.live)
    for action, demands in reach.served.items():
        if all(need in bound for need in network.needs[action]):
            kept = [demand for demand in demands if demand in bound]
            if kept:
                part.served[action] = kept
    for demand, users in reach.consumers.items():
        if demand in bound:
            part.consumers[demand] = [action for action in users if action in part.served]
    return part


def _search(
    network: Network,
    part: Reach,
    bound: Dict[int, int],
    best: PlanDraft,
    free: AbstractSet[int],
    floor: int,
    steps: int,
) -> Tuple[PlanDraft, bool]:
    """Look at every choice that could undercut the best way; exact if it ends in time."""
    needs = network.needs
    cost_of = {action: 0 if action in free else network.costs[action] for action in part.served}
    offers: Dict[int, List[int]] = {demand: [] for demand in part.consumers}
    for action, demands in part.served.items():
        for demand in demands:
            offers[demand].append(action)

    def price(action: int) -> Tuple[int, str]:
        inputs = sum(bound[need] for need in needs[action])
        return cost_of[action] + inputs, network.labels[action]

    for found in offers.values():
        found.sort(key=price)
    for demand in part.live:
        offers[demand] = [LIVE]  # costs and needs nothing: nothing is better

    chosen: Chosen = {}
    users: Dict[int, int] = {}  # how many choices rest on an action
    open_demands: List[int] = [part.goal]
    cost = 0
    # One frame for each decision: the demand, its offers, the next of them, and how many demands
    # the present one opened (-1: none is taken yet).
    frames: List[Tuple[int, List[int], int, int]] = []

    def least() -> int:
        most = 0
        for demand in open_demands:
            low = min(
                0 if action == LIVE or action in users else cost_of[action]
                for action in offers[demand]
            )
            most = max(most, low)
        return cost + most

    def enter() -> None:
        demand = open_demands.pop()
        used = [action for action in offers[demand] if action in users]
        rest = [action for action in offers[demand] if action not in users]
        frames.append((demand, used + rest, 0, -1))

    enter()
    while frames:
        demand, order, position, opened = frames.pop()
        if opened >= 0:  # take the last choice back
            action = chosen.pop(demand)
            if action != LIVE:
                users[action] -= 1
                if not users[action]:
                    del users[action]
                    cost -= cost_of[action]
            del open_demands[len(open_demands) - opened :]
        if position == len(order):
            open_demands.append(demand)
            continue
        action = chosen[demand] = order[position]
        fresh: List[int] = []
        if action != LIVE:
            if action not in users:
                cost += cost_of[action]
                waiting = set(open_demands)
                fresh = [d for d in needs[action] if d not in chosen and d not in waiting]
                open_demands.extend(fresh)
            users[action] = users.get(action, 0) + 1
        frames.append((demand, order, position + 1, len(fresh)))
        steps -= 1 + len(open_demands)
        if steps < 0:
            return best, False
        if least() >= best.cost:
            continue
        if open_demands:
            enter()
            continue
        steps -= len(chosen)
        way = drafted(network, part, dict(chosen), free)
        if way is not None and way.cost < best.cost:
            best = way
            if best.cost <= floor:
                return best, True
    return best, True


def _exchange(
    network: Network, part: Reach, draft: PlanDraft, free: AbstractSet[int], floor: int, steps: int
) -> PlanDraft:
    """Leave one part after the other out, and see whether the rest serves better."""
    size = len(part.served) + len(part.consumers)
    improved = True
    while improved and draft.cost > floor:
        improved = False
        present: Set[int] = set(draft.actions)
        costly = sorted(
            present - set(free), key=lambda each: (-network.costs[each], network.labels[each])
        )
        for action in costly:
            steps -= size
            if steps < 0:
                return draft
            values = cheapest(network, part, present | free, {action}, until=part.goal)
            if part.goal not in values.value:
                continue
            found = drafted(network, part, values.chosen, free)
            if found is not None and found.cost < draft.cost:
                draft, improved = found, True
                break
    return draft
