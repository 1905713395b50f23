# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The planner against one that tries everything."""

from __future__ import annotations

import random

import pytest
from unit.manager.planning.brute_force import Problem, TooLarge, assert_valid, least_cost
from unit.manager.planning.random_problems import random_problem

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Answer, NoPlan

_SHARE = 1_000


def solve(problem: Problem, seed: int = 0) -> Answer:
    library = list(problem.library)
    random.Random(seed).shuffle(library)
    planner = Planner(problem.ontology)
    planner.add(library)
    return planner.plan(problem.goal, problem.live, problem.exclude, budget=1.0)


def compare(seeds: range) -> None:
    plans, proven, skipped = 0, 0, 0
    for seed in seeds:
        problem = random_problem(seed)
        answer = solve(problem)
        assert solve(problem, 1) == answer, seed
        try:
            expected = least_cost(problem)
        except TooLarge:
            skipped += 1
            continue
        if isinstance(answer, NoPlan):
            assert expected is None, seed
            continue
        assert expected is not None, seed
        assert_valid(answer, problem)
        assert answer.least_cost <= expected <= answer.cost, seed
        plans += 1
        proven += answer.least_cost == answer.cost
    assert plans > len(seeds) // 10
    assert proven > 0.99 * plans
    assert skipped < len(seeds) // 50


def test_a_share_of_random_libraries() -> None:
    compare(range(_SHARE))


@pytest.mark.long
@pytest.mark.parametrize("block", range(29))
def test_random_libraries(block: int) -> None:
    compare(range((block + 1) * _SHARE, (block + 2) * _SHARE))
