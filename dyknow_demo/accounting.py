# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts the frames that are lost and doubled in a chain that is re-wired while it runs.

Three independent records are compared, all in seconds of one clock:

* the frames that each camera *published*, as seen by a witness that stays connected to that
  camera: a frame was routed at some moment between ``sent``, its stamp, and ``seen``, when it
  reached the witness;
* the *arrivals* at the end of the chain;
* the *switches*: which camera the chain was connected to, and between which moments (``called``,
  ``returned``) that came into force.

The moment of a switch is not observed. So one is looked for, inside the call, that explains every
frame on either side of it; the frames that even the best moment leaves unexplained are counted.
A single frame that was published during the call is explained whether it arrived or not: the
switch came after it, or before.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple, Sequence


class FrameName(NamedTuple):
    """One frame of one camera, which counts its frames from 0.

    It travels in ``header.frame_id``, which every stage copies: rospy overwrites ``header.seq``
    with a count of its own as soon as a node of another process listens.
    """

    camera: str
    number: int

    def __str__(self) -> str:
        return f"{self.camera}#{self.number}"

    @classmethod
    def parse(cls, text: str) -> FrameName:
        """Read a name back.

        Raises:
            ValueError: it is not of the form ``camera#number``.
        """
        camera, separator, number = text.rpartition("#")
        if not separator:
            raise ValueError(f"'{text}' names no camera frame: expected 'camera#number'")
        return cls(camera, int(number))


class Published(NamedTuple):
    """A frame that a camera published."""

    frame: FrameName
    sent: float
    seen: float


class Arrival(NamedTuple):
    """A frame at the end of the chain; ``size`` is its width and height in pixels."""

    frame: FrameName
    sent: float
    arrived: float
    size: tuple[int, int]


class Switch(NamedTuple):
    """The chain is connected to ``camera`` (empty: to none) and counts for ``stage`` from now."""

    camera: str
    stage: str
    called: float
    returned: float


@dataclass(frozen=True)
class Account:
    """Counts of the frames of one stage.

    Attributes:
        messages: arrivals.
        rate: arrivals a second; 0 for less than two.
        latencies: seconds from the stamp to the arrival, sorted.
        size: width and height of the last arrival; zeros for none.
        lost: published while the chain was connected, but never arrived.
        doubled: arrivals beyond the first, or of frames that were not for this chain.
        reordered: arrived after one that should have come later.
    """

    messages: int
    rate: float
    latencies: tuple[float, ...]
    size: tuple[int, int]
    lost: int
    doubled: int
    reordered: int

    @property
    def mean(self) -> float:
        """Mean latency in seconds."""
        return sum(self.latencies) / len(self.latencies) if self.latencies else 0.0

    def percentile(self, percent: float) -> float:
        """Latency in seconds that so many percent of the arrivals do not exceed."""
        if not self.latencies:
            return 0.0
        return self.latencies[math.ceil(percent / 100 * len(self.latencies)) - 1]


class _Visit(NamedTuple):
    """The time that the chain was connected to one camera in one wiring."""

    camera: str
    stage: str
    begin: float
    end: float

    def may_have(self, each: Published) -> bool:
        """Whether a frame may have been routed then."""
        return each.sent <= self.end and each.seen >= self.begin


def gaps(published: Sequence[Published]) -> int:
    """Count the frames that a witness missed: then its record proves nothing."""
    numbers: dict[str, set[int]] = {}
    for each in published:
        numbers.setdefault(each.frame.camera, set()).add(each.frame.number)
    return sum(max(seen) + 1 - len(seen) for seen in numbers.values())


def account(
    published: Sequence[Published], arrivals: Sequence[Arrival], switches: Sequence[Switch]
) -> dict[str, Account]:
    """Settle the account of each stage.

    Args:
        published: all frames of all cameras.
        arrivals: in the order of arrival.
        switches: in the order of time; the last one ends the last stage and is none itself.

    Returns:
        Accounts by stage, in the order of the stages, for all but the last switch.
    """
    counts = Counter(arrival.frame for arrival in arrivals)
    visits = _visits(published, counts, switches)
    stages = list(dict.fromkeys(switch.stage for switch in switches[:-1]))
    places: dict[FrameName, int] = {}
    lost: Counter[str] = Counter()
    strays: set[FrameName] = set()
    for each in published:
        at = [index for index, visit in enumerate(visits) if visit.may_have(each)]
        own = [index for index in at if visits[index].camera == each.frame.camera]
        places[each.frame] = (own or at)[0]
        if len(own) == len(at) and not counts[each.frame]:
            lost[visits[at[0]].stage] += 1
        if not own:
            strays.add(each.frame)
    rows = _Rows(stages)
    latest = (0, -1)
    for arrival in arrivals:
        index = places.get(arrival.frame)
        if index is None:  # no witness saw it: it belongs nowhere
            rows.add(visits[latest[0]].stage, arrival, stray=True, late=False)
            continue
        key = (index, arrival.frame.number)
        rows.add(visits[index].stage, arrival, arrival.frame in strays, key < latest)
        latest = max(latest, key)
    return {stage: rows.close(stage, lost[stage]) for stage in stages}


def _visits(
    published: Sequence[Published], counts: Counter[FrameName], switches: Sequence[Switch]
) -> list[_Visit]:
    camera, stage, begin = "", switches[0].stage, -math.inf
    visits = []
    for switch in switches:
        moment = _moment(published, counts, camera, switch)
        visits.append(_Visit(camera, stage, begin, moment))
        camera, stage, begin = switch.camera, switch.stage, moment
    visits.append(_Visit(camera, stage, begin, math.inf))
    return visits


def _moment(
    published: Sequence[Published], counts: Counter[FrameName], before: str, switch: Switch
) -> float:
    """Return the moment inside the call that leaves the fewest frames unexplained."""
    near = [
        each
        for each in published
        if each.seen >= switch.called
        and each.sent <= switch.returned
        and before != switch.camera
        and each.frame.camera in (before, switch.camera)
    ]

    def unexplained(moment: float) -> int:
        wrong = 0
        for each in near:
            surely_before, surely_after = each.seen < moment, each.sent > moment
            is_old = each.frame.camera == before
            arrived = counts[each.frame] > 0
            wrong += surely_before and arrived is not is_old
            wrong += surely_after and arrived is is_old
        return wrong

    moments = {
        switch.called,
        switch.returned,
        *(t for each in near for t in (each.sent, each.seen)),
    }
    inside = (moment for moment in moments if switch.called <= moment <= switch.returned)
    return min(sorted(inside), key=unexplained)


class _Rows:
    """Collects the arrivals of each stage."""

    def __init__(self, stages: Sequence[str]) -> None:
        self._arrivals: dict[str, list[Arrival]] = {stage: [] for stage in stages}
        self._doubled: Counter[str] = Counter()
        self._reordered: Counter[str] = Counter()
        self._known: set[FrameName] = set()

    def add(self, stage: str, arrival: Arrival, stray: bool, late: bool) -> None:
        if stage not in self._arrivals:
            if not stray:
                return  # of the stage that is not over yet
            stage = list(self._arrivals)[-1]
        again = arrival.frame in self._known
        self._known.add(arrival.frame)
        self._arrivals[stage].append(arrival)
        self._doubled[stage] += again or stray
        self._reordered[stage] += late and not again

    def close(self, stage: str, lost: int) -> Account:
        arrivals = self._arrivals[stage]
        span = arrivals[-1].arrived - arrivals[0].arrived if arrivals else 0.0
        return Account(
            messages=len(arrivals),
            rate=(len(arrivals) - 1) / span if span > 0 else 0.0,
            latencies=tuple(sorted(each.arrived - each.sent for each in arrivals)),
            size=arrivals[-1].size if arrivals else (0, 0),
            lost=lost,
            doubled=self._doubled[stage],
            reordered=self._reordered[stage],
        )
