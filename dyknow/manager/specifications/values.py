# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The values of parameters: converts the text of a specification for the parameter server.

The parameter server speaks XML-RPC. It holds strings, integers of 32 bits, doubles, booleans,
and lists and string-keyed mappings of these; anything else is refused with its line, and not in
the middle of a spawn.
"""

from __future__ import annotations

import math
import re
from typing import Any, Callable, Dict, Iterable, List, Mapping, Union

import yaml

from dyknow.manager.specifications.findings import shorten
from dyknow.manager.specifications.limits import DEFAULT_LIMITS, SpecificationLimits
from dyknow.model.placeholders import fill, variables_of
from dyknow.model.transformation import Parameter

Value = Union[str, int, float, bool, List[Any], Dict[str, Any]]

_INT = re.compile(r"[+-]?[0-9]+\Z")
_DOUBLE = re.compile(r"[+-]?(([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?|inf|nan)\Z")
_LONG_NUMBER = re.compile(r"[-+0-9a-fA-Fxo_.:]+\Z")
#: What XML, and so XML-RPC, has no way to write; a carriage return comes out as a line feed.
_NO_XML = re.compile("[\0-\x08\x0b-\x1f\ud800-\udfff\ufffe\uffff]")
#: What ends a document of YAML.
_END = re.compile(r"\n(\.\.\.\n)?\Z")
_BOOLS: dict[str, bool] = {"true": True, "1": True, "false": False, "0": False}
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class BadValue(ValueError):
    """A text is not a value of its type; the message names the expected form."""


def infer_type(text: str) -> str:
    """Return the type of a parameter that states none, as roslaunch does."""
    if _INT.match(text):
        return "int"
    if "." in text and _DOUBLE.match(text):
        return "double"
    return "bool" if text.lower() in ("true", "false") else "string"


def parse_value(type_: str, text: str, limits: SpecificationLimits = DEFAULT_LIMITS) -> Value:
    """Parse the text of a parameter into the value for the parameter server.

    Raises BadValue if it is not of this type, or the parameter server cannot hold it.
    """
    if type_ == "string":
        _check_text(text)
        return text
    if type_ == "int":
        if not _INT.match(text):
            raise BadValue(f"expected an int, such as 42, found '{shorten(text)}'")
        # A longer text is out of range without parsing.
        integer = int(text) if len(text) <= 40 else 2**31
        _check_int(integer, text)
        return integer
    if type_ == "double":
        if not _DOUBLE.match(text.lower()):
            raise BadValue(f"expected a double, such as 0.5 or 1e-3, found '{shorten(text)}'")
        number = float(text)
        if math.isinf(number) and "inf" not in text.lower():
            raise BadValue(f"expected a double of 64 bits, or inf, found '{shorten(text)}'")
        return number
    if type_ == "bool":
        if text.lower() not in _BOOLS:
            raise BadValue(f"expected a bool, true or false, found '{shorten(text)}'")
        return _BOOLS[text.lower()]
    if type_ == "yaml":
        return _parse_yaml(text, limits)
    raise BadValue(f"expected the type string, int, double, bool or yaml, found '{type_}'")


def value_of(parameter: Parameter) -> Value:
    """Return the value for the parameter server; lists and mappings are the caller's own."""
    return parse_value(parameter.type, parameter.text)


def as_tree(parameters: Iterable[Parameter]) -> dict[str, Any]:
    """Return what the parameter server has once parameters are set, in this order."""
    tree: dict[str, Any] = {}
    for parameter in parameters:
        *spaces, key = filter(None, parameter.name.split("/"))
        here = tree
        for space in spaces:
            if not isinstance(here.get(space), dict):
                here[space] = {}
            here = here[space]
        here[key] = value_of(parameter)
    return tree


def find(tree: Any, name: str, default: Any) -> Any:
    """Return a parameter, also one in a namespace, from a tree; or its default."""
    for key in filter(None, name.split("/")):  # as the parameter server reads it
        tree = tree.get(key, default) if isinstance(tree, dict) else default
    return tree


def filled(
    type_: str, text: str, names: Mapping[str, str], limits: SpecificationLimits = DEFAULT_LIMITS
) -> str:
    """Put names for the placeholders of a parameter; in YAML they are strings, or parts of them.

    Raises BadValue if the text is not YAML, KeyError if a variable has no name.
    """
    variables = variables_of(text)
    if type_ != "yaml" or not variables:
        return fill(text, names)
    letters = set(text)
    mark = next(each for each in map(chr, range(0xE000, 0x110000)) if each not in letters)
    places = {each: f"{mark}{number}{mark}" for number, each in enumerate(variables)}
    value = _parse_yaml(fill(text, places), limits)
    place = re.compile(f"{mark}([0-9]+){mark}")
    named = _replaced(value, lambda each: place.sub(lambda m: names[variables[int(m[1])]], each))
    return as_yaml(named)


def as_yaml(value: Value) -> str:
    """Write a value as YAML, in one line."""
    written: str = yaml.safe_dump(
        value, allow_unicode=True, default_flow_style=True, sort_keys=False, width=float("inf")
    )
    return _END.sub("", written)


def _replaced(value: Value, replace: Callable[[str], str]) -> Value:
    if isinstance(value, list):
        return [_replaced(each, replace) for each in value]
    if isinstance(value, dict):
        return {replace(key): _replaced(each, replace) for key, each in value.items()}
    return replace(value) if isinstance(value, str) else value


def _check_int(value: int, text: str) -> None:
    if not -(2**31) <= value < 2**31:
        raise BadValue(
            f"expected an int of 32 bits, which the parameter server holds, found {shorten(text)}"
        )


def _parse_yaml(text: str, limits: SpecificationLimits) -> Value:
    try:
        _check_yaml_events(text, limits)
        value = yaml.load(text, Loader=_LOADER)
    except BadValue:
        raise
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f" (line {mark.line + 1} of the value)" if mark is not None else ""
        reason = getattr(error, "problem", None) or str(error).split("\n")[0]
        raise BadValue(f"expected YAML; {reason}{place}") from None
    except (ValueError, TypeError, OverflowError, AttributeError, LookupError) as error:
        # PyYAML's constructors raise these for scalars such as `!!int x` or 2001-99-99.
        raise BadValue(f"expected YAML; a value cannot be read: {error}") from None
    _check_plain(value)
    return value  # type: ignore[no-any-return]


def _check_yaml_events(text: str, limits: SpecificationLimits) -> None:
    """Refuse YAML that would expand, before it is loaded."""
    depth = nodes = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.AliasEvent):
            raise BadValue("expected YAML without aliases (*name), write the value out")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > limits.nesting:
                raise BadValue(f"expected YAML nested at most {limits.nesting} deep")
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.ScalarEvent):
            number = not event.style or event.tag is not None
            if number and len(event.value) > 400 and _LONG_NUMBER.match(event.value):
                raise BadValue(
                    f"expected numbers of at most 400 digits in YAML, found "
                    f"{shorten(event.value)}; quote it if it is a string"
                )
        if isinstance(event, yaml.NodeEvent):
            nodes += 1
            if nodes > limits.yaml_nodes:
                raise BadValue(f"expected YAML of at most {limits.yaml_nodes} values")


def _check_text(text: str) -> None:
    found = _NO_XML.search(text)
    if found is not None:
        raise BadValue(
            "expected text without control characters, which the parameter server cannot hold, "
            f"found {shorten(text)!r}"
        )


def _check_plain(value: Any) -> None:
    if isinstance(value, str):
        _check_text(value)
    elif isinstance(value, list):
        for item in value:
            _check_plain(item)
    elif isinstance(value, dict):
        for key, item in value.items():
            if not isinstance(key, str):
                raise BadValue(f"expected YAML with strings as keys, found the key {key!r}")
            _check_text(key)
            _check_plain(item)
    elif isinstance(value, int):
        _check_int(value, f"{value:#x}" if abs(value) > 2**64 else str(value))
    elif not isinstance(value, float):
        found = "an empty value" if value is None else f"a {type(value).__name__}"
        raise BadValue(
            "expected YAML of strings, numbers, bools, lists and mappings, which the parameter "
            f"server holds, found {found}"
        )
