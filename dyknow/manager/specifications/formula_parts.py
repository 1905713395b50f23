# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas in specifications: `<formula>`, whose nodelet is dyknow/Formula, and `<requires>`."""

from __future__ import annotations

import json
import re
from typing import Callable, Iterable, Sequence

from dyknow.errors import BadParameter, DyKnowError, FormulaError
from dyknow.formulas import Formula, Range
from dyknow.formulas.tree import Quantified, walk
from dyknow.formulas.types import Lookup
from dyknow.manager.specifications.findings import listed, meant, shorten
from dyknow.manager.specifications.tags import read_tags, tag_of_individuals
from dyknow.manager.specifications.values import BadValue, parse_value
from dyknow.manager.specifications.xml_reader import ANY, Attribute, Element, XmlNode
from dyknow.model.transformation import IN, OUT, VERDICT, Parameter, Port

#: What of a formula's nodelet a specification may set: the parameter's type, and its default.
_SETTINGS = {
    "period": ("double", "0.1"),
    "hold": ("double", "0"),
    "delay": ("double", "0.1"),
    "exact": ("bool", "false"),
    "max_nodes": ("int", "1000"),
}
_NUMBER = re.compile(r"[0-9]{1,9}(\.[0-9]{0,9})?\Z")

FORMULA = Element(
    "formula",
    attributes={
        **dict.fromkeys(("period", "hold", "delay", "max_nodes"), ANY),
        "exact": Attribute(("true", "false")),
    },
    holds_text=True,
)
REQUIRES = Element(
    "requires",
    attributes={"initially": Attribute(("true", "false"))},
    holds_text=True,
    may_repeat=True,
)

Note = Callable[[XmlNode, str], None]


def no_types(name: str) -> None:
    """Describe no message type."""


class FormulaParts:
    """Reads the formula of one transformation, and checks it against the ports."""

    def __init__(self, node: XmlNode, element: XmlNode, problem: Note, lookup: Lookup) -> None:
        """Read `element`, a `<formula>`, in `node`; each problem is noted with its element."""
        self._node = node
        self._element = element
        self._problem = problem
        self._lookup = lookup
        self._formula: Formula | None = None
        try:
            self._formula = Formula(element.text)
        except FormulaError as error:
            self._refuse(error)

    @property
    def concepts(self) -> tuple[str, ...]:
        """The concepts of the formula's quantifiers, in the order written."""
        parts = () if self._formula is None else walk(self._formula.tree)
        found = [each.concept for each in parts if isinstance(each, Quantified)]
        return tuple(dict.fromkeys(filter(None, found)))

    def built(self, ports: Sequence[Port]) -> tuple[tuple[Port, ...], tuple[Parameter, ...]]:
        """Return the ports of the nodelet, without those of individuals, and its parameters."""
        outs = [port for port in ports if port.direction == OUT]
        ins = {port.name: port for port in ports if port.direction == IN}
        if len(outs) != 1 or outs[0].datatype not in ("", VERDICT):
            self._problem(
                self._node, f"a formula has exactly one out-port, which carries {VERDICT}"
            )
        for port in sorted(name for name, each in ins.items() if not each.datatype):
            self._problem(self._node, f"the in-port '{port}' of a formula needs a datatype")
        settings = self._settings()
        formula = self._formula
        if formula is None or not outs:
            return tuple(ports), ()
        self._check_ports(formula, ins)
        self._check_types(formula, ins)
        own = [
            port._replace(datatype=VERDICT) if port.direction == OUT else port
            for port in ports
            if port.name not in formula.of_individuals
        ]
        tags = self._tags_of_individuals(formula, ins)
        datatypes = {name: port.datatype for name, port in ins.items()}
        parameters = [
            Parameter("formula", "string", formula.text),
            *settings,
            Parameter("datatypes", "yaml", _written(datatypes)),
            Parameter("out", "string", outs[0].name),
        ]
        if tags:
            parameters.append(Parameter("individuals", "yaml", _written(tags)))
        return tuple(own), tuple(parameters)

    def _refuse(self, error: FormulaError) -> None:
        where = f"formula, line {error.line}, column {error.column}"
        self._problem(self._element, f"{where}: {error.problem}")

    def _settings(self) -> list[Parameter]:
        """Return the parameters that are set by attributes."""
        found = []
        values = {}
        for name, (type_, default) in _SETTINGS.items():
            text = self._element.get(name, default)
            try:
                if type_ != "bool" and not _NUMBER.match(text):
                    raise BadValue("expected a number")
                parse_value(type_, text)
            except BadValue as error:
                self._problem(self._element, f'{name}="{shorten(text)}": {error}')
                text = default
            values[name] = text
            if name in self._element.attributes:
                found.append(Parameter(name, type_, text))
        if self._formula is not None:
            try:
                self._formula.monitor(
                    float(values["period"]),
                    float(values["hold"]) or None,
                    float(values["delay"]),
                    values["exact"] == "true",
                    int(values["max_nodes"]),
                )
            except BadParameter as error:
                self._problem(self._element, str(error))
            except FormulaError as error:
                self._refuse(error)
        return found

    def _check_ports(self, formula: Formula, ins: Iterable[str]) -> None:
        for port in sorted(set(formula.ports) - set(ins)):
            self._problem(
                self._element,
                f"the formula reads the port '{port}', which is not declared; known in-ports: "
                f"{listed(ins)}{meant(port, list(ins))}",
            )
        for port in sorted(set(ins) - set(formula.ports)):
            self._problem(self._node, f"the formula does not read the in-port '{shorten(port)}'")

    def _check_types(self, formula: Formula, ins: dict[str, Port]) -> None:
        types = {name: self._lookup(ins[name].datatype) for name in formula.ports if name in ins}
        if len(types) == len(formula.ports):
            try:
                formula.check(types, self._lookup)
            except FormulaError as error:
                self._refuse(error)

    def _tags_of_individuals(self, formula: Formula, ins: dict[str, Port]) -> dict[str, str]:
        try:
            wanted = formula.ranges()
        except FormulaError as error:
            self._refuse(error)
            return {}
        return {
            name: self._tag_of_individuals(formula, ins[name], range_)
            for name, range_ in wanted.items()
            if name in ins
        }

    def _tag_of_individuals(self, formula: Formula, port: Port, wanted: Range) -> str:
        """Return the one tag of a port of individuals, with placeholders for other variables."""
        variables = formula.variables
        terms = read_tags(port.tags)
        if len(terms) != 1:
            self._problem(
                self._node,
                f"the port '{port.name}' stands below a quantifier only; expected one tag with "
                f"its variable, such as Image({wanted.variable})",
            )
            return ""
        (term,) = terms
        for other in sorted({*variables} & {*term.variables} - {wanted.variable}):
            self._problem(
                self._node,
                f"the tag {shorten(str(term))} of the port '{port.name}' has the variable {other} "
                f"of another quantifier; expected {wanted.variable} alone",
            )
        try:
            term = tag_of_individuals(port.name, term, wanted)
        except DyKnowError as error:
            self._problem(self._node, str(error))
            return ""
        others = {each: f"${{{each}}}" for each in term.variables if each not in variables}
        return str(term.substitute(others))


def _written(values: dict[str, str]) -> str:
    return json.dumps(values, sort_keys=True, ensure_ascii=False)  # which YAML reads, too
