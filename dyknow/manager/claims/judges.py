# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Judges of streams by the limits that a claim may set: a rate, an age.

Of two counts only a range of rates follows. A rate counts as too low if all of the range is, so a
slow network discredits no part. It has to be too low in the first and the last third of a window
as well, so that a pause does not count.

A stream is too old if most of its last messages are, and most of the first and of the last third
of them, so that a hiccup does not count.
"""

from __future__ import annotations

import statistics
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Callable, Mapping, NamedTuple

from dyknow.manager.claim import Claim
from dyknow.manager.claims.flows import SAMPLES, WINDOW, Flow, Place, StreamParts, described
from dyknow.manager.host import Count

#: Messages that are due in a window at the least.
_MESSAGES = 10
#: Messages by which two counts may differ by chance.
_CHANCE = 2
#: A part that sends more than this part of the messages of a sender does not wait for it.
_ALIKE = 1.25
_THIRD = SAMPLES // 3
#: The part of the limit that a place may use up, however much those behind it add.
_FAIR_PART = 0.5
_NEVER = float("-inf")

Flows = Callable[[], Mapping[Place, Flow]]


class Judgement(NamedTuple):
    """The part that keeps a stream from a limit.

    Attributes:
        place: the part.
        needed: the limit that it would have to keep itself.
        what: measured and demanded values, in words.
    """

    place: Place
    needed: float
    what: str


@dataclass
class StreamHistory:
    """A claim's stream since it was changed last.

    Attributes:
        changed: when that was.
        good_from: when it was first found good.
        good_until: when it was last found good.
        usual: the highest rate of each place while it was good (Hz).
    """

    changed: float = _NEVER
    good_from: float | None = None
    good_until: float = 0.0
    usual: dict[Place, float] = field(default_factory=dict)

    def note_good(self, now: float) -> None:
        if self.good_from is None:
            self.good_from = now
        self.good_until = now

    @property
    def served(self) -> float:
        """Seconds for which it was good."""
        return 0.0 if self.good_from is None else self.good_until - self.good_from


class Judge(ABC):
    """Judges streams by one limit, from the flows of their parts."""

    def __init__(self, flows: Flows) -> None:
        self._flows = flows
        self._histories: dict[str, StreamHistory] = {}

    @abstractmethod
    def limit(self, claim: Claim) -> float:
        """The limit of a claim; 0 for none."""

    def window(self, limit: float) -> float:
        """Seconds over which a limit is judged, at least."""
        return WINDOW

    @abstractmethod
    def falls_short(self, place: Place, limit: float) -> bool | None:
        """Whether a place certainly does not keep a limit; None as long as that is not known."""

    @abstractmethod
    def judge(self, parts: StreamParts, now: float) -> Judgement | None:
        """Find the part that keeps a stream from its limit; None if there is none or unknown."""

    def history(self, claim_id: str) -> StreamHistory:
        """Return the history of a claim's stream."""
        return self._histories.setdefault(claim_id, StreamHistory())

    def restart(self, claim_id: str, now: float) -> None:
        """Start again with a stream that was changed."""
        self._histories[claim_id] = StreamHistory(now)

    def keep(self, claim_ids: set[str]) -> None:
        """Forget all other claims."""
        self._histories = {key: each for key, each in self._histories.items() if key in claim_ids}


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


class _Cause(NamedTuple):
    """Whether a sender slows a place down, if that is sure, and its share of the needed rate."""

    is_slow: bool
    is_sure: bool
    share: float


class RateJudge(Judge):
    """Judges by ``min_rate``, in Hz."""

    def limit(self, claim: Claim) -> float:
        return claim.request.min_rate

    def window(self, limit: float) -> float:
        return max(WINDOW, _MESSAGES / limit)

    def falls_short(self, place: Place, limit: float) -> bool | None:
        window = self.window(limit)
        whole = self._span(place, window)
        if whole is None:
            return None
        if whole.messages + 1 >= limit * whole.seconds:
            return False
        third = window / 3
        counts = [each for each in self._flows()[place].counts if each.asked >= whole.first.asked]
        begin = next(each for each in counts if Span(whole.first, each).seconds >= third)
        end = next(each for each in reversed(counts) if Span(each, whole.last).seconds >= third)
        return all(
            each.messages < limit * each.seconds
            for each in (Span(whole.first, begin), Span(end, whole.last))
        )

    def judge(self, parts: StreamParts, now: float) -> Judgement | None:
        limit = self.limit(parts.claim)
        window = self.window(limit)
        is_below = self.falls_short(parts.goal, limit)
        if is_below is False:
            history = self.history(parts.claim.claim_id)
            history.note_good(now)
            for place in parts.topics:
                span = self._span(place, window)
                if span is not None:
                    history.usual[place] = max(span.rate, history.usual.get(place, 0.0))
        bottleneck = self._bottleneck(parts, window) if is_below else None
        if bottleneck is None:
            return None
        place, needed = bottleneck
        whole, own = self._span(parts.goal, window), self._span(place, window)
        assert whole is not None and own is not None
        has = f"the stream has {whole.rate:.3g} Hz, at least {limit:g} Hz are demanded"
        what = f"{described(place)} is too slow: it sends {own.rate:.3g} Hz; {has}"
        return Judgement(place, needed, what)

    def _span(self, place: Place, window: float) -> Span | None:
        """Return the shortest span of a window at least, up to the latest count."""
        flow = self._flows().get(place)
        counts = list(flow.counts) if flow is not None else []
        for first in reversed(counts):
            span = Span(first, counts[-1])
            if span.seconds >= window:
                return span
        return None

    def _bottleneck(self, parts: StreamParts, window: float) -> tuple[Place, float] | None:
        """Follow slow parts upstream to the first one, with the rate that it would need.

        None as long as that is not certain.
        """
        place, needed, seen = parts.goal, self.limit(parts.claim), {parts.goal}
        while True:
            senders = {each for senders in parts.suppliers(place) for each in senders} - seen
            if any(self._span(each, window) is None for each in senders):
                return None
            causes = {each: self._cause(each, place, needed, parts, window) for each in senders}
            slow = sorted((each.share, sender) for sender, each in causes.items() if each.is_slow)
            if not slow:
                return (place, needed) if all(each.is_sure for each in causes.values()) else None
            _, sender = slow[0]
            needed *= self._ratio(sender, place, parts)
            place = sender
            seen.add(place)

    def _cause(
        self, sender: Place, place: Place, needed: float, parts: StreamParts, window: float
    ) -> _Cause:
        """Tell whether a place is too slow since its sender is.

        A place that kept up with a sender that is too slow is not to blame. Neither is a sender
        that the place did not keep up with, or that it never waited for. Nor is one that is as
        fast as while the stream was fast enough, but that leaves the cause open.
        """
        given, sent = self._span(sender, window), self._span(place, window)
        assert given is not None and sent is not None
        usual, _ = known = self._known(sender, place, parts)
        ratio, is_known = self._ratio(sender, place, parts), all(known)
        changes_alone = not given.messages and given.last.latched
        is_ahead = not is_known and sent.messages > _ALIKE * given.messages + _CHANCE
        is_behind = (sent.messages + _CHANCE) * ratio < given.messages
        is_as_ever = is_known and given.messages + 1 >= usual * given.seconds
        share = given.rate / (needed * ratio)
        if changes_alone or is_ahead or is_behind:
            return _Cause(False, True, share)
        is_slow = not is_as_ever and (given.messages + 1) / ratio + 1 < needed * given.seconds
        return _Cause(is_slow, is_slow, share)

    def _ratio(self, sender: Place, place: Place, parts: StreamParts) -> float:
        """Messages of a sender for each one of a place; 1 where that was never seen."""
        given, sent = self._known(sender, place, parts)
        return given / sent if given and sent else 1.0

    def _known(self, sender: Place, place: Place, parts: StreamParts) -> tuple[float, float]:
        """Usual rates of both; 0 where there was no message while the stream was fast enough."""
        usual = self.history(parts.claim.claim_id).usual
        return usual.get(sender, 0.0), usual.get(place, 0.0)


class AgeJudge(Judge):
    """Judges by ``max_age``, in seconds."""

    def __init__(self, flows: Flows, stated_latency: Callable[[Place], float]) -> None:
        super().__init__(flows)
        self._stated_latency = stated_latency

    def limit(self, claim: Claim) -> float:
        return claim.request.max_age

    def is_unknown(self, place: Place) -> bool:
        """Whether a place has sent messages whose age is unknown."""
        flow = self._flows().get(place)
        return flow is not None and len(flow.samples) == SAMPLES and not self._ages(place)

    def falls_short(self, place: Place, limit: float) -> bool | None:
        return _are_above(self._ages(place), limit)

    def judge(self, parts: StreamParts, now: float) -> Judgement | None:
        history, limit = self.history(parts.claim.claim_id), self.limit(parts.claim)
        since = history.changed
        ages = self._ages(parts.goal, since)
        is_late = _are_above(ages, limit)
        if is_late is False:
            history.note_good(now)
        if not is_late:
            return None
        place, added = self._bottleneck(parts, since)
        age = statistics.median(ages)
        behind = age - statistics.median(self._ages(place, since))
        needed = max(limit - behind, _FAIR_PART * limit)
        what = f"{described(place)} delays the stream by {added:.3g} s"
        return Judgement(
            place, needed, f"{what}: it is {age:.3g} s old, at most {limit:g} s was asked for"
        )

    def _ages(self, place: Place, since: float = _NEVER) -> list[float]:
        """Known ages of the latest messages of a place that were sent after a moment."""
        flow = self._flows().get(place)
        samples = flow.samples if flow is not None else ()
        return [each.age for each in samples if each.age is not None and each.asked >= since]

    def _bottleneck(self, parts: StreamParts, since: float) -> tuple[Place, float]:
        """Follow the oldest messages upstream to the part that adds most to its stated latency."""
        place, seen = parts.goal, {parts.goal}
        found: list[tuple[float, int, Place, float]] = []
        while True:
            ages = self._ages(place, since)
            age = statistics.median(ages)
            senders = self._stamped_senders(place, parts, since, seen)
            # A place that sends younger messages than it receives has another stamp for them.
            typical = {
                each: received for each, received in senders.items() if received <= max(ages)
            }
            base = max(sorted(typical), key=lambda each: typical[each], default=None)
            added = age if base is None else age - min(age, typical[base])
            found.append((added - self._stated_latency(place), len(found), place, added))
            if base is None:
                _, _, bottleneck, seconds = max(found)
                return bottleneck, seconds
            place = base

    def _stamped_senders(
        self, place: Place, parts: StreamParts, since: float, seen: set[Place]
    ) -> dict[Place, float]:
        """Typical ages of the suppliers of a place, or of theirs if they have no stamps."""
        found: dict[Place, float] = {}
        waiting = [place]
        while waiting:
            for each in [one for senders in parts.suppliers(waiting.pop()) for one in senders]:
                if each in seen:
                    continue
                seen.add(each)
                ages = self._ages(each, since)
                if ages:
                    found[each] = statistics.median(ages)
                else:
                    waiting.append(each)
        return found


def _are_above(ages: list[float], limit: float) -> bool | None:
    """Whether most of all ages, and of the first and last third, are above a limit."""
    if len(ages) < SAMPLES:
        return None
    parts = (ages, ages[:_THIRD], ages[-_THIRD:])
    return all(statistics.median(each) > limit for each in parts)
