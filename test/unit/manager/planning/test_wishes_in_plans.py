# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Wishes of clients in plans, by examples."""

from __future__ import annotations

from typing import List, Tuple

from unit.manager.planning.examples import demand, labels, make, planner_with
from unit.manager.planning.random_problems import Kinds

from dyknow.manager.planning.explanation import as_tree, tree_as_dot
from dyknow.manager.planning.problem import (
    AVOIDED,
    NOT_PREFERRED,
    Live,
    Plan,
    TaggedStream,
    Wishes,
)
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.transformation import Transformation


def camera(label: str, cost: int, tag: str = "Raw(field)") -> Transformation:
    return make(label, [], [tag], cost)


FILTER = make("filter", ["Raw(?x)"], ["Filtered(field)"])
GOAL = demand("Filtered(field)")
CEILING: TaggedStream = (
    Live("/ceiling", "o0", "/ceiling_1", "ceiling", ""),
    (parse_tag("Raw(field)"),),
)


def plan(*wishes: Tuple[str, ...], live: Tuple[TaggedStream, ...] = ()) -> Plan:
    library = [camera("bottom", 1), camera("top", 3), camera("ceiling", 5), FILTER]
    answer = planner_with(library).plan(GOAL, live, wishes=Wishes(*wishes))
    assert isinstance(answer, Plan)
    return answer


def test_where_there_is_a_choice_the_preferred_one_is_taken() -> None:
    assert plan(("nonesuch",), ("nonesuch",)) == plan()
    assert labels(plan()) == ["bottom", "filter"]
    answer = plan(("ceiling",))
    assert labels(answer) == ["ceiling", "filter"]
    assert answer.cost == answer.least_cost == 6
    assert {step.charge for step in answer.steps} == {0}


def test_what_is_avoided_is_taken_only_without_a_choice() -> None:
    assert labels(plan((), ("bottom",))) == ["top", "filter"]
    answer = plan((), ("bottom", "top", "ceiling"))
    assert labels(answer) == ["bottom", "filter"]
    assert answer.cost == 2 + AVOIDED
    assert (AVOIDED, NOT_PREFERRED) == (1000, 100)  # as documented
    assert as_tree(answer).split("\n") == [
        "Filtered(field): cost 1002 (proven least)",
        "└─ filter.o0 [?x=field] (new, cost 1)",
        "   └─ i0 ← bottom.o0 (new, cost 1, charged 1000)",
    ]


def test_what_runs_is_charged_too() -> None:
    assert labels(plan(live=(CEILING,))) == ["filter"]
    assert labels(plan((), ("ceiling",), live=(CEILING,))) == ["bottom", "filter"]
    assert labels(plan(("top",), live=(CEILING,))) == ["top", "filter"]
    answer = plan(("nonesuch",), ("Raw",), live=(CEILING,))
    assert answer.live == (CEILING[0],)
    assert answer.cost == answer.least_cost == 1 + AVOIDED
    tree = as_tree(answer)
    assert "i0 ← ceiling.o0 (runs as /ceiling_1, charged 1000)" in tree
    assert "/ceiling_1" in tree_as_dot(tree)


def test_a_running_part_is_charged_for_what_it_works_on_not_for_its_kind() -> None:
    library = [
        camera("robot", 1, "Raw(robot_camera)"),
        camera("above", 10, "Raw(ceiling_camera)"),
        make("tracker", ["Raw(?x)"], ["Position(?x)"]),
        make("spare tracker", ["Raw(?x)"], ["Position(?x)"], 100),
    ]
    running = Live("/position", "o0", "/tracker_1", "tracker", "")
    live: Tuple[TaggedStream, ...] = ((running, (parse_tag("Position(robot_camera)"),)),)
    fed = {"/tracker_1": ("robot",)}
    for wishes in (Wishes((), ("robot_camera",)), Wishes(("ceiling_camera",), ("robot_camera",))):
        answer = planner_with(library).plan(
            demand("Position(?x)"), live, wishes=wishes, feeders=fed
        )
        assert isinstance(answer, Plan)
        assert (labels(answer), answer.cost) == (["above", "tracker"], 11)


def test_a_running_part_costs_no_more_than_a_new_one() -> None:
    library = [camera("robot", 1, "Raw(robot_camera)"), make("t", ["Raw(?x)"], ["Position(?x)"])]
    live: Tuple[TaggedStream, ...] = (
        (Live("/raw", "o0", "/robot_1", "robot", ""), (parse_tag("Raw(robot_camera)"),)),
        (Live("/position", "o0", "/t_1", "t", ""), (parse_tag("Position(robot_camera)"),)),
    )
    wishes, fed = Wishes((), ("robot_camera",)), {"/t_1": ("robot",)}
    answer = planner_with(library).plan(demand("Position(?x)"), live, wishes=wishes, feeders=fed)
    assert isinstance(answer, Plan)
    assert (answer.live, answer.cost) == ((live[1][0],), AVOIDED)


def test_each_feeder_is_charged_be_it_new_or_running() -> None:
    library = [make("raw", [], ["Raw(left)"]), make("pair", ["Raw(left)", "Raw(right)"], ["Pair"])]
    stream: TaggedStream = (Live("/p", "o0", "/pair_1", "pair", ""), (parse_tag("Pair"),))
    fed = {"/pair_1": ("raw", "raw")}
    answer = planner_with(library).plan(
        demand("Pair"), (stream,), wishes=Wishes((), ("raw",)), feeders=fed
    )
    assert isinstance(answer, Plan)
    assert answer.cost == 2 * AVOIDED


def test_what_feeds_a_running_part_is_charged_with_it() -> None:
    stream: TaggedStream = (
        Live("/f", "o0", "/filter_1", "filter", ""),
        (parse_tag("Filtered(field)"),),
    )
    planner = planner_with([camera("bottom", 1), camera("top", 3), FILTER])
    wishes = Wishes((), ("bottom",))
    fed = {"/filter_1": ("bottom",)}
    answer = planner.plan(GOAL, (stream,), wishes=wishes, feeders=fed)
    assert isinstance(answer, Plan)
    assert labels(answer) == ["top", "filter"]


def test_concepts_are_those_of_the_tags() -> None:
    library = [camera("one", 1, "A(a)"), camera("two", 2, "D(b)"), camera("three", 3, "A(c)")]
    planner = planner_with(library, Kinds())

    def taken(*wishes: Tuple[str, ...]) -> List[str]:
        return labels(planner.plan(demand("D(?x)"), wishes=Wishes(*wishes)))

    assert taken() == ["one"]
    assert taken(("L",)) == ["two"]
    assert taken(("c",)) == ["three"]
    assert taken((), ("urn:a",)) == ["two"]
    assert taken((), ("A",)) == ["two"]
    assert taken((), ("D",)) == ["one"]
