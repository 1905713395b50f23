# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The bond protocol as plain Python: no thread, no clock, no ROS.

A bond ties two processes together so that each learns when the other ends. Both publish on one
topic about once a second that they are alive, and each limits the silence of the other. `_BondEnd`
is our end of one bond; the other end is its sister:

    WAITING --alive--> ALIVE --dead, or silence--> DEAD
       |                 |
       |  part           +--part--> PARTING --dead, or too long--> DEAD
       +---------------------------^
       +--dead, or too long--> DEAD

The rules are those of bond_core's state machine (bondcpp, bondpy), with five differences that its
sisters cannot distinguish from ordinary traffic:

* Silence counts from the sister's first heartbeat, not from her second; a sister that died in
  between would be waited for without end.
* An end that stops waiting for its sister publishes "dead" once, so that a sister that was only
  suspended learns it at once.
* An end that parts before its sister was heard repeats "dead" for a while too: she may just be
  connecting, and would wait for the whole connect timeout.
* After the sister's death is acknowledged, the end lingers and acknowledges again while she
  repeats herself; the first answer may have been sent before she was connected.
* An id can be used again at once: answers of former sisters to the end of the earlier bond do not
  count. One that still publishes "alive" after the disconnect timeout ignores that end, and is the
  sister of the new bond.

As in bond_core, the timeouts that a sister announces are for debugging; each end follows its own.
"""

from __future__ import annotations

import enum
import uuid
from dataclasses import dataclass, field
from typing import Callable

from dyknow.errors import DyKnowError

OnBroken = Callable[[], None]


class DuplicateBond(DyKnowError):
    """A bond with this id is alive already."""

    def __init__(self, bond_id: str) -> None:
        self.bond_id = bond_id
        super().__init__(f"there is a bond with the id '{bond_id}' already; choose another id")


@dataclass(frozen=True)
class BondTimings:
    """Limits and periods of an end, in seconds."""

    connect_timeout: float  #: from the start to the sister's first heartbeat
    heartbeat_timeout: float  #: the longest silence of a sister that was heard
    disconnect_timeout: float  #: from the end's parting to the sister's acknowledgement
    heartbeat_period: float  #: between two "alive"
    dead_publish_period: float  #: between two "dead" while the sister has not acknowledged


@dataclass(frozen=True)
class Announcement:
    """A message to publish: this end of this bond is alive or dead."""

    bond_id: str
    instance_id: str
    active: bool


@dataclass
class Effects:
    """Actions that an event asks of the table's owner.

    Attributes:
        announcements: to publish, in this order.
        broken: callbacks of the bonds that broke by themselves, in that order.
        intruded: ids of bonds on which a third party published.
    """

    announcements: list[Announcement] = field(default_factory=list)
    broken: list[OnBroken] = field(default_factory=list)
    intruded: list[str] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.announcements or self.broken or self.intruded)


_State = enum.Enum("_State", "WAITING ALIVE PARTING DEAD")
"""State of an end; see the module's diagram."""


class _BondEnd:
    """Our end of one bond. Each method takes the time (s, steady), and adds to the effects."""

    def __init__(
        self,
        bond_id: str,
        on_broken: OnBroken,
        table: BondTable,
        now: float,
        former: _BondEnd | None,
    ) -> None:
        """Wait for the sister; ``former`` is our end of an earlier bond with the same id."""
        self.bond_id = bond_id
        self.state = _State.WAITING
        #: When `tick` has to be called next; None: not before another event.
        self.deadline: float | None = now + table.timings.connect_timeout
        self._on_broken = on_broken
        self._table = table
        self._timings = table.timings
        self._instance_id = str(uuid.uuid4())
        self._sister: str | None = None
        self._own_instances = {self._instance_id}
        self._former_sisters: set[str | None] = set()
        if former is not None:
            self._own_instances |= former._own_instances
            self._former_sisters |= former._former_sisters | {former._sister}
        self._former_settled_at = now + self._timings.disconnect_timeout
        self._parted_at = now

    @property
    def is_living(self) -> bool:
        return self.state in (_State.WAITING, _State.ALIVE)

    @property
    def is_over(self) -> bool:
        """Whether no event can change this end any more."""
        return self.state is _State.DEAD and self.deadline is None

    def announce(self, active: bool) -> None:
        word = Announcement(self.bond_id, self._instance_id, active)
        self._table.effects.announcements.append(word)

    def receive(self, instance_id: str, active: bool, now: float) -> None:
        """Handle a status message with this bond's id."""
        if instance_id in self._own_instances:
            return
        is_former = instance_id in self._former_sisters
        is_of_former_bond = is_former and (not active or now < self._former_settled_at)
        if self._sister is None and not is_of_former_bond:
            self._sister = instance_id
        if instance_id == self._sister:
            (self._sister_alive if active else self._sister_dead)(now)
        elif not is_former:
            self._table.effects.intruded.append(self.bond_id)

    def tick(self, now: float, silence_counts: bool | None) -> None:
        """Act on the deadline; see `BondTable.tick`."""
        if self.deadline is None or now < self.deadline:
            return
        parting_ends = self._parted_at + self._timings.disconnect_timeout
        if self.state is _State.WAITING or (self.state is _State.ALIVE and silence_counts):
            self._die()
            self.announce(False)
            self._table.effects.broken.append(self._on_broken)
        elif self.state is _State.ALIVE:
            if silence_counts is not None:
                self.deadline = now + self._timings.heartbeat_timeout
        elif self.state is _State.PARTING and now < parting_ends:
            self.deadline = now + self._timings.dead_publish_period
            self.announce(False)
        else:
            self._die()

    def part(self, now: float) -> None:
        """Break the bond on purpose: the sister is notified, the owner is not."""
        if self.is_living:
            self.state = _State.PARTING
            self._parted_at = now
            self.deadline = now + self._timings.dead_publish_period
            self.announce(False)

    def _sister_alive(self, now: float) -> None:
        if self.is_living:
            if self.state is _State.WAITING:
                self.announce(True)
            self.state = _State.ALIVE
            self.deadline = now + self._timings.heartbeat_timeout

    def _sister_dead(self, now: float) -> None:
        if self.state is _State.PARTING:
            self._die()
        elif self.is_living:
            self.state = _State.DEAD
            self.deadline = now + self._timings.disconnect_timeout
            self._table.effects.broken.append(self._on_broken)
        if self.deadline is not None:
            self.announce(False)

    def _die(self) -> None:
        self.state = _State.DEAD
        self.deadline = None


class BondTable:
    """The bonds of one topic by their id, with one heartbeat for all of them.

    So forty bonds wake their thread as often as one does. A table is not thread-safe and calls
    nothing: every event returns `Effects`, which the owner carries out after it has released its
    lock. An end that parted, or whose sister died, stays until nothing more is expected of it.
    """

    def __init__(self, timings: BondTimings) -> None:
        self.timings = timings
        self.effects = Effects()
        self._ends: dict[str, _BondEnd] = {}
        self._next_heartbeat = 0.0

    def is_parting(self) -> bool:
        """Whether a sister has not acknowledged yet that we broke a bond on purpose."""
        return any(end.state is _State.PARTING for end in self._ends.values())

    def silent(self, now: float) -> list[str]:
        """Ids of the bonds whose sister has been silent for too long."""
        return [
            end.bond_id
            for end in self._ends.values()
            if end.state is _State.ALIVE and end.deadline is not None and end.deadline <= now
        ]

    def next_due(self) -> float | None:
        """When `tick` has to be called next, None: not before another event."""
        due = [end.deadline for end in self._ends.values() if end.deadline is not None]
        if self._living():
            due.append(self._next_heartbeat)
        return min(due, default=None)

    def add(self, bond_id: str, on_broken: OnBroken, now: float) -> Effects:
        """Start a bond; raises `DuplicateBond` if there is a living one with this id."""
        former = self._ends.get(bond_id)
        if former is not None and former.is_living:
            raise DuplicateBond(bond_id)
        if not self._living():
            self._next_heartbeat = now + self.timings.heartbeat_period
        self._ends[bond_id] = _BondEnd(bond_id, on_broken, self, now, former)
        self._ends[bond_id].announce(True)
        return self._taken()

    def remove(self, bond_id: str, now: float) -> Effects:
        """Break a bond on purpose; nothing if it does not exist or has broken already."""
        if bond_id in self._ends:
            self._ends[bond_id].part(now)
        return self._taken()

    def remove_all(self, now: float) -> Effects:
        """Break all bonds on purpose."""
        for end in self._ends.values():
            end.part(now)
        return self._taken()

    def receive(self, bond_id: str, instance_id: str, active: bool, now: float) -> Effects:
        """Handle a message of the topic; most of them are about unknown bonds."""
        if bond_id in self._ends:
            self._ends[bond_id].receive(instance_id, active, now)
        return self._taken()

    def tick(self, now: float, silence_counts: bool | None = None) -> Effects:
        """Act on all deadlines, and publish heartbeats.

        If silence does not count, each silent sister is waited for once more. None leaves silent
        bonds alone, for a later call to decide.
        """
        for end in self._ends.values():
            end.tick(now, silence_counts)
        if now >= self._next_heartbeat and self._living():
            self._next_heartbeat = now + self.timings.heartbeat_period
            for end in self._living():
                end.announce(True)
        return self._taken()

    def _living(self) -> list[_BondEnd]:
        return [end for end in self._ends.values() if end.is_living]

    def _taken(self) -> Effects:
        """Forget the ends that are over, and return the effects of the event."""
        self._ends = {key: end for key, end in self._ends.items() if not end.is_over}
        taken, self.effects = self.effects, Effects()
        return taken
