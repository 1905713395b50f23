# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The planner against one that tries everything."""

from __future__ import annotations

import random
from collections import Counter
from typing import Dict, List, Tuple

import pytest
from unit.manager.planning.brute_force import (
    Problem,
    TooLarge,
    assert_valid,
    individuals,
    least_cost,
    least_latency,
    ways,
)
from unit.manager.planning.examples import planner_with
from unit.manager.planning.random_problems import (
    look_up_by_name,
    random_problem,
    with_limits,
    with_nodelets,
    with_verdicts,
    with_wishes,
)

from dyknow.manager.planning.problem import NO_VERDICTS, Answer, Demand, NoPlan, Plan
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Bindings, parse_tag
from dyknow.model.transformation import Port, Transformation

_SHARE = 1_000


def solve(problem: Problem, seed: int = 0) -> Answer:
    transformations = list(problem.library)
    random.Random(seed).shuffle(transformations)
    free: Dict[str, List[Bindings]] = {}
    for label, kept in problem.free:
        free.setdefault(label, []).append(kept)
    return planner_with(transformations, problem.ontology).plan(
        problem.goal,
        problem.live,
        problem.exclude,
        free,
        problem.paused,
        budget=1.0,
        wishes=problem.wishes,
        verdicts=problem.verdicts,
    )


def charged(problem: Problem) -> Problem:
    """Write charges into costs; live streams that are charged become transformations."""
    planner = planner_with(problem.library, problem.ontology)
    charges = planner.charges(problem.goal, problem.live, problem.exclude, problem.wishes)
    library = [
        each._replace(cost=each.cost + charges.get(each.label, 0)) for each in problem.library
    ]
    live = []
    for number, (stream, terms) in enumerate(problem.live):
        cost = charges.get(stream.label, 0)
        if cost:
            port = Port("out0", "out", stream.datatype, tuple(map(str, terms)))
            library.append(Transformation(f"live{number}", "", cost=cost, ports=(port,)))
        else:
            live.append((stream, terms))
    return problem._replace(library=tuple(library), live=tuple(live))


#: Features of problems besides tags: limits that are stated and demanded, verdicts, wishes, or
#: nodelets that are free, also with limits.
KINDS = ("tags", "limits", "verdicts", "wishes", "nodelets", "nodelets and limits")


def judge(seed: int, kind: str, monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Judge a plan and its bound, or a refusal; count its features."""
    look_up_by_name(monkeypatch, seed)
    problem = random_problem(seed)
    if "limits" in kind:
        problem = with_limits(problem, seed)
    if "nodelets" in kind:
        problem = with_nodelets(problem, seed)
    if kind == "verdicts":
        problem = with_verdicts(problem, seed)
    if kind == "wishes":
        problem = with_wishes(problem, seed)
    goal = problem.goal
    answer = solve(problem)
    assert solve(problem, 1) == answer, seed
    priced = charged(problem) if kind == "wishes" else problem
    try:
        expected = at_any_age = least_cost(priced)
        if goal.max_age:
            at_any_age = least_cost(problem._replace(goal=goal._replace(max_age=0.0)))
    except TooLarge:
        return Counter(skipped=1)
    if isinstance(answer, NoPlan):
        assert expected is None, seed
        if "nodelets" not in kind:
            assert bool(answer.latency) == (at_any_age is not None), seed
        if answer.latency:
            soonest = least_latency(problem)  # with as many nodelets as it takes
            assert at_any_age is not None, seed
            assert answer.latency == pytest.approx(soonest) or "nodelets" in kind, seed
        is_forbidden = kind == "verdicts" and isinstance(
            solve(problem._replace(verdicts=NO_VERDICTS)), Plan
        )
        return Counter(late=bool(answer.latency), forbidden=is_forbidden)
    assert expected is not None and at_any_age is not None, seed
    assert_valid(answer, problem)
    assert goal.is_soon(answer.latency), seed
    assert answer.least_cost <= expected <= answer.cost, seed
    return Counter(
        plans=1,
        proven=answer.least_cost == answer.cost,
        dearer=expected > at_any_age,
        bound=any(step.instance.bindings for step in answer.steps),
        several=any(len(step.instance.bindings) > 1 for step in answer.steps),
        charged=any(step.charge for step in answer.steps) or bool(answer.charges),
        other="nodelets" in kind and expected != least_cost(_with_one_of_each(problem)),
    )


def _with_one_of_each(problem: Problem) -> Problem:
    """Leave one free nodelet of each transformation."""
    return problem._replace(free=tuple(dict(problem.free).items()))


def judge_all(seeds: range, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    count: Counter[str] = Counter()
    for seed in seeds:
        count += judge(seed, kind, monkeypatch)
    plans = count["plans"]
    assert plans > len(seeds) // (4 if kind == "verdicts" else 3)
    assert count["proven"] > 0.99 * plans
    assert count["skipped"] < len(seeds) // (25 if kind == "limits" else 50)
    if "nodelets" in kind:
        assert count["other"] > plans // (50 if kind == "nodelets" else 200)
    elif kind == "limits":
        assert count["dearer"] > plans // 30
        assert count["late"] > plans // 10
    elif kind == "verdicts":
        assert count["forbidden"] > len(seeds) // 100
    elif kind == "wishes":
        assert count["charged"] > plans // 6
    else:
        assert count["bound"] > plans // 4
        assert count["several"] > plans // 12


@pytest.mark.parametrize("kind", KINDS)
def test_a_share_of_random_libraries(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    judge_all(range(_SHARE // 8), monkeypatch, kind)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("block", range(30))
def test_random_libraries(block: int, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    judge_all(range(block * _SHARE, (block + 1) * _SHARE), monkeypatch, kind)


@pytest.mark.parametrize(
    ("seed", "kind"),
    [
        pytest.param(6181, "tags", id="a second search finds other inputs for an instance"),
        pytest.param(23169, "tags", id="of several out-ports one supplies the names"),
        pytest.param(439, "limits", id="a nodelet with slow inputs feeds its own fast inputs"),
        pytest.param(2793, "limits", id="the same, but there is another way"),
        *[pytest.param(seed, "tags", id=f"ties {seed}") for seed in (4678, 17328, 28605)],
    ],
)
def test_an_answer_that_was_wrong_once(
    seed: int, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge(seed, kind, monkeypatch)


def _rectified(seed: int) -> Problem:
    """Write a problem in which nodelets are free, and more than one may be needed."""
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
    free: List[Tuple[str, Bindings]] = [("rectifier", ())]
    for _ in range(chance.choice([0, 1, 1, 2])):
        free.append(("rectifier", (("?c", chance.choice(cameras)),)))
    if chance.random() < 0.3:
        free = free[1:]
    if chance.random() < 0.2:
        free.append((cameras[0], ()))
    paused = frozenset(["rectifier"] if chance.random() < 0.3 else [])
    return Problem(tuple(library), (), frozenset(), goal, NO_ONTOLOGY, tuple(free), paused=paused)


def test_each_nodelet_that_is_free_saves_the_cost_of_one() -> None:
    twice = dearer = none = 0
    for seed in range(300):
        problem = _rectified(seed)
        answer, expected = solve(problem), least_cost(problem)
        assert isinstance(answer, NoPlan) is (expected is None), seed
        if isinstance(answer, NoPlan):
            causes = {each for obstacle in answer.obstacles for each in obstacle.causes}
            assert causes == {"no nodelet of rectifier is free, and none is made now"}, seed
            none += 1
            continue
        assert_valid(answer, problem)
        assert answer.cost == answer.least_cost == expected, seed
        costs = [step.cost for step in answer.steps if step.instance.label == "rectifier"]
        twice += costs.count(0) > 1
        dearer += any(costs)
    assert twice > 60 and dearer > 40 and none > 10


def test_what_the_variables_of_a_demand_can_stand_for() -> None:
    """Those names that can be put in their places; a class would stand for its individuals too."""
    several = 0
    for seed in range(_SHARE // 4):
        problem = random_problem(seed)
        tags, canonical = list(problem.goal.tags), problem.ontology.canonical
        usable = [each for each in problem.library if each.label not in problem.exclude]
        planner = planner_with(usable, problem.ontology)
        live = [each for each in problem.live if each[0].label not in problem.exclude]
        names = [name for name in individuals(problem) if name.islower()]
        expected = set()
        for way in ways(tags, names, problem.ontology):
            ground = frozenset(term.substitute(way) for term in tags)
            if isinstance(planner.plan(problem.goal._replace(tags=ground), live), Plan):
                expected.add(tuple((x, canonical(name)) for x, name in way.items()))
        found, are_all = planner.bindings(problem.goal, live)
        known = [tuple((x, canonical(name)) for x, name in each) for each in found]
        known = [each for each in known if all(name.islower() for _, name in each)]
        assert are_all
        assert set(known) == expected, seed
        assert len(known) == len(expected)
        several += len(expected) > 1
    assert several > 10
