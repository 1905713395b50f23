# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parses transformation specifications: the transformations, or all problems at once."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Iterable, Iterator, Optional, Tuple, Union

from dyknow.errors import Problem, SpecificationError
from dyknow.manager.specifications.builder import Builder
from dyknow.manager.specifications.findings import EnoughProblems, Findings
from dyknow.manager.specifications.limits import DEFAULT_LIMITS, SpecificationLimits
from dyknow.manager.specifications.reader import SpecificationReader, TransformationDraft
from dyknow.manager.specifications.template import Concepts, Expander
from dyknow.model.transformation import Transformation


@dataclass(frozen=True)
class Specifications:
    """The contents of a specification.

    Attributes:
        transformations: The transformations, templates expanded, in the order written.
        warnings: Accepted texts that are probably mistakes.
    """

    transformations: Tuple[Transformation, ...]
    warnings: Tuple[Problem, ...]


@dataclass(frozen=True)
class Report:
    """The outcome of `check`.

    Attributes:
        labels: The labels of the transformations; empty if there are problems.
        problems: Why the text would be refused; empty if it would be accepted.
        warnings: Accepted texts that are probably mistakes.
    """

    labels: Tuple[str, ...]
    problems: Tuple[Problem, ...]
    warnings: Tuple[Problem, ...]


def parse(
    text: Union[str, bytes],
    file_name: str = "specification",
    ontology: Optional[Concepts] = None,
    limits: SpecificationLimits = DEFAULT_LIMITS,
) -> Specifications:
    """Parse a specification, or many in a `<transformations>` element.

    Args:
        text: The XML, as characters or as UTF-8.
        file_name: The name to use in messages.
        ontology: Has the individuals of the classes that templates name.
        limits: The caps to hold.

    Returns:
        The transformations and the warnings.

    Raises:
        SpecificationError: With every problem of the text.
    """
    findings = Findings(file_name, limits.problems)
    try:
        transformations = tuple(
            transformations_of(
                SpecificationReader(findings, limits).drafts(text), findings, ontology, limits
            )
        )
    except EnoughProblems:
        transformations = ()
    findings.raise_if_any()
    return Specifications(transformations, findings.warnings)


def parse_file(
    path: str, ontology: Optional[Concepts] = None, limits: SpecificationLimits = DEFAULT_LIMITS
) -> Specifications:
    """Parse a file.

    Args:
        path: The file; messages name it as it is given here.
        ontology: Has the individuals of the classes that templates name.
        limits: The caps to hold; no more than the allowed size is read.

    Raises:
        SpecificationError: With every problem of the text, or because the file cannot be read.
    """
    name = os.fspath(path)
    try:
        with open(name, "rb") as file:
            data = file.read(limits.text_size + 1)
    except OSError as error:
        reason = f"cannot be read: {error.strerror or error}"
        raise SpecificationError([Problem(name, 0, reason)]) from error
    return parse(data, name, ontology, limits)


def check(
    path: str, ontology: Optional[Concepts] = None, limits: SpecificationLimits = DEFAULT_LIMITS
) -> Report:
    """Parse a file; report problems instead of raising them."""
    try:
        found = parse_file(path, ontology, limits)
    except SpecificationError as error:
        return Report((), error.problems, error.warnings)
    return Report(tuple(t.label for t in found.transformations), (), found.warnings)


def transformations_of(
    drafts: Iterable[TransformationDraft],
    findings: Findings,
    ontology: Optional[Concepts] = None,
    limits: SpecificationLimits = DEFAULT_LIMITS,
) -> Iterator[Transformation]:
    """Expand the templates among the drafts of one text, and make transformations of all.

    Problems are noted in `findings`; if there are any, the transformations are not to be used.
    """
    builder = Builder(findings, limits, ontology)
    for draft in _expanded(drafts, Expander(findings, limits, ontology), builder):
        transformation = builder.build(draft)
        if transformation is not None:
            yield transformation


def _expanded(
    drafts: Iterable[TransformationDraft], expander: Expander, builder: Builder
) -> Iterator[TransformationDraft]:
    for draft in drafts:
        if not draft.args and not draft.has_variables:
            yield draft
            continue
        expanded = expander.expand(draft)
        if expanded is None:
            builder.check_template(draft)
        else:
            yield from expanded
