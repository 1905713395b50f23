# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A process's answers to the DyKnow managers that poll it and move its nodelets, and its end.

With each poll a manager renews the lease of the process; the rules are in
``dyknow.nodelet.leases``. Here are the thread that watches over leases, and its probe of a
manager's host.

A node ends when another one has registered under its name. The master notifies it at that moment,
but only once. A node that is cut off just then never hears of it, so each also polls the master.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
import xmlrpc.client
from io import BytesIO
from typing import Any, Callable, Iterable

import psutil
import rospy
from dyknow_msgs import msg
from dyknow_msgs.srv import HandOver, HandOverRequest, HandOverResponse, Poll, PollResponse
from genpy import Time
from rospy.impl.registration import get_service_manager
from rospy.impl.tcpros_service import ServiceImpl

from dyknow.errors import DyKnowError, LimitExceeded, PeerTimeout
from dyknow.nodelet.context import Context
from dyknow.nodelet.hand_over import HandedTopic, HandOvers
from dyknow.nodelet.leases import Leases, Sight, suspended_clock
from dyknow.nodelet.loading.leftovers import StuckCallbacks
from dyknow.nodelet.loading.loader import Loader
from dyknow.nodelet.middleware import DIGEST_SIZE, Closable
from dyknow.nodelet.streams.bus import Bus
from dyknow.nodelet.texts import sendable
from dyknow.periodic import PeriodicWorker
from dyknow.proxy.proxy import NodeletProxy
from dyknow.ros.nodelets.announcements import Announcer
from dyknow.ros.nodelets.process_guards import ProcessGuards, caller_of
from dyknow.ros.wire.addresses import connect, host_and_port
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.message_classes import message_class
from dyknow.ros.wire.messages import counts_message, direction_from, direction_message
from dyknow.ros.wire.poll_client import HAND_OVER, POLL

#: Seconds between two checks of the leases.
PERIOD = 0.2
#: Seconds for a connection to a manager's host, and for an answer.
PATIENCE = 0.4
#: Seconds between two queries of the master for our name, and for its answer.
NAME_PERIOD = 1.0
#: Queries in a row that find no node of our name, until none is expected: a DyKnow manager
#: registers nodes with a new master within two seconds.
_FORGOTTEN = 4


class _UnregisteredService(Closable):
    """A private service that the master does not list; the node must be initialised.

    Managers look up another service of the process. So nothing of it shows in the graph.
    """

    def __init__(self, name: str, kind: Any, answer: Callable[[Any], Any]) -> None:
        self._service = ServiceImpl(f"~{name}", kind, answer)
        get_service_manager().map[self._service.resolved_name] = self._service

    def close(self) -> None:
        get_service_manager().map.pop(self._service.resolved_name, None)


class PollService(_UnregisteredService):
    """Offers ``~poll``, which answers polls and renews leases."""

    def __init__(
        self,
        loader: Loader,
        bus: Bus,
        guards: ProcessGuards,
        announcer: Announcer,
        stuck: StuckCallbacks,
    ) -> None:
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
        super().__init__(POLL, Poll, self._poll)

    def close(self) -> None:
        self._worker.close()
        super().close()

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


class HandOverService(_UnregisteredService):
    """Offers ``~hand_over``, by which a manager moves a nodelet from or to this process."""

    def __init__(
        self, loader: Loader, guards: ProcessGuards, unload: Callable[[Context], object]
    ) -> None:
        self._guards = guards
        self._hand_overs = HandOvers(loader, _message_class, unload)
        super().__init__(HAND_OVER, HandOver, self._answer)

    def close(self) -> None:
        super().close()
        self._hand_overs.close()

    def _answer(self, request: Any) -> HandOverResponse:
        name = request.nodelet
        try:
            texts = [name, *(each.topic for each in request.topics)]
            self._guards.current().check_sizes(texts, len(request.topics))
            self._guards.check_caller(caller_of(request), f"moving '{name}'")
            self._guards.check_protection(caller_of(request), name)
            return HandOverResponse(self._step(name, request.step, request.topics))
        except DyKnowError as error:
            raise rospy.ServiceException(sendable(error)) from error

    def _step(self, name: str, step: int, topics: Any) -> list[msg.HandedTopic]:
        moves, ends = self._hand_overs, list(map(topic_from, topics))
        if step == HandOverRequest.NOTE:
            return list(map(topic_message, moves.note(name)))
        if step == HandOverRequest.GIVE:
            return list(map(topic_message, moves.give(name, ends)))
        if step == HandOverRequest.PARK:
            return list(map(topic_message, moves.park(name, ends)))
        if step == HandOverRequest.TAKE:
            moves.take(name, ends)
        else:
            moves.end(name)
        return []


def topic_message(topic: HandedTopic) -> msg.HandedTopic:
    digests = b"".join(digest for _, digest in topic.given)
    times = [moment for moment, _ in topic.given]
    sizes = list(map(len, topic.waiting))
    waiting = b"".join(topic.waiting)
    fields = (digests, times, waiting, sizes, topic.latch, topic.options, topic.flows)
    return msg.HandedTopic(
        topic.topic, topic.datatype, direction_message(topic.direction), *fields
    )


def topic_from(message: Any) -> HandedTopic:
    digests = _parts(message.given, [DIGEST_SIZE] * len(message.arrived))
    given = tuple(zip(message.arrived, digests))
    waiting = tuple(_parts(message.waiting, message.sizes))
    fields = (given, waiting, message.latch, message.options, message.flows)
    return HandedTopic(message.topic, message.datatype, direction_from(message), *fields)


def _parts(content: bytes, sizes: Iterable[int]) -> list[bytes]:
    stream = BytesIO(content)
    return [stream.read(size) for size in sizes]


def _message_class(datatype: str) -> Any:
    return None if datatype == "*" else message_class(datatype)


def machine_message() -> msg.Machine:
    """Describe the machine of this process, with the time of this moment."""
    cores, memory = os.cpu_count() or 1, psutil.virtual_memory()
    load = os.getloadavg()[0] / cores
    used = 1.0 - memory.available / memory.total
    return msg.Machine(Time.from_sec(time.time()), cores, load, used)


def probe(uri: str) -> Sight:
    """Probe the host of a node's address: is the process there, and does it answer?

    A connection is made by the kernel, so that of a process that was stopped is made too.
    """
    try:
        host, port = host_and_port(uri)
        with contextlib.closing(connect(host, port, PATIENCE)) as connection:
            return _query(connection, host)
    except socket.timeout:
        return Sight.SILENT
    except ConnectionRefusedError:
        return Sight.GONE
    except ConnectionError:
        return Sight.STOPPED
    except OSError:
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


def watch_name(
    name: str, uri: str, end: Callable[[str], None], forgotten: Callable[[], None]
) -> None:
    """Look periodically, in a thread of its own, for the node that the master has under a name.

    Args:
        name: the name of this node.
        uri: its address.
        end: called once, with the reason, when another address has the name.
        forgotten: called when the master has not known the name for some seconds: it is a new one,
            with which no DyKnow manager has registered this node. One that is away does not count.
    """
    master = Master(name, timeout=NAME_PERIOD)
    missed = 0

    def check() -> None:
        nonlocal missed
        with contextlib.suppress(PeerTimeout):
            found = master.node(name)
            missed = 0 if found else missed + 1
            if found not in ("", uri):
                worker.close()
                end(f"another node bears the name {name} now")
            elif missed == _FORGOTTEN:
                forgotten()

    worker = PeriodicWorker("looking who bears the name of this node", check, NAME_PERIOD)
    worker.start()
    worker.wake()
