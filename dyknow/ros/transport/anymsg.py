# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Messages of any type: between ``rospy.AnyMsg`` and the classes of messages.

rospy has one subscriber for each topic of a process, and its first user decides which class its
messages have. Here they are converted for all others.
"""

from __future__ import annotations

from io import BytesIO
from typing import Any, Dict, Optional

import rospy

from dyknow.nodelet.middleware import Receive


def connection_header(datatype: Any, latching: bool) -> Dict[str, str]:
    """The connection header of messages from this process, without their topic."""
    return {
        "callerid": rospy.get_name(),
        "latching": str(int(latching)),
        "md5sum": datatype._md5sum,
        "message_definition": datatype._full_text,
        "type": datatype._type,
    }


def serialised(any_class: Any, message: Any, header: Optional[Dict[str, str]] = None) -> Any:
    """Convert a message of this process to one of any type."""
    buffer = BytesIO()
    message.serialize(buffer)
    wrapped = any_class()
    wrapped._buff = buffer.getvalue()
    wrapped._connection_header = header or connection_header(message, False)
    return wrapped


class TypedReceiver:
    """Feeds a connection of a definite type from a rospy subscriber that may be of any type."""

    def __init__(self, topic: str, datatype: Any, receive: Receive) -> None:
        self._topic = topic
        self._datatype = datatype
        self._receive = receive

    def push(self, message: Any) -> None:
        """Pass a message on, in its class."""
        if message._md5sum == "*":
            present = message._connection_header
            if present["md5sum"] != self._datatype._md5sum:
                rospy.logwarn_throttle(
                    10.0,
                    f"{self._topic} carries {present['type']}, but {self._datatype._type} was "
                    "asked for: dropping it",
                )
                return
            message = self._datatype().deserialize(message._buff)
            message._connection_header = present
        self._receive(message)
