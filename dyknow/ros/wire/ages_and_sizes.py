# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How old and how large messages are.

Their age is the ROS time since the stamp in the header that they begin with. With
``/use_sim_time`` that is simulated time. A stamp of zero is none.
"""

from __future__ import annotations

import functools
import struct
from typing import Any

import rospy

from dyknow.ros.wire.message_classes import message_class

#: A header begins with its number, seconds and nanoseconds.
_HEADER = struct.Struct("<III")
#: Bytes of each primitive type.
_BYTES = {"byte": 1, "char": 1, "bool": 1, "time": 8, "duration": 8}
_BYTES.update((f"{sign}int{bits}", bits // 8) for sign in ("", "u") for bits in (8, 16, 32, 64))
_BYTES.update((f"float{bits}", bits // 8) for bits in (32, 64))
#: Bytes that count the elements of an array, or the letters of a string.
_COUNT = 4


@functools.lru_cache(maxsize=1000)
def is_stamped(datatype: str) -> bool | None:
    """Whether messages of a type begin with a header; None if the type is not known here."""
    found = message_class(datatype)
    return None if found is None else bool(getattr(found, "_has_header", False))


def age_of(message: Any) -> float | None:
    """Return the age of a message in seconds; None if it bears no stamp."""
    if not getattr(message, "_has_header", False):
        return None
    try:
        stamp = message.header.stamp
        return _age(stamp.secs, stamp.nsecs)
    except (AttributeError, TypeError):  # its author put something else there
        return None


def age_of_serialised(message: Any) -> float | None:
    """Return the age in seconds of a message that was received as ``rospy.AnyMsg``."""
    definition = (message._connection_header or {}).get("message_definition", "")
    if len(message._buff or b"") < _HEADER.size or not _begins_with_header(definition):
        return None
    _, seconds, nanoseconds = _HEADER.unpack_from(message._buff)
    return _age(seconds, nanoseconds)


@functools.lru_cache(maxsize=1000)
def _begins_with_header(definition: str) -> bool:
    """Read the first field of a message definition, behind comments and constants."""
    for line in definition.splitlines():
        words = line.split("#")[0].split()
        if words and "=" not in line.split("#")[0]:
            return words[1:] == ["header"] and words[0].split("/")[-1] == "Header"
    return False


def _age(seconds: int, nanoseconds: int) -> float | None:
    if not seconds and not nanoseconds:
        return None
    now = rospy.get_rostime()
    return float(now.secs - seconds + (now.nsecs - nanoseconds) * 1e-9)


def size_of(message: Any) -> int:
    """Return about how many bytes a message has serialised, 0 if that is not known; quick.

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
