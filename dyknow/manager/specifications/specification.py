# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parses transformation specifications: the transformations, or all problems at once."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from typing import Iterable, Iterator

from dyknow.errors import Problem, SpecificationError
from dyknow.formulas.types import Lookup
from dyknow.manager.specifications.builder import Builder
from dyknow.manager.specifications.findings import EnoughProblems, Findings
from dyknow.manager.specifications.formula_parts import FORMULA, REQUIRES, no_types
from dyknow.manager.specifications.limits import DEFAULT_LIMITS, SpecificationLimits
from dyknow.manager.specifications.template import Concepts, Expander
from dyknow.manager.specifications.xml_reader import (
    ANY,
    NEEDED,
    Attribute,
    Element,
    XmlNode,
    XmlReader,
)
from dyknow.model.transformation import Transformation

# The elements are those of `transformations.rng`, which is for people and their editors; a test
# compares the two.

_ARG = Element("arg", attributes={"label": NEEDED}, holds_text=True, may_repeat=True)
_PARAM_TYPE = Attribute(("string", "int", "double", "bool", "yaml"))
_PARAM = Element(
    "param", attributes={"name": NEEDED, "type": _PARAM_TYPE}, holds_text=True, may_repeat=True
)
_PORT = Element(
    "port",
    attributes={
        "type": Attribute(("in", "out"), is_required=True),
        "datatype": ANY,
        "rate": ANY,
        "latency": ANY,
    },
    holds_text=True,
    may_repeat=True,
)
_TAG = Element("tag", attributes={"port": NEEDED}, holds_text=True, may_repeat=True)
TRANSFORMATION = Element(
    "transformation",
    (
        Element("label", holds_text=True, is_required=True),
        Element("source", holds_text=True, is_required=True, unless=("node", "formula")),
        FORMULA,
        Element("args", (_ARG,)),
        Element("params", (_PARAM,)),
        Element("ports", (_PORT,)),
        Element("tags", (_TAG,)),
        REQUIRES,
    ),
    attributes={
        "type": Attribute(("nodelet", "node", "topic", "formula")),
        "cost": ANY,
        "isolated": Attribute(("true", "false")),
        "node": ANY,
    },
    may_repeat=True,
    is_unit=True,
)
TRANSFORMATIONS = Element("transformations", (TRANSFORMATION,))


@dataclass(frozen=True)
class Specifications:
    """The contents of a specification.

    The transformations are in the order written, templates expanded. Warnings are about accepted
    texts that are probably mistakes.
    """

    transformations: tuple[Transformation, ...]
    warnings: tuple[Problem, ...]


def parse(
    text: str | bytes,
    file_name: str = "specification",
    ontology: Concepts | None = None,
    limits: SpecificationLimits = DEFAULT_LIMITS,
    types: Lookup = no_types,
) -> Specifications:
    """Parse a specification, or many in a `<transformations>` element.

    The text is characters or UTF-8. The ontology has the individuals of the classes that templates
    name, ``types`` describes message types, as far as they are known, for formulas.

    Raises:
        SpecificationError: With every problem of the text.
    """
    findings = Findings(file_name, limits)
    nodes = XmlReader(findings, TRANSFORMATION, TRANSFORMATIONS).read(text)
    found: list[Transformation] = []
    with contextlib.suppress(EnoughProblems):
        found += transformations_of(nodes, findings, ontology, types)
    findings.raise_if_any()
    return Specifications(tuple(found), findings.warnings)


def parse_file(
    path: str, ontology: Concepts | None = None, types: Lookup = no_types
) -> Specifications:
    """Parse a file, which messages name as it is given here; see ``parse``.

    SpecificationError also says that the file cannot be read.
    """
    name = os.fspath(path)
    try:
        with open(name, "rb") as file:
            data = file.read(DEFAULT_LIMITS.text_size + 1)
    except OSError as error:
        reason = f"cannot be read: {error.strerror or error}"
        raise SpecificationError([Problem(name, 0, reason)]) from error
    return parse(data, name, ontology, types=types)


def transformations_of(
    nodes: Iterable[XmlNode],
    findings: Findings,
    ontology: Concepts | None = None,
    types: Lookup = no_types,
) -> Iterator[Transformation]:
    """Make the transformations of one text from its `<transformation>` elements.

    Problems are noted in `findings`; if there are any, the transformations are not to be used.
    """
    builder = Builder(findings, ontology, types)
    expander = Expander(findings, ontology)
    limit = findings.limits.transformations
    for count, node in enumerate(nodes, 1):
        if count > limit:
            findings.problem(node.line, f"more than {limit} transformations in one text")
            raise EnoughProblems
        expanded = expander.expand(node)
        if expanded is None:
            builder.ports(node, is_template=True)
            continue
        for each in expanded:
            transformation = builder.build(each)
            if transformation is not None:
                yield transformation
