# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""All bonds of one topic, as plain Python: what has to be said, and when something is due next.

The table owns the ends of the bonds (`BondEnd`) and one heartbeat for all of them, so that forty
bonds wake their thread as often as one does. It is not thread-safe and calls nothing: every event
returns `Effects`, which the owner carries out after it has let go of its lock.
"""

from __future__ import annotations

import uuid
from dataclasses import dataclass, field
from typing import Callable, Iterable

from dyknow.errors import DyKnowError
from dyknow.ros.bonding.bond_states import BondEnd, BondState, BondTimings, Outcome

OnBroken = Callable[[], None]


class DuplicateBond(DyKnowError):
    """A bond with this id is alive already."""

    def __init__(self, bond_id: str) -> None:
        self.bond_id = bond_id
        super().__init__(f"there is a bond with the id '{bond_id}' already; choose another id")


@dataclass(frozen=True)
class Word:
    """Something to publish: this end of this bond is alive or dead."""

    bond_id: str
    instance_id: str
    active: bool


@dataclass
class Effects:
    """What has to be done after an event.

    Attributes:
        words: To publish, in this order.
        broken: The callbacks of the bonds that broke by themselves, in the order of their
            breaking.
        silent: Ends whose sister was silent for too long, for `BondTable.judge_silence`.
        intruded: The ids of bonds on which a third party spoke.
    """

    words: list[Word] = field(default_factory=list)
    broken: list[OnBroken] = field(default_factory=list)
    silent: list[BondEnd] = field(default_factory=list)
    intruded: list[str] = field(default_factory=list)

    def __bool__(self) -> bool:
        """Whether there is anything to do."""
        return bool(self.words or self.broken or self.silent or self.intruded)


class BondTable:
    """The bonds of one topic by their id.

    An end that parted, or whose sister died, stays until nothing more is expected of it; its id
    can be used again at once nevertheless.
    """

    def __init__(self, timings: BondTimings) -> None:
        """Make an empty table of bonds that follow the same timings."""
        self._timings = timings
        self._ends: dict[str, tuple[BondEnd, OnBroken]] = {}
        self._next_heartbeat = 0.0

    def __len__(self) -> int:
        """The number of bonds, those that come to their end included."""
        return len(self._ends)

    def is_parting(self) -> bool:
        """Whether a sister has not acknowledged yet that we broke a bond on purpose."""
        return any(end.state is BondState.PARTING for end, _ in self._ends.values())

    def next_due(self) -> float | None:
        """When `tick` has to be called next, None: not before another event."""
        due = [end.deadline for end, _ in self._ends.values() if end.deadline is not None]
        if self._has_living():
            due.append(self._next_heartbeat)
        return min(due, default=None)

    def add(self, bond_id: str, on_broken: OnBroken, now: float) -> Effects:
        """Start a bond.

        Raises:
            DuplicateBond: There is a living one with this id.
        """
        former = None
        if bond_id in self._ends:
            former, _ = self._ends[bond_id]
            if former.wants_heartbeats:
                raise DuplicateBond(bond_id)
        if not self._has_living():
            self._next_heartbeat = now + self._timings.heartbeat_period
        end = BondEnd(bond_id, str(uuid.uuid4()), self._timings, now, former)
        self._ends[bond_id] = (end, on_broken)
        return Effects(words=[Word(bond_id, end.instance_id, True)])

    def remove(self, bond_id: str, now: float) -> Effects:
        """Break a bond on purpose; nothing if it does not exist or has broken already."""
        if bond_id not in self._ends:
            return Effects()
        end, _ = self._ends[bond_id]
        return self._effects([(end, end.part(now))])

    def remove_all(self, now: float) -> Effects:
        """Break all bonds on purpose."""
        return self._effects([(end, end.part(now)) for end, _ in self._ends.values()])

    def hear(self, bond_id: str, instance_id: str, active: bool, now: float) -> Effects:
        """Take in a message of the topic; most are for others."""
        if bond_id not in self._ends:
            return Effects()
        end, _ = self._ends[bond_id]
        return self._effects([(end, end.hear(instance_id, active, now))])

    def tick(self, now: float) -> Effects:
        """Do what is due."""
        effects = self._effects([(end, end.tick(now)) for end, _ in list(self._ends.values())])
        if now >= self._next_heartbeat and self._has_living():
            self._next_heartbeat = now + self._timings.heartbeat_period
            effects.words += [
                Word(end.bond_id, end.instance_id, True)
                for end, _ in self._ends.values()
                if end.wants_heartbeats
            ]
        return effects

    def judge_silence(self, ends: Iterable[BondEnd], counts: bool, now: float) -> Effects:
        """Settle what `tick` reported as silent; see `BondEnd.judge_silence`."""
        return self._effects([(end, end.judge_silence(counts, now)) for end in ends])

    def _has_living(self) -> bool:
        return any(end.wants_heartbeats for end, _ in self._ends.values())

    def _effects(self, outcomes: Iterable[tuple[BondEnd, Outcome]]) -> Effects:
        effects = Effects()
        for end, outcome in outcomes:
            if outcome.say is not None:
                effects.words.append(Word(end.bond_id, end.instance_id, outcome.say))
            if outcome.broken:
                effects.broken.append(self._ends[end.bond_id][1])
            if outcome.silent:
                effects.silent.append(end)
            if outcome.intruder:
                effects.intruded.append(end.bond_id)
            if end.forgettable:
                self._forget(end)
        return effects

    def _forget(self, end: BondEnd) -> None:
        current = self._ends.get(end.bond_id)
        if current is not None and current[0] is end:
            del self._ends[end.bond_id]
