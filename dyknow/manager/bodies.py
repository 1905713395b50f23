# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What the store keeps of transformations, and the check of stored values against their types."""

from __future__ import annotations

import collections.abc
import dataclasses
import functools
import json
from typing import Any, Union, get_args, get_origin, get_type_hints

from dyknow.model.transformation import Parameter, Port, Transformation


def pack(transformation: Transformation) -> str:
    """Write a transformation as one line of JSON; earlier versions read it if they can use it."""
    is_plain = not (transformation.isolated or transformation.node)
    return json.dumps(transformation[:6] if is_plain else transformation, separators=(",", ":"))


def unpack(body: str) -> Transformation:
    """Read a transformation that ``pack`` wrote; ValueError or TypeError if it is not one."""
    label, source, kind, cost, parameters, ports, *rest = json.loads(body)
    isolated, node = rest or (False, "")
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
    )


def check_types(value: Any) -> None:
    """Raise TypeError if a field of a dataclass or named tuple has not its declared type."""
    for name, hint in _fields(value.__class__).items():
        if not _fits(getattr(value, name), hint):
            expected = getattr(hint, "__name__", None) or str(hint).replace("typing.", "")
            raise TypeError(f"{name} is {getattr(value, name)!r}, expected {expected}")


@functools.lru_cache(maxsize=None)
def _fields(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _fits(value: Any, hint: Any) -> bool:
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Union:
        return any(_fits(value, each) for each in arguments)
    if origin is tuple:
        if not isinstance(value, tuple):
            return False
        hints = arguments[:1] * len(value) if arguments[1:] == (Ellipsis,) else arguments
        return len(value) == len(hints) and all(map(_fits, value, hints))
    if origin is collections.abc.Mapping:
        return isinstance(value, collections.abc.Mapping) and all(
            all(map(_fits, each, arguments)) for each in value.items()
        )
    if hint is float:
        return type(value) in (int, float) and value == value
    if type(value) is not hint:
        return False
    if dataclasses.is_dataclass(hint) or hasattr(hint, "_fields"):
        check_types(value)
    return True
