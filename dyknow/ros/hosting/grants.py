# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The context of a manager's peers, and the lease of a process to publish on topics of claims."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any, Callable, Mapping, Sequence

from dyknow.guards import NO_GUARDS, Guards
from dyknow.nodelet.leases import DURATION
from dyknow.ros.wire.master import Master

#: Seconds after our start until which one may hold that was extended while no manager was there.
YOUTH = 10.0
#: Seconds that those hold which we grant at our end, to leave the streams as they are.
PARTING = 8.0


@dataclass(eq=False)
class PeerContext:
    """Shared by the peers of one DyKnow manager.

    Attributes:
        master: the ROS master; its caller is the manager's node.
        guards: restrictions of nodelets.
        uri: address of the manager's node.
        on_change: called when a process is up or has ended, its nodelets have changed, or a lease
            has run out.
        running: time for which this process has run (s): a manager that was stopped asks again
            before it judges.
        subscribe: has a function called with the announcements on a topic.
        producers: by topic of a claim, the nodelet that publishes there; empty for none.
        protected: by process, the nodelets that only this manager may unload.
    """

    master: Master
    guards: Guards = NO_GUARDS
    uri: str = ""
    on_change: Callable[[], object] = lambda: None
    running: Callable[[], float] = time.monotonic
    subscribe: Callable[[str, Callable[[Any], None]], Any] = lambda topic, hear: None
    producers: Mapping[str, str] = field(default_factory=dict)
    protected: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.began = self.running()

    @property
    def is_young(self) -> bool:
        """Whether a lease may still hold that an earlier life of the manager granted."""
        return self.running() - self.began < YOUTH


class Lease:
    """Lets one process publish on topics of claims, for ``DURATION`` from each renewal.

    ``dyknow.nodelet.leases`` is the process's side. While a process may hold a lease, nothing that
    it supplies is replaced, although it does not answer: it has not certainly stopped publishing.
    """

    def __init__(self, context: PeerContext) -> None:
        """Grant none yet."""
        self._context = context
        #: When it was answered last. At first, that if one of an earlier life ended at the latest.
        self._answered: float | None = None
        self._clock = 0.0
        self._duration = DURATION
        self._is_out = False

    @property
    def is_granted(self) -> bool:
        """Whether it was granted; from then on it is renewed."""
        return self._answered is not None

    @property
    def may_be_held(self) -> bool:
        """Whether the process may still hold one, perhaps from an earlier life of the manager."""
        if self._answered is None:
            return self._context.is_young
        return self._context.running() - self._answered < DURATION

    def has_just_run_out(self) -> bool:
        """Whether it runs no more, and did at the last call."""
        was_out, self._is_out = self._is_out, not self.may_be_held
        return self._is_out and not was_out

    def grant(self) -> None:
        """Renew it with each poll from now on."""
        if self._answered is None:
            earlier = self._context.began + YOUTH - DURATION
            self._answered = max(earlier, self._context.running())

    def renewal(self) -> dict[str, object]:
        """Return the fields of a poll that renew it; empty if it is not granted."""
        return self._request(self._context.producers) if self.is_granted else {}

    def part(self) -> None:
        """Renew it for longer from now on: we end, and the next manager may come late."""
        self._duration = PARTING

    def release(self) -> dict[str, object]:
        """Return the fields of a poll that take it back."""
        return self._request({})

    def note_clock(self, clock: float) -> None:
        """Note an answer, with the clock of the process; that of a stock one is always 0."""
        self._clock = clock

    def answered(self, clock: float) -> None:
        """Note the answer to a renewal, with the clock of the process."""
        self.note_clock(clock)
        self._answered = self._context.running()

    def _request(self, producers: Mapping[str, str]) -> dict[str, object]:
        topics = sorted(producers)
        return {
            "uri": self._context.uri,
            "confirmed": self._clock,
            "duration": self._duration,
            "topics": topics,
            "nodelets": [producers[topic] for topic in topics],
        }
