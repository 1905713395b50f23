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
    """The machine of a process, as that stated last; the fields are those of the message."""

    cores: int = 0  # processors; 0 if unknown
    #: Processes that ran or wanted to in the last minute, for each processor; NaN if unknown.
    load: float = math.nan
    memory: float = math.nan  # share of the memory that is in use; NaN if unknown

    @property
    def is_overloaded(self) -> bool:
        """Whether one more nodelet would have to wait for a processor, or for memory."""
        return self.load >= 1.0 or self.memory >= 0.95


@dataclass(frozen=True)
class ClockOffset:
    """How another clock differs from ours."""

    offset: float = math.nan  # seconds by which it is ahead; NaN if unknown
    error: float = math.nan  # seconds by which that may be wrong, up or down; NaN if unknown

    def exceeds(self, limit: float) -> bool:
        """Whether the clocks certainly differ by more than a limit (s)."""
        return abs(self.offset) - self.error > limit


UNKNOWN_MACHINE = Machine()
UNKNOWN_OFFSET = ClockOffset()


@dataclass(frozen=True)
class HostStatus:
    """A host on which processes run that a manager knows.

    The fields are those of ``dyknow_msgs/HostStatus``; NaN where a number is unknown.
    """

    name: str  # as ROS names it
    is_own: bool = False  # whether the manager runs there
    is_away: bool = False  # whether none of its processes answers
    lasts: float = 0.0  # seconds for which it has been away, or not
    managers: Tuple[str, ...] = ()  # names of the nodelet managers there that run, as far as known
    nodelets: Tuple[str, ...] = ()  # names of the nodelets and nodes there, lost ones included
    pinned: Tuple[str, ...] = ()  # names of the nodelets whose spawn named the host
    cores: int = 0  # processors; 0 if unknown
    #: Processes that ran or wanted to in the last minute, for each processor.
    load: float = math.nan
    memory: float = math.nan  # share of the memory that is in use
    offset: float = math.nan  # seconds by which its clock is ahead of the manager's
    error: float = math.nan  # seconds by which the offset may be wrong, up or down
    #: Seconds for which it is not chosen for new nodelets if there is another host.
    pause: float = 0.0
    address: str = ""  # its IP address; empty if unknown

    @property
    def clock(self) -> ClockOffset:
        """How its clock differs from the manager's."""
        return ClockOffset(self.offset, self.error)


def pins(hosts: Sequence[HostStatus]) -> Mapping[str, str]:
    """Return the host that each nodelet is pinned to, by nodelet."""
    return {name: each.name for each in hosts for name in each.pinned}
