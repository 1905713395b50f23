# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Streams on request for Python programs: ``with dyknow.acquire(tag) as stream:``.

Works in a rospy node and in a nodelet. The claim lives as long as the ``with`` block or, without
one, until ``release``. Its lease is renewed automatically, and a bond notifies the manager when
the process dies.
"""

from __future__ import annotations

import os
import time
import uuid
from dataclasses import replace
from typing import Any, Callable, Iterable

import rospy

from dyknow.errors import BadParameter, DyKnowError, HostError, PeerTimeout, Refused, StreamRefused
from dyknow.locks import state_condition
from dyknow.model.streams import Acquisition, ClaimState, StreamEvent, StreamRequest, StreamStatus
from dyknow.periodic import EventQueue
from dyknow.ros.client import CHANGE_TIMEOUT, ManagerClient
from dyknow.ros.stream_session import StreamSession

OnEvent = Callable[[StreamEvent], None]

#: Seconds after which a claim ends if its client does not renew it.
LEASE = 30.0
_PERIOD = 0.2


class AcquiredStream:
    """A stream that the manager makes and maintains for this process.

    Attributes:
        tag: the requested tag.
        claim_id: the claim's id, for ``dyknow streams``, ``replan`` and ``release``.
        lease: seconds that the claim outlives a silent client.
        spawned: nodelets that were spawned for it.
        reused: nodelets that ran already.
    """

    def __init__(
        self,
        client: ManagerClient,
        session: StreamSession,
        status: StreamStatus,
        lease: float,
        on_event: OnEvent | None,
    ) -> None:
        self.claim_id = status.claim_id
        self.tag = status.tag
        self.lease = lease
        self.spawned: tuple[str, ...] = ()
        self.reused: tuple[str, ...] = ()
        self._client = client
        self._session = session
        self._notifications: EventQueue[StreamEvent] = EventQueue(on_event or (lambda event: None))
        self._changed = state_condition("acquired stream")
        self._status = status
        self._released = False
        self._events = 0

    @property
    def topic(self) -> str:
        """The topic to subscribe to; it stays the same. Empty while the stream cannot be made."""
        return self._status.topic

    @property
    def datatype(self) -> str:
        """ROS type of the stream; empty while that is not known."""
        return self._status.datatype

    @property
    def state(self) -> ClaimState:
        """The claim's state, as last reported by the manager."""
        return self._status.state

    @property
    def detail(self) -> str:
        """Why it does not flow, or that no message has come yet; empty if it flows."""
        return self._status.detail

    @property
    def nodelets(self) -> tuple[str, ...]:
        """Names of the nodelets that it needs, as last reported by the manager."""
        return self._status.nodelets

    @property
    def bindings(self) -> dict[str, str]:
        """Names for the variables of the tag, such as ``{"?camera": "left"}``.

        A repair may change them, which is an event.
        """
        return dict(each.split("=", 1) for each in self._status.bindings)

    def wait_until_active(self, timeout: float | None = None) -> bool:
        """Wait for the stream.

        Args:
            timeout: seconds; None for as long as it takes.

        Returns:
            Whether it is active; False if the time, the node or the claim ended first.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        with self._changed:
            while self.state is not ClaimState.ACTIVE:
                late = deadline is not None and time.monotonic() >= deadline
                if late or self.state.ended or rospy.is_shutdown():
                    return False
                self._changed.wait(_PERIOD)
        return True

    def release(self) -> None:
        """End the claim; does nothing if it has ended.

        A manager that cannot be reached ends the claim when it notices that the bond is broken.
        """
        with self._changed:
            if self._released:
                return
            self._released = True
        self._session.remove(self.claim_id)
        try:
            if not self.state.ended:
                self._client.release_stream(self.claim_id)
        except (HostError, PeerTimeout, Refused) as error:
            rospy.logwarn("stream %s was not released: %s", self.claim_id, error)
        finally:
            self._session.close()
        self._change("released", state=ClaimState.RELEASED, detail="")

    def __enter__(self) -> AcquiredStream:
        return self

    def __exit__(self, *unused: object) -> None:
        self.release()

    def __repr__(self) -> str:
        return f"<stream {self.tag} on {self.topic or 'no topic'}: {self.state.name}>"

    # Called by the session

    @property
    def events(self) -> int:
        """Number of changes seen; an answer requested before the last change is out of date."""
        return self._events

    def on_event(self, event: StreamEvent) -> None:
        """Apply a change, unless the claim has ended."""
        with self._changed:
            if not self._status.state.ended:
                self._events += 1
                self._put(event)
        self._notifications.deliver()

    def on_status(self, status: StreamStatus, events: int) -> None:
        """Apply the claim's status as of ``events`` changes; reported if a change was missed."""
        with self._changed:
            if events == self._events:
                self._take(status, status.detail or "an earlier event was missed")
        self._notifications.deliver()

    def on_lost(self, why: str) -> None:
        """Mark the claim as ended: the manager no longer knows it."""
        self._change(why, state=ClaimState.EXPIRED, detail=why)

    def _change(self, reason: str, **changes: Any) -> None:
        with self._changed:
            self._take(replace(self._status, **changes), reason)
        self._notifications.deliver()

    def _take(self, status: StreamStatus, reason: str) -> None:
        before = self._status
        if before.state.ended:
            return
        if _shown(status) != _shown(before):
            self._put(StreamEvent(rospy.get_time(), before, status, reason))
        else:
            self._status = status

    def _put(self, event: StreamEvent) -> None:
        self._status = event.after
        self._changed.notify_all()
        self._notifications.add(event)


def acquire(
    tag: str,
    datatype: str | Any = "",
    *,
    max_silence: float = 0.0,
    min_rate: float = 0.0,
    max_age: float = 0.0,
    require: str = "",
    exclude: str | Iterable[str] = (),
    prefer: str | Iterable[str] = (),
    avoid: str | Iterable[str] = (),
    budget: float = 0.0,
    pending: bool = False,
    lease: float = LEASE,
    on_event: OnEvent | None = None,
    client_id: str = "",
    manager: str = "",
    timeout: float = CHANGE_TIMEOUT,
) -> AcquiredStream:
    """Request a stream, which the manager makes and maintains.

    Args:
        tag: a term such as ``FieldPosition(ball)`` or ``BallObject(?robot)``.
        datatype: the type that it must have, as a message class or by name; any by default.
        max_silence: seconds without a message after which a part counts as broken; 0: only dead
            parts count as broken.
        min_rate: Hz; a part that keeps the stream slower is replaced. 0: any rate will do.
        max_age: seconds that messages may be old when they are published, by the stamps in their
            headers; a part that makes them older is replaced. 0: any age will do. A type without
            a header is refused.
        require: a formula over ``it``, the messages of the stream; where it is FALSE, the stream
            is made in another way (:doc:`formulas`).
        exclude: labels of transformations that must not be used, or a single one; an unknown
            label is only a warning.
        prefer: concepts or labels, or a single one, to use where there is a choice.
        avoid: concepts or labels, or a single one, to use only where there is no choice.
        budget: seconds for planning, at most 60; 0: the manager's default, 0.1. A plan that takes
            longer to find is not improved. Other streams are repaired and other clients served
            meanwhile.
        pending: also accept a stream that cannot be made yet; see ``wait_until_active``.
        lease: the most seconds that the claim outlives this process.
        on_event: called with each change of the claim (``before``, ``after``, ``reason``), on any
            thread; its errors are logged.
        client_id: name of the client; by default this node's.
        manager: the manager's node; by default ``$DYKNOW_MANAGER``, else ``dyknow_manager``.
        timeout: seconds allowed for making it.

    Raises:
        StreamRefused: it cannot be made; the text says why, and which tags nothing supplies.
        HostError: there is no manager.
        PeerTimeout: the manager does not answer in time.
        rospy.ROSInitException: this process is not a node.
    """
    if not rospy.core.is_initialized():
        raise rospy.ROSInitException("dyknow.acquire needs a node: call rospy.init_node first")
    if not lease > 0:
        raise BadParameter("lease", lease, "seconds, more than 0")
    node = rospy.get_name()
    client = ManagerClient(manager or os.environ.get("DYKNOW_MANAGER") or "dyknow_manager", node)
    session = StreamSession.open(client)
    try:
        request = StreamRequest(
            tag=tag,
            datatype=getattr(datatype, "_type", datatype),
            client_id=client_id or node,
            request_id=str(uuid.uuid4()),
            bond_id=session.bond_id,
            lease=lease,
            max_silence=max_silence,
            min_rate=min_rate,
            max_age=max_age,
            require=require,
            exclude=_names(exclude),
            prefer=_names(prefer),
            avoid=_names(avoid),
            budget=budget,
        )
        status, answer = _ask(client, request, pending, timeout)
        stream = AcquiredStream(client, session, status, lease, on_event)
        if answer is not None:
            stream.spawned, stream.reused = answer.spawned, answer.reused
        session.add(stream)
    except BaseException:
        session.close()
        raise
    return stream


def _shown(status: StreamStatus) -> tuple[object, ...]:
    """Return the fields whose change triggers an event."""
    return status.state, status.topic, status.detail, status.bindings


def _names(given: str | Iterable[str]) -> tuple[str, ...]:
    return (given,) if isinstance(given, str) else tuple(given)


def _ask(
    client: ManagerClient, request: StreamRequest, pending: bool, timeout: float
) -> tuple[StreamStatus, Acquisition | None]:
    """Request a stream; return its status, and the answer unless it is still pending."""
    status = StreamStatus(
        "", request.client_id, request.tag, "", "", ClaimState.PENDING, "", (), 0.0
    )
    try:
        answer = client.acquire_stream(request, timeout=timeout)
    except StreamRefused as error:
        if error.claim_id and pending:
            return replace(status, claim_id=error.claim_id, detail=str(error)), None
        if error.claim_id:
            _release(client, error.claim_id)
            raise error.given_up() from error
        raise
    active = replace(
        status,
        claim_id=answer.claim_id,
        topic=answer.topic,
        datatype=answer.datatype,
        state=ClaimState.ACTIVE,
        detail=answer.message,
        nodelets=tuple(sorted({*answer.spawned, *answer.reused})),
        expires=answer.expires,
        bindings=answer.bindings,
    )
    return active, answer


def _release(client: ManagerClient, claim_id: str) -> None:
    try:
        client.release_stream(claim_id)
    except DyKnowError as error:  # it ends with its lease
        rospy.logwarn("stream %s was not released: %s", claim_id, error)
