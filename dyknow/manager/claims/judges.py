# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Judges of streams by the limits that a claim may set: a rate, an age.

A count holds for some moment between its question and its answer, so of two counts only a range of
rates follows. A rate counts as too low if all of the range is: a slow network discredits no part.
It has to be too low in the first and the last third of a window as well, so that a pause does not
count.

Of each place the age of one message is measured for each count. A stream is too old if most of the
last messages are, and most of the first and of the last third of them, so that a hiccup does not
count.
"""

from __future__ import annotations

import collections
import statistics
from abc import ABC, abstractmethod
from typing import (
    Callable,
    Deque,
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
)

from dyknow.manager.claim import Claim
from dyknow.manager.claims.flows import UNANSWERED, Place, StreamParts, described
from dyknow.manager.host import Count

_Value = TypeVar("_Value")
#: Seconds that a part may take to begin, before its rate is judged.
GRACE = 2.0
#: Seconds over which a rate is taken, and the messages that are due in it at the least.
_WINDOW = 4.5
_MESSAGES = 10
#: Messages by which two counts may differ by chance.
_CHANCE = 2
#: A part that sends more than this part of the messages of a sender does not wait for it.
_ALIKE = 1.25
#: Messages that are judged together, and seconds that lie between two of them at the least.
_SAMPLES = 9
_THIRD = _SAMPLES // 3
_SPACING = 0.4
#: The part of the limit that a place may use up, however much those behind it add.
_FAIR_PART = 0.5
_NEVER = float("-inf")


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


class Judge(ABC):
    """Judges streams by one limit, from counts of their parts."""

    def __init__(self) -> None:
        #: When the stream of a claim was first and last found good since it was changed.
        self._good: Dict[str, Tuple[float, float]] = {}

    @abstractmethod
    def limit(self, claim: Claim) -> float:
        """The limit of a claim; 0 for none."""

    @abstractmethod
    def window(self, limit: float) -> float:
        """Seconds over which a limit is judged."""

    @abstractmethod
    def add(self, counted: Mapping[Place, Count], windows: Mapping[Place, float]) -> None:
        """Take counts in.

        Args:
            counted: the latest counts.
            windows: seconds over which places are judged; the other places are forgotten.
        """

    @abstractmethod
    def falls_short(self, place: Place, limit: float) -> Optional[bool]:
        """Whether a place certainly does not keep a limit; None as long as that is not known."""

    @abstractmethod
    def judge(self, parts: StreamParts, now: float) -> Optional[Judgement]:
        """Find the part that keeps a stream from its limit; None if there is none or unknown."""

    def restart(self, claim_id: str, names: Iterable[str], now: float) -> None:
        """Start again with a stream that was changed.

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


class _Cause(NamedTuple):
    """Whether a sender slows a place down, if that is sure, and its share of the needed rate."""

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
        """Start again with nodelets that were connected elsewhere for a claim."""
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
        """Find the part that slows a stream down; None if there is none or it is unknown."""
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
        bottleneck = self._bottleneck(parts, window)
        if bottleneck is None:
            return None
        place, needed = bottleneck
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

    def _bottleneck(self, parts: StreamParts, window: float) -> Optional[Tuple[Place, float]]:
        """Follow slow parts upstream to the first one; None as long as that is not certain.

        Returns:
            The first slow part, and the rate that it would need.
        """
        place, needed, seen = parts.goal, parts.claim.request.min_rate, {parts.goal}
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
        fast as while the stream was fast enough, but that does not say who is.
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

    def _known(self, sender: Place, place: Place, parts: StreamParts) -> Tuple[float, float]:
        """Usual rates of both; 0 where there was no message while the stream was fast enough."""
        usual = self._usual.get(parts.claim.claim_id, {})
        return usual.get(sender, 0.0), usual.get(place, 0.0)


class _Sample(NamedTuple):
    """The age of a message in seconds, None if not known, and the time of its query."""

    age: Optional[float]
    asked: float


class AgeJudge(Judge):
    """Judges by ``max_age``, from the latest messages of each place."""

    def __init__(self, stated_latency: Callable[[Place], float]) -> None:
        super().__init__()
        self._stated_latency = stated_latency
        self._counts: Dict[Place, Count] = {}
        self._samples: Dict[Place, Deque[_Sample]] = {}
        #: When the stream of a claim was changed last.
        self._changed: Dict[str, float] = {}

    def limit(self, claim: Claim) -> float:
        """Seconds that a claim's messages may be old."""
        return claim.request.max_age

    def window(self, limit: float) -> float:
        """Seconds over which an age is judged, at least."""
        return _WINDOW

    def add(self, counted: Mapping[Place, Count], windows: Mapping[Place, float]) -> None:
        """Take a sample of each place that has sent messages since its last one."""
        for place in [place for place in self._counts if place not in windows]:
            del self._counts[place]
            self._samples.pop(place, None)
        for place in windows.keys() & counted.keys():
            count, last = counted[place], self._counts.get(place)
            if last is None or count.messages < last.messages:  # the nodelet was loaded again
                self._counts[place] = count
                self._samples[place] = collections.deque(maxlen=_SAMPLES)
            elif count.messages > last.messages and count.asked - last.asked >= _SPACING:
                self._counts[place] = count
                self._samples[place].append(_Sample(count.age, last.answered))

    def restart(self, claim_id: str, names: Iterable[str], now: float) -> None:
        """Judge a claim's stream only by messages that are sent after now."""
        super().restart(claim_id, names, now)
        if names:
            self._changed[claim_id] = now

    def keep(self, claim_ids: Iterable[str]) -> None:
        """Forget all other claims."""
        super().keep(claim_ids)
        self._changed = kept(self._changed, claim_ids)

    def is_unknown(self, place: Place) -> bool:
        """Whether a place has sent messages whose age is unknown."""
        samples = self._samples.get(place, ())
        return len(samples) == _SAMPLES and not self._ages(place)

    def falls_short(self, place: Place, limit: float) -> Optional[bool]:
        """Whether the messages of a place are too old; None as long as that is not known."""
        return _are_above(self._ages(place), limit)

    def judge(self, parts: StreamParts, now: float) -> Optional[Judgement]:
        """Find the part that delays a stream; None if there is none or it is unknown."""
        claim_id, limit = parts.claim.claim_id, self.limit(parts.claim)
        since = self._changed.get(claim_id, _NEVER)
        ages = self._ages(parts.goal, since)
        is_late = _are_above(ages, limit)
        if is_late is None:
            return None
        if not is_late:
            self._note_good(claim_id, now)
            return None
        place, added = self._bottleneck(parts, since)
        age = statistics.median(ages)
        behind = age - statistics.median(self._ages(place, since))
        needed = max(limit - behind, _FAIR_PART * limit)
        what = f"{described(place)} delays the stream by {added:.3g} s"
        return Judgement(
            place, needed, f"{what}: it is {age:.3g} s old, at most {limit:g} s was asked for"
        )

    def _ages(self, place: Place, since: float = _NEVER) -> List[float]:
        """Known ages of the latest messages of a place that were sent after a moment."""
        return [
            each.age
            for each in self._samples.get(place, ())
            if each.age is not None and each.asked >= since
        ]

    def _bottleneck(self, parts: StreamParts, since: float) -> Tuple[Place, float]:
        """Follow the oldest messages upstream; find the part that adds most to its stated latency.

        Returns:
            That part, and the seconds that it adds.
        """
        place, seen = parts.goal, {parts.goal}
        found: List[Tuple[float, int, Place, float]] = []
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
    ) -> Dict[Place, float]:
        """Typical ages of the suppliers of a place, or of theirs if they have no stamps."""
        found: Dict[Place, float] = {}
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


def _are_above(ages: List[float], limit: float) -> Optional[bool]:
    """Whether most of all ages, and of the first and last third, are above a limit."""
    if len(ages) < _SAMPLES:
        return None
    parts = (ages, ages[:_THIRD], ages[-_THIRD:])
    return all(statistics.median(each) > limit for each in parts)
