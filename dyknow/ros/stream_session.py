# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The session of a process with one manager: a bond, a subscription and renewals of leases.

A session is opened with the first stream that is acquired from the manager, and closed with the
last. It owns the bond, the subscriber of ``~stream_events`` and the thread that renews leases.
"""

from __future__ import annotations

import threading
import time
import uuid
from functools import partial
from typing import TYPE_CHECKING, Any, Callable

import rospy
from bond.msg import Constants, Status
from dyknow_msgs.msg import StreamEvent as StreamEventMessage

from dyknow import names
from dyknow.errors import HostError, PeerTimeout, Refused
from dyknow.locks import state_lock, turn_lock
from dyknow.periodic import PeriodicWorker, attempt
from dyknow.ros.bonding.bond_table import Announcement
from dyknow.ros.bonding.bonds import TOPIC, status_message
from dyknow.ros.client import ManagerClient
from dyknow.ros.wire.messages import event_from

if TYPE_CHECKING:
    from dyknow.ros.acquiring import AcquiredStream

#: A lease is renewed when this fraction of it has passed.
_RENEWED_AFTER = 1 / 3
#: Seconds before the next call to a manager that did not answer.
_RETRY = 1.0
#: Seconds to wait for the events' connection, so that the first events are not missed.
_CONNECT_PATIENCE = 0.5
_POLL = 0.01
_QUEUE_SIZE = 10
#: Seconds to wait, at the end, for a heartbeat that is being sent.
_CLOSE_PATIENCE = 1.0


class ClientBond(rospy.SubscribeListener):
    """The client's end of the bond ``bond_id`` that its claims depend on.

    It only publishes heartbeats: to each new subscriber at once, and to all of them once a second.
    A client learns from its leases that the manager is gone, and goes on meanwhile, so a manager
    that was killed finds its clients alive when it is back.
    """

    def __init__(self, manager: str) -> None:
        self.bond_id = str(uuid.uuid4())
        self._instance_id = str(uuid.uuid4())
        self._closed = threading.Event()
        self._publisher: Any = rospy.Publisher(
            names.join(manager, TOPIC), Status, subscriber_listener=self, queue_size=_QUEUE_SIZE
        )
        period = float(Constants.DEFAULT_HEARTBEAT_PERIOD)
        self._worker = PeriodicWorker("heartbeats of streams", self._publish, period)
        self._worker.start()

    def close(self) -> None:
        """End the bond."""
        self._closed.set()
        self._worker.close(_CLOSE_PATIENCE)
        self._publish(active=False)
        self._publisher.unregister()

    def peer_subscribe(
        self, topic_name: str, topic_publish: Any, peer_publish: Callable[[Status], None]
    ) -> None:
        """Send a heartbeat to a new subscriber, whose time limit is shorter once it has one."""
        if not self._closed.is_set():
            peer_publish(self._status(active=True))

    def _publish(self, active: bool = True) -> None:
        try:
            self._publisher.publish(self._status(active))
        except rospy.ROSException:
            return  # the node has shut down, and the manager misses the heartbeats

    def _status(self, active: bool) -> Status:
        return status_message(Announcement(self.bond_id, self._instance_id, active))


class StreamSession:
    """Keeps the claims of this process alive; every method is safe from any thread."""

    _sessions: dict[str, StreamSession] = {}
    _sessions_lock = state_lock("stream sessions")

    @classmethod
    def open(cls, client: ManagerClient) -> StreamSession:
        """Return the session for the client's manager; each call needs a ``close``."""
        with cls._sessions_lock:
            if client.manager not in cls._sessions:
                cls._sessions[client.manager] = cls(client)
            session = cls._sessions[client.manager]
            session._users += 1
        try:
            session._start()
        except BaseException:
            session.close()
            raise
        return session

    def __init__(self, client: ManagerClient) -> None:
        """Store the client; ``open`` returns a session with its subscription and bond."""
        self._client = client
        self._users = 0
        self._turn = turn_lock("opening of a stream session")
        self._state_lock = state_lock("streams of a session")
        self._streams: dict[str, AcquiredStream] = {}
        self._due: dict[str, float] = {}
        self._bond: ClientBond | None = None
        self._subscriber: Any = None
        self._worker = PeriodicWorker("renewing leases", self._keep, self._until_due)

    @property
    def bond_id(self) -> str:
        """Id of the bond on which this process's claims depend."""
        assert self._bond is not None
        return self._bond.bond_id

    def add(self, stream: AcquiredStream) -> None:
        """Keep a stream's claim alive, and pass on its changes."""
        with self._state_lock:
            self._streams[stream.claim_id] = stream
            self._due[stream.claim_id] = 0.0  # at once, for changes before it was added
        self._worker.wake()

    def remove(self, claim_id: str) -> None:
        """Stop renewing a stream's claim."""
        with self._state_lock:
            self._streams.pop(claim_id, None)
            self._due.pop(claim_id, None)

    def close(self) -> None:
        """Give up one ``open``; the last one ends the session."""
        with self._sessions_lock:
            self._users -= 1
            if self._users:
                return
            self._sessions.pop(self._client.manager)
        self._worker.close()
        self._client.close()
        with self._turn:
            if self._subscriber is not None:
                self._subscriber.unregister()
            if self._bond is not None:
                self._bond.close()

    # Inside

    def _start(self) -> None:
        """Subscribe to the events and start the bond and the renewals, unless that is done."""
        with self._turn:
            if self._bond is None:
                self._bond = ClientBond(self._client.manager)
            if self._subscriber is None:
                topic = names.join(self._client.manager, "stream_events")
                self._subscriber = rospy.Subscriber(topic, StreamEventMessage, self._on_event)
                deadline = time.monotonic() + _CONNECT_PATIENCE
                while not self._subscriber.get_num_connections() and time.monotonic() < deadline:
                    time.sleep(_POLL)
        self._worker.start()

    def _on_event(self, message: Any) -> None:
        with self._state_lock:
            stream = self._streams.get(message.after.claim_id)
        if stream is not None:
            stream.on_event(event_from(message))

    def _keep(self) -> None:
        """Renew the leases when they are due."""
        now = time.monotonic()
        with self._state_lock:
            due = [self._streams[each] for each, at in self._due.items() if at <= now]
        for stream in due:
            attempt("renewing a lease", partial(self._renew, stream))
        if due:
            self._refresh([stream.claim_id for stream in due])

    def _until_due(self) -> float | None:
        """Seconds until the next lease has to be renewed; None without leases."""
        with self._state_lock:
            soonest = min(self._due.values(), default=None)
        return None if soonest is None else max(0.0, soonest - time.monotonic())

    def _renew(self, stream: AcquiredStream) -> None:
        began = time.monotonic()
        self._put_off(stream, began + _RETRY)  # for any failure
        try:
            self._client.renew_stream(stream.claim_id, stream.lease)
        except Refused as error:
            self._refresh([stream.claim_id])  # the manager may still know why it ended
            self.remove(stream.claim_id)
            stream.on_lost(str(error))
        except (HostError, PeerTimeout) as error:
            rospy.logwarn_throttle(10, f"the lease of stream {stream.claim_id}: {error}")
        else:
            self._put_off(stream, began + stream.lease * _RENEWED_AFTER)

    def _put_off(self, stream: AcquiredStream, due: float) -> None:
        with self._state_lock:
            if stream.claim_id in self._due:
                self._due[stream.claim_id] = due

    def _refresh(self, claim_ids: list[str]) -> None:
        """Ask for the current status: events are not latched, so some may have been missed."""
        with self._state_lock:
            events = {key: self._streams[key].events for key in claim_ids if key in self._streams}
        if not events:
            return
        try:
            claims = {each.claim_id: each for each in self._client.list_streams()}
        except (HostError, PeerTimeout):
            return  # the next renewal will show
        for claim_id in claim_ids:
            with self._state_lock:
                stream = self._streams.get(claim_id)
            if stream is not None and claim_id in claims:
                stream.on_status(claims[claim_id], events.get(claim_id, -1))
