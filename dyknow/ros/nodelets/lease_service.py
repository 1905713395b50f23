# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps a process from publishing beside its successor: leases, and the name of the node.

The rules of leases are in ``dyknow.nodelet.leases``; here are the service with which DyKnow
managers renew them, the thread that watches over them, and its probe of a manager's host.

A node ends when another one has registered under its name. The master notifies it at that moment,
but only once. A node that is cut off just then never hears of it, so each also polls the master.
"""

from __future__ import annotations

import contextlib
import socket
import xmlrpc.client
from typing import Any, Callable

import rosgraph.network
import rospy
from dyknow_msgs.srv import RenewLease, RenewLeaseResponse

from dyknow.errors import LimitExceeded, PeerTimeout
from dyknow.nodelet.bus import Bus
from dyknow.nodelet.leases import Leases, Sight
from dyknow.nodelet.middleware import Closable
from dyknow.periodic import PeriodicWorker
from dyknow.ros.nodelets.guard_parameters import GuardParameters, caller_of
from dyknow.ros.wire.addresses import connect
from dyknow.ros.wire.master import Master

SERVICE = "renew_lease"
#: Seconds between two checks of the leases.
PERIOD = 0.2
#: Seconds for a connection to a manager's host, and for an answer.
PATIENCE = 0.4
#: Seconds between two queries of the master for our name, and for its answer.
NAME_PERIOD = 1.0


class LeaseService(Closable):
    """Offers the service; the node must be initialised."""

    def __init__(self, bus: Bus, guards: GuardParameters) -> None:
        self._guards = guards
        self._leases = Leases(lambda topic: bus.owners(topic)[0], bus.fence)
        self._worker = PeriodicWorker(
            "watching over leases", lambda: self._leases.watch(probe), PERIOD
        )
        self._service = rospy.Service("~" + SERVICE, RenewLease, self._renew)

    def close(self) -> None:
        self._worker.close()
        self._service.shutdown("the nodelet manager ends")

    def _renew(self, request: Any) -> RenewLeaseResponse:
        try:
            self._guards.current().check_sizes((request.uri, *request.topics, *request.nodelets))
        except LimitExceeded as error:
            raise rospy.ServiceException(str(error)) from error
        if len(request.topics) != len(request.nodelets):
            raise rospy.ServiceException("expected as many nodelets as topics")
        producers = dict(zip(request.topics, request.nodelets))
        if producers:
            self._worker.start()
        clock = self._leases.renew(
            caller_of(request), request.uri, request.confirmed, request.duration, producers
        )
        return RenewLeaseResponse(clock)


def probe(uri: str) -> Sight:
    """Probe the host of a node's address: is the process there, and does it answer?

    A connection is made by the kernel, so that of a process that was stopped is made too.
    """
    try:
        host, port = rosgraph.network.parse_http_host_and_port(uri)
        with contextlib.closing(connect(host, port, PATIENCE)) as connection:
            return _query(connection, host)
    except socket.timeout:
        return Sight.SILENT
    except ConnectionError:
        return Sight.NOT_AT_WORK  # nothing listens there
    except (OSError, ValueError):
        return Sight.SILENT


def _query(connection: socket.socket, host: str) -> Sight:
    body = xmlrpc.client.dumps((rospy.get_name(),), "getPid")
    head = f"POST /RPC2 HTTP/1.0\r\nHost: {host}\r\nContent-Type: text/xml\r\n"
    connection.settimeout(PATIENCE)
    try:
        connection.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n{body}".encode())
        return Sight.AT_WORK if connection.recv(1) else Sight.NOT_AT_WORK
    except (socket.timeout, ConnectionError):
        return Sight.NOT_AT_WORK


def end_when_displaced(name: str, uri: str, end: Callable[[str], None]) -> None:
    """Call ``end`` once, with the reason, when the master has another address of a node's name.

    A thread of its own polls the master. One that is away, or knows no such node, changes nothing.
    """
    master = Master(name, timeout=NAME_PERIOD)

    def check() -> None:
        with contextlib.suppress(PeerTimeout):
            if master.node(name) not in ("", uri):
                worker.close()
                end(f"another node bears the name {name} now")

    worker = PeriodicWorker("looking who bears the name of this node", check, NAME_PERIOD)
    worker.start()
    worker.wake()
