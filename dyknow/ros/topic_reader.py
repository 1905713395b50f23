# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads a topic from one of its publishers without registering a node.

A shell command need not register with the master: it asks the publisher for a connection and reads
the messages from it.
"""

from __future__ import annotations

import socket
import time
from typing import Any, Optional

from dyknow.errors import PeerTimeout
from dyknow.ros.master import Master
from dyknow.ros.tcpros import TcprosConnection


class TopicReader:
    """A connection to one publisher of a topic."""

    def __init__(
        self, master: Master, publisher: str, topic: str, message_class: Any, timeout: float
    ) -> None:
        """Connect.

        Args:
            master: the master that knows the node.
            publisher: global name of the node.
            topic: global name of the topic.
            message_class: generated class of the message.
            timeout: seconds for the whole of it.

        Raises:
            LookupError: the node is unknown, or does not publish the topic.
            PeerTimeout: it does not answer in time.
            OSError: the connection broke.
        """
        self._what = f"topic {topic} of {publisher}"
        self._class = message_class
        deadline = time.monotonic() + timeout
        node = Master(master.caller, master.ask("lookupNode", publisher), _left(deadline))
        offer = node.ask("requestTopic", topic, [["TCPROS"]])
        if not offer:
            raise LookupError(f"{publisher} offers no TCPROS connection for {topic}")
        _, host, port = offer
        try:
            self._connection = TcprosConnection(host, port, _left(deadline))
            self._shake_hands(master.caller, topic, deadline)
        except socket.timeout as error:
            raise PeerTimeout(self._what, timeout) from error

    def __enter__(self) -> TopicReader:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def read(self, timeout: float) -> Optional[Any]:
        """Return the next message, or None if there is none in time.

        Raises:
            OSError: the connection broke; the publisher may be gone.
        """
        try:
            frame = self._connection.receive_frame(time.monotonic() + timeout)
        except socket.timeout:
            return None
        return self._class().deserialize(frame)

    def close(self) -> None:
        """Disconnect."""
        self._connection.close()

    # Inside

    def _shake_hands(self, caller: str, topic: str, deadline: float) -> None:
        fields = {
            "topic": topic,
            "type": self._class._type,
            "md5sum": self._class._md5sum,
            "callerid": caller,
            "tcp_nodelay": "1",
        }
        try:
            answer = self._connection.shake_hands(fields, deadline)
            if "error" in answer:
                raise LookupError(answer["error"])
        except BaseException:
            self.close()
            raise


def _left(deadline: float) -> float:
    return max(0.001, deadline - time.monotonic())
