"""Whose turn it is to change claims.

Requests of clients come one at a time; in between, the reconciler makes its rounds. A request that
waits for a nodelet to come up lets rounds pass meanwhile: streams that break are mended although
somebody else's takes long to be made. A round lets nobody pass, since a request that came in
between could make a second time what the round is about to make.
"""

from __future__ import annotations

import contextlib
from typing import Iterable, Iterator, Set

from dyknow.locks import turn_lock


class ClaimLock:
    """A lock with an order of precedence."""

    def __init__(self) -> None:
        """Nobody has the turn."""
        self._requests = turn_lock("claim request")
        self._work = turn_lock("claim work")
        self._may_pause = False
        #: Claim that the present request is about; rounds keep off it.
        self.claim_id = ""
        #: Nodelets that the present request counts on; rounds do not clear them away.
        self.reserved: Set[str] = set()

    @contextlib.contextmanager
    def request(self, claim_id: str = "") -> Iterator[None]:
        """Work on a request, about a claim that is there or about a new one."""
        with self._requests, self._work:
            self.claim_id = claim_id
            self._may_pause = True
            try:
                yield
            finally:
                self._may_pause = False
                self.claim_id = ""
                self.reserved.clear()

    @contextlib.contextmanager
    def round(self) -> Iterator[None]:
        """Look at all claims, and mend them."""
        with self._work:
            yield

    def reserve(self, names: Iterable[str]) -> None:
        """Keep nodelets from being cleared away as long as the present request takes.

        Nothing happens in a round, which clears away only what nobody needs at its end.
        """
        if self._may_pause:
            self.reserved.update(names)

    @contextlib.contextmanager
    def pause(self) -> Iterator[None]:
        """Wait for something: rounds can pass meanwhile, if it is a request that waits.

        Called by whoever has the lock, who has to expect that afterwards nodelets have other
        topics, or are gone.
        """
        if not self._may_pause:
            yield
            return
        self._may_pause = False
        self._work.release()
        try:
            yield
        finally:
            self._work.acquire()
            self._may_pause = True
