# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts shared parts once: from the cheapest tree to the cheapest plan.

The problem is that of a Steiner arborescence with AND nodes, which is NP-hard. First every action
is left out that cannot be part of a cheaper plan, since no plan costs less than the maximum over
its inputs. On the others a branch-and-bound search is exact if it ends within its budget; if it
does not, an exchange of single parts improves the plan. The budget counts steps, not seconds, so
equal problems have equal plans on fast and slow machines.
"""

from __future__ import annotations

from typing import AbstractSet, Dict, List, NamedTuple, Optional, Set, Tuple

from dyknow.manager.planning.knuth import LIVE, cheapest
from dyknow.manager.planning.network import Chosen, Network, Reach

#: Actions beyond which the search is not begun.
_SEARCHABLE = 2_000
#: Actions beyond which a plan is not improved.
_MOST_ACTIONS = 10_000


class PlanDraft(NamedTuple):
    """A way to the goal: the choices, the actions with suppliers first, and their cost."""

    chosen: Chosen
    actions: List[int]
    cost: int


def drafted(
    network: Network, reach: Reach, chosen: Chosen, free: AbstractSet[int]
) -> Optional[PlanDraft]:
    """Follow choices from the goal; None if they have a cycle."""
    needs, costs = network.needs, network.costs
    order: List[int] = []
    if chosen[reach.goal] == LIVE:
        return PlanDraft(chosen, order, 0)
    done: Dict[int, bool] = {}  # False while its inputs are being followed
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
    """Return a draft of less cost, or the given one.

    Args:
        network: the library.
        reach: what the goal can reach.
        draft: the cheapest tree.
        free: actions that cost nothing.
        steps: the budget.
    """
    if len(draft.actions) > _MOST_ACTIONS:
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
    """Leave out actions with an input that alone costs as much as the present draft."""
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
    """Search all choices that may cost less than the best draft.

    Returns:
        The best draft, and whether the search ended within its budget.
    """
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
        offers[demand] = [LIVE]  # costs nothing and needs nothing, so no offer is better

    chosen: Chosen = {}
    users: Dict[int, int] = {}  # how many choices use an action
    open_demands: List[int] = [part.goal]
    cost = 0
    # One frame for each decision: the demand, its offers, the position of the next offer, and how
    # many demands the present one opened (-1 before the first).
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
        if opened >= 0:  # undo the last choice
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
    """Leave out one action after the other, as long as the draft becomes cheaper."""
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
