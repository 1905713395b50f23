# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What there is to each limit that a claim may set for its stream: who judges by it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Dict, Iterable, Mapping, NamedTuple, Optional, Tuple, TypeVar

from dyknow.manager.claim import Claim
from dyknow.manager.claims.flows import Place
from dyknow.manager.claims.stream_parts import StreamParts
from dyknow.manager.host import Count

_Value = TypeVar("_Value")


class Judgement(NamedTuple):
    """What keeps a stream from what is demanded.

    Attributes:
        place: who is to blame.
        needed: the limit that it would have to keep itself.
        what: measured and demanded values, in words.
    """

    place: Place
    needed: float
    what: str


class Judge(ABC):
    """Judges streams by one limit, from counts of their parts."""

    def __init__(self) -> None:
        """Begin without a count."""
        #: When the stream of a claim was first and last found good since it was changed.
        self._good: Dict[str, Tuple[float, float]] = {}

    @abstractmethod
    def limit(self, claim: Claim) -> float:
        """What a claim demands; 0 for nothing."""

    @abstractmethod
    def window(self, limit: float) -> float:
        """Seconds over which a limit is judged."""

    @abstractmethod
    def add(self, counted: Mapping[Place, Count], windows: Mapping[Place, float]) -> None:
        """Take counts in.

        Args:
            counted: what was counted just now.
            windows: seconds over which places are judged; others are forgotten.
        """

    @abstractmethod
    def falls_short(self, place: Place, limit: float) -> Optional[bool]:
        """Whether a place certainly does not keep a limit; None as long as that is not known."""

    @abstractmethod
    def judge(self, parts: StreamParts, now: float) -> Optional[Judgement]:
        """Find out what keeps a stream from its limit; None if nothing or that is not known."""

    def restart(self, claim_id: str, names: Iterable[str], now: float) -> None:
        """Begin again with a stream that was changed.

        Args:
            claim_id: whose stream it is.
            names: its nodelets that were connected elsewhere.
            now: steady time.
        """
        if names:
            self._good.pop(claim_id, None)

    def keep(self, claim_ids: Iterable[str]) -> None:
        """Forget all other claims."""
        self._good = kept(self._good, claim_ids)

    def served(self, claim_id: str) -> float:
        """Seconds for which a claim's stream was good since it was changed last."""
        first, last = self._good.get(claim_id, (0.0, 0.0))
        return last - first

    def _note_good(self, claim_id: str, now: float) -> None:
        first, _ = self._good.get(claim_id, (now, now))
        self._good[claim_id] = (first, now)


def kept(by_claim: Mapping[str, _Value], claim_ids: Iterable[str]) -> Dict[str, _Value]:
    """Return what there is about some claims."""
    ids = set(claim_ids)
    return {claim_id: each for claim_id, each in by_claim.items() if claim_id in ids}
