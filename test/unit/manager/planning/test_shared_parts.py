# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How good plans are in which shared parts decide, judged by an exact solver."""

from __future__ import annotations

import time
from typing import Callable, List

import pytest

from dyknow.manager.planning.planner import BUDGET, Planner
from dyknow.manager.planning.problem import Demand, Plan
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.transformation import Transformation

pytest.importorskip("scipy", reason="Python 3.8 has no exact solver here")
from unit.manager.planning.set_cover import least_cost, set_cover

GOAL = Demand(frozenset([parse_tag("Goal")]))


def plan(
    library: List[Transformation], budget: float, clock: Callable[[], float] = lambda: 0.0
) -> Plan:
    """Plan by the count of steps alone, unless there is a clock."""
    planner = Planner(clock=clock)
    planner.add(library)
    answer = planner.plan(GOAL, budget=budget)
    assert isinstance(answer, Plan)
    return answer


def judge(seeds: range) -> None:
    good = 0
    for seed in seeds:
        library = set_cover(seed)
        expected = least_cost(library, "Goal")
        answer = plan(library, 0.5)
        assert answer.least_cost <= expected <= answer.cost
        assert not answer.is_cut_short
        good += answer.cost <= 1.02 * expected
    assert good >= 0.9 * len(seeds)


def test_plans_are_near_the_cheapest_and_bounds_below_it() -> None:
    judge(range(10))


@pytest.mark.long
def test_many_plans_are_near_the_cheapest_and_bounds_below_it() -> None:
    judge(range(100, 300))


def test_equal_budgets_have_equal_plans_and_larger_ones_no_dearer_plans() -> None:
    library = set_cover(3)
    first = plan(library, 0.05)
    assert plan(library[::-1], 0.05) == first
    assert plan(library, 0.2).cost <= first.cost <= plan(library, 0).cost


def test_the_clock_ends_what_takes_long_and_the_plan_says_so() -> None:
    times = iter(range(10**9))
    answer = plan(set_cover(3), 20.0, lambda: float(next(times)))
    assert answer.is_cut_short
    assert answer.least_cost < answer.cost


@pytest.mark.long
def test_the_budget_is_kept() -> None:
    late = []
    for seed in range(30):
        library = set_cover(seed)
        begin = time.process_time()
        plan(library, 0, time.process_time)
        without = time.process_time() - begin
        begin = time.process_time()
        plan(library, BUDGET, time.process_time)
        late.append(time.process_time() - begin - without - BUDGET)
    assert max(late) < 0.02
