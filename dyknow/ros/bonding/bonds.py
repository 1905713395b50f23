# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The bonds of a process on one topic, one thread for all of them.

A nodelet manager has a bond with every client that loaded a nodelet and stays to watch over it.
With python3-bondpy forty bonds cost a hundred threads, which compete for the interpreter lock.
`Bonds` speaks the same protocol, with stock sisters at the other end, through one publisher, one
subscriber and one thread, and has none of the three while there is no bond.

The rules are in `bond_table`. Ownership: the condition guards the table. The thread owns the
publisher and the subscriber, which come and go with it; so it is not a `PeriodicWorker`, whose
thread would stay. A turn is held while something is published, since a rospy publisher must not be
unregistered meanwhile.
"""

from __future__ import annotations

import threading
import time
from functools import partial
from typing import Any, Callable, Sequence

import rospy
from bond.msg import Constants, Status

from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.locks import state_condition, turn_lock
from dyknow.periodic import RETRY, attempt, in_background
from dyknow.ros.bonding.bond_table import Announcement, BondTable, BondTimings, Effects, OnBroken
from dyknow.ros.wire.master import Master

STOCK_TIMINGS = BondTimings(
    connect_timeout=Constants.DEFAULT_CONNECT_TIMEOUT,
    heartbeat_timeout=Constants.DEFAULT_HEARTBEAT_TIMEOUT,
    disconnect_timeout=Constants.DEFAULT_DISCONNECT_TIMEOUT,
    heartbeat_period=Constants.DEFAULT_HEARTBEAT_PERIOD,
    dead_publish_period=Constants.DEAD_PUBLISH_PERIOD,
)
"""What bondcpp and bondpy use."""

#: Name of the topic of bonds below a manager of either kind.
TOPIC = "bond"
#: Heartbeats of many bonds at once; they are small, and a sister that reads none is given up.
_QUEUE_SIZE = 1000

_PARAMETER_TIMEOUT = 1.0


class BondsClosed(DyKnowError):
    """A bond was to be started after `Bonds.close`."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        super().__init__(f"no new bonds on '{topic}': this end is closed")


class Bonds:
    """Every bond of this process on one topic; every method is safe from any thread."""

    def __init__(
        self,
        topic: str,
        timings: BondTimings = STOCK_TIMINGS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Make an end without bonds; the topic is registered with the first.

        Args:
            topic: where both ends publish, `MANAGER/bond` for nodelets.
            timings: limits and periods of all bonds.
            clock: seconds by which silence is measured. A clock of the time for which this
                process has run leaves sisters time to answer after a pause.
        """
        self._clock = clock
        self._topic = topic
        self._timings = timings
        self._changed = state_condition("bonds")
        self._table = BondTable(timings)
        self._thread: threading.Thread | None = None
        self._publisher: Any = None
        self._publishing_turn = turn_lock("messages of bonds")
        self._closed_until: float | None = None

    def add(self, bond_id: str, on_broken: OnBroken) -> None:
        """Start a bond; the sister may be there already or come within the connect timeout.

        ``on_broken`` is called once, when the sister dies, falls silent or never comes.

        Raises:
            DuplicateBond: there is a bond with this id.
            BondsClosed: `close` was called.
        """
        with self._changed:
            if self._closed_until is not None:
                raise BondsClosed(self._topic)
            if self._thread is None:  # first: the system may refuse it
                self._thread = in_background("bonds", self._run)
            effects = self._table.add(bond_id, on_broken, self._clock())
            self._changed.notify()
        self._perform(effects)

    def remove(self, bond_id: str) -> None:
        """Break a bond on purpose, if it exists: the sister is notified, `on_broken` is not."""
        with self._changed:
            effects = self._table.remove(bond_id, self._clock())
            self._changed.notify()
        self._perform(effects)

    def close(self, timeout: float = 0.5) -> None:
        """Break all bonds on purpose, refuse new ones, and wait for acknowledgements."""
        with self._changed:
            now = self._clock()
            self._closed_until = now + timeout
            effects = self._table.remove_all(now)
            thread = self._thread
            self._changed.notify()
        self._perform(effects)
        if thread is not None and thread is not threading.current_thread():
            thread.join(timeout + _PARAMETER_TIMEOUT)

    def _run(self) -> None:
        while not attempt("serving bonds", self._serve):
            time.sleep(RETRY)

    def _serve(self) -> bool:
        """Serve until the last bond is gone."""
        publisher = rospy.Publisher(self._topic, Status, queue_size=_QUEUE_SIZE)
        with self._changed:
            self._publisher = publisher
        subscriber = rospy.Subscriber(self._topic, Status, self._on_status, tcp_nodelay=True)
        try:
            while self._serve_once():
                pass
            return True
        finally:
            subscriber.unregister()
            with self._publishing_turn:  # after the present message, before any other
                if self._publisher is publisher:
                    self._publisher = None
            publisher.unregister()

    def _serve_once(self) -> bool:
        """Act on due bonds, or sleep; return False when the last bond is gone."""
        with self._changed:
            silent = self._table.silent(self._clock())
        silence_counts = not self._is_heartbeat_timeout_disabled(silent) if silent else None
        with self._changed:
            now = self._clock()
            effects = self._table.tick(now, silence_counts)
            if not effects:
                due = self._next_due(now)
                if due is None:
                    self._thread = self._publisher = None
                    return False
                self._changed.wait(due - now)
        self._perform(effects)
        return True

    def _next_due(self, now: float) -> float | None:
        due = self._table.next_due()
        if due is None or self._closed_until is None:
            return due
        if now >= self._closed_until or not self._table.is_parting():
            return None
        return min(due, self._closed_until)

    def _on_status(self, status: Any) -> None:
        with self._changed:
            effects = self._table.receive(
                status.id, status.instance_id, status.active, self._clock()
            )
            if effects:
                self._changed.notify()
        self._perform(effects)

    def _perform(self, effects: Effects) -> None:
        """Carry out the effects; never called with the lock."""
        with self._publishing_turn:
            publisher = self._publisher  # the thread may be about to make it; announcements repeat
            for each in effects.announcements if publisher is not None else ():
                try:
                    publisher.publish(status_message(each, self._timings))
                except rospy.ROSException:
                    break  # the node shuts down; our silence has the same meaning
        for bond_id in effects.intruded:
            rospy.logerr_throttle(
                10,
                "More than two locations are trying to use a single bond "
                f"(topic: {self._topic}, id: {bond_id}).",
            )
        if effects.broken:  # a slow unload must not delay the heartbeats of the other bonds
            in_background("broken bonds", partial(_call_each, effects.broken))

    def _is_heartbeat_timeout_disabled(self, silent: Sequence[str]) -> bool:
        """Whether silence breaks no bonds, as a parameter for debugging says."""
        name = Constants.DISABLE_HEARTBEAT_TIMEOUT_PARAM
        try:
            found = Master(rospy.get_name(), timeout=_PARAMETER_TIMEOUT).ask("getParam", name)
        except LookupError:
            return False  # it is not set
        except PeerTimeout as error:
            rospy.logwarn(
                f"Cannot read the parameter {name}, so heartbeat timeouts count: {error}"
            )
            return False
        if found:
            rospy.logwarn(
                "Heartbeat timeout is disabled.  Not breaking bond "
                f"(topic: {self._topic}, id: {', '.join(silent)})"
            )
        return bool(found)


def status_message(announcement: Announcement, timings: BondTimings = STOCK_TIMINGS) -> Status:
    """Make the message that both ends of a bond exchange."""
    status = Status(
        id=announcement.bond_id,
        instance_id=announcement.instance_id,
        active=announcement.active,
        heartbeat_timeout=timings.heartbeat_timeout,
        heartbeat_period=timings.heartbeat_period,
    )
    status.header.stamp = rospy.Time.now()
    return status


def _call_each(callbacks: Sequence[OnBroken]) -> None:
    for callback in callbacks:
        attempt("the callback of a broken bond", callback)
