# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tags of the ports below the quantifiers of formulas: their bindings are the individuals."""

from __future__ import annotations

from dyknow.errors import DyKnowError
from dyknow.formulas import Range
from dyknow.manager.specifications.tags import Term, types_of


def tag_of_individuals(port: str, tag: Term, wanted: Range) -> Term:
    """Return the tag of a port below a quantifier, with the quantifier's concept.

    Raises:
        DyKnowError: it does not have the quantifier's variable, or has it with another concept.
    """
    variable, concept = wanted
    where = f"the tag {tag} of the port '{port}'"
    if variable not in tag.variables:
        has = f"the variable {', '.join(tag.variables)}" if tag.variables else "no variable"
        raise DyKnowError(f"{where} has {has}; expected the quantifier's, {variable}")
    for other in sorted(types_of([tag]).get(variable, frozenset()) - {concept}):
        if concept:
            raise DyKnowError(
                f"{where} has the variable {variable} with the concept {other}; expected the "
                f"quantifier's, {concept}"
            )
    return tag.restricted(variable, concept)
