"""Reads a topic from one of its publishers, without being a node.

A command of the shell need not register with the master: it asks the publisher itself for a
connection and takes what is sent on it.
"""

from __future__ import annotations

import socket
import struct
import time
from typing import Any, Optional

import rosgraph.network

from dyknow.errors import PeerTimeout
from dyknow.ros.addresses import connect
from dyknow.ros.master import Master

_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 16


class TopicReader:
    """A connection to one publisher of a topic."""

    def __init__(
        self, master: Master, publisher: str, topic: str, message_class: Any, timeout: float
    ) -> None:
        """Connect.

        Args:
            master: where the node is looked up.
            publisher: global name of the node.
            topic: global name of the topic.
            message_class: generated class of the message.
            timeout: seconds for all of it.

        Raises:
            LookupError: the node is unknown, or does not publish the topic.
            PeerTimeout: it does not answer in time.
            OSError: the connection broke.
        """
        self._what = f"topic {topic} of {publisher}"
        self._class = message_class
        self._buffer = bytearray()
        deadline = time.monotonic() + timeout
        node = Master(master.caller, master.ask("lookupNode", publisher), _left(deadline))
        offer = node.ask("requestTopic", topic, [["TCPROS"]])
        if not offer:
            raise LookupError(f"{publisher} offers no TCPROS connection for {topic}")
        _, host, port = offer
        try:
            self._connection = connect(host, port, _left(deadline))
        except socket.timeout as error:
            raise PeerTimeout(self._what, timeout) from error
        try:
            self._shake_hands(master.caller, topic, timeout)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> TopicReader:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def read(self, timeout: float) -> Optional[Any]:
        """Return the next message, or None if none comes in time.

        Raises:
            OSError: the connection broke; the publisher may be gone.
        """
        frame = self._frame(timeout)
        return None if frame is None else self._class().deserialize(frame)

    def close(self) -> None:
        """Disconnect."""
        self._connection.close()

    # Inside

    def _shake_hands(self, caller: str, topic: str, timeout: float) -> None:
        rosgraph.network.write_ros_handshake_header(
            self._connection,
            {
                "topic": topic,
                "type": self._class._type,
                "md5sum": self._class._md5sum,
                "callerid": caller,
                "tcp_nodelay": "1",
            },
        )
        header = self._frame(timeout)
        if header is None:
            raise PeerTimeout(self._what, timeout)
        answer = rosgraph.network.decode_ros_handshake_header(_LENGTH.pack(len(header)) + header)
        if "error" in answer:
            raise LookupError(answer["error"])

    def _frame(self, timeout: float) -> Optional[bytes]:
        """Read a length and what it counts; what has come of it is kept if time runs out."""
        deadline = time.monotonic() + timeout
        while True:
            if len(self._buffer) >= _LENGTH.size:
                (length,) = _LENGTH.unpack_from(self._buffer)
                end = _LENGTH.size + length
                if len(self._buffer) >= end:
                    frame = bytes(self._buffer[_LENGTH.size : end])
                    del self._buffer[:end]
                    return frame
            self._connection.settimeout(_left(deadline))
            try:
                part = self._connection.recv(_CHUNK)
            except socket.timeout:
                return None
            if not part:
                raise ConnectionResetError("the publisher closed the connection")
            self._buffer += part


def _left(deadline: float) -> float:
    return max(0.001, deadline - time.monotonic())
