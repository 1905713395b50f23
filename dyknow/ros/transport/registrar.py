# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Registers what rospy adds with the master, in rospy's place, and keeps the master's answers.

The master answers the registration of a topic with the nodes on its other side. rospy drops that
answer for publishers. Registering again would notify every subscriber twice: a rospy subscriber
may then connect twice, and messages sent over the first connection are lost.
rospy also repeats a registration for ever while the master is down, under the locks that
every other registration of the process needs; here one that fails is repeated by a thread. So is a
withdrawal, or the master would list the topic for as long as the process lives.

A publisher refuses a subscriber that has learnt too late that the topic was withdrawn. rospy
counts that as a connection, for a second or for ever, and does not connect when the topic is back;
here it is none.

The hook is two instance attributes of rospy's ``RegManager``, those of its documented
``RegistrationListener`` interface, and the function that connects a subscriber.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import logging
import threading
import time
from typing import Any, Callable, Collection, Iterator, Sequence, Tuple

import rospy
import rospy.core
from rospy.exceptions import TransportInitError
from rospy.impl import tcpros_pubsub
from rospy.impl.registration import Registration, get_topic_manager

from dyknow.errors import PeerTimeout
from dyknow.locks import state_lock
from dyknow.periodic import PeriodicWorker
from dyknow.ros.process.node_process import registration_manager
from dyknow.ros.transport.late_subscribers import Addresses, LateSubscribers, Reminders
from dyknow.ros.wire.master import Master

#: Seconds between two attempts while the master is down.
_AGAIN = 0.5

_QUESTIONS = {
    Registration.PUB: ("registerPublisher", "unregisterPublisher"),
    Registration.SUB: ("registerSubscriber", "unregisterSubscriber"),
    Registration.SRV: ("registerService", "unregisterService"),
}

#: Packages of messages that the process sends for itself.
_OWN = ("bond/", "dyknow_msgs/", "rosgraph_msgs/")

Key = Tuple[str, str, str]  # kind of registration, name, and the address of a service

#: In ``offered`` the services that a thread offers together: the registrar, name and address.
_together = threading.local()

#: Not below "rosout": to publish there rospy asks the master about a parameter first.
_log = logging.getLogger("dyknow.master")


class Registrar:
    """Registrations of this process, in place of rospy's own; the node must be initialised."""

    def __init__(self, master: Master | None = None) -> None:
        """Take over; ``master`` is that of the environment by default."""
        self._master = master or Master(rospy.get_name())
        self._uri: str = rospy.core.get_node_uri() or ""
        self._lock = state_lock("registrar")
        #: Subscribers that are not waited for.
        self.late = LateSubscribers()
        #: With the type or address that is to be registered; empty for a withdrawal.
        self._owed: dict[Key, str] = {}
        self._peers: dict[Key, Addresses] = {}
        self._worker = PeriodicWorker(
            "registering", self._settle, lambda: _AGAIN if self._owed else None, 0.0, _log
        )
        self._reminders = Reminders(self._register_again, self._connected)
        self._manager: Any = registration_manager()
        #: When a connection to a publisher, by topic and address, failed last.
        self._refused: dict[tuple[str, str], float] = {}
        if self._manager is not None:
            self._manager.reg_added = self.reg_added
            self._manager.reg_removed = self.reg_removed
            connect = functools.partial(self._connect, tcpros_pubsub.robust_connect_subscriber)
            tcpros_pubsub.robust_connect_subscriber = connect

    def subscribers(self, topic: str) -> Addresses | None:
        """Addresses of the other nodes that subscribed when this process began to publish.

        They are returned once, since they grow old; None if there was no new registration.
        """
        return self._answer((Registration.PUB, topic, ""))

    def publishers(self, topic: str) -> Addresses | None:
        """Addresses of the other nodes that published when this process subscribed, likewise."""
        return self._answer((Registration.SUB, topic, ""))

    def _answer(self, key: Key) -> Addresses | None:
        with self._lock:
            return self._peers.pop(key, None)

    def connect_again(self, topic: str, uris: Collection[str]) -> None:
        """Connect to publishers of a topic that this process has disconnected from."""
        # With all other publishers: rospy forgets what the master has just reported of the topic.
        with contextlib.suppress(PeerTimeout, LookupError):
            uris = {*uris, *map(self._master.node, self._master.publishers(topic))} - {""}
        self._hear_of(topic, uris)

    def _hear_of(self, topic: str, uris: Collection[str]) -> None:
        """Let rospy connect to publishers of a topic, and to those that it is about to.

        It takes the last list for the newest. An answer of the master may come after, but be older
        than, the notification of a publisher that registered just then.
        """
        if self._manager is None:
            return
        with self._manager.cond:
            waiting = (found for each, found in self._manager.updates if each == topic)
            self._manager.publisher_update(topic, sorted({*uris, *itertools.chain(*waiting)}))

    def _connect(self, connect: Callable[..., None], connection: Any, *where: Any) -> None:
        """Connect to a publisher with rospy's function ``connect``, and receive its messages."""
        _, _, uri, _, topic = where
        rospy_connect, has_failed = connection.connect, False

        def attempt(*args: Any, **options: Any) -> None:
            nonlocal has_failed
            try:
                rospy_connect(*args, **options)
            except TransportInitError:
                has_failed = True
                if connection.socket is not None:  # there is no other attempt
                    _close(connection)
                raise
            vars(connection).pop("connect", None)
            has_failed = False

        connection.connect = attempt
        connect(connection, *where)
        if not has_failed or rospy.is_shutdown():
            return
        if connection.protocol is not None:  # it was given up, not closed
            _close(connection)
        now = time.monotonic()
        with self._lock:
            lately = {each: at for each, at in self._refused.items() if now - at < _AGAIN}
            self._refused = {**lately, (topic, uri): now}
        if (topic, uri) not in lately:  # it may be back: an update meanwhile had no effect
            self.connect_again(topic, ())

    def is_subscribed(self, topic: str) -> bool:
        """Whether the master knows the subscription of this process, as far as there is one."""
        with self._lock:
            return not self._owed.get((Registration.SUB, topic, ""))

    def reg_added(self, name: str, datatype_or_uri: str, kind: str) -> None:
        """Register a topic or a service, after those that wait for the master already."""
        offered = getattr(_together, "offered", None)
        if offered is not None and kind == Registration.SRV:
            offered.append((self, name, datatype_or_uri))
            return
        key = _key(kind, name, datatype_or_uri)
        with self._lock:
            is_down = bool(self._owed)
        if is_down or not self._register(key, datatype_or_uri):
            self._owe(key, datatype_or_uri)

    def register_services(self, offered: Sequence[Tuple[str, str]]) -> None:
        """Register services, pairs of a name and an address, with one question to the master."""
        questions = [
            (_QUESTIONS[Registration.SRV][0], self._master.caller, *each, self._uri)
            for each in offered
        ]
        with self._lock:
            is_down = bool(self._owed)
        answers: Sequence[Any] = [None] * len(offered)
        try:
            if not is_down:
                answers = self._master.ask_all(questions)
        except LookupError:  # it takes one question at a time
            pass
        except PeerTimeout:
            for name, uri in offered:
                self._owe(_key(Registration.SRV, name, uri), uri)
            return
        for (name, uri), answer in zip(offered, answers):
            if answer is None:  # alone it gets the reason
                self.reg_added(name, uri, Registration.SRV)

    def reg_removed(self, name: str, datatype_or_uri: str, kind: str) -> None:
        offered = getattr(_together, "offered", [])
        if (self, name, datatype_or_uri) in offered:
            offered.remove((self, name, datatype_or_uri))
            return
        key = _key(kind, name, datatype_or_uri)
        with self._lock:
            is_down = bool(self._owed)  # its registration may be under way, too
            self._peers.pop(key, None)
        if is_down or not self._unregister(key):
            self._owe(key, "")
        if kind == Registration.PUB:
            self._reminders.withdrawn(name)

    def _register(self, key: Key, what: str) -> bool:
        kind, name, _ = key
        try:
            peers = self._master.ask(_QUESTIONS[kind][0], name, what, self._uri)
        except PeerTimeout as error:
            _log.debug("%s is not registered yet: %s", name, error)
            return False
        except LookupError as error:
            _log.error("the ROS master refuses to register %s: %s", name, error)
            return True
        if kind == Registration.SRV:
            return True
        others = frozenset(peers) - {self._uri}
        with self._lock:
            self._peers[key] = others
        if kind == Registration.PUB:
            self._reminders.advertised(name, what, others)
        else:
            self._hear_of(name, peers)
        return True

    def _register_again(self, topic: str, datatype: str) -> Addresses | None:
        """Let the master notify all subscribers of a topic again; return their addresses."""
        try:
            peers = self._master.ask("registerPublisher", topic, datatype, self._uri)
        except (PeerTimeout, LookupError) as error:
            _log.debug("the subscribers of %s are not notified again: %s", topic, error)
            return None
        if get_topic_manager().get_publisher_impl(topic) is None:  # withdrawn in between
            self._unregister((Registration.PUB, topic, ""))
        return frozenset(peers)

    def _connected(self, topic: str) -> Addresses:
        """Addresses of the nodes that are connected to a topic which this process publishes."""
        implementation = get_topic_manager().get_publisher_impl(topic)
        connections = implementation.connections if implementation is not None else None
        try:
            return frozenset(self._master.node(each.endpoint_id) for each in connections or ())
        except PeerTimeout:
            return frozenset()

    def _unregister(self, key: Key) -> bool:
        kind, name, service = key
        try:
            self._master.ask(_QUESTIONS[kind][1], name, service or self._uri)
        except PeerTimeout as error:
            _log.debug("%s stays registered: %s", name, error)
            return False
        except LookupError:
            pass  # the master has forgotten it already
        return True

    def _owe(self, key: Key, what: str) -> None:
        change = "registered" if what else "withdrawn"
        _log.warning("the ROS master does not answer; %s will be %s when it does", key[1], change)
        with self._lock:
            is_first = not self._owed
            self._owed[key] = what
        if is_first:
            self._worker.start()
            self._worker.wake()

    def _settle(self) -> None:
        """Repeat what failed, one after the other, as long as the master answers.

        Nothing is registered if another node has our name by now: the master would shut it down.
        """
        try:
            if self._master.node(self._master.caller) not in ("", self._uri):
                return
        except PeerTimeout:
            return
        while not rospy.is_shutdown():
            with self._lock:
                if not self._owed:
                    return
                key, what = next(iter(self._owed.items()))
            if not (self._register(key, what) if what else self._unregister(key)):
                return
            with self._lock:
                if self._owed[key] == what:  # else that has changed meanwhile
                    del self._owed[key]


@contextlib.contextmanager
def services_together() -> Iterator[None]:
    """Register the services that this thread offers meanwhile at the end, with one question.

    The master may be far away. In a process without a `Registrar` each is registered at once.
    """
    offered: list[tuple[Registrar, str, str]] = []
    _together.offered = offered
    try:
        yield
    finally:
        del _together.offered
        if offered:
            registrar = offered[0][0]  # a process has one
            registrar.register_services([(name, uri) for _, name, uri in offered])


def _close(connection: Any) -> None:
    """Close a connection, also one that rospy closed before it had a socket, or has given up.

    The publisher's process accepts no further connection until the header of this one has come,
    or its end.
    """
    connection.done = False
    connection.close()


def _key(kind: str, name: str, datatype_or_uri: str) -> Key:
    return kind, name, datatype_or_uri if kind == Registration.SRV else ""


# The topics of the code in a process, which guards bind, and DyKnow's own ones


def guard_topics(check_topic: Callable[[str], None]) -> None:
    """Check each topic before rospy registers it, for code that uses rospy itself.

    ``check_topic`` raises Denied if nothing must be connected to the topic. The hook is one
    instance attribute of rospy's topic manager.
    """
    manager = get_topic_manager()
    acquire = manager.acquire_impl

    def acquire_checked(side: str, topic: str, datatype: Any) -> Any:
        if not datatype._type.startswith(_OWN):
            check_topic(topic)
        return acquire(side, topic, datatype)

    manager.acquire_impl = acquire_checked


def hide_topics(hidden: Collection[str]) -> None:
    """Leave topics out of this process's lists of topics; they work as before.

    rospy lists all topics of the process in every message to /rosout and in the slave API. A
    program that runs unchanged lists those that it uses itself. The hook is three instance
    attributes of rospy's topic manager.
    """
    manager = get_topic_manager()

    def shown(listed: Callable[[], Collection[Any]]) -> Callable[[], list[Any]]:
        return lambda: [each for each in listed() if each[0] not in hidden]

    topics = manager.get_topics
    manager.get_topics = lambda: topics().difference(hidden)
    manager.get_publications = shown(manager.get_publications)
    manager.get_subscriptions = shown(manager.get_subscriptions)
