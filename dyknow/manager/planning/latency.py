# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Latency: what out-ports state, summed up along the longest path of a plan.

Whole microseconds inside the planner, since their sums are exact; seconds outside.
"""

from __future__ import annotations

from typing import Dict, Iterable, Mapping, Tuple

from dyknow.manager.planning.problem import Live, PlanStep, Source
from dyknow.manager.specifications.tags import Bindings

Latencies = Mapping[Tuple[str, str], int]
"""Of labels and out-ports, in microseconds; what is not stated is left out."""


def microseconds(seconds: float) -> int:
    """Return the nearest whole number of microseconds."""
    return round(seconds * 1e6)


def latency_of(goal: Source, steps: Iterable[PlanStep], stated: Latencies) -> float:
    """Return the latency of a plan, in seconds; its steps have suppliers before consumers."""
    begun: Dict[Tuple[str, Bindings], int] = {}

    def until(source: Source) -> int:
        if isinstance(source, Live):
            return microseconds(source.latency)
        own = stated.get((source.label, source.port), 0)
        return begun[source.label, source.bindings] + own

    for step in steps:
        inputs = [until(each) for _, each in step.inputs]
        begun[step.action.label, step.bindings] = max(inputs, default=0)
    return until(goal) / 1e6
