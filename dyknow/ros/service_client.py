"""A service client in which every step has a time limit.

rospy's ServiceProxy has none: a call to a stopped process blocks for as long as that stays
stopped. This one speaks the service protocol of TCPROS on a socket of its own. It also hands on
the words of a service that fails as they were said.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from io import BytesIO
from typing import Any, Optional

import rosgraph.network

from dyknow.errors import HostError, PeerTimeout
from dyknow.locks import assert_no_state_lock, turn_lock
from dyknow.ros.addresses import connect
from dyknow.ros.master import Master

#: Seconds in which a connection has to be there.
CONNECT_TIMEOUT = 2.0
_LENGTH = struct.Struct("<I")
_CHUNK = 1 << 16
#: What rospy's services put before the words of their handlers.
_PREFIX = "service cannot process request: "


class ServiceFailed(HostError):
    """The service answered that it failed; the text is what it said."""


class ServiceLost(HostError):
    """The server went away before it answered, or is not there."""


class ServiceClient:
    """Calls one service. Safe from any thread; the calls of a persistent client take turns.

    A persistent client asks once more, on a new connection, when the old one turns out to be
    closed: it is for services that may be asked twice.
    """

    def __init__(
        self,
        master: Master,
        name: str,
        service_class: Any,
        persistent: bool = False,
        reconnects: bool = True,
    ) -> None:
        """Prepare calls; nothing is sent yet.

        Args:
            master: where the service is looked up.
            name: global name of the service.
            service_class: generated class.
            persistent: keep the connection from call to call.
            reconnects: whether a persistent client connects again when the connection is lost,
                perhaps to another process that offers the service now.
        """
        self.name = name
        self._master = master
        self._class = service_class
        self._persistent = persistent
        self._reconnects = reconnects
        #: Where the service was found last; another process has another address.
        self.address = ""
        self._turn = turn_lock("service client")
        self._socket: Optional[socket.socket] = None
        self._owed = False

    def call(self, timeout: float, *args: Any, **kwds: Any) -> Any:
        """Call the service and return its response.

        A persistent client whose last call was not answered in time does not ask again before
        that answer has come: a hung server costs its clients nothing.

        Args:
            timeout: seconds for all of it.
            args: fields of the request, or the request itself.
            kwds: fields of the request.

        Raises:
            ServiceFailed: the service says that it failed.
            ServiceLost: nobody offers it, or the server went away.
            PeerTimeout: no answer in time.
        """
        assert_no_state_lock(f"calling service {self.name}")
        request_class = self._class._request_class
        is_request = len(args) == 1 and isinstance(args[0], request_class)
        request = args[0] if is_request else request_class(*args, **kwds)
        buffer = BytesIO()
        request.serialize(buffer)
        if not self._persistent:
            return self._call_once(buffer.getvalue(), time.monotonic() + timeout, timeout)
        if not self._turn.acquire(timeout=timeout):
            raise PeerTimeout(f"service {self.name}", timeout)
        try:
            return self._call_kept(buffer.getvalue(), time.monotonic() + timeout, timeout)
        finally:
            self._turn.release()

    def close(self) -> None:
        """Close the connection; the next call opens another."""
        connection, self._socket = self._socket, None
        self._owed = False
        if connection is not None:
            connection.close()

    # Inside

    def _call_once(self, body: bytes, deadline: float, timeout: float) -> Any:
        try:
            with contextlib.closing(self._connect(deadline)) as connection:
                return self._exchange(connection, body, deadline)
        except socket.timeout as error:
            raise PeerTimeout(f"service {self.name}", timeout) from error
        except OSError as error:
            raise ServiceLost(f"service {self.name} is gone: {error}") from error

    def _call_kept(self, body: bytes, deadline: float, timeout: float) -> Any:
        for attempt in (1, 2):
            fresh = self._socket is None
            try:
                if self._socket is None:
                    self._socket = self._connect(deadline)
                if self._owed:
                    self._drop_late_answer(self._socket)
                self._owed = True
                return self._exchange(self._socket, body, deadline)
            except ServiceFailed:
                raise
            except socket.timeout as error:
                if not self._owed:
                    self.close()
                raise PeerTimeout(f"service {self.name}", timeout) from error
            except OSError as error:
                self.close()
                if fresh or attempt == 2 or not self._reconnects:
                    raise ServiceLost(f"service {self.name} is gone: {error}") from error
            except BaseException:
                self.close()
                raise
        raise AssertionError("not reached")

    def _drop_late_answer(self, connection: socket.socket) -> None:
        with contextlib.suppress(ServiceFailed):
            self._receive(connection, time.monotonic() + 0.001)

    def _find(self) -> str:
        """Ask the master for the address; while that is away the last one serves."""
        if self.address and not self._reconnects:
            raise ServiceLost(f"service {self.name}: the connection was lost")
        try:
            return str(self._master.ask("lookupService", self.name))
        except LookupError as error:
            raise ServiceLost(f"service {self.name} is not offered") from error
        except PeerTimeout:
            if not self.address:
                raise
            return self.address

    def _connect(self, deadline: float) -> socket.socket:
        self.address = self._find()
        uri = self.address.replace("rosrpc://", "http://")
        host, port = rosgraph.network.parse_http_host_and_port(uri)
        seconds = max(0.001, min(deadline - time.monotonic(), CONNECT_TIMEOUT))
        connection = connect(host, port, seconds)
        try:
            self._shake_hands(connection, deadline)
        except BaseException:
            connection.close()
            raise
        return connection

    def _shake_hands(self, connection: socket.socket, deadline: float) -> None:
        header = {
            "service": self.name,
            "md5sum": self._class._md5sum,
            "type": self._class._type,
            "callerid": self._master.caller,
        }
        if self._persistent:
            header["persistent"] = "1"
        rosgraph.network.write_ros_handshake_header(connection, header)
        answer = rosgraph.network.decode_ros_handshake_header(
            self._framed(connection, deadline, with_length=True)
        )
        if "error" in answer:
            raise ServiceLost(f"service {self.name}: {answer['error']}")

    def _exchange(self, connection: socket.socket, body: bytes, deadline: float) -> Any:
        connection.settimeout(max(0.001, deadline - time.monotonic()))
        connection.sendall(_LENGTH.pack(len(body)) + body)
        return self._class._response_class().deserialize(self._receive(connection, deadline))

    def _receive(self, connection: socket.socket, deadline: float) -> bytes:
        succeeded = self._exactly(connection, 1, deadline) != b"\0"
        self._owed = False  # half an answer cannot be waited for later: the connection is closed
        body = self._framed(connection, deadline)
        if not succeeded:
            text = body.decode("utf-8", "replace")
            raise ServiceFailed(text[len(_PREFIX) :] if text.startswith(_PREFIX) else text)
        return body

    def _framed(
        self, connection: socket.socket, deadline: float, with_length: bool = False
    ) -> bytes:
        length = self._exactly(connection, _LENGTH.size, deadline)
        body = self._exactly(connection, _LENGTH.unpack(length)[0], deadline)
        return length + body if with_length else body

    @staticmethod
    def _exactly(connection: socket.socket, count: int, deadline: float) -> bytes:
        parts = bytearray()
        while len(parts) < count:
            connection.settimeout(max(0.001, deadline - time.monotonic()))
            part = connection.recv(min(_CHUNK, count - len(parts)))
            if not part:
                raise ConnectionResetError("the server closed the connection")
            parts += part
        return bytes(parts)
