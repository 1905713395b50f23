# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Checks that whoever makes a nodelet can know what its variables stand for.

The streams at the in-ports of a nodelet bind its variables. So tags of out-ports and texts of
parameters may use only variables that stand in the tags of in-ports.
"""

from __future__ import annotations

from typing import AbstractSet, Dict, List, Set, Tuple

from dyknow.errors import InvalidTag
from dyknow.manager.specifications.draft import TransformationDraft
from dyknow.manager.specifications.findings import Findings, listed, meant, shorten
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.placeholders import variables_of
from dyknow.model.transformation import IN, TOPIC, Transformation


def check_variables(draft: TransformationDraft, findings: Findings) -> None:
    """Note the variables of a transformation that nothing binds."""
    directions = {port.name: port.direction for port in draft.ports}
    used: List[Tuple[str, str, int]] = []  # variable, where, line
    bound: Dict[str, None] = {}
    for tag in draft.tags:
        variables = sorted(_variables(tag.text))
        if directions.get(tag.port) == IN:
            bound.update(dict.fromkeys(variables))
        else:
            used += [(each, f"the tag '{shorten(tag.text)}'", tag.line) for each in variables]
    for name, _, text, line in draft.parameters:
        used += [(each, f"the parameter '{shorten(name)}'", line) for each in variables_of(text)]
    for variable, where, line in used:
        if draft.type == TOPIC:
            findings.problem(
                line,
                f"{where} of a topic has the variable {shorten(variable)}; expected names, as "
                "nothing binds it",
            )
        elif variable not in bound and draft.ports_known:
            findings.problem(
                line,
                f"{where} has the variable {shorten(variable)}, which no tag of an in-port binds; "
                f"known variables: {listed(bound)}{meant(variable, bound)}",
            )


def shares_variables(transformation: Transformation) -> bool:
    """Whether a variable stands in several tags of a transformation."""
    found: Set[str] = set()
    for port in transformation.ports:
        for tag in port.tags:
            variables = _variables(tag)
            if found & variables:
                return True
            found |= variables
    return False


def _variables(tag: str) -> AbstractSet[str]:
    if "?" not in tag:
        return frozenset()
    try:
        return {arg for arg in parse_tag(tag).args if arg[0] == "?"}
    except InvalidTag:
        return frozenset()  # the planner passes it over
