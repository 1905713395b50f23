# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A process's answers to the DyKnow managers that poll it, and its end beside a successor.

With each poll a manager renews the lease of the process; the rules are in
``dyknow.nodelet.leases``. Here are the thread that watches over leases, and its probe of a
manager's host.

A node ends when another one has registered under its name. The master notifies it at that moment,
but only once. A node that is cut off just then never hears of it, so each also polls the master.
"""

from __future__ import annotations

import contextlib
import socket
import time
import xmlrpc.client
from typing import Any, Callable

import psutil
import rosgraph.network
import rospy
from dyknow_msgs.srv import Poll, PollResponse
from rospy.impl.registration import get_service_manager
from rospy.impl.tcpros_service import ServiceImpl

from dyknow.errors import LimitExceeded, PeerTimeout
from dyknow.nodelet.bus import Bus
from dyknow.nodelet.leases import Leases, Sight, suspended_clock
from dyknow.nodelet.leftovers import StuckCallbacks
from dyknow.nodelet.loader import Loader
from dyknow.nodelet.middleware import Closable
from dyknow.nodelet.texts import sendable
from dyknow.periodic import PeriodicWorker
from dyknow.proxy.proxy import NodeletProxy
from dyknow.ros.nodelets.announcements import Announcer
from dyknow.ros.nodelets.process_guards import ProcessGuards, caller_of
from dyknow.ros.wire.addresses import connect
from dyknow.ros.wire.machines import machine_message
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.messages import counts_message
from dyknow.ros.wire.poll_client import SERVICE

#: Seconds between two checks of the leases.
PERIOD = 0.2
#: Seconds for a connection to a manager's host, and for an answer.
PATIENCE = 0.4
#: Seconds between two queries of the master for our name, and for its answer.
NAME_PERIOD = 1.0


class PollService(Closable):
    """Offers ``~poll``, which is not registered with the master.

    Managers look up another service of the process. So nothing of it shows in the graph.
    """

    def __init__(
        self,
        loader: Loader,
        bus: Bus,
        guards: ProcessGuards,
        announcer: Announcer,
        stuck: StuckCallbacks,
    ) -> None:
        """Offer it; the node must be initialised."""
        self._loader = loader
        self._guards = guards
        self._announcer = announcer
        self._stuck = stuck
        self._leases = Leases(lambda topic: bus.owners(topic)[0], bus.fence)
        self._worker = PeriodicWorker(
            "watching over leases", lambda: self._leases.watch(probe), PERIOD
        )
        #: Set first at the end of the process: it has to be seen to end, not to lose nodelets.
        self.is_ending = False
        self._service = ServiceImpl("~" + SERVICE, Poll, self._poll)
        get_service_manager().map[self._service.resolved_name] = self._service

    def close(self) -> None:
        self._worker.close()
        get_service_manager().map.pop(self._service.resolved_name, None)

    def _poll(self, request: Any) -> PollResponse:
        texts = (request.uri, *request.topics, *request.nodelets, *request.counted)
        try:
            self._guards.current().check_sizes(texts)
        except LimitExceeded as error:
            raise rospy.ServiceException(sendable(error)) from error
        if len(request.topics) != len(request.nodelets):
            raise rospy.ServiceException("expected as many nodelets as topics")
        for guards in request.guards:
            self._guards.hand_over(caller_of(request), guards)
        if request.duration > 0.0:
            self._renew(request)
        counted = set(request.counted)
        changes = self._announcer.since(request.seen)
        contexts = self._loader.contexts()
        if self.is_ending:  # checked last: the end may have unloaded some
            raise rospy.ServiceException("the process ends")
        counts = [
            counts_message(
                context.name, context.attached.get_statistics(), context.busy(with_running=True)
            )
            for context in contexts
            if context.name in counted and isinstance(context.attached, NodeletProxy)
        ]
        if counts and len(contexts) == 1:
            counts[0].cpu = time.process_time()
            counts[0].memory = psutil.Process().memory_info().rss
        return PollResponse(
            suspended_clock(),
            [context.name for context in contexts],
            changes,
            counts,
            self._stuck.remains(),
            machine_message(),
            time.process_time(),
            [context.busy() for context in contexts],
        )

    def _renew(self, request: Any) -> None:
        producers = dict(zip(request.topics, request.nodelets))
        if producers:
            self._worker.start()
        self._leases.renew(
            caller_of(request), request.uri, request.confirmed, request.duration, producers
        )


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
    except ConnectionRefusedError:
        return Sight.GONE
    except ConnectionError:
        return Sight.STOPPED
    except (OSError, ValueError):
        return Sight.SILENT


def _query(connection: socket.socket, host: str) -> Sight:
    body = xmlrpc.client.dumps((rospy.get_name(),), "getPid")
    head = f"POST /RPC2 HTTP/1.0\r\nHost: {host}\r\nContent-Type: text/xml\r\n"
    connection.settimeout(PATIENCE)
    try:
        connection.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n{body}".encode())
        return Sight.AT_WORK if connection.recv(1) else Sight.STOPPED
    except (socket.timeout, ConnectionError):
        return Sight.STOPPED


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
