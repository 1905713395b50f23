# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Messages of live topics, for one monitor."""

from __future__ import annotations

import queue
from functools import partial
from typing import Any, Callable, Iterator, Mapping, NamedTuple

import rospy

from dyknow.formulas import Monitor, Verdict
from dyknow.locks import state_lock
from dyknow.ros.formulas.individuals import take_waiting
from dyknow.ros.process.node_process import init_node

#: Most seconds between two looks at the clock and the individuals.
_PATIENCE = 0.1


class Received(NamedTuple):
    """A message of a port, of an individual, and when it was received; none without a port."""

    port: str
    individual: str
    message: Any
    when: Any


class LiveTopics:
    """The messages of topics, in the order of receipt."""

    def __init__(self) -> None:
        """Become a node, if this process is none yet."""
        if not rospy.core.is_initialized():
            init_node("dyknow_holds", anonymous=True, disable_signals=True, disable_rosout=True)
        self._received: queue.Queue[Received] = queue.Queue()
        self._state_lock = state_lock("messages of topics")
        #: The last message of each port, of an individual, that the monitor has not received.
        self._waiting: dict[tuple[str, str], Any] = {}

    def subscribe(self, port: str, individual: str, topic: str, kind: Any) -> Any:
        """Receive a topic as a port; returns the subscriber."""
        self._waiting.pop((port, individual), None)  # of its last stream
        return rospy.Subscriber(topic, kind, partial(self._note, port, individual))

    def _note(self, port: str, individual: str, message: Any) -> None:
        with self._state_lock:  # between threads, too, times are in order: none is a jump back
            self._received.put(Received(port, individual, message, rospy.Time.now()))

    def verdicts(
        self,
        monitor: Monitor,
        individuals: Callable[[], Mapping[str, list[str]] | None],
        is_over: Callable[[], bool],
    ) -> Iterator[Verdict]:
        """Yield verdicts as they come.

        ``individuals`` returns the individuals that are there, by variable; None as long as that
        is not known, and no state begins.
        """
        while not is_over() and not rospy.is_shutdown():
            try:
                received = self._received.get(timeout=_PATIENCE)
            except queue.Empty:
                self._note("", "", None)  # time passes
                continue
            if received.port:
                self._waiting[received.port, received.individual] = received.message
            present = individuals()
            if present is None or not received.when:  # ROS time has not begun
                continue
            yield from take_waiting(monitor, self._waiting, present, received.when)
            yield from monitor.advance(received.when)
