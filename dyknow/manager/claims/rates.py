# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The rates at which the parts of streams send, over windows of time, and who slows a stream down.

A count holds for some moment between its question and its answer, so of two counts only a range of
rates follows. A rate counts as too low if all of the range is: a slow network blames nobody. It
has to be too low in the first and the last third of a window as well: a pause is no slowness.
"""

from __future__ import annotations

import collections
from typing import Deque, Dict, Iterable, Mapping, NamedTuple, Optional, Sequence, Tuple

from dyknow.manager.claim import Claim
from dyknow.manager.claims.flows import UNANSWERED, Place
from dyknow.manager.claims.judges import Judge, Judgement, kept
from dyknow.manager.claims.stream_parts import StreamParts, described
from dyknow.manager.host import Count

#: Seconds that a part may take to begin, before its rate is judged.
GRACE = 2.0
#: Seconds over which a rate is taken, and the messages that are due in it at the least.
_WINDOW = 4.5
_MESSAGES = 10
#: Messages by which two counts may differ by chance.
_CHANCE = 2
#: A part that sends more than this part of what it receives from a feeder does not wait for it.
_ALIKE = 1.25


class _Cause(NamedTuple):
    """Whether a feeder slows a place down, if that is sure, and its share of what is needed."""

    is_slow: bool
    is_sure: bool
    share: float


class Span(NamedTuple):
    """Two counts of one place."""

    first: Count
    last: Count

    @property
    def messages(self) -> int:
        """Messages between the two."""
        return self.last.messages - self.first.messages

    @property
    def seconds(self) -> float:
        """Seconds that certainly lie between them."""
        return self.last.asked - self.first.answered

    @property
    def rate(self) -> float:
        """About how many messages a second there were, in Hz."""
        return self.messages / self.seconds


class RateJudge(Judge):
    """Judges by ``min_rate``, from the latest counts of each place."""

    def __init__(self) -> None:
        """Begin without a count."""
        super().__init__()
        self._counts: Dict[Place, Deque[Count]] = {}
        self._began: Dict[Place, float] = {}
        #: The highest rate of each place, by claim, since its stream was changed last.
        self._usual: Dict[str, Dict[Place, float]] = {}

    def limit(self, claim: Claim) -> float:
        """Hz that a claim demands."""
        return claim.request.min_rate

    def window(self, limit: float) -> float:
        """Seconds over which a rate is judged that has to be at least so high."""
        return max(_WINDOW, _MESSAGES / limit)

    def add(self, counted: Mapping[Place, Count], windows: Mapping[Place, float]) -> None:
        """Take counts in."""
        for place in [place for place in self._counts if place not in windows]:
            del self._counts[place]
        for place in windows.keys() & counted.keys():
            self._add(place, counted[place], windows[place])

    def _add(self, place: Place, count: Count, window: float) -> None:
        counts = self._counts.setdefault(place, collections.deque())
        if counts and (
            count.messages < counts[-1].messages or count.asked - counts[-1].answered > UNANSWERED
        ):
            counts.clear()  # it was loaded again, or stopped
        if not counts:
            self._began[place] = count.answered
        elif count.messages == counts[0].messages and count.asked - self._began[place] < GRACE:
            counts.clear()  # it has not begun to send
        counts.append(count)
        while len(counts) > 2 and count.asked - counts[1].answered >= window:
            counts.popleft()

    def restart(self, claim_id: str, names: Iterable[str], now: float) -> None:
        """Begin again with nodelets that were connected elsewhere for a claim."""
        super().restart(claim_id, names, now)
        names = set(names)
        if names:
            self._usual.pop(claim_id, None)
            for place in [place for place in self._counts if place[0] in names]:
                del self._counts[place]

    def keep(self, claim_ids: Iterable[str]) -> None:
        """Forget all other claims."""
        super().keep(claim_ids)
        self._usual = kept(self._usual, claim_ids)

    def falls_short(self, place: Place, limit: float) -> Optional[bool]:
        """Whether a place certainly sends less than a rate; None as long as that is not known."""
        window = self.window(limit)
        whole = self._span(place, window)
        if whole is None:
            return None
        if whole.messages + 1 >= limit * whole.seconds:
            return False
        third = window / 3
        counts = [each for each in self._counts[place] if each.asked >= whole.first.asked]
        begin = next(each for each in counts if Span(whole.first, each).seconds >= third)
        end = next(each for each in reversed(counts) if Span(each, whole.last).seconds >= third)
        return all(
            each.messages < limit * each.seconds
            for each in (Span(whole.first, begin), Span(end, whole.last))
        )

    def judge(self, parts: StreamParts, now: float) -> Optional[Judgement]:
        """Find out what slows a stream down; None if it is fast enough or that is not known."""
        limit = self.limit(parts.claim)
        window = self.window(limit)
        is_below = self.falls_short(parts.goal, limit)
        if is_below is None:
            return None
        if not is_below:
            self._note_good(parts.claim.claim_id, now)
            usual = self._usual.setdefault(parts.claim.claim_id, {})
            for place in parts.topics:
                span = self._span(place, window)
                if span is not None:
                    usual[place] = max(span.rate, usual.get(place, 0.0))
            return None
        culprit = self._culprit(parts, window)
        if culprit is None:
            return None
        place, needed = culprit
        whole, own = self._span(parts.goal, window), self._span(place, window)
        assert whole is not None and own is not None
        has = f"the stream has {whole.rate:.3g} Hz, at least {limit:g} Hz are demanded"
        what = f"{described(place)} is too slow: it sends {own.rate:.3g} Hz; {has}"
        return Judgement(place, needed, what)

    def _span(self, place: Place, window: float) -> Optional[Span]:
        """Return the shortest span of a window at least, up to the latest count."""
        counts: Sequence[Count] = self._counts.get(place, ())
        for first in reversed(counts):
            span = Span(first, counts[-1])
            if span.seconds >= window:
                return span
        return None

    def _culprit(self, parts: StreamParts, window: float) -> Optional[Tuple[Place, float]]:
        """Follow what is too slow to where it begins; None as long as that is not certain.

        Returns:
            Who is to blame, and the rate that it would have to have.
        """
        place, needed, seen = parts.goal, parts.claim.request.min_rate, {parts.goal}
        while True:
            feeders = {each for senders in parts.feeders(place) for each in senders} - seen
            if any(self._span(each, window) is None for each in feeders):
                return None
            causes = {each: self._cause(each, place, needed, parts, window) for each in feeders}
            slow = sorted((each.share, feeder) for feeder, each in causes.items() if each.is_slow)
            if not slow:
                return (place, needed) if all(each.is_sure for each in causes.values()) else None
            _, feeder = slow[0]
            needed *= self._ratio(feeder, place, parts)
            place = feeder
            seen.add(place)

    def _cause(
        self, feeder: Place, place: Place, needed: float, parts: StreamParts, window: float
    ) -> _Cause:
        """Tell whether a place is too slow since its feeder is.

        A place that kept up with a feeder that is too slow is not to blame. Neither is a feeder
        that the place did not keep up with, or that it never waited for. Nor is one that is as
        fast as while the stream was fast enough, but that does not say who is.
        """
        given, sent = self._span(feeder, window), self._span(place, window)
        assert given is not None and sent is not None
        usual, _ = known = self._known(feeder, place, parts)
        ratio, is_known = self._ratio(feeder, place, parts), all(known)
        changes_alone = not given.messages and given.last.latched
        is_ahead = not is_known and sent.messages > _ALIKE * given.messages + _CHANCE
        is_behind = (sent.messages + _CHANCE) * ratio < given.messages
        is_as_ever = is_known and given.messages + 1 >= usual * given.seconds
        share = given.rate / (needed * ratio)
        if changes_alone or is_ahead or is_behind:
            return _Cause(False, True, share)
        is_slow = not is_as_ever and (given.messages + 1) / ratio + 1 < needed * given.seconds
        return _Cause(is_slow, is_slow, share)

    def _ratio(self, feeder: Place, place: Place, parts: StreamParts) -> float:
        """Messages of a feeder for each one of a place; 1 where that was never seen."""
        given, sent = self._known(feeder, place, parts)
        return given / sent if given and sent else 1.0

    def _known(self, feeder: Place, place: Place, parts: StreamParts) -> Tuple[float, float]:
        """Usual rates of both; 0 where there was no message while the stream was fast enough."""
        usual = self._usual.get(parts.claim.claim_id, {})
        return usual.get(feeder, 0.0), usual.get(place, 0.0)
