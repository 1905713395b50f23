# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How large messages are when they are serialised, without serialising them."""

from __future__ import annotations

from typing import Any

_BYTES = {"byte": 1, "char": 1, "bool": 1, "time": 8, "duration": 8}
_BYTES.update((f"{sign}int{bits}", bits // 8) for sign in ("", "u") for bits in (8, 16, 32, 64))
_BYTES.update((f"float{bits}", bits // 8) for bits in (32, 64))
#: Bytes that count the elements of an array, or the letters of a string.
_COUNT = 4


def size_of(message: Any) -> int:
    """Return about how many bytes a message has, 0 if that is not known; quick.

    All strings and messages of an array count like the first of them.
    """
    try:
        return _size(message)
    except (AttributeError, TypeError, ValueError):  # its author put something else there
        return 0


def _size(message: Any) -> int:
    return sum(
        _size_of_field(kind, getattr(message, name))
        for name, kind in zip(message.__slots__, message._slot_types)
    )


def _size_of_field(kind: str, value: Any) -> int:
    element, is_array, length = kind.partition("[")
    if is_array:
        each = _BYTES.get(element) or (_size_of_field(element, value[0]) if len(value) else 0)
        return (_COUNT if length == "]" else 0) + len(value) * each
    if element == "string":
        return _COUNT + len(value.encode() if isinstance(value, str) else value)
    return _BYTES.get(element) or _size(value)
