# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The planner against one that tries everything."""

from __future__ import annotations

import itertools
import random
from typing import List

import pytest
from unit.manager.planning.brute_force import (
    Problem,
    TooLarge,
    assert_valid,
    individuals,
    is_typed,
    least_cost,
)
from unit.manager.planning.random_problems import random_problem

from dyknow.manager.planning import library
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Answer, Demand, NoPlan, Plan
from dyknow.manager.specifications.tags import NO_ONTOLOGY, parse_tag
from dyknow.model.transformation import Port, Transformation

_SHARE = 1_000


def solve(problem: Problem, seed: int = 0) -> Answer:
    """Plan by the count of steps alone, which no other process disturbs."""
    library = list(problem.library)
    random.Random(seed).shuffle(library)
    planner = Planner(problem.ontology, clock=lambda: 0.0)
    planner.add(library)
    return planner.plan(problem.goal, problem.live, problem.exclude, budget=1.0)


@pytest.fixture(autouse=True, params=[0, library.MANY])
def many(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Look makers up by known names, also where they are few."""
    monkeypatch.setattr(library, "MANY", request.param)


def compare(seeds: range) -> None:
    plans, proven, skipped, bound, several = 0, 0, 0, 0, 0
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
        bound += any(step.bindings for step in answer.steps)
        several += any(len(step.bindings) > 1 for step in answer.steps)
    assert plans > len(seeds) // 3
    assert bound > plans // 4
    assert several > plans // 12
    assert proven > 0.99 * plans
    assert skipped < len(seeds) // 50


def test_a_share_of_random_libraries() -> None:
    compare(range(_SHARE // 3))


def _rectified(seed: int) -> Problem:
    """Write a problem in which one nodelet is free, and more than one may be needed."""
    chance = random.Random(seed)

    def make(label: str, needs: List[str], supplied: str) -> Transformation:
        ports = [Port(f"in{number}", "in", "", (need,)) for number, need in enumerate(needs)]
        ports.append(Port("out", "out", "", (supplied,)))
        return Transformation(label, "p/X", cost=chance.randint(0, 9), ports=tuple(ports))

    cameras = [f"cam{number}" for number in range(chance.randint(2, 4))]
    library = [make(each, [], f"Raw({each})") for each in cameras]
    library += [
        make(f"other {each}", [], f"Rect({each})") for each in cameras if chance.random() < 0.7
    ]
    library.append(make("rectifier", ["Raw(?c)"], "Rect(?c)"))
    library.append(make("depth", [f"Rect({each})" for each in cameras], "Depth"))
    goal = Demand(frozenset([parse_tag("Depth")]))
    free = ("rectifier",) if chance.random() < 0.8 else ("rectifier", *cameras[:1])
    return Problem(tuple(library), (), frozenset(), goal, NO_ONTOLOGY, free)


def test_one_nodelet_of_what_is_free_costs_nothing() -> None:
    twice = 0
    for seed in range(150):
        problem = _rectified(seed) if seed % 3 else random_problem(seed)
        if not problem.free:
            labels = [each.label for each in problem.library]
            chosen = random.Random(seed).sample(labels, len(labels) // 2)
            problem = problem._replace(free=tuple(chosen))
        free = {label: () for label in problem.free}
        planner = Planner(problem.ontology, clock=lambda: 0.0)
        planner.add(problem.library)
        answer = planner.plan(problem.goal, problem.live, problem.exclude, free, budget=1.0)
        expected = least_cost(problem)
        assert isinstance(answer, NoPlan) is (expected is None), seed
        if isinstance(answer, Plan):
            assert expected is not None
            assert answer.cost == answer.least_cost == expected, seed
            used = [each.action.label for each in answer.steps if each.action.label in free]
            twice += len(used) > len({*used})
    assert twice > 10


def test_a_second_search_may_find_other_inputs_for_an_instance() -> None:
    answer = solve(random_problem(6181))
    assert isinstance(answer, Plan)
    assert_valid(answer, random_problem(6181))
    assert answer.cost == least_cost(random_problem(6181))


def test_of_several_out_ports_one_is_taken_that_supplies_the_names() -> None:
    problem = random_problem(23169)
    answer = solve(problem)
    assert isinstance(answer, Plan)
    assert_valid(answer, problem)
    assert answer.cost == least_cost(problem)


@pytest.mark.parametrize("seed", [4678, 17328, 28605])
def test_ties_do_not_depend_on_the_order_in_which_demands_were_met(seed: int) -> None:
    problem = random_problem(seed)
    assert solve(problem, 1) == solve(problem)


def test_what_the_variables_of_a_demand_can_stand_for() -> None:
    """Those names that can be put in their places; a class would stand for its individuals too."""
    several = 0
    for seed in range(_SHARE // 4):
        problem = random_problem(seed)
        tags, canonical = list(problem.goal.tags), problem.ontology.canonical
        variables = sorted({each for term in tags for each in term.variables})
        planner = Planner(problem.ontology, clock=lambda: 0.0)
        planner.add(each for each in problem.library if each.label not in problem.exclude)
        live = [each for each in problem.live if each[0].label not in problem.exclude]
        names = [name for name in individuals(problem) if name.islower()]
        expected = set()
        for each in itertools.product(names, repeat=len(variables)):
            ground = frozenset(term.substitute(dict(zip(variables, each))) for term in tags)
            answer = planner.plan(problem.goal._replace(tags=ground), live)
            is_right = is_typed(tags, dict(zip(variables, each)), problem.ontology)
            if is_right and isinstance(answer, Plan):
                expected.add(tuple(zip(variables, map(canonical, each))))
        found, are_all = planner.bindings(problem.goal, live)
        known = [tuple((x, canonical(name)) for x, name in each) for each in found]
        known = [each for each in known if all(name.islower() for _, name in each)]
        assert are_all
        assert set(known) == expected, seed
        assert len(known) == len(expected)
        several += len(expected) > 1
    assert several > 10


@pytest.mark.long
@pytest.mark.parametrize("block", range(30))
def test_random_libraries(block: int) -> None:
    compare(range(block * _SHARE, (block + 1) * _SHARE))
