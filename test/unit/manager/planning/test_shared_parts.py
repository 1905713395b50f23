# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How good plans are in which shared parts decide, judged by an exact solver."""

from __future__ import annotations

import random
import time
from typing import Callable, Dict, List, Sequence, Tuple

import pytest
from unit.manager.planning.examples import demand, make

from dyknow.manager.planning.planner import BUDGET, Planner
from dyknow.manager.planning.problem import Plan
from dyknow.model.transformation import OUT, Transformation

numpy = pytest.importorskip("numpy")
solver = pytest.importorskip("scipy.optimize", reason="Python 3.8 has no exact solver here")


def set_cover(seed: int) -> List[Transformation]:
    """Write 60 to 150 transformations; the goal is ``Goal``.

    The goal needs many elements. Sets supply some of them; half of the libraries have sets that
    need devices, which they share.
    """
    chance = random.Random(seed)
    count = chance.randint(58, 148)
    elements = [f"E{number}" for number in range(chance.randint(15, 40))]
    devices = [f"D{number}" for number in range(chance.choice([0, 10]))]
    library = [make("goal", elements, ["Goal"], 0)]
    library += [make(f"device {tag}", [], [tag], chance.randint(5, 30)) for tag in devices]
    sets = []
    for number in range(count - len(devices)):
        size = chance.randint(2, 6)
        sets.append((chance.sample(elements, size), chance.randint(3, 12) * size // 2 + 1, number))
    covered = {element for elements_, _, _ in sets for element in elements_}
    rest = [element for element in elements if element not in covered]
    for members, cost, number in sets:
        needs = chance.sample(devices, chance.randint(0, 2)) if devices else []
        library.append(make(f"set {number}", needs, members, cost))
    library.append(make("rest", [], rest or ["Other"], 40))
    return library


def least_cost(library: Sequence[Transformation]) -> int:
    """Solve a library without cycles as a mixed integer program.

    Each demand of a used transformation is met by another one that is used.
    """
    makers: Dict[str, List[int]] = {}
    demands: List[Tuple[int, str]] = []
    for number, each in enumerate(library):
        for port in each.ports:
            if port.direction == OUT:
                makers.setdefault(port.tags[0], []).append(number)
            else:
                demands.append((number, port.tags[0]))
    matrix = numpy.zeros((len(demands), len(library)))
    for row, (user, tag) in zip(matrix, demands):
        row[makers[tag]] = 1
        row[user] = -1
    found = solver.milp(
        [each.cost for each in library],
        integrality=numpy.ones(len(library)),
        bounds=solver.Bounds([each.label == "goal" for each in library], 1),
        constraints=solver.LinearConstraint(matrix, 0, numpy.inf),
    )
    assert found.success
    return round(found.fun)


def plan(
    library: List[Transformation], budget: float, clock: Callable[[], float] = lambda: 0.0
) -> Plan:
    """Plan by the count of steps alone, unless there is a clock."""
    planner = Planner(clock=clock)
    planner.know(library)
    answer = planner.plan(demand("Goal"), budget=budget)
    assert isinstance(answer, Plan)
    return answer


def judge(seeds: range) -> None:
    good = 0
    for seed in seeds:
        library = set_cover(seed)
        expected = least_cost(library)
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
