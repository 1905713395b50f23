# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Connections to hosts by name; a silent name server delays only callers that need it.

``getaddrinfo`` has no time limit. Each name is looked up by one thread at a time, for all callers,
and each caller waits as long as its own time limit says. A name that was found before is never
waited for: its old address serves until there is a new one.
"""

from __future__ import annotations

import contextlib
import socket
import time
from concurrent.futures import Future, wait
from functools import partial
from typing import Callable, TypeVar

import rosgraph.network

from dyknow.locks import state_lock
from dyknow.periodic import in_background

T = TypeVar("T")

#: Seconds after which an address is looked up again.
FRESH = 10.0
#: Seconds without an acknowledgement after which a connection ends: the other host is away. The
#: kernel acknowledges for a process that hangs.
UNACKNOWLEDGED = 2.0


def future_of(what: str, call: Callable[[], T]) -> Future[T]:
    """Make a call in a daemon thread of its own, which delays no exit; its result comes later."""
    future: Future[T] = Future()

    def work() -> None:
        try:
            future.set_result(call())
        except Exception as error:
            future.set_exception(error)

    in_background(what, work)
    return future


def look_up(host: str) -> tuple[str, ...]:
    """Ask the system for the addresses of a host, however long it takes."""
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    return tuple(dict.fromkeys(str(address[0]) for *_, address in found))


class Addresses:
    """Addresses by name; every method is safe from any thread."""

    def __init__(
        self,
        look_up: Callable[[str], tuple[str, ...]] = look_up,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._look_up = look_up
        self._clock = clock
        self._state_lock = state_lock("addresses")
        self._known: dict[str, tuple[tuple[str, ...], float]] = {}  # and when they were found
        self._searches: dict[str, Future[tuple[str, ...]]] = {}

    def of(self, host: str, timeout: float) -> tuple[str, ...]:
        """Return the addresses of a host; raises ``OSError``, ``socket.timeout`` if late."""
        if _is_address(host):
            return (host,)
        with self._state_lock:
            known, since = self._known.get(host, ((), 0.0))
            search = self._searches.get(host)
            if search is None and not (known and self._clock() - since < FRESH):
                search = future_of(f"address of {host}", partial(self._search, host))
                self._searches[host] = search
        if known or search is None:
            return known
        if not wait([search], timeout).done:
            raise socket.timeout("timed out")
        return search.result()

    def _search(self, host: str) -> tuple[str, ...]:
        found: tuple[str, ...] = ()
        try:
            found = self._look_up(host)
        except UnicodeError as error:  # it cannot be the name of a host
            raise OSError(str(error)) from error
        finally:
            with self._state_lock:
                del self._searches[host]
                if found:
                    self._known[host] = found, self._clock()
        return found


def _is_address(host: str) -> bool:
    for family in (socket.AF_INET, socket.AF_INET6):
        with contextlib.suppress(OSError):
            socket.inet_pton(family, host)
            return True
    return False


#: The addresses of this process.
ADDRESSES = Addresses()


def connect(host: str, port: int, timeout: float) -> socket.socket:
    """Connect to a host, its look-up included, at the first of its addresses that answers.

    Raises:
        socket.timeout: one was silent until the time was up.
        ConnectionError: no address answers, and one refuses.
        OSError: no address can be found, or reached.
    """
    deadline = time.monotonic() + timeout
    failure: OSError | None = None
    for address in ADDRESSES.of(host, timeout):
        try:
            left = max(0.001, deadline - time.monotonic())
            connection = socket.create_connection((address, port), left)
        except socket.timeout:
            raise
        except OSError as error:
            failure = error if isinstance(error, ConnectionError) else failure or error
            continue
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        milliseconds = round(1000 * UNACKNOWLEDGED)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds)
        return connection
    raise failure or OSError(f"{host} has no address")


def refuses(uri: str, timeout: float) -> bool:
    """Whether the host in a node's address answers that no process listens there: it has ended."""
    try:
        connect(*host_and_port(uri), timeout).close()
    except ConnectionRefusedError:
        return True
    except OSError:
        pass
    return False


def host_and_port(uri: str) -> tuple[str, int]:
    """Split the address of a node or of a service.

    Raises ``OSError``, as where nothing answers, if it is none: nodes register whatever their
    ``ROS_IP`` makes of it.
    """
    try:
        host, port = rosgraph.network.parse_http_host_and_port(uri)
    except ValueError as error:
        raise OSError(f"'{uri}' is no address of a process") from error
    return host, port


def host_of(uri: str) -> str:
    """Return the host in the address of a node or of a service, as it is written there."""
    return uri.partition("://")[2].partition("/")[0].rpartition(":")[0]


def is_here(host: str, timeout: float) -> bool:
    """Whether a host is this one; raises ``OSError`` if its address is not known in time."""
    return any(map(rosgraph.network.is_local_address, ADDRESSES.of(host, timeout)))
