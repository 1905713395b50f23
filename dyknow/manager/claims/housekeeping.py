"""Clears away what claims leave behind: nodelets that none needs, and second publishers."""

from __future__ import annotations

import logging
from functools import partial
from typing import Callable, Dict, Set, Tuple

from dyknow.errors import DyKnowError
from dyknow.manager.claim import Claim, ClaimState
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.silence import SilenceWatch
from dyknow.manager.claims.transaction import connect
from dyknow.manager.claims.turn import Turn
from dyknow.manager.manager import Manager
from dyknow.manager.model import Record, State
from dyknow.manager.specifications.transformation import OUT

_log = logging.getLogger("rosout.dyknow")

#: Seconds until something that failed is tried again.
_PAUSE = 1.0


class Housekeeping:
    """Works after the claims were mended; never touches what is protected or made by hand."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        turn: Turn,
        silence: SilenceWatch,
        linger: float,
        clock: Callable[[], float],
    ) -> None:
        """Prepare.

        Args:
            manager: destroys nodelets.
            table: the claims.
            turn: knows what a request that waits counts on.
            silence: knows which nodelets do not answer.
            linger: seconds that a nodelet that no claim needs any more is kept.
            clock: seconds, steady.
        """
        self._manager = manager
        self._table = table
        self._turn = turn
        self._silence = silence
        self._linger = linger
        self._clock = clock
        self._idle_since: Dict[str, float] = {}
        self._not_before: Dict[str, float] = {}
        self._replaced: Set[Tuple[str, str, str]] = set()

    def replaced(self, claim: Claim) -> None:
        """Remember who published for a claim and could not be told that it was replaced.

        When it is back, it leaves the topic to its successor.
        """
        for record in self._manager.graph.all():
            if record.name != claim.goal[0] and record.state is not State.RUNNING:
                for port, topic in record.topics.items():
                    if topic == claim.topic:
                        self._replaced.add((record.name, port, topic))

    def clear_topics(self) -> None:
        """Leave one publisher on each claimed topic."""
        goals = {
            claim.topic: claim.goal[0]
            for claim in self._table.living()
            if claim.state is ClaimState.ACTIVE and claim.goal[0]
        }
        self._replaced = {each for each in self._replaced if each[2] in goals}
        for record in self._manager.graph.all():
            if record.state is not State.RUNNING or record.name in self._silence.mute:
                continue
            ports = {
                port.name: ""
                for port in record.ports
                if port.direction == OUT
                and goals.get(port.topic, record.name) != record.name
                and (record.claimed or (record.name, port.name, port.topic) in self._replaced)
            }
            if ports and self._may_try(record.name):
                self._try(record, partial(connect, self._manager, record.name, ports))

    def collect(self) -> None:
        """Destroy what was made for claims and no claim needs, after a while."""
        now = self._clock()
        needed = self._table.needed() | self._turn.reserved
        for record in reversed(self._manager.graph.all()):
            if not record.claimed or record.is_protected or record.name in needed:
                self._idle_since.pop(record.name, None)
                continue
            since = self._idle_since.setdefault(record.name, now)
            linger = 0.0 if record.name in self._silence.unhealthy else self._linger
            reachable = record.state in (State.RUNNING, State.FAILED)
            if now - since >= linger and reachable and self._may_try(record.name):
                self._try(record, partial(self._manager.lifecycle.destroy, record.name))
        present = {record.name for record in self._manager.graph.all()}
        for table in (self._idle_since, self._not_before):
            for name in [name for name in table if name not in present]:
                del table[name]

    def _may_try(self, name: str) -> bool:
        return self._clock() >= self._not_before.get(name, float("-inf"))

    def _try(self, record: Record, action: Callable[[], None]) -> None:
        try:
            action()
        except DyKnowError as error:
            self._not_before[record.name] = self._clock() + _PAUSE
            _log.warning("%s: %s", record.name, error)
