# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Where the messages of a type carry their time stamp."""

from __future__ import annotations

from typing import Any


class StampField:
    """The field of a message type that says when a message was made.

    That is ``header.stamp`` where there is a header, else the first field of type ``time``:
    ``std_msgs/Header.stamp``, ``std_msgs/Time.data``, ``rosgraph_msgs/Clock.clock``.
    """

    def __init__(self, owner: str, name: str) -> None:
        self._owner = owner
        self._name = name

    @classmethod
    def of(cls, datatype: Any) -> StampField | None:
        """Find the field of a message class; None if its messages are not stamped."""
        types = dict(zip(datatype.__slots__, datatype._slot_types))
        if types.get("header") in ("std_msgs/Header", "Header"):
            return cls("header", "stamp")
        for name, field_type in types.items():
            if field_type == "time":
                return cls("", name)
        return None

    def read(self, message: Any) -> Any:
        """Return the stamp, a ``rospy.Time``."""
        return getattr(self._holder(message), self._name)

    def write(self, message: Any, stamp: Any) -> None:
        """Set the stamp of a message that is not published yet."""
        setattr(self._holder(message), self._name, stamp)

    def _holder(self, message: Any) -> Any:
        return getattr(message, self._owner) if self._owner else message
