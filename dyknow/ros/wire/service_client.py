# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Remote calls and TCPROS connections in which every step has a time limit.

rospy's have none: a call to a suspended process blocks for as long as it stays suspended. A
`ServiceClient` uses TCPROS connections of its own, and passes on the error text of a service that
fails unchanged.

TCPROS sends frames: four bytes for the length, and as many bytes of content. A connection begins
with a frame of header fields in each direction.
"""

from __future__ import annotations

import contextlib
import re
import socket
import struct
import threading
import time
from io import BytesIO
from typing import Any

import rosgraph.network

from dyknow.errors import HostError, NotUtf8, PeerTimeout
from dyknow.locks import assert_no_state_lock, state_lock, turn_lock
from dyknow.ros.wire.addresses import connect, host_and_port
from dyknow.ros.wire.master import Master

#: Seconds in which a connection has to be there.
CONNECT_TIMEOUT = 2.0
#: What rospy's services put before the words of their handlers.
_PREFIX = re.compile("(service cannot process|error processing) request: ")
_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 16
_LEAST_WAIT = 0.001
OTHER_VERSION = "its process was started with another version of DyKnow: restart it"


class ConnectionRefused(HostError):
    """The other side answered the header with an error: another type, or another checksum."""

    def __init__(self, what: str, answer: str) -> None:
        self.answer = answer
        advice = f"; {OTHER_VERSION}" if "md5sum" in answer else ""
        super().__init__(f"{what} cannot be used: {answer}{advice}")


class TcprosConnection:
    """The side that connects. Deadlines are moments of the steady clock.

    The methods that send and receive raise ``socket.timeout`` when the deadline passes, and
    ``OSError`` when the connection breaks. Received bytes are kept for the next call.
    """

    def __init__(self, host: str, port: int, seconds: float) -> None:
        self._socket = connect(host, port, seconds)
        self._received = bytearray()

    def shake_hands(self, what: str, fields: dict[str, str], deadline: float) -> None:
        """Exchange headers; raises `ConnectionRefused`, and closes the connection on any error."""
        try:
            self._limit(deadline)
            rosgraph.network.write_ros_handshake_header(self._socket, fields)
            header = self.receive_frame(deadline)
            answer: dict[str, str] = rosgraph.network.decode_ros_handshake_header(
                _LENGTH.pack(len(header)) + header
            )
            if "error" in answer:
                raise ConnectionRefused(what, answer["error"])
        except BaseException:
            self.close()
            raise

    def send_frame(self, body: bytes, deadline: float) -> None:
        self._limit(deadline)
        self._socket.sendall(_LENGTH.pack(len(body)) + body)

    def receive_frame(self, deadline: float) -> bytes:
        return self._receive(0, deadline)[1]

    def receive_answer(self, deadline: float) -> tuple[bool, bytes]:
        """Return the answer of a service: whether it succeeded, and the content of the frame."""
        succeeded, body = self._receive(1, deadline)
        return succeeded != b"\0", body

    def keep_alive(self) -> None:
        """Notice within seconds, while nothing is received, that the other side's host is gone."""
        for option, value in (
            (socket.TCP_KEEPIDLE, 5),
            (socket.TCP_KEEPINTVL, 2),
            (socket.TCP_KEEPCNT, 3),
        ):
            self._socket.setsockopt(socket.IPPROTO_TCP, option, value)

    def interrupt(self) -> None:
        """Make a call of another thread raise OSError."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Disconnect; only for the thread that uses the connection."""
        self._socket.close()

    def _receive(self, before: int, deadline: float) -> tuple[bytes, bytes]:
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


def is_offered(service: str, address: str, caller: str, timeout: float) -> bool:
    """Whether the process at an address offers a service; one that is late may do so."""
    fields = {"probe": "1", "service": service, "md5sum": "*", "callerid": caller}
    try:
        connection = TcprosConnection(*host_and_port(address), timeout)
        connection.shake_hands(service, fields, time.monotonic() + timeout)
    except socket.timeout:
        return True
    except (OSError, ConnectionRefused):
        return False
    connection.close()
    return True


class ServiceFailed(HostError):
    """The service answered that it failed; the text is its own."""


class ServiceLost(HostError):
    """The server went away before it answered, or is not there."""


def _serialized(request: Any) -> bytes:
    buffer = BytesIO()
    try:
        request.serialize(buffer)
    except UnicodeEncodeError as error:
        raise NotUtf8(error.object) from error
    return buffer.getvalue()


class ServiceClient:
    """Calls one service. Safe from any thread; the calls of a persistent client take turns.

    A persistent client keeps its connection from call to call. It repeats a call, over a new
    connection, when the old one turns out to be closed, so it is for services that may be called
    twice.
    """

    def __init__(
        self,
        master: Master,
        name: str,
        service_class: Any,
        persistent: bool = False,
        reconnects: bool = True,
        beside: str = "",
    ) -> None:
        """Prepare calls of a service of that global name; nothing is sent yet.

        A client that ``reconnects`` connects again when a kept connection is lost, perhaps to
        another process that offers the service now. ``beside`` is a service of the same process,
        which is looked up instead of one that is not registered with the master.
        """
        self.name = name
        self._master = master
        self._class = service_class
        self._persistent = persistent
        self._reconnects = reconnects
        self._registered = beside or name
        #: Where the service was found last; another process has another address.
        self.address = ""
        self._turn = turn_lock("service client")
        self._state_lock = state_lock("connection of a service client")
        self._connection: TcprosConnection | None = None
        self._owed = False  # an answer that came too late for its call

    def call(self, timeout: float, *args: Any, **kwds: Any) -> Any:
        """Call the service and return its response.

        A persistent client whose last call was not answered in time asks again only after that
        answer has come. Until then its calls fail at once, so a server that hangs holds up the
        first call alone.

        The ``timeout`` is for all of it, the wait for the calls of other threads included. The
        further arguments are the request itself, or its fields.

        Raises:
            ServiceFailed: the service says that it failed.
            ServiceLost: it is not offered, or the server went away.
            PeerTimeout: no answer in time.
            NotUtf8: a text of the request cannot be sent.
        """
        assert_no_state_lock(f"calling service {self.name}")
        request_class = self._class._request_class
        is_request = len(args) == 1 and isinstance(args[0], request_class)
        request = args[0] if is_request else request_class(*args, **kwds)
        timeout = min(timeout, threading.TIMEOUT_MAX)
        body, deadline = _serialized(request), time.monotonic() + timeout
        try:
            if not self._persistent:
                with contextlib.closing(self._connect(deadline)) as connection:
                    connection.send_frame(body, deadline)
                    return self._response(*connection.receive_answer(deadline))
            if not self._turn.acquire(timeout=timeout):
                raise socket.timeout
            try:
                return self._call_kept(body, deadline)
            finally:
                self._turn.release()
        except socket.timeout as error:
            raise PeerTimeout(f"service {self.name}", timeout) from error
        except OSError as error:
            raise ServiceLost(f"service {self.name} is gone: {error}") from error

    def close(self) -> None:
        """Close the connection; the next call opens another.

        A call that is going on in another thread fails, or is repeated over a new connection.
        """
        with self._state_lock:
            if self._connection is not None:
                self._connection.interrupt()
        # Only the thread whose turn it is may close the socket: while it reads, the descriptor
        # must not become that of another connection.
        if self._turn.acquire(blocking=False):
            try:
                self._disconnect()
            finally:
                self._turn.release()

    # Inside

    def _call_kept(self, body: bytes, deadline: float) -> Any:
        is_old = self._connection is not None
        try:
            self._connection = self._connection or self._connect(deadline)
            return self._response(*self._exchange(self._connection, body, deadline))
        except ServiceFailed:
            raise
        except socket.timeout:
            if not self._owed:  # part of a request cannot be taken back
                self._disconnect()
            raise
        except OSError:
            self._disconnect()
            if is_old and self._reconnects:
                return self._call_kept(body, deadline)
            raise
        except BaseException:
            self._disconnect()
            raise

    def _disconnect(self) -> None:
        with self._state_lock:
            connection, self._connection = self._connection, None
            self._owed = False
            if connection is not None:
                connection.close()

    def _exchange(
        self, connection: TcprosConnection, body: bytes, deadline: float
    ) -> tuple[bool, bytes]:
        if self._owed:
            connection.receive_answer(time.monotonic())
            self._owed = False
        connection.send_frame(body, deadline)
        self._owed = True
        answer = connection.receive_answer(deadline)
        self._owed = False
        return answer

    def _response(self, succeeded: bool, body: bytes) -> Any:
        if succeeded:
            return self._class._response_class().deserialize(body)
        text = body.decode("utf-8", "replace")
        prefix = _PREFIX.match(text)
        raise ServiceFailed(text[prefix.end() :] if prefix else text)

    def _connect(self, deadline: float) -> TcprosConnection:
        self.address = self._find(deadline)
        host, port = host_and_port(self.address)
        seconds = max(_LEAST_WAIT, min(deadline - time.monotonic(), CONNECT_TIMEOUT))
        header = {
            "service": self.name,
            "md5sum": self._class._md5sum,
            "type": self._class._type,
            "callerid": self._master.caller,
            **({"persistent": "1"} if self._persistent else {}),
        }
        connection = TcprosConnection(host, port, seconds)
        try:
            connection.shake_hands(f"service {self.name}", header, deadline)
        except ConnectionRefused as error:
            raise ServiceFailed(str(error)) from error
        return connection

    def _find(self, deadline: float) -> str:
        """Ask the master for the address, again if it is slow; else the last one serves."""
        if self.address and not self._reconnects:
            raise ServiceLost(f"service {self.name}: the connection was lost")
        while True:
            try:
                return str(self._master.ask("lookupService", self._registered))
            except LookupError as error:
                raise ServiceLost(f"service {self._registered} is not offered") from error
            except PeerTimeout as error:
                if self.address:
                    return self.address
                is_slow = isinstance(error.__cause__, socket.timeout)
                if not is_slow or time.monotonic() >= deadline:
                    raise
