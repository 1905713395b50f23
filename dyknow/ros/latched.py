"""Reads what is latched on a topic, without being a node.

A command that only wants to know the present state need not register with the master: it asks the
publisher itself for a connection and takes the one message that is sent to newcomers.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from typing import Any

import rosgraph.network

from dyknow.errors import PeerTimeout
from dyknow.ros.master import Master

_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 16


def read_latched(
    master: Master, publisher: str, topic: str, message_class: Any, timeout: float
) -> Any:
    """Return the message that a node has latched on a topic.

    Args:
        master: where the node is looked up.
        publisher: global name of the node.
        topic: global name of the topic.
        message_class: generated class of the message.
        timeout: seconds for all of it.

    Raises:
        LookupError: the node is unknown, or does not publish the topic.
        PeerTimeout: no message in time.
        OSError: the connection broke.
    """
    deadline = time.monotonic() + timeout
    node = Master(master.caller, master.ask("lookupNode", publisher), _left(deadline))
    offer = node.ask("requestTopic", topic, [["TCPROS"]])
    if not offer:
        raise LookupError(f"{publisher} offers no TCPROS connection for {topic}")
    _, host, port = offer
    try:
        connection = socket.create_connection((host, port), _left(deadline))
        with contextlib.closing(connection):
            rosgraph.network.write_ros_handshake_header(
                connection,
                {
                    "topic": topic,
                    "type": message_class._type,
                    "md5sum": message_class._md5sum,
                    "callerid": master.caller,
                    "tcp_nodelay": "1",
                },
            )
            header = _frame(connection, deadline)
            answer = rosgraph.network.decode_ros_handshake_header(
                _LENGTH.pack(len(header)) + header
            )
            if "error" in answer:
                raise LookupError(answer["error"])
            return message_class().deserialize(_frame(connection, deadline))
    except socket.timeout as error:
        raise PeerTimeout(f"topic {topic} of {publisher}", timeout) from error


def _frame(connection: socket.socket, deadline: float) -> bytes:
    (length,) = _LENGTH.unpack(_exactly(connection, _LENGTH.size, deadline))
    return _exactly(connection, length, deadline)


def _exactly(connection: socket.socket, count: int, deadline: float) -> bytes:
    parts = bytearray()
    while len(parts) < count:
        connection.settimeout(_left(deadline))
        part = connection.recv(min(_CHUNK, count - len(parts)))
        if not part:
            raise ConnectionResetError("the publisher closed the connection")
        parts += part
    return bytes(parts)


def _left(deadline: float) -> float:
    return max(0.001, deadline - time.monotonic())
