# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Checks that whoever makes a nodelet can know what its variables stand for.

The streams at the in-ports of a nodelet bind its variables. So tags of out-ports and texts of
parameters may use only variables that stand in the tags of in-ports.
"""

from __future__ import annotations

from typing import Dict, List, Optional, Set, Tuple

from dyknow.errors import InvalidTag
from dyknow.manager.specifications.draft import TransformationDraft
from dyknow.manager.specifications.findings import Findings, listed, meant, shorten
from dyknow.manager.specifications.tags import Term, parse_tag
from dyknow.manager.specifications.template import Concepts
from dyknow.model.placeholders import variables_of
from dyknow.model.transformation import IN, TOPIC, Transformation


def check_variables(
    draft: TransformationDraft, findings: Findings, ontology: Optional[Concepts] = None
) -> None:
    """Note the variables of a transformation that nothing binds, and types that are no classes."""
    directions = {port.name: port.direction for port in draft.ports}
    used: List[Tuple[str, str, int]] = []  # variable, where, line
    bound: Dict[str, None] = {}
    for tag in draft.tags:
        term, where = _with_variables(tag.text), f"the tag '{shorten(tag.text)}'"
        if term is None:
            continue
        for type_ in term.types:
            if type_ and ontology is not None and not ontology.is_class(type_):
                unknown = f"{where} has the type '{shorten(type_)}', which is no class"
                findings.warning(tag.line, f"{unknown} of the ontology")
        if directions.get(tag.port) == IN:
            bound.update(dict.fromkeys(term.variables))
        else:
            used += [(each, where, tag.line) for each in term.variables]
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
            term = _with_variables(tag)
            variables = term.variables if term is not None else ()
            if found.intersection(variables):
                return True
            found.update(variables)
    return False


def _with_variables(tag: str) -> Optional[Term]:
    """Read a tag; None if it has no variable, or is passed over by the planner."""
    if "?" not in tag:
        return None
    try:
        return parse_tag(tag)
    except InvalidTag:
        return None
