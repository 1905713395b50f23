# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that can be connected elsewhere, and the steps of a plan for which they are used."""

from __future__ import annotations

from typing import Dict, List, NamedTuple, Sequence, Tuple, Union

from dyknow.manager.planning.problem import New, Plan, PlanStep
from dyknow.manager.specifications.tags import Bindings, Subsumption

Instance = Tuple[str, Bindings]
"""The label of a transformation and what its variables stand for: what a plan needs once."""


class OwnNodelet(NamedTuple):
    """A healthy nodelet that can be connected elsewhere for a claim.

    Attributes:
        name: its name.
        label: its transformation.
        kept: what its variables have to stand for wherever it is connected.
        present: what they stand for now, as far as that is known.
    """

    name: str
    label: str
    kept: Bindings = ()
    present: Bindings = ()


def instance_of(part: Union[New, PlanStep]) -> Instance:
    """Return the instance that a part of a plan belongs to."""
    label = part.label if isinstance(part, New) else part.action.label
    return label, part.bindings


def assigned(plan: Plan, own: Sequence[OwnNodelet], ontology: Subsumption) -> Dict[Instance, str]:
    """Choose nodelets for the steps of a plan.

    Those that stay as they are come first, since nothing that they supply changes.

    Args:
        plan: what is to be made.
        own: nodelets that can be connected elsewhere, the preferred ones first.
        ontology: knows which names mean the same individual.

    Returns:
        Names of nodelets by instance; the other instances need new ones.
    """
    left: List[OwnNodelet] = list(own)
    found: Dict[Instance, str] = {}
    for stays in (True, False):
        for step in plan.steps:
            instance = instance_of(step)
            if instance in found:
                continue
            for each in left:
                bound = each.present if stays else each.kept
                if each.label == instance[0] and _agree(bound, instance[1], ontology):
                    if stays and not each.present:
                        continue
                    found[instance] = each.name
                    left.remove(each)
                    break
    return found


def _agree(some: Bindings, all_: Bindings, ontology: Subsumption) -> bool:
    """Whether all that is bound in ``some`` stands for the same individual in ``all_``."""
    known = {variable: ontology.canonical(name) for variable, name in all_}
    return all(known.get(variable) == ontology.canonical(name) for variable, name in some)
