# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The context of the parts of the reconciler, and the lock under which they change claims."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Callable, Iterable, Iterator

from dyknow.locks import turn_lock
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.connector import Connector, Transaction
from dyknow.manager.claims.monitors import StreamMonitor
from dyknow.manager.claims.world import World
from dyknow.manager.manager import Manager


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
        #: Claim that the present request is about; rounds leave it alone.
        self.claim_id = ""
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


@dataclass(frozen=True)
class ClaimContext:
    """The context that the parts of the reconciler share."""

    manager: Manager
    table: ClaimTable
    lock: ClaimLock
    connector: Connector
    monitor: StreamMonitor
    clock: Callable[[], float]
    sleep: Callable[[float], None]
    #: Returns the world of this moment.
    world: Callable[[], World]

    def transaction(self) -> Transaction:
        """Open a transaction that changes nodelets for claims."""
        return Transaction(self.manager, self.connector, self.monitor.is_reachable)
