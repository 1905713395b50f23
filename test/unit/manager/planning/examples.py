# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Small libraries and demands, written briefly."""

from __future__ import annotations

from typing import Any, Iterable, List, Sequence

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Answer, Demand, Plan
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption, parse_tag
from dyknow.model.transformation import IN, OUT, Port, Transformation


def make(
    label: str, needs: Sequence[str], gives: Sequence[str], cost: int = 1, **stated: Any
) -> Transformation:
    """Make a transformation with one port for each tag; ``a&b`` are two tags of one port.

    Args:
        label: its label.
        needs: tags of its in-ports.
        gives: tags of its out-ports.
        cost: its cost.
        stated: further fields of its out-ports.
    """
    ports = [Port(f"i{at}", IN, "", tuple(tag.split("&"))) for at, tag in enumerate(needs)]
    outs = [Port(f"o{at}", OUT, "", tuple(tag.split("&"))) for at, tag in enumerate(gives)]
    ports += [port._replace(**stated) for port in outs]
    return Transformation(label, "p/X", cost=cost, ports=tuple(ports))


def demand(tag: str, **limits: Any) -> Demand:
    return Demand(frozenset([parse_tag(tag)]), **limits)


def planner_with(
    transformations: Iterable[Transformation], ontology: Subsumption = NO_ONTOLOGY
) -> Planner:
    """Make a planner that plans by the count of steps alone, which no other process disturbs."""
    planner = Planner(ontology, clock=lambda: 0.0)
    planner.know(transformations)
    return planner


def labels(answer: Answer) -> List[str]:
    """Return the labels of a plan's steps."""
    assert isinstance(answer, Plan)
    return [step.instance.label for step in answer.steps]
