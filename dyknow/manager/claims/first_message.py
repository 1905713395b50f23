"""Says of a stream that no message has come yet, as long as that is so.

A stream can be wired as it should and yet carry nothing. Every change of one makes the question
open again. It is answered by counts that nodelets keep anyway; nobody listens to a topic merely to
find out, so where the publisher cannot be asked, the claim says that it is not known.
"""

from __future__ import annotations

from typing import Callable, Dict, Iterable, Tuple

from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.flows import FlowMeter, Place
from dyknow.manager.graph import Graph
from dyknow.model.streams import NO_MESSAGE, ClaimState

#: Seconds between two counts while a message is waited for.
_PERIOD = 0.25


class FirstMessageMonitor:
    """Waits for the first message of each stream after its last change."""

    def __init__(
        self,
        table: ClaimTable,
        counts: FlowMeter,
        graph: Graph,
        clock: Callable[[], float],
    ) -> None:
        """Wait for nothing yet."""
        self._table = table
        self._counts = counts
        self._graph = graph
        self._clock = clock
        self._since: Dict[str, float] = {}

    def expect(self, claim: Claim, goal: Tuple[str, str], topic: str) -> str:
        """Begin to wait, now that a claim's stream was changed; returns what its detail is to say.

        Args:
            claim: whose stream it is.
            goal: nodelet and out-port that publish it; empty for a topic of ordinary nodes.
            topic: where it is published.
        """
        self._since[claim.claim_id] = self._clock()
        record = self._graph.find(goal[0])
        can_be_asked = record is not None and not record.rewired_by_reload
        if can_be_asked or claim.request.max_silence > 0:
            return NO_MESSAGE
        return f"not known whether messages come: the publisher of {topic} cannot be asked"

    def periods(self, claims: Iterable[Claim]) -> Dict[Place, float]:
        """Tell how often (s) to count where."""
        return {_place(claim): _PERIOD for claim in claims if _waits(claim)}

    def look(self) -> None:
        """Let the claims know whose message has come, by the latest counts."""
        waiting = [claim for claim in self._table.living() if _waits(claim)]
        since = {each.claim_id: self._since.get(each.claim_id, self._clock()) for each in waiting}
        self._since = since
        for claim in waiting:
            if self._counts.has_come(_place(claim), since[claim.claim_id]):
                self._table.change(claim.claim_id, "its first message has come", detail="")


def _waits(claim: Claim) -> bool:
    return claim.state is ClaimState.ACTIVE and claim.detail == NO_MESSAGE


def _place(claim: Claim) -> Place:
    return claim.goal if claim.goal[0] else ("", claim.topic)
