# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Copies of messages, and conversion between ``rospy.AnyMsg`` and the classes of messages.

rospy has one subscriber for each topic of a process, and its first user decides which class its
messages have. They are converted here for its other users.
"""

from __future__ import annotations

import copy
import hashlib
from io import BytesIO
from typing import Any, Sequence

import genpy
import rospy
import rospy.msg

from dyknow.nodelet.middleware import DIGEST_SIZE, Receive

_FLAT = (int, float, str, bytes)


def packed(message: Any) -> bytes:
    """Serialise a message."""
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def digest(message: Any) -> bytes:
    """Digest of a message; the sequence number, which rospy changes, does not count."""
    if getattr(message.__class__, "_has_header", False):
        message = shallow_copy(message)
        message.header = shallow_copy(message.header)
        message.header.seq = 0
    return hashlib.blake2b(packed(message), digest_size=DIGEST_SIZE).digest()


def copy_by_wire(message: Any) -> Any:
    """Copy a message the way the network does."""
    return message.__class__().deserialize(packed(message))


def copy_of(message: Any, datatype: Any = None) -> Any:
    """Copy a message, so that code which changes it afterwards changes its own.

    A copy is structural: messages and lists in it are new, and immutable values (bytes, strings,
    numbers) are shared. So the copy of an image of any size takes microseconds. ``datatype`` is
    another class of the same type, as ``rospy.numpy_msg`` makes them.
    """
    if datatype in (None, message.__class__):
        new = _copied(message)
    else:
        new = datatype().deserialize(packed(message))
    header = getattr(message, "_connection_header", None)
    if header is not None:
        new._connection_header = header
    return new


def shallow_copy(message: Any) -> Any:
    """Copy a message whose fields are shared, quicker than ``copy`` does."""
    new = message.__class__.__new__(message.__class__)
    for slot in message.__slots__:
        setattr(new, slot, getattr(message, slot))
    return new


def _copied(value: Any) -> Any:
    if isinstance(value, genpy.Message):
        new = value.__class__.__new__(value.__class__)
        for slot in value.__slots__:
            setattr(new, slot, _copied(getattr(value, slot)))
        return new
    if isinstance(value, (list, tuple)):
        is_flat = not value or isinstance(value[0], _FLAT)
        return value[:] if is_flat else [_copied(each) for each in value]
    if isinstance(value, (genpy.TVal, bytearray, memoryview)) or hasattr(value, "__array__"):
        return copy.copy(value)
    return value


def connection_header(datatype: Any, latching: bool) -> dict[str, str]:
    """The connection header of messages from this process, without their topic."""
    return {
        "callerid": rospy.get_name(),
        "latching": str(int(latching)),
        "md5sum": datatype._md5sum,
        "message_definition": datatype._full_text,
        "type": datatype._type,
    }


def serialised(any_class: Any, message: Any, header: dict[str, str] | None = None) -> Any:
    """Convert a message of this process to one of any type."""
    wrapped = any_class()
    wrapped._buff = packed(message)
    wrapped._connection_header = header or connection_header(message, False)
    return wrapped


def has_arrays(datatype: Any) -> bool:
    """Whether ``rospy.numpy_msg`` made a class of messages; numpy is not imported for that."""
    return bool(datatype.__module__ == "rospy.numpy_msg")


def in_class(datatype: Any, message: Any) -> Any:
    """Return a message in a class of its type.

    One of any type passes, and one of a class that its author has derived from that class.
    """
    if message.__class__ is datatype or "*" in (datatype._md5sum, message._md5sum):
        return message
    if isinstance(message, datatype) and not has_arrays(message.__class__):
        return message
    return copy_of(message, datatype)


def receive_in_class(datatype: Any, receive: Receive) -> Receive:
    """Give subscribers of a class that is not genpy's own messages of it, of any publisher."""
    if not issubclass(datatype, genpy.Message):
        return receive
    if datatype._md5sum == "*":
        return lambda message: receive(
            message if message._md5sum == "*" else serialised(datatype, message)
        )
    if genpy.Message in datatype.__bases__:
        return receive
    return lambda message: receive(
        message if message.__class__ is datatype else in_class(datatype, message)
    )


def built(datatype: Any, args: Sequence[Any], kwds: dict[str, Any]) -> Any:
    """Make a message as ``rospy.Publisher.publish`` does; in a plain one there are no arrays."""
    message = rospy.msg.args_kwds_to_message(datatype, tuple(args), kwds)
    if has_arrays(message.__class__) and message.__class__ is not datatype:
        return in_class(datatype, message)
    return message


class TypedReceiver:
    """Feeds a connection of a definite type from a rospy subscriber that may be of any type."""

    def __init__(self, topic: str, datatype: Any, receive: Receive) -> None:
        self._topic = topic
        self._datatype = datatype
        self._receive = receive

    def push(self, message: Any) -> None:
        if message._md5sum == "*":
            header = message._connection_header
            if header["md5sum"] != self._datatype._md5sum:
                rospy.logwarn_throttle(
                    10.0,
                    f"{self._topic} carries {header['type']}, but {self._datatype._type} was "
                    "requested: dropping it",
                )
                return
            message = self._datatype().deserialize(message._buff)
            message._connection_header = header
        elif message.__class__ is not self._datatype:  # of the first subscriber of the topic
            message = in_class(self._datatype, message)
        self._receive(message)
