# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ranges of quantifiers: whose streams the ports below them have."""

from __future__ import annotations

from typing import Dict, Mapping, NamedTuple

from dyknow.errors import FormulaError
from dyknow.formulas.states import own_ports
from dyknow.formulas.tree import Node, Quantified, ports, walk


class Range(NamedTuple):
    """The individuals of a variable; ``concept`` is empty for individuals of any kind."""

    variable: str
    concept: str


def ranges(formula: Node, text: str) -> Mapping[str, Range]:
    """Return the range of each port of individuals; see ``Formula.ranges``."""
    own = own_ports(formula)
    quantified = [each for each in walk(formula) if isinstance(each, Quantified)]
    concepts: Dict[str, str] = {}
    variables: Dict[str, str] = {}
    for each in quantified:
        concept = concepts.setdefault(each.variable, each.concept) or each.concept
        if each.concept not in ("", concept):
            problem = f"{each.variable} is of the concept {concept} in another quantifier: "
            raise FormulaError(text, each.place, f"{problem}expected it, or another variable")
        concepts[each.variable] = concept
        for port in ports(each.operand):
            if port not in own and variables.setdefault(port, each.variable) != each.variable:
                problem = f"the port '{port}' has a stream for each {variables[port]}: a "
                raise FormulaError(
                    text, each.place, f"{problem}quantifier of {each.variable} cannot read it"
                )
    for each in quantified:
        if each.variable not in variables.values():
            problem = (
                f"{each.variable} has no individuals: each port below the quantifier is read "
            )
            raise FormulaError(text, each.place, f"{problem}outside as well")
    return {port: Range(variable, concepts[variable]) for port, variable in variables.items()}
