# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How old messages are when the parts of streams send them, and who delays a stream.

Of each place one message is measured for each count. A stream is too old if most of the last
messages are, and most of the first and of the last third of them: a hiccup is no delay.
"""

from __future__ import annotations

import collections
import statistics
from typing import Callable, Deque, Dict, Iterable, List, Mapping, NamedTuple, Optional, Tuple

from dyknow.manager.claim import Claim
from dyknow.manager.claims.flows import Place
from dyknow.manager.claims.judges import Judge, Judgement, kept
from dyknow.manager.claims.stream_parts import StreamParts, described
from dyknow.manager.host import Count

#: Messages that are judged together, and seconds that lie between two of them at the least.
_SAMPLES = 9
_THIRD = _SAMPLES // 3
_SPACING = 0.4
#: Seconds over which an age is judged, of a stream with enough messages.
_WINDOW = 4.5
#: The part of the limit that a place may use up, however much those behind it add.
_FAIR_PART = 0.5

_NEVER = float("-inf")


class _Sample(NamedTuple):
    """The age of a message in seconds, None if not known, and when it was asked for."""

    age: Optional[float]
    asked: float


class AgeJudge(Judge):
    """Judges by ``max_age``, from the latest messages of each place."""

    def __init__(self, stated_latency: Callable[[Place], float]) -> None:
        """Begin without a message.

        Args:
            stated_latency: returns the seconds that a place states to add.
        """
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
        """Judge a claim's stream only by what was sent after now."""
        super().restart(claim_id, names, now)
        if names:
            self._changed[claim_id] = now

    def keep(self, claim_ids: Iterable[str]) -> None:
        """Forget all other claims."""
        super().keep(claim_ids)
        self._changed = kept(self._changed, claim_ids)

    def is_unknown(self, place: Place) -> bool:
        """Whether a place has sent messages, and nobody can tell how old they are."""
        samples = self._samples.get(place, ())
        return len(samples) == _SAMPLES and not self._ages(place)

    def falls_short(self, place: Place, limit: float) -> Optional[bool]:
        """Whether what a place sends is too old; None as long as that is not known."""
        return _are_above(self._ages(place), limit)

    def judge(self, parts: StreamParts, now: float) -> Optional[Judgement]:
        """Find out what delays a stream; None if nothing does or that is not known."""
        claim_id, limit = parts.claim.claim_id, self.limit(parts.claim)
        since = self._changed.get(claim_id, _NEVER)
        ages = self._ages(parts.goal, since)
        is_late = _are_above(ages, limit)
        if is_late is None:
            return None
        if not is_late:
            self._note_good(claim_id, now)
            return None
        place, added = self._culprit(parts, since)
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

    def _culprit(self, parts: StreamParts, since: float) -> Tuple[Place, float]:
        """Follow the oldest messages to their source; find what adds most beyond what it states.

        Returns:
            Who that is, and the seconds that it adds.
        """
        place, seen = parts.goal, {parts.goal}
        found: List[Tuple[float, int, Place, float]] = []
        while True:
            ages = self._ages(place, since)
            age = statistics.median(ages)
            feeders = self._stamped_feeders(place, parts, since, seen)
            # A place that sends younger messages than it receives has another stamp for them.
            typical = {
                each: received for each, received in feeders.items() if received <= max(ages)
            }
            base = max(sorted(typical), key=lambda each: typical[each], default=None)
            added = age if base is None else age - min(age, typical[base])
            found.append((added - self._stated_latency(place), len(found), place, added))
            if base is None:
                _, _, culprit, seconds = max(found)
                return culprit, seconds
            place = base

    def _stamped_feeders(
        self, place: Place, parts: StreamParts, since: float, seen: set[Place]
    ) -> Dict[Place, float]:
        """Typical ages of what feeds a place; of what feeds that, where it has no stamps."""
        found: Dict[Place, float] = {}
        waiting = [place]
        while waiting:
            for each in [one for senders in parts.feeders(waiting.pop()) for one in senders]:
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
