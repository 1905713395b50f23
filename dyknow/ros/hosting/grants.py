# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Grants to a process: the lease to publish on topics of claims, and the guards."""

from __future__ import annotations

import contextlib
import logging
import time
from dataclasses import dataclass, field
from typing import Any, Callable, Mapping, Sequence

from dyknow import names
from dyknow.errors import HostError, PeerTimeout
from dyknow.guards import NO_GUARDS, Guards
from dyknow.manager.host import ProcessState
from dyknow.ros.nodelets.guard_parameters import guards_key, to_parameter
from dyknow.ros.wire.master import Master

#: Seconds that a lease holds.
DURATION = 2.0
#: Seconds between two checks that the guards are still there.
GUARDS_PERIOD = 1.0

_log = logging.getLogger("rosout.dyknow")


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
        return self.running() - self.began < DURATION


class Lease:
    """Lets one process publish on topics of claims, for ``DURATION`` from each renewal.

    ``dyknow.nodelet.leases`` is the process's side. While a process may hold a lease, nothing that
    it supplies is replaced, although it does not answer: it has not certainly stopped publishing.
    """

    def __init__(self, context: PeerContext) -> None:
        """Grant none yet."""
        self._context = context
        #: When it was answered last, or granted: an earlier life may have done that just before.
        self._answered: float | None = None
        self._clock = 0.0
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
            self._answered = self._context.running()

    def renewal(self) -> dict[str, object]:
        """Return the fields of a poll that renew it; empty if it is not granted."""
        return self._request(self._context.producers) if self.is_granted else {}

    def release(self) -> dict[str, object]:
        """Return the fields of a poll that take it back."""
        return self._request({})

    def answered(self, clock: float) -> None:
        """Note an answer, with the clock of the process."""
        self._clock = clock
        if self._answered is not None:
            self._answered = self._context.running()

    def forget_clock(self) -> None:
        """Let it begin anew with another process, which has another clock."""
        self._clock = 0.0

    def _request(self, producers: Mapping[str, str]) -> dict[str, object]:
        topics = sorted(producers)
        return {
            "uri": self._context.uri,
            "confirmed": self._clock,
            "duration": DURATION,
            "topics": topics,
            "nodelets": [producers[topic] for topic in topics],
        }


class Guarding:
    """Whether one process has the guards, which are a parameter of its own at the master.

    With them go the names of the nodelets that only this DyKnow manager may unload
    (``dyknow.ros.nodelets.guard_parameters``). Guards that are missing, or were changed by another
    program, are handed over again. Stock nodelet managers enforce nothing, and get none. Every
    hand-over is within the host's turn.
    """

    def __init__(self, context: PeerContext, name: str) -> None:
        self._context = context
        self._name = name
        self._key = names.join(name, guards_key(context.master.caller))
        #: Incarnation that has the guards, and the nodelets named to it.
        self._done: object = None
        self._seen = 0.0
        self._trouble = ""

    def hand_over(self, state: ProcessState) -> None:
        """Hand them over, unless the process has them; a failure is logged, and tried again."""
        if not state.alive or not state.rewirable:
            return
        now = self._context.running()
        protected = tuple(sorted(self._context.protected.get(self._name, ())))
        is_known = self._done == (state.incarnation, protected)
        if is_known and now - self._seen < GUARDS_PERIOD:
            return
        self._seen = now
        parameter = to_parameter(self._context.guards, protected)
        try:
            if is_known and self._present() == parameter:
                return
            self._context.master.ask("setParam", self._key, parameter)
        except (PeerTimeout, LookupError) as error:
            is_news, self._trouble = not self._trouble, str(error)
            if is_news:
                _log.warning("%s cannot be given the guards yet: %s", self._name, error)
            return
        self._done = (state.incarnation, protected)
        had_failed, self._trouble = bool(self._trouble), ""
        if had_failed:
            _log.info("%s has the guards now", self._name)
        elif is_known:
            _log.warning("%s: the guards were missing or changed, and are set again", self._name)

    def check(self) -> None:
        """Raise ``HostError`` if they could not be handed over: nothing may be loaded then."""
        if self._trouble:
            raise HostError(
                f"nodelet manager '{self._name}' does not have the guards yet: {self._trouble}"
            )

    def withdraw(self) -> None:
        """Remove them, as far as the master answers."""
        with contextlib.suppress(LookupError, PeerTimeout):
            self._context.master.ask("deleteParam", self._key)

    def _present(self) -> object:
        try:
            return self._context.master.ask("getParam", self._key)
        except LookupError:
            return None
