# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark library``: add many transformations at once, and plan over them."""

from __future__ import annotations

import argparse
import time
from typing import List, Tuple

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Demand, Plan
from dyknow.manager.specifications.specification import parse
from dyknow.manager.specifications.tags import parse_tag
from dyknow_benchmark import machine, options, progress, system
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import MeasurementFailed, Session
from dyknow_benchmark.targets import Verdict

HEADER = ("what", "count", "min_s", "median_s", "max_s")
_PLANS = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--transformations", type=options.positive, default=100_000)


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    count = arguments.transformations
    text = system.library_text(count)
    load = machine.Load()
    with Session() as session:
        client = system.start(session)
        progress.say(f"adding {count} transformations, {len(text) / 2**20:.0f} MiB")
        begin = time.monotonic()
        added = len(client.add_transformation(text).labels)
        adding = time.monotonic() - begin
    if added != count:
        raise MeasurementFailed(f"{added} of {count} transformations were added")
    begin = time.monotonic()
    transformations = parse(text).transformations
    parsing = time.monotonic() - begin
    indexing, plans = _plan(transformations, count)
    results = Results(
        load.rows(),
        [
            Verdict("plan, median in s", system.spread(plans)[1], 0.5),
            Verdict("plan with the planner's index made first, in s", indexing + plans[0], 2.0),
        ],
    )
    rows = [
        ("add by service", 1, adding, adding, adding),
        ("parse", 1, parsing, parsing, parsing),
        ("index for the planner", 1, indexing, indexing, indexing),
        ("plan", len(plans), *system.spread(plans)),
    ]
    results.table("library", f"{count} transformations", HEADER, rows)
    return results


def _plan(transformations: Tuple, count: int) -> Tuple[float, List[float]]:  # type: ignore[type-arg]
    begin = time.monotonic()
    planner = Planner()
    planner.add(transformations)
    indexing = time.monotonic() - begin
    width = max(1, count // 20)
    layer = (count - 1) // width
    times = []
    for number in range(_PLANS):
        place = number * 37 % max(1, count - layer * width)
        goal = Demand(frozenset((parse_tag(f"Stream{layer}(x{place})"),)))
        begin = time.monotonic()
        answer = planner.plan(goal)
        times.append(time.monotonic() - begin)
        if not isinstance(answer, Plan):
            raise MeasurementFailed(str(answer))
    return indexing, times
