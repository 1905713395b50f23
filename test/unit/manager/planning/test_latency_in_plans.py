# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Stated latencies, and stated rates, in plans."""

from __future__ import annotations

from typing import List, Sequence

import pytest
from unit.manager.planning.examples import demand, labels, make, planner_with

from dyknow.manager.planning.explanation import as_tree, tree_as_dot
from dyknow.manager.planning.problem import Answer, Live, Plan, TaggedStream
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.transformation import Port, Transformation

LIBRARY = [
    make("camera", [], ["Image(field)"], 1, latency=0.03),
    make("network", ["Image(field)"], ["Ball(field)"], 1, latency=0.2),
    make("colors", ["Image(field)", "Lamps(field)"], ["Ball(field)"], 3, latency=0.01),
    make("lamps", [], ["Lamps(field)"], 1, latency=0.05),
]


def ball(max_age: float, live: Sequence[TaggedStream] = ()) -> Answer:
    return planner_with(LIBRARY).plan(demand("Ball(field)", max_age=max_age), live)


def test_the_longest_path_counts() -> None:
    answer = ball(0.06)
    assert labels(answer) == ["camera", "lamps", "colors"]
    assert isinstance(answer, Plan)
    assert (answer.cost, answer.least_cost, answer.latency) == (5, 5, 0.06)
    tree = as_tree(answer)
    first = "Ball(field) [at most 0.06 s old]: cost 5 (proven least), latency 0.06 s as stated"
    assert tree.split("\n")[0] == first
    assert "latency 0.06 s" in tree_as_dot(tree)
    answer = ball(0.0)  # without a limit the latency is told and decides nothing
    assert labels(answer) == ["camera", "network"]
    first = "Ball(field): cost 2 (proven least), latency 0.23 s as stated"
    assert as_tree(answer).split("\n")[0] == first


def test_when_everything_is_too_late_the_least_latency_is_told() -> None:
    answer = ball(0.05)
    why = "the soonest plan found takes 0.06 s"
    assert str(answer) == f"no plan for Ball(field) [at most 0.05 s old]: {why}"
    assert as_tree(answer).endswith(f"└─ {why}")


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
    planner = planner_with([Transformation("camera", "p/C", ports=ports)])
    answer = planner.plan(demand("Image(field)", max_age=0.05))
    assert isinstance(answer, Plan)
    assert answer.goal.port == "half"


def test_of_several_out_ports_one_supplies_that_is_fast_enough() -> None:
    """An out-port that states no rate is as fast as its inputs; a slow one beside it is not."""
    ports = (
        Port("in", "in", "", ("Raw(field)",)),
        Port("preview", "out", "", ("Image(field)",), 5.0),
        Port("whole", "out", "", ("Image(field)",), 0.0, 0.02),
    )
    library = [make("camera", [], ["Raw(field)"]), Transformation("filter", "p/F", ports=ports)]
    answer = planner_with(library).plan(demand("Image(field)", min_rate=10.0))
    assert isinstance(answer, Plan)
    assert answer.goal.port == "whole"
