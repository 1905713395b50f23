# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Fields of types float32 and bool: numbers are read and compared in their precision.

A message that is passed by reference has doubles in such fields, as its author wrote them; one
that was sent or recorded has the nearest values of 32 bits, so that 0.2 is a little more than
0.2. Here both are the same number, and it equals the constant 0.2. A flag that its author wrote
as 1 is true, as it is once it was sent.
"""

from __future__ import annotations

from collections.abc import Sequence as AbstractSequence
from ctypes import c_float
from functools import lru_cache
from typing import Any, Callable, Mapping

from dyknow.formulas.types import ARRAY, known_type, type_of


def _rounding(compare: Callable[[Any, Any], bool]) -> Any:
    """Make a comparison that rounds the other side, if it is a number, to 32 bits."""

    def compare_rounded(single: Single, other: Any) -> bool:
        is_number = isinstance(other, (float, int))
        return compare(single, c_float(other).value if is_number else other)

    return compare_rounded


class Single(float):
    """A number of 32 bits; one that it is compared with is rounded to as many."""

    __slots__ = ()

    __lt__ = _rounding(float.__lt__)
    __le__ = _rounding(float.__le__)
    __gt__ = _rounding(float.__gt__)
    __ge__ = _rounding(float.__ge__)
    __eq__ = _rounding(float.__eq__)
    __ne__ = _rounding(float.__ne__)
    __hash__ = float.__hash__

    def __abs__(self) -> Single:
        return Single(float.__abs__(self))

    def __neg__(self) -> Single:
        return Single(float.__neg__(self))

    def __str__(self) -> str:
        """Write the fewest digits that stand for it."""
        texts = (f"{float(self):.{digits}g}" for digits in range(6, 9))
        return next((text for text in texts if self == float(text)), f"{float(self):.9g}")


class _Message:
    """A message whose fields are read as if it had been sent."""

    __slots__ = ("_message", "_types")

    def __init__(self, message: Any) -> None:
        self._message = message
        self._types = _types_of(message.__class__)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._message, name)
        datatype = self._types.get(name)
        return value if datatype is None else _read(value, datatype)


class _Array(AbstractSequence):  # type: ignore[type-arg]
    """An array of these, of numbers or of flags."""

    __slots__ = ("_array", "_datatype")

    def __init__(self, array: Any, datatype: str) -> None:
        self._array = array
        self._datatype = datatype

    def __len__(self) -> int:
        return len(self._array)

    def __getitem__(self, index: Any) -> Any:
        return _read(self._array[index], self._datatype)


def narrowed(message: Any) -> Any:
    """Return a view of a message with such fields, and any other message as it is."""
    return _Message(message) if _types_of(message.__class__) else message


def plain(value: Any) -> Any:
    """Return Python's number for one of numpy, which wraps round and divides by zero."""
    return value.item() if getattr(value, "ndim", None) == 0 else value


def original(value: Any) -> Any:
    """Return what a view shows."""
    if isinstance(value, _Message):
        return value._message
    return value._array if isinstance(value, _Array) else value


@lru_cache(maxsize=1000)
def _types_of(message_class: Any) -> Mapping[str, str]:
    """Return the types of the fields of a message that a view reads."""
    found = type_of(message_class)
    fields = {} if found is None else found.fields
    return {name: datatype for name, datatype in fields.items() if _is_viewed(datatype)}


def _is_viewed(datatype: str) -> bool:
    array = ARRAY.match(datatype)
    element = array.group(1) if array else datatype
    if "/" not in element:
        return element in ("float32", "bool")
    found = known_type(element)  # of one that is not built here the message's class will tell
    return found is None or any(map(_is_viewed, found.fields.values()))


def _read(value: Any, datatype: str) -> Any:
    if datatype == "float32":
        try:
            return Single(c_float(value).value)
        except TypeError:  # its author put something else there
            return value
    if datatype == "bool":
        flag = plain(value)
        return bool(flag) if isinstance(flag, int) else value
    array = ARRAY.match(datatype)
    return _Array(value, array.group(1)) if array else narrowed(value)
