# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Copies of messages, so that code which changes what it sent or received changes its own.

A copy is structural: messages and lists in it are new, and what cannot change (bytes, strings,
numbers) is shared. So the copy of an image of any size takes microseconds.
"""

from __future__ import annotations

import copy
from io import BytesIO
from typing import Any

import genpy

_FLAT = (int, float, str, bytes)


def copy_of(message: Any) -> Any:
    """Copy a message."""
    new = _copied(message)
    header = getattr(message, "_connection_header", None)
    if header is not None:
        new._connection_header = header
    return new


def copy_as(datatype: Any, message: Any) -> Any:
    """Copy a message into another class of the same type, as ``rospy.numpy_msg`` makes them."""
    if message.__class__ is datatype:
        return copy_of(message)
    buffer = BytesIO()
    message.serialize(buffer)
    new = datatype().deserialize(buffer.getvalue())
    new._connection_header = getattr(message, "_connection_header", None)
    return new


def _copied(value: Any) -> Any:
    if isinstance(value, genpy.Message):
        new = value.__class__.__new__(value.__class__)
        for slot in value.__slots__:
            setattr(new, slot, _copied(getattr(value, slot)))
        return new
    if isinstance(value, (list, tuple)):
        if not value or isinstance(value[0], _FLAT):
            return value[:]
        return [_copied(each) for each in value]
    if isinstance(value, genpy.TVal):
        return copy.copy(value)
    if isinstance(value, (bytearray, memoryview)) or hasattr(value, "__array__"):
        return copy.copy(value)
    return value
