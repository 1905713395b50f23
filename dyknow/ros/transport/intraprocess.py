# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps rospy from connecting to itself where the bus delivers already.

rospy links a publisher and a subscriber of one process through a TCP connection to itself. For a
topic on which the bus publishes that would deliver everything twice, so the connection to our own
address is answered with an INTRAPROCESS transport that carries nothing; rosnode and rqt_graph
still see it. The hook is ``create_transport`` of rospy's protocol handler, of its documented
``ProtocolHandler`` interface. On the topics of the bus, methods of rospy's own publisher and
subscriber objects are wrapped too: ``publish``, ``add_connection`` and ``set_queue_size``,
``add_callback`` and ``remove_callback``. All of them are attributes of objects: no class is
patched.

A publisher is taken over before the master learns of it. One that ordinary handles had made may
have subscribers, and one that connects at this moment: rospy's thread has found the method that
is being wrapped, and logs before it adds the connection. Listeners are called after that, so
``OrdinaryHandles`` is a ``SubscribeListener`` as well.

What ordinary rospy handles in this process (tf2's listeners and broadcasters, say) exchange on
such a topic is passed on by this module: to ordinary subscribers on a strand of their own, from
ordinary publishers as a copy, since those may change a message after publishing it. Ordinary
subscribers find in ``_connection_header`` what rospy would have put there. It differs from topic
to topic, so they get a message object of their own, whose fields are shared.

``IntraProcess`` owns one ``OrdinaryHandles`` for each topic that the bus publishes on, from the
first publication until rospy's publisher of that topic is gone.
"""

from __future__ import annotations

import collections
import contextlib
import copy
import functools
from typing import Any, Callable, Collection, ContextManager, Iterator, Tuple

import rospy
import rospy.core
import rospy.impl.registration
import rospy.impl.tcpros
from rospy.impl.tcpros_pubsub import QueuedConnection
from rospy.impl.transport import INBOUND, Transport

from dyknow.errors import PeerTimeout
from dyknow.locks import state_lock
from dyknow.nodelet.scheduler import Executor, Strand, message_lock
from dyknow.nodelet.streams.endpoints import NOTHING, Connection
from dyknow.periodic import NO_THREAD, in_background
from dyknow.ros.transport.conversions import (
    TypedReceiver,
    connection_header,
    copy_by_wire,
    serialised,
)
from dyknow.ros.transport.late_subscribers import Backlog
from dyknow.ros.transport.outbound import Outbound, wider
from dyknow.ros.transport.shared_memory import Answer, SharedMemory, connect_once
from dyknow.ros.wire.master import Master

#: Messages that wait for a callback of an ordinary subscriber which gives no size, at least.
_IN_SOCKETS = 100

Callback = Tuple[Callable[..., Any], Any]


class IntraProcessTransport(Transport):
    """What rospy shows for a link inside the process."""

    transport_type = "INTRAPROCESS"

    def __init__(self, topic: str, uri: str, closed: Callable[[], None]) -> None:
        super().__init__(INBOUND, topic)
        self.endpoint_id = uri
        self.callerid_pub = rospy.get_name()
        self.latch: Any = None
        self.socket = None
        self._closed = closed

    def get_transport_info(self) -> str:
        """Describe the link for ``rosnode info``."""
        return "INTRAPROCESS"

    def close(self) -> None:
        """End it; without the guard rospy's version calls itself through the clean-up callback."""
        if not self.done:
            super().close()
            self._closed()


class _Waiting:
    """Messages that wait for a callback of an ordinary subscriber: ``entry`` of rospy's list."""

    def __init__(self, strand: Strand, subscriber: Any, entry: Callback) -> None:
        self.entry = entry
        self._strand = strand
        self._subscriber = subscriber
        self._messages: collections.deque[Any] = collections.deque()

    def is_wanted(self) -> bool:
        return any(each is self.entry for each in self._subscriber.callbacks or ())

    def post(self, message: Any, queue_size: int) -> None:
        """Queue a message; when ``queue_size`` wait the oldest is dropped, 0 for any number."""
        dropped = None  # freed without the lock: finalizers may call anything
        with message_lock:
            if 0 < queue_size <= len(self._messages):
                dropped = self._messages.popleft()
            else:  # as many tasks as messages
                self._strand.post_locked(self._call)
            self._messages.append(message)
        del dropped

    def _call(self) -> None:
        with message_lock:
            message = self._messages.popleft()
        if self.is_wanted():
            self._subscriber._invoke_callback(message, *self.entry)


def held(publisher: Any) -> ContextManager[Any]:
    """Hold rospy's publisher, if there is one, so that no other thread publishes.

    Its own ``release`` does nothing once another thread has closed it: that takes its lock off.
    """
    return getattr(publisher, "publock", None) or contextlib.nullcontext()


class OrdinaryHandles(rospy.SubscribeListener):
    """Ordinary rospy handles of this process, at ``uri``, on one topic of the bus.

    ``address`` returns the address of a node, ``executor`` runs callbacks of ordinary subscribers,
    ``outbound`` replaces a connection to a subscriber, with a queue size, and ``subscribers``
    returns the names of the nodes that have subscribed to a topic.
    """

    outwards: Callable[..., Any]

    def __init__(
        self,
        name: str,
        uri: str,
        address: Callable[[str], str],
        executor: Executor,
        outbound: Callable[[Any, int | None], Any],
        subscribers: Callable[[str], Collection[str]],
    ) -> None:
        self.name = name
        self.registrations: set[Any] = set()
        self.backlog = Backlog()
        self.backlog.gave_up = self.refresh
        self.backlog.look = self._look
        #: By publication, the latest last; under None the message of ordinary publishers.
        self._latches: dict[Any, Any] = {}
        self._uri = uri
        self._address = address
        self._outbound = outbound
        self._subscribers = subscribers
        self._strand = Strand(executor, f"rospy subscribers of {name}")
        self._waiting: list[_Waiting] = []
        #: The largest queue size of the publications; None before the first.
        self._queue_size: int | None = None
        self._refreshing = state_lock("outside listeners")
        self._connecting = 0  # subscribers whose connections are being added
        self._publisher: Any = None  # rospy's
        self._subscriber: Any = None  # rospy's

    @property
    def foreign(self) -> list[Callback]:
        """Callbacks of ordinary subscribers."""
        subscriber = self._subscriber
        if subscriber is None:  # as a rule, and looked at on every publish
            return []
        return [each for each in list(subscriber.callbacks) if not _is_ours(each[0])]

    def latch(self, registration: Any, message: Any) -> None:
        self._latches.pop(registration, None)
        self._latches[registration] = message

    def unlatch(self, registration: Any) -> Any:
        """Forget a publication's message; returns what rospy is to latch instead, or None."""
        self._latches.pop(registration, None)
        self._forget_ordinary()
        return self._latest()

    def _latest(self) -> Any:
        latest = (list(self._latches) or [None])[-1]
        return self._latches.get(None) if latest is None else latest.sent

    def _forget_ordinary(self) -> None:
        """Forget the message of ordinary publishers once none of them is left."""
        if None not in self._latches:
            return
        with self._publisher_held() as publisher:
            ours = [each for each in list(self.registrations) if each.is_registered]
            if publisher.ref_count <= len(ours):
                self._latches.pop(None, None)
                publisher.latch = self._latest()

    def _fenced(self) -> list[Any]:
        return [each for each in list(self.registrations) if each.is_fenced()]

    def adopt(self, publisher: Any) -> None:
        """Pass on what ordinary publishers of this process publish on the topic."""
        if self._publisher is publisher:
            return
        self._publisher = publisher
        self._latches.pop(None, None)
        if publisher.latch is not None:
            self.latch(None, publisher.latch)
        self.outwards = outwards = publisher.publish
        add = publisher.add_connection

        def publish(message: Any, connection_override: Any = None) -> Any:
            if connection_override is None:
                self._from_ordinary(message)
            elif any(each.sent is message for each in self._fenced()):
                return False  # rospy gives a new subscriber the latched message
            return outwards(message, connection_override)

        def add_connection(connection: Any) -> Any:
            self._count_connecting(1)  # first: a peer that sees the connection is heard already
            address: str | None = None
            try:
                while True:
                    with self._publisher_held():  # nothing comes between missed and later messages
                        if address is not None or not self.backlog.open:
                            return add_and_catch_up(connection, address or "")
                    address = self._address(connection.endpoint_id)  # which takes its time
            finally:
                self._count_connecting(-1)

        def add_and_catch_up(connection: Any, address: str) -> Any:
            made = self._outbound(connection, self._queue_size)
            self._forget_ordinary()
            latched, missed = publisher.latch, self.backlog.missed_by(address)
            if any(each is latched for each in missed):
                publisher.latch = None  # rospy would send it first, and again
            try:
                added = add(made)
                latched = publisher.latch or latched  # a listener may have published
                for message in missed:
                    outwards(message, made)
                return added
            finally:
                publisher.latch = latched
                # Last: until now it is expected, from now on it is among the connections.
                self.backlog.forget({address})

        publisher.publish = publish
        publisher.add_connection = add_connection
        if publisher.queue_size is not None:
            self.widen(publisher.queue_size)
        publisher.set_queue_size = self.widen
        publisher.queue_size = None  # rospy would put a queue of its own before each connection
        publisher.add_subscriber_listener(self)
        self._take_connections()
        subscriber = rospy.impl.registration.get_topic_manager().get_subscriber_impl(self.name)
        if subscriber is not None and subscriber.has_connection(self._uri):
            # It takes the place of rospy's connection to itself, which has delivered its latch.
            self.link(subscriber, replacing=True)

    def widen(self, queue_size: int) -> None:
        """Keep as many messages for each subscriber as a further publication says; 0 for all.

        Subscribers that are connected have the queue of the publication that was there then,
        which may have been one for a nodelet that was yet to be loaded.
        """
        with self._publisher_held() as publisher:
            before = self._queue_size
            size = self._queue_size = queue_size if before is None else wider(before, queue_size)
            self.backlog.widen(size)
            for connection in (publisher and publisher.connections) or ():
                if isinstance(connection, Outbound):
                    connection.widen(size)

    def peer_subscribe(self, topic: str, publish: Any, publish_to_peer: Any) -> None:
        """Note a new connection; rospy calls this."""
        self._take_connections()
        self.refresh()

    def peer_unsubscribe(self, topic: str, remaining: int) -> None:
        """Note that a connection has ended; rospy calls this."""
        self.refresh()

    def _take_connections(self) -> None:
        """Put our queue before each connection that has none yet."""
        publisher = self._publisher
        with publisher.c_lock:
            present = publisher.connections
            for number, connection in enumerate(present):
                if not isinstance(connection, (Outbound, QueuedConnection)):
                    present[number] = self._outbound(connection, self._queue_size)

    @contextlib.contextmanager
    def _publisher_held(self) -> Iterator[Any]:
        """Hold rospy's publisher, if there is one: nothing is published, nothing connected."""
        publisher = self._publisher
        with held(publisher):
            yield publisher

    def expect(self, notified: Collection[str]) -> None:
        """Keep messages for subscribers that were notified and have yet to connect."""
        with self._publisher_held() as publisher:  # before it is asked for its connections
            connected = {self._address(each.endpoint_id) for each in publisher.connections}
            self.backlog.expect(set(notified) - connected, self._queue_size or 0)
        self.refresh()

    def forget_dead(self, is_dead: Callable[[str], bool]) -> None:
        """Expect subscribers no more that are gone; to find that out may take time."""
        dead = set(filter(is_dead, self.backlog.due))
        with self._publisher_held():
            self.backlog.forget(dead)
        self.refresh()

    def _look(self) -> None:
        with contextlib.suppress(*NO_THREAD):  # a later message tries again
            in_background(f"looking for subscribers of {self.name}", self.forget_left)

    def forget_left(self) -> None:
        """Expect those no more that do not subscribe to the topic now; the master is asked."""
        with contextlib.suppress(PeerTimeout, LookupError):
            present = {self._address(each) for each in self._subscribers(self.name)}
            if "" not in present:  # else some address is not known now
                self.forget_dead(lambda each: each not in present)

    def link(self, subscriber: Any, replacing: bool = False) -> None:
        """Show the link on rospy's subscriber and follow its ordinary callbacks."""
        is_new = self._subscriber is not subscriber
        if is_new:
            self._listen_with(subscriber)  # first: a peer that sees the link is heard already
        if not any(isinstance(each, IntraProcessTransport) for each in subscriber.connections):
            subscriber.add_connection(
                IntraProcessTransport(self.name, self._uri, lambda: self._unlinked(subscriber))
            )
        if is_new:
            self._catch_up(list(subscriber.callbacks), ordinary=not replacing)

    def _listen_with(self, subscriber: Any) -> None:
        self._subscriber = subscriber
        self._follow(subscriber, "add_callback", "remove_callback")
        add = subscriber.add_callback

        def add_callback(callback: Any, args: Any) -> None:
            add(callback, args)
            same = (e for e in subscriber.callbacks or () if e[0] is callback and e[1] is args)
            self._catch_up([*same][-1:])

        subscriber.add_callback = add_callback
        self.refresh()

    def _unlinked(self, subscriber: Any) -> None:
        if self._subscriber is subscriber and subscriber.closed:
            self._subscriber = None
            self.refresh()

    def unlink(self) -> None:
        """Take the link off rospy's subscriber: this process publishes here no more."""
        subscriber = self._subscriber
        if subscriber is not None:
            vars(subscriber).pop("add_callback", None)
            vars(subscriber).pop("remove_callback", None)
            for connection in list(subscriber.connections or ()):
                if isinstance(connection, IntraProcessTransport):
                    subscriber.remove_connection(connection)

    def refresh(self) -> None:
        """Let the publications of the bus know whether they have listeners outside."""
        with self._refreshing:  # the last thread here has seen all changes
            self._waiting = [each for each in self._waiting if each.is_wanted()]
            heard = bool(
                self.foreign
                or self._connecting
                or self.backlog.waiting()
                or (self._publisher and self._publisher.connections)
            )
            for registration in list(self.registrations):
                registration.heard = heard
                changed = registration.changed
                if changed is not None:
                    changed()

    def _count_connecting(self, change: int) -> None:
        with self._refreshing:
            self._connecting += change
        self.refresh()

    def _follow(self, implementation: Any, *changes: str) -> None:
        """Refresh after every call of these methods of rospy's object."""
        for name in changes:
            setattr(implementation, name, self._refreshing_after(getattr(implementation, name)))

    def _refreshing_after(self, change: Callable[..., Any]) -> Callable[..., Any]:
        def changed(*args: Any) -> Any:
            try:
                return change(*args)
            finally:
                self.refresh()

        return changed

    def deliver(self, message: Any) -> None:
        """Hand a message of the bus to the ordinary subscribers."""
        self._hand_over(message, self.foreign)

    def _from_ordinary(self, message: Any) -> None:
        subscriber, is_latching = self._subscriber, self._publisher.is_latch
        callbacks = list(subscriber.callbacks) if subscriber is not None else []
        if not (callbacks or is_latching):
            return
        message = copy_by_wire(message)
        if is_latching:
            self.latch(None, message)
        self._hand_over(message, callbacks)

    def _catch_up(self, newcomers: list[Callback], ordinary: bool = True) -> None:
        """Hand over the latched message, that of ordinary publishers only if ``ordinary``.

        The bus delivers its own latched messages to its own subscribers.
        """
        self._forget_ordinary()
        if ordinary and None in self._latches:
            self._hand_over(self._latches[None], [each for each in newcomers if _is_ours(each[0])])
        fenced = self._fenced()
        latches = [each for each in self._latches.items() if each[0] not in fenced]
        registration, message = (latches or [(None, NOTHING)])[-1]
        if message is not NOTHING and (ordinary or registration is not None):
            self._hand_over(message, [each for each in newcomers if not _is_ours(each[0])])

    def _hand_over(self, message: Any, callbacks: list[Callback]) -> None:
        """Have callbacks called: those of the bus only queue it, ordinary ones take their time."""
        subscriber = self._subscriber
        if not callbacks or subscriber is None:
            return
        message = self._received(message, subscriber)
        for entry in callbacks:
            if _is_ours(entry[0]):
                entry[0](message)
            else:
                waiting = self._waiting_for(entry, subscriber)
                waiting.post(message, subscriber.queue_size or self._bound())

    def _bound(self) -> int:
        """Most messages that wait for a subscriber which gives no size; 0 for any number.

        With rospy they would wait in the publication's queue and, before that, in sockets.
        """
        return max(self._queue_size, _IN_SOCKETS) if self._queue_size else 0

    def _waiting_for(self, entry: Callback, subscriber: Any) -> _Waiting:
        for each in self._waiting:
            if each.entry is entry:
                return each
        made = _Waiting(self._strand, subscriber, entry)
        with self._refreshing:
            if made.is_wanted():  # else its removal, which takes it off, is over
                self._waiting = [*self._waiting, made]
        return made

    def _received(self, message: Any, subscriber: Any) -> Any:
        """The message as rospy's subscriber would have received it."""
        publisher = self._publisher
        header = connection_header(message, publisher.is_latch)
        header.update(topic=self.name)
        header.update(publisher.headers or {})  # last, as in rospy
        if subscriber.data_class._md5sum == "*":
            return serialised(subscriber.data_class, message, header)
        received = copy.copy(message)
        received._connection_header = header
        return received


class IntraProcess(rospy.impl.registration.RegistrationListener):
    """The hook, and the topics that it is for."""

    def __init__(self, executor: Executor, shared_memory: SharedMemory) -> None:
        """Install the hook; the node must be initialised."""
        self._executor = executor
        self._shared_memory = shared_memory
        self._master = Master(rospy.get_name())
        self._lock = state_lock("topics taken over")
        self._topics: dict[str, OrdinaryHandles] = {}
        self._uri: str = rospy.core.get_node_uri()
        handler = rospy.impl.tcpros.get_tcpros_handler()
        self._connect_outside = handler.create_transport
        handler.create_transport = self._create_transport
        listeners = rospy.impl.registration.get_registration_listeners()
        with listeners.lock:
            listeners.listeners.insert(0, self)  # before the one that registers with the master

    def publishing(self, topic: str) -> OrdinaryHandles:
        """Take over a topic, before rospy's publisher is made."""
        with self._lock:
            if topic not in self._topics:
                self._topics[topic] = OrdinaryHandles(
                    topic,
                    self._uri,
                    self._address_of,
                    self._executor,
                    self._shared_memory.outbound,
                    self._master.subscribers,
                )
                self._shared_memory.topics.add(topic)
            return self._topics[topic]

    def retire(self, topic: str) -> None:
        """Return the topic to rospy if that has no publisher for it any more."""
        if rospy.impl.registration.get_topic_manager().get_publisher_impl(topic) is not None:
            return
        with self._lock:
            handles = self._topics.get(topic)
            if handles is None or handles.registrations:
                return
            del self._topics[topic]
            self._shared_memory.topics.discard(topic)
        handles.unlink()

    def reg_added(self, resolved_name: str, data_type_or_uri: str, reg_type: str) -> None:
        """Take a publisher over; no subscriber knows of it yet."""
        handles = self._topics.get(resolved_name)
        if handles is not None and reg_type == rospy.impl.registration.Registration.PUB:
            topics = rospy.impl.registration.get_topic_manager()
            handles.adopt(topics.get_publisher_impl(resolved_name))

    def reg_removed(self, resolved_name: str, data_type_or_uri: str, reg_type: str) -> None:
        if reg_type == rospy.impl.registration.Registration.PUB:
            self.retire(resolved_name)

    def _address_of(self, caller: str) -> str:
        try:
            return self._master.node(caller)
        except PeerTimeout:
            return ""

    def _create_transport(self, topic: str, uri: str, parameters: Any) -> Answer:
        if uri == self._uri and topic in self._topics:
            return self._link(topic)
        subscriber = rospy.impl.registration.get_topic_manager().get_subscriber_impl(topic)
        if subscriber is None:
            return 0, f"no subscriber of {topic}", 0
        connect = functools.partial(self._connect_outside, topic, uri, parameters)
        answer = connect_once(subscriber, uri, connect)
        if uri == self._uri and topic in self._topics:
            return self._link(topic)  # meanwhile, by a thread that did not see this connection yet
        return answer

    def _link(self, topic: str) -> Answer:
        subscriber = rospy.impl.registration.get_topic_manager().get_subscriber_impl(topic)
        handles = self._topics.get(topic)
        if subscriber is None or handles is None:
            return 0, f"no subscriber of {topic}", 0
        handles.link(subscriber)
        return 1, "intraprocess", 0


def _is_ours(callback: Any) -> bool:
    return isinstance(getattr(callback, "__self__", None), (Connection, TypedReceiver))
