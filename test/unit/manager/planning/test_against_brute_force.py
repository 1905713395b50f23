# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The planner against one that tries everything."""

from __future__ import annotations

import itertools
import random
from collections import Counter
from typing import List

import pytest
from unit.manager.planning.brute_force import (
    Problem,
    TooLarge,
    assert_valid,
    individuals,
    is_typed,
    least_cost,
    least_latency,
)
from unit.manager.planning.random_problems import (
    look_up_by_name,
    random_problem,
    with_limits,
    with_verdicts,
)

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import NO_VERDICTS, Answer, Demand, NoPlan, Plan
from dyknow.manager.specifications.tags import NO_ONTOLOGY, parse_tag
from dyknow.model.transformation import Port, Transformation

_SHARE = 1_000


def solve(problem: Problem, seed: int = 0) -> Answer:
    """Plan by the count of steps alone, which no other process disturbs."""
    transformations = list(problem.library)
    random.Random(seed).shuffle(transformations)
    planner = Planner(problem.ontology, clock=lambda: 0.0)
    planner.add(transformations)
    return planner.plan(
        problem.goal, problem.live, problem.exclude, budget=1.0, verdicts=problem.verdicts
    )


def judge(
    seed: int,
    has_limits: bool,
    monkeypatch: pytest.MonkeyPatch,
    has_verdicts: bool = False,
) -> Counter[str]:
    """Judge a plan and its bound, or a refusal; count what matters in it."""
    look_up_by_name(monkeypatch, seed)
    problem = random_problem(seed)
    if has_limits:
        problem = with_limits(problem, seed)
    if has_verdicts:
        problem = with_verdicts(problem, seed)
    goal = problem.goal
    answer = solve(problem)
    assert solve(problem, 1) == answer, seed
    try:
        expected = at_any_age = least_cost(problem)
        if goal.max_age:
            at_any_age = least_cost(problem._replace(goal=goal._replace(max_age=0.0)))
    except TooLarge:
        return Counter(skipped=1)
    if isinstance(answer, NoPlan):
        assert expected is None, seed
        assert bool(answer.latency) == (at_any_age is not None), seed
        if answer.latency:
            assert answer.latency == pytest.approx(least_latency(problem)), seed
        return Counter(late=bool(answer.latency))
    assert expected is not None and at_any_age is not None, seed
    assert_valid(answer, problem)
    assert goal.is_soon(answer.latency), seed
    assert answer.least_cost <= expected <= answer.cost, seed
    return Counter(
        plans=1,
        proven=answer.least_cost == answer.cost,
        dearer=expected > at_any_age,
        bound=any(step.bindings for step in answer.steps),
        several=any(len(step.bindings) > 1 for step in answer.steps),
    )


def judge_all(seeds: range, monkeypatch: pytest.MonkeyPatch, has_limits: bool) -> None:
    count: Counter[str] = Counter()
    for seed in seeds:
        count += judge(seed, has_limits, monkeypatch)
    plans = count["plans"]
    assert plans > len(seeds) // 3
    assert count["proven"] > 0.99 * plans
    assert count["skipped"] < len(seeds) // (25 if has_limits else 50)
    if has_limits:
        assert count["dearer"] > plans // 30
        assert count["late"] > plans // 10
    else:
        assert count["bound"] > plans // 4
        assert count["several"] > plans // 12


@pytest.mark.parametrize("has_limits", [False, True])
def test_a_share_of_random_libraries(monkeypatch: pytest.MonkeyPatch, has_limits: bool) -> None:
    judge_all(range(_SHARE // 3), monkeypatch, has_limits)


def test_verdicts_forbid_instances(monkeypatch: pytest.MonkeyPatch) -> None:
    judged: Counter[str] = Counter()
    for seed in range(_SHARE):
        found = judge(seed, False, monkeypatch, has_verdicts=True)
        problem = with_verdicts(random_problem(seed), seed)
        free = solve(problem._replace(verdicts=NO_VERDICTS))
        judged += found
        judged["forbidden"] += isinstance(free, Plan) and not found["plans"]
    assert judged["plans"] > _SHARE // 4
    assert judged["forbidden"] > _SHARE // 50


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
@pytest.mark.parametrize("has_limits", [False, True])
@pytest.mark.parametrize("block", range(30))
def test_random_libraries(block: int, has_limits: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    judge_all(range(block * _SHARE, (block + 1) * _SHARE), monkeypatch, has_limits)


@pytest.mark.parametrize(
    ("seed", "has_limits"),
    [
        pytest.param(6181, False, id="a second search finds other inputs for an instance"),
        pytest.param(23169, False, id="of several out-ports one supplies the names"),
        pytest.param(439, True, id="a nodelet with slow inputs feeds its own fast inputs"),
        pytest.param(2793, True, id="the same, but there is another way"),
        *[pytest.param(seed, False, id=f"ties {seed}") for seed in (4678, 17328, 28605)],
    ],
)
def test_an_answer_that_was_wrong_once(
    seed: int, has_limits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge(seed, has_limits, monkeypatch)
