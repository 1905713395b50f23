# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The claims: written to disk first, then shown; and the lock of those who work on them.

A claim that has ended stays ended, even if a repair that was still at work writes afterwards, and
a lease that was renewed meanwhile stays renewed. Events come in the order of the changes.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from functools import partial
from typing import Any, Callable, Iterable, Iterator

from dyknow.errors import UnknownClaim
from dyknow.locks import state_lock, turn_lock
from dyknow.manager.claim import Claim, ClaimEvent, Moment
from dyknow.manager.store import Store
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.periodic import EventQueue

#: Seconds for which this process must have stood still, for leases to outlast it.
_PAUSE = 1.0
#: Seconds that clients have then to renew their leases.
_PARDON = 3.0
#: Seconds that they have after a start of the manager, which answers late at first.
_START = 10.0
#: Ended claims that are still shown.
_ENDED_KEPT = 100


class ClaimTable:
    """Claims by id; safe from any thread."""

    def __init__(
        self,
        store: Store,
        clock: Callable[[], float],
        running: Callable[[], float],
        on_event: Callable[[ClaimEvent], object] = lambda event: None,
    ) -> None:
        """Take up the claims that the store has.

        ``clock`` counts steady seconds, ``running`` only those for which this process has run;
        ``on_event`` is called with every change, in their order, outside the locks.
        """
        self._running = running
        self._paused = clock() - running()
        self._store = store
        self._clock = clock
        self._turn = turn_lock("claims on disk")
        self._state_lock = state_lock("claims")
        read = partial(Claim.from_body, now=Moment.now(clock))
        self._claims: dict[str, Claim] = store.read("claims", read)
        self._pardon_until = running() + _START if self._claims else 0.0
        #: The claims that have not ended, by id; replaced as a whole by every change.
        self.living: tuple[Claim, ...] = ()
        self._sort()
        self.events: EventQueue[ClaimEvent] = EventQueue(on_event)

    def all(self) -> list[Claim]:
        """Return every claim, those that ended lately included, by id."""
        with self._state_lock:
            return [self._claims[claim_id] for claim_id in sorted(self._claims)]

    def together(self, claim: Claim) -> list[Claim]:
        """Return the claims whose clients listen where this one's does; this one first."""
        others = [
            e for e in self.living if e.topic == claim.topic and e.claim_id != claim.claim_id
        ]
        return [claim, *others] if claim.topic else [claim]

    def find(self, claim_id: str) -> Claim | None:
        """Return a claim that has not ended, or None."""
        with self._state_lock:
            claim = self._claims.get(claim_id)
        return None if claim is None or claim.state.ended else claim

    def get(self, claim_id: str) -> Claim:
        """Return a claim that has not ended; else raise UnknownClaim."""
        with self._state_lock:
            claim = self._claims.get(claim_id)
        if claim is None or claim.state.ended:
            raise UnknownClaim(claim_id, "" if claim is None else claim.state.name.lower())
        return claim

    def same(self, request: StreamRequest) -> Claim | None:
        """Return the living claim of an earlier copy of a request; None without a request id."""
        if not request.request_id:
            return None
        wanted = (request.client_id, request.request_id)
        for claim in self.living:
            if (claim.request.client_id, claim.request.request_id) == wanted:
                return claim
        return None

    def add(self, claim: Claim, reason: str) -> Claim:
        """Keep a new claim; its lease begins."""
        lease = claim.request.lease
        claim = replace(claim, deadline=self._clock() + lease if lease > 0 else None)
        with self._turn:
            self._write(claim)
            self.events.add(ClaimEvent(None, claim, reason))
        self.events.deliver()
        return claim

    def change(self, claim_id: str, reason: str, **changes: Any) -> Claim | None:
        """Change a claim and return it; None if it has ended."""
        with self._turn:
            before = self.find(claim_id)
            if before is None:
                return None
            after = replace(before, **changes)
            if after != before:
                self._write(after)
                self.events.add(ClaimEvent(before, after, reason))
        self.events.deliver()
        return after

    def report(self, claim_id: str, news: str) -> None:
        """Send an event about a claim that does not change it."""
        with self._turn:
            claim = self.find(claim_id)
            if claim is not None:
                self.events.add(ClaimEvent(claim, claim, news))
        self.events.deliver()

    def renew(self, claim_id: str, lease: float) -> Claim:
        """Let a claim live for so many seconds from now (0: until it is released)."""
        with self._turn:
            deadline = self._clock() + lease if lease > 0 else None
            claim = replace(self.get(claim_id), deadline=deadline)
            self._write(claim)
        return claim

    def end(
        self, claim_id: str, state: ClaimState, reason: str, late_at: float | None = None
    ) -> None:
        """End a claim; one that has ended, or is unknown, is left as it is.

        With ``late_at`` one whose lease is not over by then is left as well.
        """
        with self._turn:
            before = self.find(claim_id)
            if before is None or (late_at is not None and not _is_late(before, late_at)):
                return
            after = replace(before, state=state, detail=reason)
            self._store.write({("claims", claim_id): None})
            with self._state_lock:
                self._claims.pop(claim_id)
                self._claims[claim_id] = after  # now the last one to be forgotten
                ended = [key for key, claim in self._claims.items() if claim.state.ended]
                for key in ended[: max(0, len(ended) - _ENDED_KEPT)]:
                    del self._claims[key]
                self._sort()
            self.events.add(ClaimEvent(before, after, reason))
        self.events.deliver()

    def expire_late(self) -> None:
        """End the claims whose lease is over; after a pause or a start renewals come first."""
        now, running = self._clock(), self._running()
        paused = now - running
        if paused - self._paused > _PAUSE:
            self._pardon_until = max(self._pardon_until, running + _PARDON)
        self._paused = paused
        if running < self._pardon_until:
            return
        for claim in self.living:
            if _is_late(claim, now):  # a renewal may come first
                self.end(claim.claim_id, ClaimState.EXPIRED, "its lease ended", now)

    def _write(self, claim: Claim) -> None:
        self._store.write({("claims", claim.claim_id): claim.body(Moment.now(self._clock))})
        with self._state_lock:
            self._claims[claim.claim_id] = claim
            self._sort()

    def _sort(self) -> None:
        """Find the claims that have not ended; with the lock of the state held."""
        claims = sorted(self._claims.items())
        self.living = tuple([claim for _, claim in claims if not claim.state.ended])


def _is_late(claim: Claim, now: float) -> bool:
    return claim.deadline is not None and now >= claim.deadline


class ClaimLock:
    """Two turns with an order of precedence.

    Requests of clients come one at a time; in between, the reconciler makes its rounds. A request
    that waits for a plan, or for a nodelet to come up, lets rounds pass meanwhile: streams that
    break are repaired although another one takes long to be made. A round lets no request pass,
    which could make a second stream of those that the round is about to make.
    """

    def __init__(self) -> None:
        self._requests = turn_lock("claim request")
        self._work = turn_lock("claim work")
        self._may_pause = False
        self.claim_id = ""  # claim that the present request is about; rounds leave it alone
        #: Nodelets that the present request counts on; rounds do not destroy them.
        self.reserved: set[str] = set()

    @contextlib.contextmanager
    def request(self, claim_id: str = "") -> Iterator[None]:
        """Work on a request, about an existing claim or, without an id, about a new one."""
        with self._requests, self.reading():
            self.claim_id = claim_id
            try:
                yield
            finally:
                self.claim_id = ""
                self.reserved.clear()

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """Read the world for a plan; a computation in a pause holds up no other work."""
        with self._work:
            self._may_pause = True
            try:
                yield
            finally:
                self._may_pause = False

    @contextlib.contextmanager
    def round(self) -> Iterator[None]:
        """Work on all claims."""
        with self._work:
            yield

    def reserve(self, names: Iterable[str]) -> None:
        """Keep nodelets from being destroyed until the present request is done.

        A round destroys nodelets only at its end.
        """
        if self._may_pause:
            self.reserved.update(names)

    def free(self) -> None:
        """Reserve nothing for the present request any more."""
        if self._may_pause:
            self.reserved.clear()

    @contextlib.contextmanager
    def pause(self) -> Iterator[bool]:
        """Let rounds pass while a request waits; returns whether they may, not so in a round.

        Called with the lock held. Afterwards nodelets may have other topics, or be gone.
        """
        if not self._may_pause:
            yield False
            return
        self._may_pause = False
        self._work.release()
        try:
            yield True
        finally:
            self._work.acquire()
            self._may_pause = True
