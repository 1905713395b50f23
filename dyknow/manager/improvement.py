"""Counts shared parts once: from the cheapest tree to the cheapest plan.

The problem is that of a Steiner arborescence with AND nodes, so exactness has its price. A search
with bounds looks at every choice and is exact when it ends within its budget; what it cannot
finish, an exchange of single parts improves. The budget counts steps and not seconds: equal
problems have equal plans on fast and slow machines.
"""

from __future__ import annotations

from typing import Dict, List, Optional, Set, Tuple

from dyknow.manager.knuth import Problem, Solution, cheapest
from dyknow.manager.planning import Choice, Live, New, Plan, Source, assemble
from dyknow.manager.supply import Demand


class _Budget:
    """Steps that are left."""

    def __init__(self, steps: int) -> None:
        self.left = steps

    def spend(self, steps: int) -> bool:
        """Take steps away; False when there are none left."""
        self.left -= steps
        return self.left > 0


def improve(problem: Problem, trees: Solution, plan: Plan, steps: int) -> Plan:
    """Find a plan of less cost, or return the given one.

    Args:
        problem: what can be reached.
        trees: the cheapest trees.
        plan: the plan that they make.
        steps: how much may be tried.
    """
    bound = cheapest(problem, use_sum=False)
    other = assemble(problem.demand, bound.best, problem.actions)
    if other is not None and other.cost < plan.cost:
        plan = other
    floor = bound.value[problem.demand]
    if plan.cost <= floor:
        return plan
    budget = _Budget(steps)
    found, complete = _search(problem, trees, plan, floor, budget)
    if complete:
        return found
    return _exchange(problem, found, floor, _Budget(steps))


def _search(
    problem: Problem, trees: Solution, plan: Plan, floor: int, budget: _Budget
) -> Tuple[Plan, bool]:
    """Look at every choice that could undercut the best plan; exact if it completes."""
    sources = {
        demand: [each for each in offered if _possible(problem, trees, each)]
        for demand, offered in problem.sources.items()
        if demand in trees.value
    }
    for demand in sources:
        first = sources[demand][0]
        if isinstance(first, Live):
            sources[demand] = [first]  # free and without needs: nothing is better
    best = plan
    chosen: Choice = {}
    users: Dict[str, int] = {}  # how many choices rest on an action
    open_demands: List[Demand] = [problem.demand]
    cost = 0
    # One frame for each decision: the demand, its sources, the next one, what was undone by it.
    frames: List[Tuple[Demand, List[Source], int, int]] = []

    def bound() -> int:
        most = 0
        for demand in open_demands:
            least: Optional[int] = None
            for source in sources[demand]:
                price = (
                    0
                    if isinstance(source, Live) or source.label in users
                    else problem.actions[source.label].cost
                )
                if least is None or price < least:
                    least = price
                    if not price:
                        break
            most = max(most, least or 0)
        return cost + most

    def enter() -> None:
        demand = open_demands.pop()
        order = sorted(sources[demand], key=lambda each: _price(problem, trees, users, each))
        frames.append((demand, order, 0, -1))

    enter()
    while frames:
        demand, order, position, added = frames.pop()
        if added >= 0:  # take the last choice back
            source = chosen.pop(demand)
            if isinstance(source, New):
                users[source.label] -= 1
                if not users[source.label]:
                    del users[source.label]
                    cost -= problem.actions[source.label].cost
                for _ in range(added):
                    open_demands.pop()
        if position == len(order):
            open_demands.append(demand)
            continue
        if not budget.spend(1 + len(open_demands)):
            return best, False
        source = order[position]
        added = 0
        chosen[demand] = source
        if isinstance(source, New):
            if source.label not in users:
                cost += problem.actions[source.label].cost
                needed = {need.demand for need in problem.actions[source.label].needs}
                waiting = set(open_demands)
                fresh = sorted(needed - chosen.keys() - waiting, key=str)
                open_demands.extend(fresh)
                added = len(fresh)
            users[source.label] = users.get(source.label, 0) + 1
        frames.append((demand, order, position + 1, added))
        if bound() >= best.cost or not budget.spend(1):
            continue
        if open_demands:
            enter()
            continue
        found = assemble(problem.demand, chosen, problem.actions)
        budget.spend(len(chosen))
        if found is not None and found.cost < best.cost:
            best = found
            if best.cost <= floor:
                return best, True
    return best, True


def _exchange(problem: Problem, plan: Plan, floor: int, budget: _Budget) -> Plan:
    """Leave one part after the other out, and see whether the rest serves better."""
    size = len(problem.actions) + len(problem.sources)
    improved = True
    while improved and plan.cost > floor:
        improved = False
        labels = {step.action.label for step in plan.steps}
        for label in sorted(labels, key=lambda each: (-problem.actions[each].cost, each)):
            if not budget.spend(size):
                return plan
            solution = cheapest(problem, banned={label}, sunk=labels - {label})
            if problem.demand not in solution.value:
                continue
            found = assemble(problem.demand, solution.best, problem.actions)
            if found is not None and found.cost < plan.cost:
                plan, improved = found, True
                break
    return plan


def _possible(problem: Problem, trees: Solution, source: Source) -> bool:
    return isinstance(source, Live) or all(
        need.demand in trees.value for need in problem.actions[source.label].needs
    )


def _price(
    problem: Problem, trees: Solution, users: Dict[str, int], source: Source
) -> Tuple[int, Tuple[str, ...]]:
    if isinstance(source, Live):
        return 0, tuple(source)
    if source.label in users:
        return 0, tuple(source)
    needs: Set[Demand] = {need.demand for need in problem.actions[source.label].needs}
    return (
        problem.actions[source.label].cost + sum(trees.value[demand] for demand in needs),
        tuple(source),
    )
