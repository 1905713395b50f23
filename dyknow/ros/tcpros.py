# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""TCPROS connections of our own, in which every step has a time limit (rospy's have none).

TCPROS sends frames: four bytes for the length, and as many bytes of content. A connection begins
with a frame of header fields in each direction.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from typing import Dict, Tuple

import rosgraph.network

from dyknow.errors import HostError
from dyknow.ros.addresses import connect

_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 16
_LEAST_WAIT = 0.001


class ConnectionRefused(HostError):
    """The other side answered the header with an error: another type, or another checksum."""

    def __init__(self, what: str, answer: str) -> None:
        self.answer = answer
        advice = ""
        if "md5sum" in answer:
            advice = "; its process was started with another version of DyKnow: restart it"
        super().__init__(f"{what} cannot be used: {answer}{advice}")


class TcprosConnection:
    """The side that connects. Deadlines are moments of the steady clock.

    The methods that send and receive raise ``socket.timeout`` when the deadline passes, and
    ``OSError`` when the connection breaks. Received bytes are kept for the next call.
    """

    def __init__(self, host: str, port: int, seconds: float) -> None:
        """Connect within ``seconds``."""
        self._socket = connect(host, port, seconds)
        self._received = bytearray()

    def shake_hands(self, what: str, fields: Dict[str, str], deadline: float) -> None:
        """Exchange headers.

        Args:
            what: the service or topic, for the error.
            fields: of the header that is sent.
            deadline: for both headers.

        Raises:
            ConnectionRefused: the header of the other side has an error.
        """
        self._limit(deadline)
        rosgraph.network.write_ros_handshake_header(self._socket, fields)
        header = self.receive_frame(deadline)
        answer: Dict[str, str] = rosgraph.network.decode_ros_handshake_header(
            _LENGTH.pack(len(header)) + header
        )
        if "error" in answer:
            raise ConnectionRefused(what, answer["error"])

    def send_frame(self, body: bytes, deadline: float) -> None:
        """Send a frame."""
        self._limit(deadline)
        self._socket.sendall(_LENGTH.pack(len(body)) + body)

    def receive_frame(self, deadline: float) -> bytes:
        """Return the content of the next frame."""
        return self._receive(0, deadline)[1]

    def receive_answer(self, deadline: float) -> Tuple[bool, bytes]:
        """Return the answer of a service: whether it succeeded, and the content of the frame."""
        succeeded, body = self._receive(1, deadline)
        return succeeded != b"\0", body

    def keep_alive(self) -> None:
        """Notice within seconds, while nothing is received, that the other side's host is gone."""
        for level, option, value in (
            (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1),
            (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 5),
            (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 2),
            (socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3),
        ):
            self._socket.setsockopt(level, option, value)

    def interrupt(self) -> None:
        """End what another thread sends or receives: it raises OSError, and then closes."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Disconnect; only for the thread that uses the connection."""
        self._socket.close()

    def _receive(self, before: int, deadline: float) -> Tuple[bytes, bytes]:
        """Return so many bytes and the frame after them, both once they are there."""
        start = before + _LENGTH.size
        self._fill(start, deadline)
        end = start + _LENGTH.unpack_from(self._received, before)[0]
        self._fill(end, deadline)
        first, body = bytes(self._received[:before]), bytes(self._received[start:end])
        del self._received[:end]
        return first, body

    def _fill(self, count: int, deadline: float) -> None:
        while len(self._received) < count:
            self._limit(deadline)
            part = self._socket.recv(_CHUNK)
            if not part:
                raise ConnectionResetError("the other side closed the connection")
            self._received += part

    def _limit(self, deadline: float) -> None:
        self._socket.settimeout(max(_LEAST_WAIT, deadline - time.monotonic()))
