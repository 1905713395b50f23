# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Checks that values read from outside have the types that their classes declare."""

from __future__ import annotations

import collections.abc
import dataclasses
import enum
import functools
from typing import Any, Dict, Tuple, Union, get_args, get_origin, get_type_hints


def check_types(value: Any) -> None:
    """Check the fields of a dataclass or named tuple, and what they hold.

    Raises:
        TypeError: a field holds something else than is declared.
    """
    for name, hint in _fields(value.__class__).items():
        if not _fits(getattr(value, name), hint):
            raise TypeError(f"{name} is {getattr(value, name)!r}, expected {_written(hint)}")


@functools.lru_cache(maxsize=None)
def _fields(kind: Any) -> Dict[str, Any]:
    return get_type_hints(kind)


def _fits(value: Any, hint: Any) -> bool:
    if hint is str:
        return isinstance(value, str)
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Union:
        return any(_fits(value, each) for each in arguments)
    if origin is tuple:
        return isinstance(value, tuple) and _fits_tuple(value, arguments)
    if origin is collections.abc.Mapping:
        return isinstance(value, collections.abc.Mapping) and all(
            _fits(key, arguments[0]) and _fits(each, arguments[1]) for key, each in value.items()
        )
    if hint in (int, float):
        kinds = (int, float) if hint is float else (int,)
        return (
            isinstance(value, kinds)
            and not isinstance(value, (bool, enum.Enum))
            and value == value
        )
    if not isinstance(value, hint):
        return False
    if dataclasses.is_dataclass(hint) or hasattr(hint, "_fields"):
        check_types(value)
    return True


def _fits_tuple(values: Tuple[Any, ...], hints: Tuple[Any, ...]) -> bool:
    if len(hints) == 2 and hints[1] is Ellipsis:
        return all(_fits(each, hints[0]) for each in values)
    return len(values) == len(hints) and all(map(_fits, values, hints))


def _written(hint: Any) -> str:
    return getattr(hint, "__name__", None) or str(hint).replace("typing.", "")
