# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark plan``: load many transformations into a planner, and plan over them.

It needs no ROS master.
"""

from __future__ import annotations

import argparse
import time
from typing import Iterator, List, Tuple

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Demand, Plan
from dyknow.manager.specifications.tags import parse_tag
from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.planning_libraries import LIBRARIES, PlanningLibrary
from dyknow_benchmark.results import Results
from dyknow_benchmark.summary import median
from dyknow_benchmark.targets import Verdict

#: Seconds that a plan may take, and one for a single room.
_PLAN, _ROOM = 0.5, 0.3

HEADER = (
    "library",
    "demand",
    "transformations",
    "steps",
    "load_s",
    "first_s",
    "median_s",
    "max_s",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--transformations", type=options.positive, default=100_000)


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    load = machine.Load()
    count = arguments.transformations
    verdicts: List[Verdict] = []
    rows = []
    for name, make in LIBRARIES.items():
        progress.say(f"library '{name}' of {count} transformations")
        for sort, steps, loading, times in _measure(make(count)):
            limit = _ROOM if sort == "ground" and name.startswith("rooms") else _PLAN
            verdicts.append(Verdict(f"{name}: plan, {sort}, median in s", median(times), limit))
            row = (name, sort, count, steps, loading)
            rows.append((*row, times[0], median(times), max(times)))
        verdicts.append(Verdict(f"{name}: loading, in s", loading, 2.0))
    results = Results(load.rows(), verdicts)
    results.table("plan", "plans over large libraries", HEADER, rows)
    return results


def _measure(library: PlanningLibrary) -> Iterator[Tuple[str, int, float, List[float]]]:
    """Yield sort of demand, steps of the last plan, seconds of loading and of each plan.

    A small library may have no plan; to find that out is measured too.
    """
    begin = time.monotonic()
    planner = Planner(library.ontology)
    planner.add(library.transformations)
    loading = time.monotonic() - begin
    for sort, tags in library.demands.items():
        times = []
        steps = 0
        for tag in tags:
            begin = time.monotonic()
            answer = planner.plan(Demand(frozenset([parse_tag(tag)])))
            times.append(time.monotonic() - begin)
            steps = len(answer.steps) if isinstance(answer, Plan) else 0
        yield sort, steps, loading, times
