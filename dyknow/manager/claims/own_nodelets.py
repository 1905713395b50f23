# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that can be connected elsewhere for a claim, and the steps of a plan that use them."""

from __future__ import annotations

from typing import NamedTuple, Sequence

from dyknow.manager.claims.ends import is_relay
from dyknow.manager.library import Library
from dyknow.manager.planning.problem import Instance, Plan
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import Bindings, Subsumption


class OwnNodelet(NamedTuple):
    """A healthy nodelet that can be connected elsewhere for a claim.

    Attributes:
        name: its name.
        label: its transformation.
        kept: names that its variables have to stand for wherever it is connected.
        present: names that they stand for now, as far as known.
    """

    name: str
    label: str
    kept: Bindings = ()
    present: Bindings = ()


def assigned(plan: Plan, own: Sequence[OwnNodelet], ontology: Subsumption) -> dict[Instance, str]:
    """Choose nodelets for the steps of a plan, by instance; the other instances need new ones.

    The preferred ones come first in ``own``. Those that stay as they are take precedence, since
    nothing that they supply changes.
    """
    left = list(own)
    found: dict[Instance, str] = {}
    instances = dict.fromkeys([step.instance for step in plan.steps])
    for stays in (True, False):
        for instance in [each for each in instances if each not in found]:
            for each in left:
                bound = each.present if stays else each.kept
                if stays and not bound:
                    continue
                if each.label == instance[0] and _agree(bound, instance[1], ontology):
                    found[instance] = each.name
                    left.remove(each)
                    break
    return found


def _agree(some: Bindings, all_: Bindings, ontology: Subsumption) -> bool:
    """Whether all that is bound in ``some`` stands for the same individual in ``all_``."""
    known = {variable: ontology.canonical(name) for variable, name in all_}
    return all(known.get(variable) == ontology.canonical(name) for variable, name in some)


def is_current(library: Library, record: Record) -> bool:
    """Whether the library still has a nodelet's transformation, perhaps in a newer version."""
    return is_relay(record.transformation) or record.label in library
