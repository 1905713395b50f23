# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Stored forms of transformations; reads other stored values by their declared types."""

from __future__ import annotations

import collections.abc
import dataclasses
import enum
import functools
import json
from typing import Any, Mapping, Union, get_args, get_origin, get_type_hints

from dyknow.model.transformation import Parameter, Port, Requirement, Transformation


def pack(transformation: Transformation) -> str:
    """Write a transformation as one line of JSON; earlier versions read it if they can use it."""
    is_plain = not (transformation.isolated or transformation.node or transformation.requires)
    return json.dumps(transformation[:6] if is_plain else transformation, separators=(",", ":"))


def unpack(body: str) -> Transformation:
    """Read a transformation that ``pack`` wrote; ValueError or TypeError if it is not one."""
    label, source, kind, cost, parameters, ports, *rest = json.loads(body)
    isolated, node, *more = rest or (False, "")
    requires = more[0] if more else ()
    texts = [label, source, kind, node]  # checked by hand: there may be hundreds of thousands
    for parameter in parameters:
        texts += parameter
    numbers: list[float] = []
    for name, side, datatype, tags, *stated in ports:  # nothing in files of earlier versions
        texts += (name, side, datatype, *tags)
        numbers += stated
    "".join(texts)
    if type(cost) is not int:
        raise TypeError(f"its cost is {cost!r}")
    if not all(type(number) is float for number in numbers):
        raise TypeError("the rate or latency of a port is no number")
    if type(isolated) is not bool:
        raise TypeError(f"isolated is {isolated!r}")
    if not all(type(tag) is str and type(initially) is bool for tag, initially in requires):
        raise TypeError(f"requires is {requires!r}")
    return Transformation(
        label,
        source,
        kind,
        cost,
        tuple(Parameter(*each) for each in parameters),
        tuple(
            Port(name, side, datatype, tuple(tags), *stated)
            for name, side, datatype, tags, *stated in ports
        ),
        isolated,
        node,
        tuple(Requirement(*each) for each in requires),
    )


def read_fields(kind: Any, body: Mapping[str, Any]) -> dict[str, Any]:
    """Read fields of a dataclass from JSON, by their declared types.

    Raises KeyError, TypeError or ValueError if one is unknown, or has another type.
    """
    hints = _hints(kind)
    return {name: read(hints[name], value) for name, value in body.items()}


def read(hint: Any, value: Any) -> Any:
    """Read a value of a type from JSON; TypeError or ValueError if it is none."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Union and value is None and type(None) in arguments:
        return None
    if origin is Union:
        return read(arguments[0], value)
    make: Any = hint
    if dataclasses.is_dataclass(hint) and isinstance(value, dict):
        return make(**read_fields(hint, value))
    if hasattr(hint, "_fields") and isinstance(value, list):
        return make(*map(read, _hints(hint).values(), value))
    if origin is tuple and isinstance(value, list):
        hints = arguments[:1] * len(value) if arguments[1:] == (Ellipsis,) else arguments
        if len(hints) == len(value):
            return tuple(map(read, hints, value))
    if origin is collections.abc.Mapping and isinstance(value, dict):
        return {read(arguments[0], key): read(arguments[1], each) for key, each in value.items()}
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return hint(value)
    is_number = hint is float and type(value) in (int, float) and value == value
    if not is_number and (hint is float or type(value) is not hint):
        expected = getattr(hint, "__name__", None) or str(hint).replace("typing.", "")
        raise TypeError(f"{value!r} is no {expected}")
    return value


@functools.lru_cache(maxsize=None)
def _hints(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)
