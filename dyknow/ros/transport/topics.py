# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Registrations of the bus: ordinary publishers and subscribers of rospy."""

from __future__ import annotations

import contextlib
import fcntl
import math
import socket
import sys
import termios
import threading
import time
import warnings
from typing import Any, Callable, Sequence

import genpy
import rospy
from rospy.impl.registration import get_topic_manager

from dyknow.errors import PeerTimeout, RemappedTopic
from dyknow.locks import flag_lock
from dyknow.nodelet.middleware import HERE, OutsidePublisher, OutsideSubscriber, Receive
from dyknow.ros.transport.conversions import TypedReceiver, shallow_copy
from dyknow.ros.transport.intraprocess import IntraProcess, IntraProcessTransport, held
from dyknow.ros.transport.outbound import Outbound
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.transport.shared_memory import SharedMemory
from dyknow.ros.wire.addresses import refuses
from dyknow.ros.wire.master import Master

#: Messages kept for each slow outside subscriber when the nodelet does not say how many.
DEFAULT_QUEUE_SIZE = 100
_STEP = 0.002
#: Seconds in which a peer that lives has connected, as a rule; then it is looked at once whether
#: those that have not are dead.
_GRACE = 0.05
#: Seconds after which a subscriber that has not connected is late.
_LATE = 0.25
#: Seconds for an answer of a publisher that has not connected in time.
_PROBE = 0.3


def _unremapped(topic: str) -> str:
    target: str = rospy.resolve_name(topic)
    if target != topic:
        raise RemappedTopic(topic, target)
    return topic


class RospyPublisher(OutsidePublisher):
    """A rospy.Publisher that sends only while it has listeners outside.

    The arguments from the topic on are those of ``Transport.advertise``.
    """

    heard: bool = False

    def __init__(
        self,
        intraprocess: IntraProcess,
        shared_memory: SharedMemory,
        registrar: Registrar,
        topic: str,
        datatype: Any,
        latch: bool,
        queue_size: int | None,
        options: dict[str, Any],
    ) -> None:
        if queue_size is None:
            warnings.warn(
                f"the publisher of {topic} should say how many messages to keep for slow "
                f"subscribers (queue_size); {DEFAULT_QUEUE_SIZE} are kept",
                SyntaxWarning,
                stacklevel=6,
            )
            queue_size = DEFAULT_QUEUE_SIZE
        self._topic = _unremapped(topic)
        self.in_flight = 0
        self.changed = None
        self._closed = False
        #: The last message that was passed to rospy, while rospy latches.
        self.sent: Any = None
        self._intraprocess = intraprocess
        self._shared_memory = shared_memory
        #: Bytes of the message before.
        self._size = 0
        self._publisher: Any = None  # rospy's
        self._ordinary = intraprocess.publishing(topic)
        self._ordinary.registrations.add(self)
        self._ordinary.widen(queue_size)
        try:
            self._publisher = rospy.Publisher(
                topic, datatype, latch=latch, queue_size=queue_size, **options
            )
        except BaseException:
            self._ordinary.registrations.discard(self)
            intraprocess.retire(topic)
            raise
        self._implementation = self._publisher.impl
        self._ordinary.adopt(self._implementation)
        self._notified = registrar.subscribers(topic) or frozenset()
        self._late = registrar.late
        self._ordinary.refresh()

    @property
    def is_registered(self) -> bool:
        """Whether rospy counts it among the publishers of the topic."""
        return self._publisher is not None

    def _connections(self) -> tuple[Any, ...]:
        return tuple(self._implementation.connections or ())

    def peers(self) -> tuple[Any, ...]:
        outside = self._connections()
        return (HERE, *outside) if self._ordinary.foreign else outside

    def publish(self, message: Any) -> None:
        """Serialise once for everyone outside; ordinary subscribers in here get the object."""
        self._ordinary.deliver(message)
        # Not the other way round: who is expected no more is among the connections by then.
        if self._ordinary.backlog.open or self._implementation.connections:
            self._send(message)

    def publish_to(self, peer: Any, message: Any) -> None:
        if peer is HERE:
            self._ordinary.deliver(message)
        elif peer in self._connections():
            self._send(message, peer)

    def latch(self, message: Any) -> None:
        self._ordinary.latch(self, message)
        self._ordinary.deliver(message)
        self._send(message)

    def wait(self, seconds: float) -> None:
        """Wait for the connections of the subscribers that the master notified.

        One that kept another topic of this process waiting gets what it misses when it connects.
        """
        began = time.monotonic()
        deadline, looks_at = began + seconds, began + _GRACE
        if self._notified:
            self._ordinary.expect(self._notified)
        backlog = self._ordinary.backlog
        while backlog.waiting() and self._late.without(backlog.due):
            if time.monotonic() >= deadline:
                if seconds >= _LATE:
                    self._late.note(backlog.due)
                break
            time.sleep(_STEP)
            if time.monotonic() >= looks_at:
                looks_at = math.inf
                self._ordinary.forget_dead(lambda each: _is_dead(each, deadline))

    def drain(self, seconds: float) -> bool:
        """Wait until rospy's sending threads have written everything, to late subscribers too.

        A rospy subscriber that connects to a topic that is gone never connects to it again, so
        those on their way are waited for even if nothing was published.
        """
        deadline = time.monotonic() + seconds
        while not self._closed and (
            self.in_flight
            or self._ordinary.backlog.waiting()
            or not all(map(_is_idle, self._connections()))
        ):
            if time.monotonic() >= deadline:
                return False
            time.sleep(_STEP)
        return True

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._ordinary.registrations.discard(self)
        self._publisher.unregister()
        successor = self._ordinary.unlatch(self)
        if self.sent is not None and self._implementation.latch is self.sent:
            self._implementation.latch = successor
        self._intraprocess.retire(self._topic)

    def _send(self, message: Any, peer: Any = None) -> None:
        """Send to all connections, or to one, which changes nothing for later subscribers."""
        # rospy writes header.seq and frame_id into its messages; subscribers in here share them.
        if getattr(message.__class__, "_has_header", False):
            message = shallow_copy(message)
            message.header = shallow_copy(message.header)
        implementation = self._implementation
        if implementation.is_latch and peer is None:
            self.sent = message
        with held(implementation):
            latched, sent = implementation.latch, implementation.message_data_sent
            try:
                if not self._shared_memory.publish(implementation, message, peer, self._size):
                    self._ordinary.outwards(message, peer)
                self._size = implementation.message_data_sent - sent
                if peer is not None:
                    implementation.latch = latched
                else:
                    self._ordinary.backlog.keep(message)
            except Exception as error:
                if self._closed:
                    return
                if implementation.buff is not None:
                    # rospy leaves the written part in front of the next message.
                    implementation.buff.seek(0)
                    implementation.buff.truncate(0)
                if isinstance(error, genpy.SerializationError):
                    raise rospy.ROSSerializationException(str(error)) from error
                raise


class RospySubscriber(OutsideSubscriber):
    """A rospy.Subscriber that feeds one connection of the bus.

    The arguments from the topic on are those of ``Transport.subscribe``.
    """

    def __init__(
        self,
        registrar: Registrar,
        topic: str,
        datatype: Any,
        receive: Receive,
        options: dict[str, Any],
    ) -> None:
        self._topic = _unremapped(topic)
        if datatype._md5sum != "*":
            receive = TypedReceiver(topic, datatype, receive).push
        self._subscriber = rospy.Subscriber(topic, datatype, receive, tcp_nodelay=True, **options)
        self._implementation = self._subscriber.impl
        self._registrar = registrar
        #: Connections that are read no more.
        self._shut: list[Any] = []
        #: Addresses of publishers that do not send to us yet.
        self._missing = registrar.publishers(topic)
        self._closed = flag_lock()

    def publishers(self) -> int:
        return len(self._implementation.connections or ())

    def links(self) -> tuple[Any, ...]:
        links = self._implementation.connections or ()
        return tuple(each for each in links if not isinstance(each, IntraProcessTransport))

    def wait(self, arrived: Callable[[float], bool], seconds: float) -> None:
        """Wait for a first message, or until all publishers would send us one."""
        began = time.monotonic()
        deadline, looks_at = began + seconds, began + _GRACE
        expected = self._missing
        if expected is None:  # an ordinary subscriber of this process had registered
            try:
                expected = _publishers(self._topic)
            except PeerTimeout:
                return
        expected -= {each.endpoint_id for each in self.links() if each.stat_num_msg}
        while expected and not arrived(_STEP) and time.monotonic() < deadline:
            expected = frozenset(each for each in expected if not self._is_served(each, deadline))
            if time.monotonic() >= looks_at:
                looks_at = math.inf
                expected = frozenset(each for each in expected if not _is_dead(each, deadline))
        self._missing = expected

    def wait_for_all(self, seconds: float) -> None:
        self.wait(threading.Event().wait, seconds)

    def missing(self) -> list[str]:
        return sorted(filter(_is_alive, self._missing or ()))

    def _is_served(self, publisher: str, deadline: float) -> bool:
        """Whether a publisher has us among its connections; False if it does not say so in time.

        It sends its header before that, and its messages in between do not reach us.
        """
        ports = {
            connection.local_endpoint[1]
            for connection in list(self._implementation.connections)
            if connection.endpoint_id == publisher and connection.callerid_pub != "unknown"
        }
        left = deadline - time.monotonic()
        if not ports or left <= 0:
            return False
        try:
            master = Master(rospy.get_name())
            return not ports.isdisjoint(master.connections(publisher, self._topic, left))
        except (PeerTimeout, LookupError):
            return False

    def hear(self, arrived: Callable[[float], bool], seconds: float) -> None:
        deadline = time.monotonic() + seconds
        came = {each: each.stat_num_msg for each in self.links()}
        if self.publishers():
            arrived(seconds)
        _wait_while(
            lambda each: not each.done and each.stat_num_msg == came[each], [*came], deadline
        )

    def drain(self, seconds: float) -> None:
        """Stop reading: rospy's threads deliver what their sockets hold, and end.

        A message of which a part has come is awaited first. With more subscribers of the topic in
        this process the threads go on.
        """
        deadline = time.monotonic() + seconds
        connections = [each for each in self._implementation.connections or () if each.socket]
        _wait_while(_is_receiving, connections, deadline)
        if len(self._implementation.callbacks or ()) != 1:
            return
        self._shut = connections
        for connection in connections:
            with contextlib.suppress(OSError, AttributeError):  # it has ended by itself
                connection.socket.shutdown(socket.SHUT_RD)
        _wait_while(lambda each: not each.done, connections, deadline)

    def close(self) -> None:
        if not self._closed.acquire(blocking=False):  # by another thread, which may be at it yet
            return
        self._subscriber.unregister()
        shut, self._shut = self._shut, []
        if shut and get_topic_manager().get_subscriber_impl(self._topic) is self._implementation:
            # Another subscriber has joined since, whose connections these are.
            _wait_while(lambda each: not each.done, shut, time.monotonic() + _LATE)
            for connection in shut:
                connection.close()
            self._registrar.connect_again(self._topic, {each.endpoint_id for each in shut})


def _publishers(topic: str) -> frozenset[str]:
    """Addresses of the other nodes that publish on a topic."""
    name = rospy.get_name()
    master = Master(name)
    return frozenset(map(master.node, master.publishers(topic) - {name})) - {""}


def _is_dead(uri: str, deadline: float) -> bool:
    """Whether a node that has not connected has ended; the master lists it until it is told."""
    return refuses(uri, max(0.0, deadline - time.monotonic()))


def _is_alive(uri: str) -> bool:
    """Whether a node answers at an address; the master lists also those that crashed."""
    return Master(rospy.get_name()).pid_at(f"at {uri}", uri, _PROBE) > 0


def _unread(connection: Any) -> int:
    """Bytes that a connection's socket holds."""
    try:
        return int.from_bytes(
            fcntl.ioctl(connection.socket, termios.FIONREAD, bytes(4)), sys.byteorder
        )
    except (OSError, TypeError, ValueError):
        return 0


def _is_receiving(connection: Any) -> bool:
    """Whether a message has come in part, or waits in the connection's socket."""
    buffer = connection.read_buff
    return not connection.done and bool(_unread(connection) or (buffer and buffer.tell()))


def _wait_while(holds: Callable[[Any], bool], connections: Sequence[Any], deadline: float) -> None:
    """Wait until a condition holds for none of the connections, or until the deadline."""
    while any(map(holds, connections)) and time.monotonic() < deadline:
        time.sleep(_STEP / 4)


def _is_idle(connection: Any) -> bool:
    """Whether all was sent, and copied; rospy's own queue is empty, and its thread waits."""
    if isinstance(connection, Outbound):
        return connection.is_idle()
    waiters = getattr(getattr(connection, "_cond_data_available", None), "_waiters", True)
    return connection.done or not (getattr(connection, "_queue", None) or not waiters)
