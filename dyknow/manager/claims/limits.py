# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The limits that claims set for their streams: a silence, a rate, an age.

A limit judges the counts of a stream, and names the parts that keep the stream from it.

A part counts as silent only if its suppliers have sent something since its own last message: of a
silent chain the first part, and none as long as a count from further up is due.

Of two counts only a range of rates follows. A rate counts as too low if all of the range is, so a
slow network discredits no part. It has to be too low in the first and the last third of a window
as well, so that a pause does not count.

A stream is too old if most of its last messages are, and most of the first and of the last third
of them, so that a hiccup does not count.
"""

from __future__ import annotations

import statistics
from abc import ABC, abstractmethod
from typing import Callable, Collection, Mapping, NamedTuple

from dyknow.manager.claim import Claim
from dyknow.manager.claims.flows import SAMPLES, WINDOW, Flow, Flows, Place, Span, Stream, Watch

#: Seconds that a part may take to send its first message, if the claim does not allow more.
FIRST_MESSAGE = 2.0
#: Counts in the time for which a part may be silent, and the least seconds between two.
COUNTS = 4
_LEAST_PERIOD = 0.05
#: Seconds between two counts where a rate or an age is judged.
_PERIOD = 0.5
#: Messages that are due in a window at the least.
_MESSAGES = 10
#: Messages by which two counts may differ by chance.
_CHANCE = 2
#: A part that sends more than this part of the messages of a sender does not wait for it.
_ALIKE = 1.25
_THIRD = SAMPLES // 3
#: The part of the limit that a place may use up, however much those behind it add.
_FAIR_PART = 0.5

Spans = Mapping[Place, Span]


class Judgement(NamedTuple):
    """The part that keeps a stream from a limit."""

    place: Place  # the part
    needed: float  # the limit that it would have to keep itself
    what: str  # measured and demanded values, in words


class Limit(ABC):
    """A limit that claims may set for their streams."""

    name: str  # of the field of a request that sets it
    concerns_all = False  # whether a part that does not keep it is of no use to any claim
    probation = 1  # windows for which a part has to keep it before it is trusted again

    def of(self, claim: Claim) -> float:
        """The limit of a claim; 0 for none."""
        return float(getattr(claim.request, self.name))

    @abstractmethod
    def watch(self, limit: float) -> Watch:
        """How places are counted by which it is judged."""

    @abstractmethod
    def falls_short(self, flow: Flow | None, limit: float) -> bool | None:
        """Whether a place certainly does not keep a limit; None as long as that is not known."""

    @abstractmethod
    def judge(self, stream: Stream, flows: Flows, now: float) -> Collection[Judgement]:
        """Find the parts that keep a stream from its limit, as far as known."""


class Silence(Limit):
    """The longest silence, in seconds."""

    name = "max_silence"
    concerns_all = True
    probation = 0

    def watch(self, limit: float) -> Watch:
        return Watch(max(limit / COUNTS, _LEAST_PERIOD), WINDOW)

    def falls_short(self, flow: Flow | None, limit: float) -> bool:
        return flow is not None and not flow.is_sending

    def judge(self, stream: Stream, flows: Flows, now: float) -> list[Judgement]:
        limit = self.of(stream.claim)
        found: list[Judgement] = []
        latched: list[Judgement] = []
        for place in sorted(stream.topics.keys() & flows.keys()):
            flow = flows[place]
            suppliers = list(stream.suppliers(place))
            moving = [
                senders
                for senders in suppliers
                if not all(each in flows and flows[each].is_latched for each in senders)
            ]
            is_fed = all(
                any(
                    each in flows and flows[each].came_after >= flow.quiet_from for each in senders
                )
                for senders in moving or suppliers
            )
            if _is_silent(flow, limit) and is_fed:
                what = f"{described(place)} was silent for longer than {limit:g} s"
                is_latched = flow.is_latched and place != stream.goal
                (latched if is_latched else found).append(Judgement(place, limit, what))
        # What is latched may have sent all that it will: it is not to blame while the rest flows.
        goal = flows.get(stream.goal)
        return found or ([] if goal is not None and not _is_silent(goal, limit) else latched)


def _is_silent(flow: Flow, limit: float) -> bool:
    return flow.silence > (limit if flow.begun else max(limit, FIRST_MESSAGE))


class _Cause(NamedTuple):
    """Whether a sender slows a place down, if that is sure, and its share of the needed rate."""

    is_slow: bool
    is_sure: bool
    share: float


class Rate(Limit):
    """The lowest rate, in Hz."""

    name = "min_rate"

    def watch(self, limit: float) -> Watch:
        return Watch(_PERIOD, max(WINDOW, _MESSAGES / limit))

    def falls_short(self, flow: Flow | None, limit: float) -> bool | None:
        window = self.watch(limit).window
        whole = flow.span(window) if flow is not None else None
        if flow is None or whole is None:
            return None
        if whole.messages + 1 >= limit * whole.seconds:
            return False
        third = window / 3
        counts = [each for each in flow.counts if each.asked >= whole.first.asked]
        begin = next(each for each in counts if Span(whole.first, each).seconds >= third)
        end = next(each for each in reversed(counts) if Span(each, whole.last).seconds >= third)
        return all(
            each.messages < limit * each.seconds
            for each in (Span(whole.first, begin), Span(end, whole.last))
        )

    def judge(self, stream: Stream, flows: Flows, now: float) -> list[Judgement]:
        limit = self.of(stream.claim)
        window = self.watch(limit).window
        found = {place: flows[place].span(window) for place in stream.topics if place in flows}
        spans = {place: span for place, span in found.items() if span is not None}
        is_there = stream.goal in spans  # not so if its nodelet is lost
        is_below = self.falls_short(flows.get(stream.goal), limit) if is_there else None
        if is_below is False:
            stream.note_good(self.name, now)
            for place, span in spans.items():
                stream.usual[place] = max(span.rate, stream.usual.get(place, 0.0))
        bottleneck = self._bottleneck(stream, spans) if is_below else None
        if bottleneck is None:
            return []
        place, needed = bottleneck
        has = f"the stream has {spans[stream.goal].rate:.3g} Hz"
        what = f"{described(place)} is too slow: it sends {spans[place].rate:.3g} Hz; {has}"
        return [Judgement(place, needed, f"{what}, at least {limit:g} Hz are demanded")]

    def _bottleneck(self, stream: Stream, spans: Spans) -> tuple[Place, float] | None:
        """Follow slow parts upstream to the first one, with the rate that it would need.

        None as long as that is not certain.
        """
        place, needed, seen = stream.goal, self.of(stream.claim), {stream.goal}
        while True:
            senders = {each for senders in stream.suppliers(place) for each in senders} - seen
            if not senders <= spans.keys():
                return None
            causes = {each: self._cause(each, place, needed, stream, spans) for each in senders}
            slow = sorted((each.share, sender) for sender, each in causes.items() if each.is_slow)
            if not slow:
                return (place, needed) if all(each.is_sure for each in causes.values()) else None
            _, sender = slow[0]
            needed *= self._ratio(sender, place, stream)
            place = sender
            seen.add(place)

    def _cause(
        self, sender: Place, place: Place, needed: float, stream: Stream, spans: Spans
    ) -> _Cause:
        """Tell whether a place is too slow since its sender is.

        A place that kept up with a sender that is too slow is not to blame. Neither is a sender
        that the place did not keep up with, or that it never waited for. Nor is one that is as
        fast as while the stream was fast enough, but that leaves the cause open.
        """
        given, sent = spans[sender], spans[place]
        usual, ratio = stream.usual.get(sender, 0.0), self._ratio(sender, place, stream)
        is_known = usual > 0.0 and stream.usual.get(place, 0.0) > 0.0
        changes_alone = not given.messages and given.last.latched
        is_ahead = not is_known and sent.messages > _ALIKE * given.messages + _CHANCE
        is_behind = (sent.messages + _CHANCE) * ratio < given.messages
        is_as_ever = is_known and given.messages + 1 >= usual * given.seconds
        share = given.rate / (needed * ratio)
        if changes_alone or is_ahead or is_behind:
            return _Cause(False, True, share)
        is_slow = not is_as_ever and (given.messages + 1) / ratio + 1 < needed * given.seconds
        return _Cause(is_slow, is_slow, share)

    def _ratio(self, sender: Place, place: Place, stream: Stream) -> float:
        """Messages of a sender for each one of a place; 1 where that was never seen."""
        given, sent = stream.usual.get(sender, 0.0), stream.usual.get(place, 0.0)
        return given / sent if given and sent else 1.0


class Age(Limit):
    """The highest age, in seconds."""

    name = "max_age"

    def __init__(self, stated_latency: Callable[[Place], float]) -> None:
        """``stated_latency`` returns the seconds that a place states to add, 0 for none."""
        self._stated_latency = stated_latency

    def watch(self, limit: float) -> Watch:
        return Watch(_PERIOD, WINDOW)

    def falls_short(self, flow: Flow | None, limit: float) -> bool | None:
        return _are_above(flow.ages() if flow is not None else [], limit)

    def judge(self, stream: Stream, flows: Flows, now: float) -> list[Judgement]:
        limit = self.of(stream.claim)
        ages = stream.ages(stream.goal, flows)
        is_late = _are_above(ages, limit)
        if is_late is False:
            stream.note_good(self.name, now)
        if not is_late:
            return []
        place, added = self._bottleneck(stream, flows)
        age = statistics.median(ages)
        behind = age - statistics.median(stream.ages(place, flows))
        needed = max(limit - behind, _FAIR_PART * limit)
        is_old = f"it is {age:.3g} s old, at most {limit:g} s is demanded"
        what = f"{described(place)} delays the stream by {added:.3g} s: {is_old}"
        return [Judgement(place, needed, what)]

    def _bottleneck(self, stream: Stream, flows: Flows) -> tuple[Place, float]:
        """Follow the oldest messages upstream to the part that adds most to its stated latency."""
        place, seen = stream.goal, {stream.goal}
        found: list[tuple[float, int, Place, float]] = []
        while True:
            ages = stream.ages(place, flows)
            age = statistics.median(ages)
            senders = self._stamped_senders(place, stream, flows, seen)
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
        self, place: Place, stream: Stream, flows: Flows, seen: set[Place]
    ) -> dict[Place, float]:
        """Typical ages of the suppliers of a place, or of theirs if they have no stamps."""
        found: dict[Place, float] = {}
        waiting = [place]
        while waiting:
            for each in [one for senders in stream.suppliers(waiting.pop()) for one in senders]:
                if each in seen:
                    continue
                seen.add(each)
                ages = stream.ages(each, flows)
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


def described(place: Place) -> str:
    """Name a place for people."""
    return f"nodelet {place[0]}" if place[0] else f"topic {place[1]}"
