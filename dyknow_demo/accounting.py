# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Counts the frames that are lost and doubled in a chain that is re-wired while it runs.

Three independent records are compared, all in seconds of one clock:

* the frames that each camera published, as recorded by a witness that stays connected to that
  camera: a frame was routed between its stamp and its arrival at the witness;
* the arrivals at the end of the chain;
* the switches: from when on the chain was connected to which camera.

A switch comes into force during its call. So a frame that may have been routed both before and
after it may arrive, or not; all other frames must arrive exactly once, or not at all.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple, Sequence


class FrameRecord(NamedTuple):
    """A frame of a camera as it was seen somewhere."""

    camera: str
    stamp: float
    arrived: float
    width: int
    height: int

    @property
    def frame(self) -> tuple[str, float]:
        """Identifies the frame: each camera has one of each stamp."""
        return self[:2]


class Switch(NamedTuple):
    """The chain is connected to ``camera`` (empty: to none) and counts for ``stage`` from now."""

    camera: str
    stage: str
    called: float
    returned: float


@dataclass
class Account:
    """Counts of the frames of one stage.

    Attributes:
        arrivals: frames at the end of the chain, in their order.
        lost: published while the chain was connected, but never arrived.
        doubled: arrivals beyond the first, or of frames that were not for this chain.
        reordered: arrived after one that should have come later.
    """

    arrivals: list[FrameRecord] = field(default_factory=list)
    lost: int = 0
    doubled: int = 0
    reordered: int = 0

    @property
    def rate(self) -> float:
        """Arrivals a second; 0 for less than two."""
        if len(self.arrivals) < 2:
            return 0.0
        span = self.arrivals[-1].arrived - self.arrivals[0].arrived
        return (len(self.arrivals) - 1) / span if span else 0.0

    @property
    def latencies(self) -> list[float]:
        """Seconds from the stamps to the arrivals, sorted; a zero if nothing arrived."""
        return sorted(each.arrived - each.stamp for each in self.arrivals) or [0.0]


def account(
    published: Sequence[FrameRecord], arrivals: Sequence[FrameRecord], switches: Sequence[Switch]
) -> dict[str, Account]:
    """Settle the account of each stage.

    Args:
        published: all frames of all cameras, as the witnesses saw them.
        arrivals: in the order of arrival.
        switches: in the order of time; the last one ends the last stage and is none itself.
    """
    rows = {switch.stage: Account() for switch in switches}
    ends = [*(switch.returned for switch in switches[1:]), math.inf]
    visits = list(zip(switches, ends))
    counts = Counter(arrival.frame for arrival in arrivals)
    own: dict[tuple[str, float], list[int]] = {}
    for each in published:
        at = [
            number
            for number, (switch, end) in enumerate(visits)
            if switch.called <= each.arrived and each.stamp <= end
        ]
        own[each.frame] = [number for number in at if visits[number][0].camera == each.camera]
        is_surely_after = each.stamp > switches[0].returned
        if at and own[each.frame] == at and is_surely_after:
            rows[visits[at[0]][0].stage].lost += not counts[each.frame]
    latest = (0, -math.inf)
    known: set[tuple[str, float]] = set()
    for arrival in arrivals:
        places = [(number, arrival.stamp) for number in own.get(arrival.frame, ())]
        later = [place for place in places if place > latest]
        place = next(iter(later or places), None)
        # A frame that was for no stage is put down to the last one.
        row = rows[switches[-2].stage if place is None else visits[place[0]][0].stage]
        row.arrivals.append(arrival)
        is_again = arrival.frame in known
        known.add(arrival.frame)
        row.doubled += is_again or place is None
        row.reordered += place is not None and not later and not is_again
        latest = max(latest, place or latest)
    return {switch.stage: rows[switch.stage] for switch in switches[:-1]}
