# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Hosts, as values: their nodelets, their load, and the offsets of their clocks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Mapping, Sequence, Tuple

#: How a spawn names a host, in the place of a nodelet manager: ``@rover``.
AT = "@"


@dataclass(frozen=True)
class Machine:
    """The machine of a process, as the process stated last; the fields are those of the message.

    Attributes:
        cores: processors; 0 if unknown.
        load: processes that ran or wanted to in the last minute, for each processor; NaN if
            unknown.
        memory: share of the memory that is in use; NaN if unknown.
    """

    cores: int = 0
    load: float = math.nan
    memory: float = math.nan

    @property
    def is_overloaded(self) -> bool:
        """Whether one more nodelet would have to wait for a processor, or for memory."""
        return self.load >= 1.0 or self.memory >= 0.95


@dataclass(frozen=True)
class ClockOffset:
    """How another clock differs from ours.

    Attributes:
        offset: seconds by which it is ahead; NaN if unknown.
        error: seconds by which that may be wrong, up or down; NaN if unknown.
    """

    offset: float = math.nan
    error: float = math.nan

    def exceeds(self, limit: float) -> bool:
        """Whether the clocks certainly differ by more than a limit (s)."""
        return abs(self.offset) - self.error > limit


UNKNOWN_MACHINE = Machine()
UNKNOWN_OFFSET = ClockOffset()


@dataclass(frozen=True)
class HostStatus:
    """A host on which processes run that a manager knows.

    The fields are those of ``dyknow_msgs/HostStatus``; NaN where a number is unknown.

    Attributes:
        name: as ROS names it.
        is_own: whether the manager runs there.
        is_away: whether none of its processes answers.
        lasts: seconds for which it has been away, or not.
        managers: names of the nodelet managers there that run, as far as known.
        nodelets: names of the nodelets and nodes there, lost ones included.
        pinned: names of the nodelets whose spawn named the host.
        cores: processors; 0 if unknown.
        load: processes that ran or wanted to in the last minute, for each processor.
        memory: share of the memory that is in use.
        offset: seconds by which its clock is ahead of the manager's.
        error: seconds by which the offset may be wrong, up or down.
        pause: seconds for which it is not chosen for new nodelets if there is another host.
        address: its IP address; empty if unknown.
    """

    name: str
    is_own: bool = False
    is_away: bool = False
    lasts: float = 0.0
    managers: Tuple[str, ...] = ()
    nodelets: Tuple[str, ...] = ()
    pinned: Tuple[str, ...] = ()
    cores: int = 0
    load: float = math.nan
    memory: float = math.nan
    offset: float = math.nan
    error: float = math.nan
    pause: float = 0.0
    address: str = ""

    @property
    def clock(self) -> ClockOffset:
        """How its clock differs from the manager's."""
        return ClockOffset(self.offset, self.error)


def pins(hosts: Sequence[HostStatus]) -> Mapping[str, str]:
    """Return the host that each nodelet is pinned to, by nodelet."""
    return {name: each.name for each in hosts for name in each.pinned}
