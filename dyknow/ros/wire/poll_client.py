# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Polls one process that runs nodelets, over a connection that is kept, and measures its clock."""

from __future__ import annotations

import collections
import time
from operator import attrgetter
from typing import Any

from dyknow_msgs.msg import NodeletChanges
from dyknow_msgs.srv import Poll, PollResponse
from nodelet.srv import NodeletList

from dyknow import names
from dyknow.errors import HostError
from dyknow.model.graph import NodeletKind
from dyknow.model.hosts import UNKNOWN_OFFSET, ClockOffset
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import (
    OTHER_VERSION,
    ConnectionRefused,
    ServiceClient,
    ServiceFailed,
)

#: Services of our nodelet managers and of re-wirable nodes that the master does not list.
POLL, HAND_OVER = "poll", "hand_over"
#: Answers of which the quickest counts.
_SAMPLES = 8


class PollClient:
    """Polls one process for its nodelets; not for several threads at once.

    When the connection breaks another process may have the name by now, so there is no other
    connection. A stock nodelet manager, which has no such service, is queried for its list.

    Attributes:
        is_stock: whether it turned out to be a stock nodelet manager.
        clock: measures its clock.
    """

    def __init__(self, master: Master, name: str, is_node: bool) -> None:
        """Prepare; nothing is sent yet."""
        registered = names.join(name, "get_config" if is_node else "list")
        self._poll = ServiceClient(
            master, names.join(name, POLL), Poll, True, reconnects=False, beside=registered
        )
        self._list = ServiceClient(master, registered, NodeletList, True, reconnects=False)
        self._is_node = is_node
        self._seen = 0
        self.is_stock = False
        self.clock = OffsetMeter()

    def ask(self, timeout: float, **request: object) -> PollResponse:
        """Poll it once; raises `PeerTimeout` or ``HostError``.

        The ``request`` has the fields of ``Poll`` except for the last seen change.
        """
        if not self.is_stock:
            began = self.clock.begin()
            try:
                answer = self._poll.call(timeout, seen=self._seen, **request)
            except ServiceFailed as error:
                self._find_reason(error)
            else:
                self._seen = answer.changes.sequence
                if answer.machine.cores:
                    self.clock.add(began, answer.machine.stamp)
                return answer
        found = self._list.call(timeout)
        changes = NodeletChanges(kind=NodeletKind.CPP.value)
        return PollResponse(nodelets=sorted(found.nodelets), changes=changes)

    def close(self) -> None:
        self._poll.close()
        self._list.close()

    def _find_reason(self, error: ServiceFailed) -> None:
        """Raise an error, unless the process is of roscpp, as stock nodelet managers are."""
        refusal = error.__cause__
        if not isinstance(refusal, ConnectionRefused) or "md5sum" in refusal.answer:
            raise error
        if self._is_node or "nonexistent service" not in refusal.answer:
            raise HostError(f"{error}; {OTHER_VERSION}") from error
        self.is_stock = True


class OffsetMeter:
    """Measures how the clock of a process differs from ours; for one thread at a time.

    A process states its time in each answer to a poll. It read its clock between the moments at
    which the request was sent and the answer received, so the middle of these is wrong by half of
    the way there and back at most. As in NTP, the quickest of the latest answers counts.

    Attributes:
        offset: the best estimate of the latest answers.
    """

    def __init__(self) -> None:
        self._samples: collections.deque[ClockOffset] = collections.deque(maxlen=_SAMPLES)
        self.offset = UNKNOWN_OFFSET

    def begin(self) -> tuple[float, float]:
        """Return the moment at which a request is sent."""
        return time.time(), time.monotonic()

    def add(self, began: tuple[float, float], stamp: Any) -> None:
        """Take the time that an answer states, to a request that was sent when it ``began``."""
        sent, at = began
        half = (time.monotonic() - at) / 2
        self._samples.append(ClockOffset(stamp.to_sec() - (sent + half), half))
        self.offset = min(self._samples, key=attrgetter("error"))
