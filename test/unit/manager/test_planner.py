# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The planner: exact on small problems, quick and without recursion on large ones."""

from __future__ import annotations

import gc
import random
from typing import Dict, FrozenSet, Iterable, List, Optional, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Answer, Demand, Live, New, NoPlan, Plan
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.transformation import Port, Transformation


def make(
    label: str, needs: Sequence[str], gives: Sequence[str], cost: int = 1, datatype: str = ""
) -> Transformation:
    """Make a transformation with one port for each tag; ``a&b`` are two tags of one port."""
    ports = [Port(f"i{i}", "in", datatype, tuple(t.split("&"))) for i, t in enumerate(needs)]
    ports += [Port(f"o{i}", "out", datatype, tuple(t.split("&"))) for i, t in enumerate(gives)]
    return Transformation(label, "pkg/X", "nodelet", cost, (), tuple(ports))


def demand(tag: str, datatype: str = "") -> Demand:
    return Demand(frozenset([parse_tag(tag)]), datatype)


def plan(transformations: Iterable[Transformation], tag: str, **kwds) -> Answer:  # type: ignore[no-untyped-def]
    planner = Planner()
    planner.add(transformations)
    return planner.plan(demand(tag), **kwds)


def check(answer: Plan, library: Dict[str, Transformation]) -> None:
    """A plan is complete, in order, without a cycle, and costs what it says."""
    made = set()
    for step in answer.steps:
        needs = [p for p in library[step.action.label].ports if p.direction == "in" and p.tags]
        assert [port for port, _ in step.inputs] == [port.name for port in needs]
        for _, source in step.inputs:
            assert isinstance(source, Live) or source.label in made
        assert step.action.label not in made
        made.add(step.action.label)
    assert isinstance(answer.goal, Live) or answer.goal.label in made
    assert answer.cost == sum(step.action.cost for step in answer.steps)


def least_cost(transformations: List[Transformation], goal: str) -> Optional[int]:
    """Try every choice of a supplier for every demand."""
    library = {each.label: each for each in transformations}
    best: List[Optional[int]] = [None]

    def acyclic(chosen: Dict[str, str]) -> bool:
        done: Dict[str, bool] = {}

        def visit(label: str) -> bool:
            if label in done:
                return done[label]
            done[label] = False
            needs = [p.tags[0] for p in library[label].ports if p.direction == "in"]
            done[label] = all(visit(chosen[tag]) for tag in needs)
            return done[label]

        return visit(chosen[goal])

    def search(chosen: Dict[str, str], waiting: Sequence[str], used: frozenset, cost: int) -> None:
        if best[0] is not None and cost >= best[0]:
            return
        if not waiting:
            if acyclic(chosen):
                best[0] = cost
            return
        tag = waiting[0]
        for each in transformations:
            if not any(p.direction == "out" and tag in p.tags for p in each.ports):
                continue
            more = []
            if each.label not in used:
                needs = [p.tags[0] for p in each.ports if p.direction == "in"]
                more = [t for t in dict.fromkeys(needs) if t not in chosen and t not in waiting]
                more = [t for t in more if t != tag]
            extra = 0 if each.label in used else each.cost
            search(
                {**chosen, tag: each.label},
                [*waiting[1:], *more],
                used | {each.label},
                cost + extra,
            )

    search({}, [goal], frozenset(), 0)
    return best[0]


TAGS = [f"T{i}" for i in range(6)]
SOME_TAGS = st.lists(st.sampled_from(TAGS), unique=True, max_size=3)


@st.composite
def libraries(draw) -> List[Transformation]:  # type: ignore[no-untyped-def]
    count = draw(st.integers(1, 9))
    return [
        make(
            f"a{number}",
            draw(SOME_TAGS),
            draw(st.lists(st.sampled_from(TAGS), unique=True, min_size=1, max_size=3)),
            draw(st.integers(0, 9)),
        )
        for number in range(count)
    ]


@examples(400)
@given(libraries())
def test_a_small_problem_is_solved_exactly(library: List[Transformation]) -> None:
    answer = plan(library, "T0")
    expected = least_cost(library, "T0")
    assert isinstance(answer, Plan) is (expected is not None)
    if isinstance(answer, Plan):
        assert answer.cost == expected
        check(answer, {each.label: each for each in library})


@examples(100)
@given(libraries(), st.randoms())
def test_the_order_of_the_library_changes_nothing(
    library: List[Transformation], rng: random.Random
) -> None:
    shuffled = list(library)
    rng.shuffle(shuffled)
    assert plan(library, "T0") == plan(shuffled, "T0")


def test_the_case_study_is_a_chain() -> None:
    library = [
        make("bottom camera", [], ["YUV(nao)"]),
        make("subsampler", ["YUV(nao)"], ["BGR(nao)", "HSV(nao)", "Planes(nao)"]),
        make("ball detector", ["Planes(nao)", "Joints(nao)"], ["Ball(nao)"]),
        make("localization", ["Ball(nao)"], ["FieldPosition(ball)"]),
    ]
    joints = Live("/joint_states", "", "", "joints", "sensor_msgs/JointState")
    answer = plan(library, "FieldPosition(ball)", live=[(joints, (parse_tag("Joints(nao)"),))])
    assert isinstance(answer, Plan)
    assert [step.action.label for step in answer.steps] == [
        "bottom camera",
        "subsampler",
        "ball detector",
        "localization",
    ]
    assert answer.live == (joints,)
    assert answer.goal == New("localization", "o0")


def test_what_is_there_costs_nothing() -> None:
    library = [make("camera", [], ["A"], 5), make("filter", ["A"], ["B"], 1)]
    running = Live("/camera/image", "o0", "/camera", "camera", "")
    answer = plan(library, "B", live=[(running, (parse_tag("A"),))])
    assert isinstance(answer, Plan)
    assert (answer.cost, answer.live) == (1, (running,))
    free = plan(library, "B", free={"camera": ()})
    assert isinstance(free, Plan)
    assert (free.cost, len(free.steps)) == (1, 2)


def test_excluded_labels_are_not_used_live_or_new() -> None:
    library = [make("cheap", [], ["A"], 1), make("dear", [], ["A"], 9)]
    running = Live("/t", "o0", "/n", "cheap", "")
    answer = plan(library, "A", live=[(running, (parse_tag("A"),))], exclude={"cheap"})
    assert isinstance(answer, Plan)
    assert answer.goal == New("dear", "o0")


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


def test_one_stream_has_to_satisfy_all_tags_of_a_port() -> None:
    library = [
        make("left", [], ["Image&Left"], 1),
        make("sharp", [], ["Image&Sharp"], 1),
        make("both", [], ["Image&Left&Sharp"], 9),
        make("user", ["Left&Sharp"], ["A"]),
    ]
    answer = plan(library, "A")
    assert isinstance(answer, Plan)
    assert [step.action.label for step in answer.steps] == ["both", "user"]


def test_types_are_part_of_the_match() -> None:
    library = [make("a", [], ["A"], 1, "t/One"), make("b", [], ["A"], 5, "t/Two")]
    planner = Planner()
    planner.add(library)
    answer = planner.plan(demand("A", "t/Two"))
    assert isinstance(answer, Plan)
    assert answer.goal == New("b", "o0")
    assert isinstance(planner.plan(demand("A", "t/Three")), NoPlan)


def test_a_replaced_and_a_removed_transformation_are_forgotten() -> None:
    planner = Planner()
    planner.add([make("a", [], ["A"], 7)])
    planner.add([make("a", [], ["B"], 3)])
    assert isinstance(planner.plan(demand("A")), NoPlan)
    planner.remove("a")
    assert isinstance(planner.plan(demand("B")), NoPlan)
    assert len(planner) == 0


@pytest.mark.parametrize("depth", [1100])
def test_stacked_diamonds_overflow_nothing(depth: int) -> None:
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


def test_shared_parts_are_counted_once() -> None:
    # Two trees of 4 each, or one shared part of 5: the trees look cheaper one by one.
    library = [
        make("goal", ["X", "Y"], ["G"], 0),
        make("x alone", [], ["X"], 4),
        make("y alone", [], ["Y"], 4),
        make("x shared", ["S"], ["X"], 0),
        make("y shared", ["S"], ["Y"], 0),
        make("shared", [], ["S"], 5),
    ]
    answer = plan(library, "G")
    assert isinstance(answer, Plan)
    assert answer.cost == 5


def test_instances_of_one_transformation_stand_in_one_plan() -> None:
    library = [
        make("cam1", [], ["Raw(cam1)"], 3),
        make("cam2", [], ["Raw(cam2)"], 4),
        make("rectifier", ["Raw(?c)"], ["Rect(?c)"], 2),
        make("stereo", ["Rect(cam1)", "Rect(cam2)"], ["Depth"], 1),
    ]
    answer = plan(library, "Depth")
    assert isinstance(answer, Plan)
    bound = [(step.action.label, step.bindings) for step in answer.steps]
    assert ("rectifier", (("?c", "cam1"),)) in bound
    assert ("rectifier", (("?c", "cam2"),)) in bound
    assert answer.cost == answer.least_cost == 12


def test_in_ports_that_share_a_variable_have_one_individual() -> None:
    library = [
        make("cheap image", [], ["Image(cam1)"], 1),
        make("dear image", [], ["Image(cam2)"], 9),
        make("pose", [], ["Pose(cam2)"], 1),
        make("map", ["Image(?c)", "Pose(?c)"], ["Map(?c)"], 1),
    ]
    answer = plan(library, "Map(?which)")
    assert isinstance(answer, Plan)
    assert (answer.cost, answer.bindings) == (11, (("?which", "cam2"),))


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

    planner = Planner(Sizes())
    planner.add([make("cam", [], ["Raw(cam)"]), make("part", ["Raw(?c)"], ["Part(?c, half)"])])
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


def test_equal_costs_beside_cheap_parts_of_others_are_compared_under_bindings() -> None:
    # Without bindings the cheapest image and the cheapest pose would cost 2 together.
    library = [make(f"image {i}", [], [f"Image(c{i})"], 1 + i) for i in range(9)]
    library += [make(f"pose {i}", [], [f"Pose(c{i})"], 9 - i) for i in range(9)]
    library += [make("map", ["Image(?c)", "Pose(?c)"], ["Map(?c)"], 0)]
    answer = plan(library, "Map(?which)")
    assert isinstance(answer, Plan)
    assert (answer.cost, answer.least_cost) == (10, 10)


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


def test_a_way_without_a_second_nodelet_may_be_cheaper() -> None:
    library = [
        make("cam1", [], ["Raw(cam1)"], 3),
        make("cam2", [], ["Raw(cam2)"], 0),
        make("rectifier", ["Raw(?c)"], ["Rect(?c)"], 10),
        make("left", [], ["Rect(cam1)"], 4),
        make("stereo", ["Rect(cam1)", "Rect(cam2)"], ["Depth"], 3),
    ]
    answer = plan(library, "Depth", free={"rectifier": ()})
    assert isinstance(answer, Plan)
    assert (answer.cost, answer.least_cost) == (7, 7)


def test_a_port_that_states_no_rate_is_as_fast_as_what_feeds_it() -> None:
    def rated(each: Transformation, rate: float) -> Transformation:
        return each._replace(ports=(*each.ports[:-1], each.ports[-1]._replace(rate=rate)))

    slow, fast = make("slow", [], ["Raw"], 1), make("fast", [], ["Raw"], 5)
    follower = make("filter", ["Raw"], ["Smooth"], 1)
    planner = Planner()
    planner.add([rated(slow, 5.0), follower])
    goal = demand("Smooth")._replace(min_rate=10.0)
    refused = planner.plan(goal)
    assert isinstance(refused, NoPlan)
    assert "Raw [at least 10 Hz] cannot be used: it is stated at 5 Hz, below 10 Hz" in str(refused)
    planner.add([rated(fast, 30.0)])
    answer = planner.plan(goal)
    assert isinstance(answer, Plan)
    assert [step.action.label for step in answer.steps] == ["fast", "filter"]
    planner.add([rated(follower, 20.0)])
    answer = planner.plan(goal)
    assert isinstance(answer, Plan)
    assert [step.action.label for step in answer.steps] == ["slow", "filter"]


def test_what_the_garbage_collector_collects_and_when_is_left_alone() -> None:
    is_on = []
    planner = Planner(clock=lambda: float(is_on.append(gc.isenabled()) or 0.0))
    threshold = gc.get_threshold()
    gc.set_threshold(10**6)
    try:
        young = [planner]
        planner.add([make("camera", [], ["A"])])
        assert isinstance(planner.plan(demand("A")), Plan)
        assert any(each is young for each in gc.get_objects(generation=0))
    finally:
        gc.set_threshold(*threshold)
    assert is_on and all(is_on)


def test_many_transformations_are_removed_at_once() -> None:
    planner = Planner()
    planner.add([make(f"camera {number}", [], [f"Raw({number})"]) for number in range(20)])
    planner.remove(*[f"camera {number}" for number in range(19)], "nonesuch")
    assert len(planner) == 1
    assert planner.bindings(demand("Raw(?x)")) == ([(("?x", "19"),)], True)
    planner.remove()
    assert isinstance(planner.plan(demand("Raw(19)")), Plan)
