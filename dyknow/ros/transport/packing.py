# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A message as it lies in shared memory, and the frame that says where.

The generated code of genpy copies a large field twice when it packs a message. Here the field is
left out: a mark takes its place, which shows where the content belongs.
"""

from __future__ import annotations

import io
import os
import struct
import weakref
from typing import Any, Tuple

import genpy
import rospy
import rospy.msg

from dyknow.ros.transport.arena import ArenaRegion
from dyknow.ros.transport.conversions import shallow_copy

#: Bytes from which a message or a field goes through shared memory; below, a frame is as quick.
LARGE = 128 << 10
_BYTES = (bytes, bytearray)
#: The length of a frame whose content is in shared memory, which is beyond that of any message.
ELSEWHERE = 0xFFFFFFFF
#: That length, the length and field's place of the text that follows, the number of the field,
#: and the region's offset, number and size.
FRAME = struct.Struct("<IIIiQQQ")
LENGTH = struct.Struct("<I")
#: The number of the field where the whole message is in shared memory.
_ALL = -1
#: Takes the place of a large field while the rest of its message is packed.
_MARK = os.urandom(16)
_PACKED_MARK = LENGTH.pack(len(_MARK)) + _MARK

Path = Tuple[str, ...]


_paths: weakref.WeakKeyDictionary[type[Any], tuple[Path, ...]] = weakref.WeakKeyDictionary()


def _bytes_fields(message: Any) -> tuple[Path, ...]:
    """Paths to the fields of a message that are arrays of bytes, but not within arrays."""
    found = _paths.get(message.__class__)
    if found is None:
        found = _paths[message.__class__] = tuple(_find_bytes_fields(message))
    return found


def _find_bytes_fields(message: Any) -> list[Path]:
    if not _is_generated(message.__class__):
        return []
    found: list[Path] = []
    for slot, datatype in zip(message.__slots__, message._slot_types):
        if datatype in ("uint8[]", "char[]"):
            found.append((slot,))
        elif "/" in datatype and not datatype.endswith("]"):
            inner = getattr(message.__class__(), slot)
            found += [(slot, *path) for path in _find_bytes_fields(inner)]
    return found


def _is_generated(datatype: type[Any]) -> bool:
    """Whether it is as genpy makes them: those of ``rospy.numpy_msg`` and ``AnyMsg`` are not."""
    return datatype.__bases__ == (genpy.Message,) and datatype is not rospy.AnyMsg


def _field(message: Any, path: Path) -> Any:
    for slot in path:
        message = getattr(message, slot)
    return message


def _with_field(message: Any, path: Path, value: Any) -> Any:
    """Return a copy of a message with another value of a field, which shares the rest."""
    if not path:
        return value
    changed = shallow_copy(message)
    inner = _with_field(getattr(message, path[0]), path[1:], value)
    setattr(changed, path[0], inner)
    return changed


def largest_field(message: Any) -> tuple[int, Path, bytes | bytearray]:
    """Return the number, path and content of the largest field that is worth a region.

    Without one, that is the whole message: the content is empty.
    """
    number, content = _ALL, b""
    found: Path = ()
    for index, path in enumerate(_bytes_fields(message)):
        value = _field(message, path)
        if value.__class__ in _BYTES and len(value) >= max(LARGE, len(content)):
            number, found, content = index, path, value
    return number, found, content


class Packed:
    """A message, serialised once for all its connections.

    Attributes:
        content: the part for shared memory: a field of the message, or all of it.
    """

    def __init__(self, message: Any, number: int) -> None:
        """Serialise a message; ``number`` is for its header."""
        self._before: bytes = b""
        self._after: bytes = b""
        self._number, path, self.content = largest_field(message)
        if path:
            message = _with_field(message, path, _MARK)
        buffer = io.BytesIO()
        rospy.msg.serialize_message(buffer, number, message)
        with buffer.getbuffer() as packed:
            if path:
                before, _, after = bytes(packed[4:]).partition(_PACKED_MARK)
                self._before, self._after = before, after
            else:
                self.content = bytes(packed[4:])
        self.size = len(self._before) + len(self.content) + len(self._after)
        self.size += LENGTH.size if path else 0
        self._plain = b""

    def plain(self) -> bytes:
        """Return the ordinary frame."""
        if not self._plain:
            length = () if self._number == _ALL else (LENGTH.pack(len(self.content)),)
            parts = (LENGTH.pack(self.size), self._before, *length, self.content, self._after)
            self._plain = b"".join(parts)
        return self._plain

    def frame(self, region: ArenaRegion) -> bytes:
        """Return the frame that says where the content is."""
        text = b""
        if self._number != _ALL:
            text = b"".join((self._before, LENGTH.pack(0), self._after))
        head = (ELSEWHERE, len(text), len(self._before), self._number)
        return FRAME.pack(*head, region.offset, region.number, region.size) + text


def assembled(datatype: type[Any], text: bytes, place: int, number: int, content: bytes) -> Any:
    """Make a message of its frame and its content in shared memory."""
    message = datatype()
    if number == _ALL:
        return message.deserialize(content)
    if _is_generated(datatype):
        message.deserialize(text)
        *path, slot = _bytes_fields(message)[number]
        setattr(_field(message, tuple(path)), slot, content)
        return message
    rest = text[place + LENGTH.size :]
    return message.deserialize(b"".join((text[:place], LENGTH.pack(len(content)), content, rest)))
