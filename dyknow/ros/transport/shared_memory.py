# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Large messages between processes of one host, through shared memory.

``SHMROS`` is a protocol beside TCPROS, negotiated as ROS negotiates transports: a subscriber
offers it first, and a publisher that does not know it takes TCPROS. Its connections are those of
TCPROS, with the same header and order. A small message is the same frame on them, too. Of a large
one the content lies in an `Arena`, and the frame says where. The subscriber copies it from there
and sends one byte back; then its region is free for another message. So

* a message is written once, however many processes receive it, and copied once by each of them;
* a message that finds no memory, or a subscriber that did not get the publisher's file, is served
  by an ordinary frame at any time, in order;
* the memory of a slow subscriber is bounded by the publisher's ``queue_size`` and ``WINDOW``.
"""

from __future__ import annotations

import contextlib
import io
import select
import socket
import threading
import weakref
from typing import Any, Callable, Sequence, Tuple

import genpy
import rospy
import rospy.core
import rospy.impl.tcpros
import rospy.impl.tcpros_base
import rospy.impl.tcpros_pubsub
import rospy.impl.transport

from dyknow.errors import HostError
from dyknow.locks import state_lock
from dyknow.periodic import NO_THREAD
from dyknow.ros.process.node_process import registration_manager
from dyknow.ros.transport.arena import Arena, ArenaReader
from dyknow.ros.transport.outbound import SHMROS, Outbound, Share
from dyknow.ros.transport.packing import (
    ELSEWHERE,
    FRAME,
    LARGE,
    LENGTH,
    Packed,
    assembled,
    largest_field,
)

TCPROS: str = rospy.impl.tcpros_base.TCPROS
#: A subscriber's answer to each message that it has copied.
_COPIED = b"\6"


Answer = Tuple[int, str, int]
"""Returned to rospy by what makes a connection: a code above 0 for success, a text, a port."""


class Inbound(rospy.impl.tcpros_pubsub.TCPROSSub):
    """Reads the frames of one connection; ``reader`` has the publisher's memory open."""

    def __init__(self, topic: str, subscriber: Any, reader: ArenaReader) -> None:
        super().__init__(
            topic,
            subscriber.data_class,
            queue_size=subscriber.queue_size,
            buff_size=subscriber.buff_size,
            tcp_nodelay=subscriber.tcp_nodelay,
        )
        self._reader = reader
        #: Messages that were copied, which the publisher is to know; and their bytes.
        self.owed = self.copied = 0

    def read_messages(self, b: io.BytesIO, msg_queue: list[Any], sock: socket.socket) -> None:
        """Take the complete frames out of the buffer, and put their messages into the queue."""
        with b.getbuffer() as buffered:
            (length,) = LENGTH.unpack_from(buffered)
            if length != ELSEWHERE and len(buffered) < LENGTH.size + length:
                return  # without a copy of what came of a large frame so far
        data, at = b.getvalue(), 0
        try:
            while True:
                end = self._read(data, at, msg_queue)
                if end == at:
                    break
                at = end
        except Exception as error:
            raise genpy.DeserializationError(f"cannot deserialize: {error}") from error
        if self.queue_size is not None:
            del msg_queue[: -self.queue_size]
        b.seek(0)
        b.truncate()
        b.write(data[at:])

    def _read(self, data: bytes, at: int, msg_queue: list[Any]) -> int:
        """Read the frame at a place, if it is complete; return where the next one begins."""
        if len(data) - at < LENGTH.size:
            return at
        length: int = LENGTH.unpack_from(data, at)[0]
        if length != ELSEWHERE:
            begin = at + LENGTH.size
            if len(data) - begin < length:
                return at
            content = data[begin : begin + length]
            msg_queue.append(self.recv_data_class().deserialize(content))
            return begin + length
        if len(data) - at < FRAME.size:
            return at
        _, length, place, number, offset, region, size = FRAME.unpack_from(data, at)
        begin = at + FRAME.size
        if len(data) - begin < length:
            return at
        found = self._reader.read(offset, region, size)
        self.owed += 1
        if found is not None:
            self.copied += len(found)
            text = data[begin : begin + length]
            msg_queue.append(assembled(self.recv_data_class, text, place, number, found))
        return begin + length


class InboundTransport(rospy.impl.tcpros_base.TCPROSTransport):
    """A connection to a publisher whose memory, at ``address``, is open."""

    transport_type = SHMROS

    def __init__(self, protocol: Inbound, topic: str, address: str) -> None:
        super().__init__(protocol, topic)
        self._address = address

    def read_header(self) -> None:
        """Read the publisher's header, and let it know that its memory is at hand."""
        self.read_buff.seek(0)  # a frame that could not be read may be in it
        self.read_buff.truncate()
        super().read_header()
        self.protocol.owed = 0  # to the connection before, if this one takes its place
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket.sendall(self._address.encode())

    def receive_once(self) -> list[Any]:
        """Receive messages; the publisher hears of those before, whose callbacks have returned."""
        protocol = self.protocol
        if protocol.owed:
            with contextlib.suppress(OSError):  # it has ended, and its last messages are here
                self.socket.sendall(_COPIED * protocol.owed)
            protocol.owed = 0
        messages: list[Any] = super().receive_once()
        self.stat_bytes: int = self.stat_bytes + protocol.copied
        protocol.copied = 0
        return messages


class SharedMemory(rospy.impl.transport.ProtocolHandler):
    """The protocol of this process; its memory is made when a subscriber first asks for it.

    Attributes:
        topics: on which subscribers are offered shared memory.
    """

    def __init__(self, is_wanted: bool) -> None:
        self._is_wanted = is_wanted
        self._making = state_lock("making shared memory")
        self._arena: Arena | None = None
        self._readers: weakref.WeakValueDictionary[str, ArenaReader] = (
            weakref.WeakValueDictionary()
        )
        self.topics: set[str] = set()

    @classmethod
    def start(cls, is_wanted: bool) -> SharedMemory:
        """Offer it beside TCPROS, if it is wanted; the node must be initialised."""
        handler = cls(is_wanted)
        manager = registration_manager()
        if is_wanted and manager is not None and manager.handler.protocol_handlers:
            manager.handler.protocol_handlers.insert(0, handler)  # none while a shutdown runs
        return handler

    # Of rospy's interface

    def supports(self, protocol: str) -> bool:
        return protocol == SHMROS

    def get_supported(self) -> list[list[str]]:
        return [[SHMROS]]

    def init_publisher(self, topic: str, protocol: Any) -> tuple[int, str, list[Any]]:
        """Answer a subscriber that knows the protocol."""
        tcpros = rospy.impl.tcpros.get_tcpros_handler()
        code, text, where = tcpros.init_publisher(topic, [TCPROS])
        arena = self._made() if code == 1 and topic in self.topics else None
        if arena is not None:
            where = [SHMROS, *where[1:], arena.address]
        return code, text, where

    def _made(self) -> Arena | None:
        """Return the memory of this process; None where the system has none, or no thread now."""
        trouble: Exception | None = None
        with self._making:
            if self._arena is None and self._is_wanted:
                try:
                    self._arena = Arena()
                except (OSError, AttributeError, *NO_THREAD) as error:
                    self._is_wanted, trouble = isinstance(error, NO_THREAD), error
        if trouble is not None:
            rospy.loginfo("messages do not travel through shared memory: %s", trouble)
        return self._arena

    def create_transport(self, topic: str, uri: str, parameters: Any) -> Answer:
        """Connect to a publisher that knows the protocol; over TCPROS if its memory is away."""
        if not isinstance(parameters, list) or len(parameters) != 4:
            return 0, f"invalid parameters of {SHMROS}: {parameters}", 0
        _, host, port, address = parameters
        reader = None
        if uri != rospy.core.get_node_uri():
            try:
                reader = self._reader(address)
            except HostError as error:
                rospy.logdebug("%s is received over TCPROS: %s", topic, error)
        subscriber = rospy.impl.registration.get_topic_manager().get_subscriber_impl(topic)
        if reader is None or subscriber is None:
            tcpros = rospy.impl.tcpros.get_tcpros_handler()
            answer: Answer = tcpros.create_transport(topic, uri, [TCPROS, host, port])
            return answer
        connection = InboundTransport(Inbound(topic, subscriber, reader), topic, address)
        connection.set_endpoint_id(uri)
        thread = threading.Thread(
            name=topic,
            target=rospy.impl.tcpros_pubsub.robust_connect_subscriber,
            args=(connection, host, port, uri, subscriber.receive_callback, topic),
        )

        def connect() -> Answer:
            if not subscriber.add_connection(connection):  # it was closed meanwhile
                connection.close()
                return 0, f"no subscriber of {topic}", 0
            try:
                thread.start()
            except NO_THREAD as error:  # without a connection the publisher is connected to later
                subscriber.remove_connection(connection)
                connection.close()
                return 0, f"{topic} is not received from {uri}: {error}", 0
            return 1, f"connected to {topic}", port

        return connect_once(subscriber, uri, connect)

    def _reader(self, address: str) -> ArenaReader:
        reader = self._readers.get(address)
        if reader is None:
            reader = self._readers[address] = ArenaReader(address)
        return reader

    # Of a publisher

    def outbound(self, connection: Any, queue_size: int | None) -> Outbound:
        """Return the replacement of a subscriber's connection, and of its queue."""
        return Outbound(connection, queue_size, self._arena)

    def publish(self, publisher: Any, message: Any, peer: Any, size: int) -> bool:
        """Publish a large message, through memory where it is shared.

        Args:
            publisher: rospy's, whose lock is held.
            message: of whose header the number is set.
            peer: the only connection to publish to; None for all.
            size: bytes of the message before.

        Returns:
            Whether it was published; if not, that is left to rospy.
        """
        if self._arena is None or not (size >= LARGE or largest_field(message)[2]):
            return False
        connections: Sequence[Any] = (peer,) if peer is not None else publisher.connections or ()
        sharing = [each for each in connections if isinstance(each, Outbound) and each.shares()]
        if publisher.closed or not sharing:
            return False
        publisher.seq += 1
        packed = Packed(message, publisher.seq)
        share = None
        if len(packed.content) >= LARGE:
            region = self._arena.write(packed.content)
            share = None if region is None else Share(packed.frame(region), region)
        if publisher.is_latch:
            publisher.latch = message
        for each in connections:
            try:
                each.write_data(share if share and each in sharing else packed.plain())
            except Exception:  # the boundary to rospy's connections, as in its own publish
                with contextlib.suppress(Exception):
                    each.close()
        publisher.message_data_sent += packed.size
        return True


def connect_once(subscriber: Any, uri: str, connect: Callable[[], Answer]) -> Answer:
    """Connect rospy's subscriber to a publisher, unless another thread has just done so.

    Of two threads that learn of a publisher at the same time, rospy lets the second one replace
    the connection of the first: messages in that are lost, or come over both.
    """
    with subscriber.c_lock:
        same = [each for each in subscriber.connections or () if each.endpoint_id == uri]
        if any(map(_is_open, same)):
            return 1, f"connected to {uri} already", 0
        return connect()


def _is_open(connection: Any) -> bool:
    """Whether a connection is being made, or has been and was not closed by the publisher."""
    if connection.done or connection.socket is None:
        return not connection.done
    poll = select.poll()
    try:
        poll.register(connection.socket, select.POLLRDHUP)
        return not poll.poll(0)
    except (OSError, TypeError, ValueError):  # closed just now
        return False
