# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark plan``: load many transformations into a planner, and plan over them.

It needs no ROS master. The deep library is searched along one chain; in the dense one nearly
everything is reachable, and a plan has tens of thousands of steps.
"""

from __future__ import annotations

import argparse
import random
import time
from typing import Callable, Dict, List, Sequence, Tuple

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Plan
from dyknow.manager.planning.supply import Demand
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.transformation import IN, OUT, Port, Transformation
from dyknow_benchmark import machine, options, progress
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import MeasurementFailed
from dyknow_benchmark.summary import median
from dyknow_benchmark.targets import Verdict

HEADER = ("library", "transformations", "steps", "load_s", "first_s", "median_s", "max_s")
#: Length of a chain of the deep library, and layers of the dense one.
_DEPTH = 100
_PLANS = 9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--transformations", type=options.positive, default=100_000)


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    load = machine.Load()
    verdicts: List[Verdict] = []
    rows = []
    for name, library in _LIBRARIES.items():
        progress.say(f"{name} library of {arguments.transformations} transformations")
        steps, loading, times = _measure(library(arguments.transformations))
        verdicts += [
            Verdict(f"{name} library: plan, median in s", median(times), 0.5),
            Verdict(f"{name} library: first plan with loading, in s", loading + times[0], 2.0),
        ]
        row = (name, arguments.transformations, steps, loading)
        rows.append((*row, times[0], median(times), max(times)))
    results = Results(load.rows(), verdicts)
    results.table("plan", "plans over large libraries", HEADER, rows)
    return results


def deep(count: int) -> List[Transformation]:
    """Write chains of 100 transformations, each of which needs the one before."""
    return [
        _make(number, [number - 1] if number % _DEPTH else [], number % 19 + 1)
        for number in range(count)
    ]


def dense(count: int) -> List[Transformation]:
    """Write 100 layers whose transformations need one to three of the layer before."""
    chance = random.Random(2)
    width = max(1, count // _DEPTH)
    library = []
    for number in range(count):
        below = (number // width - 1) * width
        needs = [below + chance.randrange(width) for _ in range(chance.randint(1, 3))]
        library.append(_make(number, needs if below >= 0 else [], chance.randint(1, 20)))
    return library


def _make(number: int, needs: Sequence[int], cost: int) -> Transformation:
    ports = [Port(f"in{k}", IN, "", (f"Stream(x{need})",)) for k, need in enumerate(needs)]
    ports.append(Port("out", OUT, "std_msgs/Header", (f"Stream(x{number})",)))
    return Transformation(f"t{number}", "dyknow/Relay", cost=cost, ports=tuple(ports))


def _measure(library: List[Transformation]) -> Tuple[int, float, List[float]]:
    """Return the steps of the last plan, and the seconds of loading and of each plan."""
    begin = time.monotonic()
    planner = Planner()
    planner.add(library)
    loading = time.monotonic() - begin
    steps = 0
    times = []
    for number in range(_PLANS):
        goal = Demand(frozenset([parse_tag(f"Stream(x{max(0, len(library) - 1 - number)})")]))
        begin = time.monotonic()
        answer = planner.plan(goal)
        times.append(time.monotonic() - begin)
        if not isinstance(answer, Plan):
            raise MeasurementFailed(str(answer))
        steps = len(answer.steps)
    return steps, loading, times


_LIBRARIES: Dict[str, Callable[[int], List[Transformation]]] = {"deep": deep, "dense": dense}
