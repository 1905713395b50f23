# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Planning by examples: what is missing, what is free, what is forgotten."""

from __future__ import annotations

import gc
from typing import FrozenSet, Iterable

from unit.manager.planning.examples import demand, labels, make, planner_with

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Answer, NoPlan, Plan
from dyknow.model.transformation import Transformation


def plan(transformations: Iterable[Transformation], tag: str, **kwds) -> Answer:  # type: ignore[no-untyped-def]
    return planner_with(transformations).plan(demand(tag), **kwds)


def test_what_is_missing_is_named() -> None:
    library = [
        make("a", ["B", "C"], ["A"]),
        make("b", ["D"], ["B"]),
        make("c", [], ["C"]),
        make("other", ["E"], ["F"]),
    ]
    answer = plan(library, "A")
    assert isinstance(answer, NoPlan)
    assert [str(each) for each in answer.missing] == ["D"]
    assert "nothing supplies D" in str(answer)
    nothing = plan(library, "Z(?x)")
    assert isinstance(nothing, NoPlan)
    assert "nothing supplies Z(?x)" in str(nothing)


def test_a_circle_is_no_plan_and_is_called_one() -> None:
    answer = plan([make("a", ["B"], ["A"]), make("b", ["A"], ["B"])], "A")
    assert isinstance(answer, NoPlan)
    assert answer.circular
    assert "needs it first" in str(answer)


def test_a_replaced_and_a_removed_transformation_are_forgotten() -> None:
    planner = Planner()
    planner.add([make("a", [], ["A"], 7)])
    planner.add([make("a", [], ["B"], 3)])
    assert isinstance(planner.plan(demand("A")), NoPlan)
    planner.add([make("c", [], ["B"], 3)])
    planner.remove("a", "c", "nonesuch")
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


def test_what_is_missing_under_bindings_is_named() -> None:
    library = [
        make("image", [], ["Image(cam1)"]),
        make("pose", [], ["Pose(cam2)"]),
        make("map", ["Image(?c)", "Pose(?c)"], ["Map(?c)"]),
    ]
    answer = plan(library, "Map(?which)")
    assert isinstance(answer, NoPlan)
    assert [str(each) for each in answer.missing] == ["Pose(cam1)"]
    answer = plan(library, "Map(cam2)")
    assert isinstance(answer, NoPlan)
    assert [str(each) for each in answer.missing] == ["Image(cam2)"]


def test_names_beside_a_variable_in_what_is_supplied_are_looked_up() -> None:
    class Sizes:
        def names_above(self, name: str) -> FrozenSet[str]:
            return frozenset((name, "size")) if name == "half" else frozenset((name,))

        def canonical(self, name: str) -> str:
            return name

    library = [make("cam", [], ["Raw(cam)"]), make("part", ["Raw(?c)"], ["Part(?c, half)"])]
    planner = planner_with(library, Sizes())
    for wanted in ("Part(?c, half)", "Part(cam, size)"):
        answer = planner.plan(demand(wanted))
        assert isinstance(answer, Plan) and answer.cost == 2, answer
    assert isinstance(planner.plan(demand("Part(cam, quarter)")), NoPlan)


def test_a_nodelet_with_a_variable_of_one_port_is_free_as_well() -> None:
    library = [
        make("camera", [], ["Raw(a)"], 0),
        make("running", ["Raw(?x)"], ["Goal(b)"], 5),
        make("cheap", ["Raw(a)"], ["Goal(b)"], 1),
    ]
    found = plan(library, "Goal(b)", free={"running": ()})
    assert isinstance(found, Plan)
    assert [step.action.label for step in found.steps] == ["camera", "running"]
    assert found.cost == 0


def test_what_is_missing_is_named_as_it_is_written_now() -> None:
    planner = Planner()
    planner.add([make("map", ["Image(?a)", "Pose(?a)"], ["Map(?a)"])])
    assert isinstance(planner.plan(demand("Map(?which)")), NoPlan)
    planner.add([make("map", ["Image(?b)", "Pose(?b)"], ["Map(?b)"])])
    answer = planner.plan(demand("Map(?which)"))
    assert isinstance(answer, NoPlan)
    assert [str(each) for each in answer.missing] == ["Image(?b)", "Pose(?b)"]


def test_one_nodelet_is_free_for_one_instance() -> None:
    library = [
        make("cam1", [], ["Raw(cam1)"], 0),
        make("cam2", [], ["Raw(cam2)"], 0),
        make("rectifier", ["Raw(?c)"], ["Rect(?c)"], 2),
        make("stereo", ["Rect(cam1)", "Rect(cam2)"], ["Depth"], 0),
    ]
    assert plan(library, "Rect(cam1)", free={"rectifier": (("?c", "cam1"),)}).cost == 0
    assert plan(library, "Rect(cam2)", free={"rectifier": (("?c", "cam1"),)}).cost == 2
    assert plan(library, "Rect(cam2)", free={"rectifier": ()}).cost == 0
    assert plan(library, "Depth", free={"rectifier": ()}).cost == 2


SLOW, FAST = make("slow", [], ["Raw"], rate=5.0), make("fast", [], ["Raw"], 9, rate=30.0)
FILTER = make("filter", ["Raw"], ["Smooth"], 1)


def fast_plan(*transformations: Transformation) -> Answer:
    return planner_with(transformations).plan(demand("Smooth", min_rate=10.0))


def test_a_port_that_states_no_rate_is_as_fast_as_what_feeds_it() -> None:
    refused = str(fast_plan(SLOW, FILTER))
    assert "Raw [at least 10 Hz] cannot be used: it is stated at 5 Hz, below 10 Hz" in refused
    assert labels(fast_plan(SLOW, FAST, FILTER)) == ["fast", "filter"]
    assert labels(fast_plan(SLOW, FAST, make("filter", ["Raw"], ["Smooth"], rate=20.0))) == [
        "slow",
        "filter",
    ]


def test_a_nodelet_with_slow_inputs_does_not_feed_itself_with_fast_ones() -> None:
    # The tree that costs least has the filter twice: after the camera and after the doubler.
    doubler = make("doubler", ["Smooth"], ["Raw"], rate=30.0)
    answer = fast_plan(SLOW, FAST, FILTER, doubler)
    assert labels(answer) == ["fast", "filter"]
    assert isinstance(answer, Plan)
    assert answer.cost == answer.least_cost == 10
    refused = fast_plan(SLOW, FILTER, doubler)
    assert isinstance(refused, NoPlan)
    assert refused.circular
    # Another nodelet before the doubler breaks the circle.
    other = make("other filter", ["Raw"], ["Smooth"], 2)
    answer = fast_plan(SLOW, FAST, FILTER, doubler, other)
    assert isinstance(answer, Plan)
    assert answer.cost == 5
    assert len({*labels(answer)}) == 4


def test_what_the_garbage_collector_collects_and_when_is_left_alone() -> None:
    is_on = []
    planner = Planner(clock=lambda: float(is_on.append(gc.isenabled()) or 0.0))
    threshold = gc.get_threshold()
    gc.set_threshold(10**6)
    try:
        young = [planner]
        cameras = [make("camera", [], ["A", "B"], 3), make("other", [], ["A"], 2)]
        planner.add([*cameras, make("stereo", ["A", "B"], ["C"])])
        assert isinstance(planner.plan(demand("C")), Plan)
        assert any(each is young for each in gc.get_objects(generation=0))
    finally:
        gc.set_threshold(*threshold)
    assert is_on and all(is_on)
