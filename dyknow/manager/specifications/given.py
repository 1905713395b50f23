# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Parameters that are given to a nodelet when it is spawned.

A name such as `rate` overrides the transformation's parameter, or adds one. A variable such as
`?camera` is bound to a name, which fills the placeholders in the transformation's parameters.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Iterable, Sequence

from dyknow.errors import InvalidParameters
from dyknow.manager.specifications.findings import listed, meant, shorten
from dyknow.manager.specifications.tags import Bindings, Subsumption, Term, read_tags, types_of
from dyknow.manager.specifications.values import BadValue, filled, infer_type, parse_value
from dyknow.model.placeholders import variables_of
from dyknow.model.transformation import OUT, Parameter, Transformation

#: Parameters that every port of images reads, its own or those of its nodelet.
_OF_IMAGES = re.compile(r"(?:\w+/)*(?:image_transport|compressed/\w+)\Z")


def bindings_of(given: Iterable[Parameter]) -> dict[str, str]:
    """Return the variables that are given, each with its name."""
    return {each.name: each.text for each in given if each.name[:1] == "?"}


def names_of(given: Iterable[Parameter]) -> tuple[str, ...]:
    """Return the names of the parameters that are given, without the variables."""
    return tuple(each.name for each in given if each.name[:1] != "?")


def undeclared(transformation: Transformation | None, given: Iterable[Parameter]) -> list[str]:
    """Describe the given parameters that a transformation with parameters does not declare.

    They are set all the same: a nodelet may read more parameters than its transformation declares.
    """
    if transformation is None or not transformation.parameters:
        return []
    known = {each.name for each in transformation.parameters}
    return [
        f"transformation '{transformation.label}' declares no parameter '{shorten(name)}': it is "
        f"set, but perhaps not read{meant(name, known)}"
        for name in names_of(given)
        if name not in known and not _OF_IMAGES.match(name)
    ]


def _terms(transformation: Transformation) -> list[Term]:
    return [term for port in transformation.ports for term in read_tags(port.tags)]


def variables(transformation: Transformation) -> set[str]:
    return {variable for term in _terms(transformation) for variable in term.variables}


def shares_variables(transformation: Transformation) -> bool:
    """Whether a variable stands in several tags of a transformation."""
    used = [variable for term in _terms(transformation) for variable in term.variables]
    return len(set(used)) < len(used)


def filling_variables(transformation: Transformation) -> set[str]:
    texts = [parameter.text for parameter in transformation.parameters]
    return {variable for text in texts for variable in variables_of(text)}


def filling(transformation: Transformation, bindings: Bindings) -> tuple[Parameter, ...]:
    """Return the given parameters that fill the placeholders of a nodelet's parameters.

    What is not bound, since the transformation was replaced meanwhile, is refused on load.
    """
    used = filling_variables(transformation)
    return tuple([Parameter(each, "string", name) for each, name in bindings if each in used])


def exposed_variables(transformation: Transformation) -> set[str]:
    """Return the variables that tell nodelets apart: of out-ports, parameters and verdicts."""
    outs = [port for port in transformation.ports if port.direction == OUT]
    terms = [term for port in outs for term in read_tags(port.tags)]
    terms += read_tags(tuple(each.tag for each in transformation.requires))
    return {each for term in terms for each in term.variables} | filling_variables(transformation)


def completed(
    transformation: Transformation, given: Sequence[Parameter], ontology: Subsumption | None = None
) -> tuple[Parameter, ...]:
    """Check parameters that are given to a nodelet; returns them with their types, by name.

    An empty type is the transformation's or follows from the text. Without an ontology the types
    of variables are not checked. InvalidParameters names all problems.
    """
    declared = {each.name: each.type for each in transformation.parameters}
    counts = Counter(name for name, _, _ in given)
    problems = [f"{name} is given more than once" for name, count in counts.items() if count > 1]
    done = []
    for name, type_, text in sorted(given):
        if name[:1] == "?":
            problems += _problems_of_variable(transformation, name, type_, text, ontology)
            done.append(Parameter(name, "string", text))
            continue
        type_ = type_ or declared.get(name) or infer_type(text)
        if not name or name[0] in "/~" or name.split() != [name]:
            problems.append(f"'{shorten(name)}' is no name of a parameter; expected one like rate")
        try:
            parse_value(type_, text)
        except BadValue as error:
            problems.append(f"the parameter '{shorten(name)}': {error}")
        done.append(Parameter(name, type_, text))
    if problems:
        raise InvalidParameters(transformation.label, problems)
    set_on_load(transformation, done)
    return tuple(done)


def set_on_load(
    transformation: Transformation, given: Sequence[Parameter]
) -> tuple[Parameter, ...]:
    """Return the parameters to set in a nodelet's namespace before it is loaded.

    Raises InvalidParameters if placeholders stay unfilled, or a value is not of its type.
    """
    bindings = bindings_of(given)
    overriding = [each for each in given if each.name[:1] != "?"]
    overridden = [each.name for each in overriding]
    problems: list[str] = []
    result: list[Parameter] = []
    for name, type_, text in transformation.parameters:
        if name in overridden:
            continue
        try:
            unbound = [each for each in variables_of(text) if each not in bindings]
            if not unbound:
                filled_text = filled(type_, text, bindings)
                parse_value(type_, filled_text)
                result.append(Parameter(name, type_, filled_text))
        except BadValue as error:
            problems.append(f"the parameter '{shorten(name)}': {error}")
        except ValueError as error:
            problems.append(f"the parameter '{name}' has {error}")
        else:
            problems += [
                f"nothing says what {each} in the parameter '{name}' stands for; give it, as in "
                f"--param '{each}=NAME'"
                for each in unbound
            ]
    if problems:
        raise InvalidParameters(transformation.label, problems)
    return (*result, *overriding)


def _problems_of_variable(
    transformation: Transformation, name: str, type_: str, text: str, ontology: Subsumption | None
) -> Iterable[str]:
    known, concepts = variables(transformation), types_of(_terms(transformation))
    if name not in known:
        yield f"unknown variable {shorten(name)}; known: {listed(known)}{meant(name, known)}"
    if type_ not in ("", "string"):
        yield f"{shorten(name)} is given as {type_}; expected a name, of type string"
    if not text.strip() or text.strip() != text or text[0] == "?" or set(text) & set("(),"):
        yield f"{shorten(name)} is given '{shorten(text)}'; expected a name such as cam1"
    if ontology is not None:
        for concept in sorted(concepts.get(name, frozenset()) - ontology.names_above(text)):
            yield f"{shorten(name)} is given '{shorten(text)}', which is no {concept}"
