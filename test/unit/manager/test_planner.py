# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Planning by examples: missing streams, free nodelets, old transformations, and late plans."""

from __future__ import annotations

import gc
from typing import Iterable, List

import pytest
from unit.manager.planning.examples import demand, labels, make, planner_with

from dyknow.manager.planning.explanation import as_tree, tree_as_dot
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Answer, NoPlan, Plan
from dyknow.model.transformation import Transformation


def plan(transformations: Iterable[Transformation], tag: str, **kwds) -> Answer:  # type: ignore[no-untyped-def]
    return planner_with(transformations).plan(demand(tag), **kwds)


def test_a_circle_is_no_plan_and_is_called_one() -> None:
    answer = plan([make("a", ["B"], ["A"]), make("b", ["A"], ["B"])], "A")
    assert isinstance(answer, NoPlan)
    assert answer.circular
    assert "needs it first" in str(answer)


def test_a_replaced_and_a_removed_transformation_are_forgotten() -> None:
    planner = Planner()
    planner.know([make("a", [], ["A"], 7)])
    planner.know([make("a", [], ["B"], 3)])
    assert isinstance(planner.plan(demand("A")), NoPlan)
    planner.know([make("a", [], ["B"], 3), make("c", [], ["B"], 3)])
    planner.know([])
    assert isinstance(planner.plan(demand("B")), NoPlan)
    assert len(planner) == 0


def test_stacked_diamonds_overflow_nothing() -> None:
    depth = 1100
    library = [make("bottom", [], ["D0"])]
    for level in range(depth):
        library += [
            make(f"left{level}", [f"D{level}"], [f"L{level}"]),
            make(f"right{level}", [f"D{level}"], [f"R{level}"]),
            make(f"join{level}", [f"L{level}", f"R{level}"], [f"D{level + 1}"]),
        ]
    answer = plan(library, f"D{depth}")
    assert isinstance(answer, Plan)
    assert answer.cost == 3 * depth + 1


def test_what_is_missing_is_named_as_it_is_written_now() -> None:
    planner = Planner()
    planner.know([make("map", ["Image(?a)", "Pose(?a)"], ["Map(?a)"])])
    assert isinstance(planner.plan(demand("Map(?which)")), NoPlan)
    planner.know([make("map", ["Image(?b)", "Pose(?b)"], ["Map(?b)"])])
    answer = planner.plan(demand("Map(?which)"))
    assert isinstance(answer, NoPlan)
    assert [str(each) for each in answer.missing] == ["Image(?b)", "Pose(?b)"]


def test_a_nodelet_is_free_under_the_bindings_that_it_has() -> None:
    library = [
        make("cam1", [], ["Raw(cam1)"], 0),
        make("cam2", [], ["Raw(cam2)"], 0),
        make("rectifier", ["Raw(?c)"], ["Rect(?c)"], 2),
    ]
    free = {"rectifier": [(("?c", "cam1"),)]}
    assert plan(library, "Rect(cam1)", free=free).cost == 0
    assert plan(library, "Rect(cam2)", free=free).cost == 2
    free["rectifier"].append((("?c", "cam2"),))
    assert plan(library, "Rect(cam1)", free=free).cost == 0
    assert plan(library, "Rect(cam2)", free=free).cost == 0


def test_a_nodelet_that_is_free_does_not_allow_another_one() -> None:
    library = [
        make("cam1", [], ["Raw(cam1)"], 0),
        make("cam2", [], ["Raw(cam2)"], 0),
        make("rectifier", ["Raw(?c)"], ["Rect(?c)"], 2),
        make("stereo", ["Rect(cam1)", "Rect(cam2)"], ["Depth"], 1),
    ]
    free, paused = {"rectifier": [(("?c", "cam1"),)]}, {"rectifier"}
    assert plan(library, "Rect(cam1)", free=free, paused=paused).cost == 0
    why = "no nodelet of rectifier is free, and none is made now"
    answer = plan(library, "Rect(cam2)", free=free, paused=paused)
    assert str(answer) == f"no plan for Rect(cam2): Rect(cam2) cannot be used: {why}"
    answer = plan(library, "Depth", free={"rectifier": [()]}, paused=paused)
    assert str(answer) == f"no plan for Depth: Depth cannot be used: {why}"
    library += [make("other", [], ["Rect(cam2)"], 9), make("another", [], ["Rect(cam1)"], 8)]
    answer = plan(library, "Depth", free=free, paused=paused)
    assert labels(answer) == ["cam1", "rectifier", "other", "stereo"]
    answer = plan(library, "Depth", free={"rectifier": [()]}, paused=paused)
    assert labels(answer) == ["another", "cam2", "rectifier", "stereo"]


LATENT = [
    make("camera", [], ["Image(field)"], 1, latency=0.03),
    make("network", ["Image(field)"], ["Ball(field)"], 1, latency=0.2),
    make("colors", ["Image(field)", "Lamps(field)"], ["Ball(field)"], 3, latency=0.01),
    make("lamps", [], ["Lamps(field)"], 1, latency=0.05),
]


@pytest.mark.parametrize(
    ("max_age", "steps", "first"),
    [
        (0.06, ["camera", "lamps", "colors"], " [at most 0.06 s old]: cost 5 (proven least)"),
        # Without a limit the latency is reported and decides nothing.
        (0.0, ["camera", "network"], ": cost 2 (proven least)"),
    ],
)
def test_the_longest_path_counts_and_is_told(max_age: float, steps: List[str], first: str) -> None:
    answer = planner_with(LATENT).plan(demand("Ball(field)", max_age=max_age))
    assert labels(answer) == steps
    assert isinstance(answer, Plan)
    assert answer.latency == pytest.approx(max_age or 0.23)
    told = f"latency {max_age or 0.23} s"
    assert as_tree(answer).split("\n")[0] == f"Ball(field){first}, {told} as stated"
    assert told in tree_as_dot(as_tree(answer))


def test_when_everything_is_too_late_the_least_latency_is_told() -> None:
    answer = planner_with(LATENT).plan(demand("Ball(field)", max_age=0.05))
    why = "the soonest plan found takes 0.06 s"
    assert str(answer) == f"no plan for Ball(field) [at most 0.05 s old]: {why}"
    assert as_tree(answer).endswith(f"└─ {why}")


def test_garbage_of_other_parts_is_collected_between_plans() -> None:
    threshold = gc.get_threshold()
    planner = Planner()
    gc.set_threshold(10**6)
    try:
        young = [planner]
        cameras = [make("camera", [], ["A", "B"], 3), make("other", [], ["A"], 2)]
        planner.know([*cameras, make("stereo", ["A", "B"], ["C"])])
        assert isinstance(planner.plan(demand("C")), Plan)
        assert any(each is young for each in gc.get_objects(generation=0))
        assert gc.isenabled() and gc.get_threshold()[0] == 10**6
    finally:
        gc.set_threshold(*threshold)
