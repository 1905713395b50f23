# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Stated latencies, and stated rates, in plans: against brute force, and by examples."""

from __future__ import annotations

from typing import List, Sequence

import pytest
from unit.manager.planning.brute_force import (
    Problem,
    TooLarge,
    assert_valid,
    least_cost,
    least_latency,
)
from unit.manager.planning.random_problems import random_problem, with_limits

from dyknow.manager.planning import library
from dyknow.manager.planning.explanation import as_tree, tree_as_dot
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Answer, Demand, Live, NoPlan, Plan, TaggedStream
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.transformation import Port, Transformation

_SHARE = 1_000


def solve(problem: Problem) -> Answer:
    planner = Planner(problem.ontology, clock=lambda: 0.0)
    planner.add(problem.library)
    return planner.plan(problem.goal, problem.live, problem.exclude, budget=1.0)


def compare(seeds: range) -> None:
    plans, proven, dearer, late, skipped = 0, 0, 0, 0, 0
    for seed in seeds:
        problem = with_limits(random_problem(seed), seed)
        answer = solve(problem)
        try:
            expected = least_cost(problem)
            at_any_age = problem._replace(goal=problem.goal._replace(max_age=0.0))
            unlimited = least_cost(at_any_age)
        except TooLarge:
            skipped += 1
            continue
        if isinstance(answer, NoPlan):
            assert expected is None, seed
            late += bool(answer.latency)
            assert bool(answer.latency) == (unlimited is not None), seed
            if answer.latency:
                assert answer.latency == pytest.approx(least_latency(problem)), seed
            continue
        assert expected is not None, seed
        assert unlimited is not None, seed
        assert_valid(answer, problem)
        assert not problem.goal.max_age or answer.latency <= problem.goal.max_age, seed
        assert answer.least_cost <= expected <= answer.cost, seed
        plans += 1
        dearer += expected > unlimited
        proven += answer.least_cost == answer.cost
    assert plans > len(seeds) // 3
    assert proven > 0.99 * plans
    assert dearer > plans // 30
    assert late > plans // 10
    assert skipped < len(seeds) // 25


@pytest.fixture(autouse=True, params=[0, library.MANY])
def many(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Look makers up by known names, also where they are few."""
    monkeypatch.setattr(library, "MANY", request.param)


def test_a_share_of_random_libraries() -> None:
    compare(range(_SHARE // 4))


@pytest.mark.long
@pytest.mark.parametrize("block", range(10))
def test_random_libraries(block: int) -> None:
    compare(range(block * _SHARE, (block + 1) * _SHARE))


def make(
    label: str, needs: Sequence[str], supplied: str, cost: int, latency: float
) -> Transformation:
    ports = [Port(f"in{number}", "in", "", (need,)) for number, need in enumerate(needs)]
    ports.append(Port("out", "out", "", (supplied,), 0.0, latency))
    return Transformation(label, "p/X", cost=cost, ports=tuple(ports))


LIBRARY = [
    make("camera", [], "Image(field)", 1, 0.03),
    make("network", ["Image(field)"], "Ball(field)", 1, 0.2),
    make("colors", ["Image(field)", "Lamps(field)"], "Ball(field)", 3, 0.01),
    make("lamps", [], "Lamps(field)", 1, 0.05),
]


def ball(max_age: float, live: Sequence[TaggedStream] = ()) -> Answer:
    planner = Planner()
    planner.add(LIBRARY)
    goal = Demand(frozenset((parse_tag("Ball(field)"),)), max_age=max_age)
    return planner.plan(goal, live)


def labels(answer: Answer) -> List[str]:
    assert isinstance(answer, Plan)
    return [step.action.label for step in answer.steps]


def test_the_longest_path_counts() -> None:
    answer = ball(0.06)
    assert labels(answer) == ["camera", "lamps", "colors"]
    assert isinstance(answer, Plan)
    assert (answer.cost, answer.least_cost, answer.latency) == (5, 5, 0.06)
    tree = as_tree(answer)
    first = "Ball(field) [at most 0.06 s old]: cost 5 (proven least), latency 0.06 s as stated"
    assert tree.split("\n")[0] == first
    assert "latency 0.06 s" in tree_as_dot(tree)


def test_without_a_limit_the_latency_is_told_and_decides_nothing() -> None:
    answer = ball(0.0)
    assert labels(answer) == ["camera", "network"]
    assert as_tree(answer).split("\n")[0] == (
        "Ball(field): cost 2 (proven least), latency 0.23 s as stated"
    )


def test_when_everything_is_too_late_the_least_latency_is_told() -> None:
    answer = ball(0.05)
    assert isinstance(answer, NoPlan)
    assert str(answer) == (
        "no plan for Ball(field) [at most 0.05 s old]: the soonest plan found takes 0.06 s"
    )
    assert as_tree(answer).endswith("└─ the soonest plan found takes 0.06 s")


@pytest.mark.parametrize(
    ("latency", "expected"), [(0.02, ["colors"]), (0.07, ["lamps", "colors"])]
)
def test_live_streams_are_as_late_as_they_state(latency: float, expected: List[str]) -> None:
    lamps = Live("/lamps", "out", "/lamps_1", "lamps", "", latency=latency)
    image = Live("/image", "out", "/camera_1", "camera", "", latency=0.03)
    streams = [
        (lamps, (parse_tag("Lamps(field)"),)),
        (image, (parse_tag("Image(field)"),)),
    ]
    answer = ball(0.06, streams)
    assert labels(answer) == expected
    assert isinstance(answer, Plan)
    assert image in answer.live
    assert (lamps in answer.live) == (latency < 0.05)


def test_of_several_out_ports_the_soonest_one_supplies() -> None:
    ports = (
        Port("full", "out", "", ("Image(field)",), 0.0, 0.1),
        Port("half", "out", "", ("Image(field)",), 0.0, 0.02),
    )
    planner = Planner()
    planner.add([Transformation("camera", "p/C", ports=ports)])
    answer = planner.plan(Demand(frozenset((parse_tag("Image(field)"),)), max_age=0.05))
    assert isinstance(answer, Plan)
    assert answer.goal.port == "half"


def test_latencies_of_what_is_gone_are_forgotten() -> None:
    planner = Planner()
    planner.add(LIBRARY)
    planner.add([make("network", ["Image(field)"], "Ball(field)", 1, 0.0)])
    answer = planner.plan(Demand(frozenset((parse_tag("Ball(field)"),)), max_age=0.05))
    assert labels(answer) == ["camera", "network"]


def test_of_several_out_ports_one_supplies_that_is_fast_enough() -> None:
    """An out-port that states no rate is as fast as its inputs; a slow one beside it is not."""
    ports = (
        Port("in", "in", "", ("Raw(field)",)),
        Port("preview", "out", "", ("Image(field)",), 5.0),
        Port("whole", "out", "", ("Image(field)",), 0.0, 0.02),
    )
    planner = Planner()
    planner.add(
        [make("camera", [], "Raw(field)", 1, 0.0), Transformation("filter", "p/F", ports=ports)]
    )
    answer = planner.plan(Demand(frozenset((parse_tag("Image(field)"),)), min_rate=10.0))
    assert isinstance(answer, Plan)
    assert answer.goal.port == "whole"
