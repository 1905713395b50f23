# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The machine of a process: its load, and how its clock differs from ours.

A process states its time in each answer to a poll. It read its clock between the moments at which
the request was sent and the answer received, so the middle of these is wrong by half of the way
there and back at most. As in NTP, the quickest of the latest answers counts.
"""

from __future__ import annotations

import collections
import os
import time
from operator import attrgetter
from typing import Any

import psutil
from dyknow_msgs.msg import Machine as MachineMessage
from genpy import Time

from dyknow.model.hosts import UNKNOWN_OFFSET, ClockOffset

#: Answers of which the quickest counts.
_SAMPLES = 8


def machine_message() -> MachineMessage:
    """Describe the machine of this process, with the time of this moment."""
    cores, memory = os.cpu_count() or 1, psutil.virtual_memory()
    load = os.getloadavg()[0] / cores
    used = 1.0 - memory.available / memory.total
    return MachineMessage(Time.from_sec(time.time()), cores, load, used)


class OffsetMeter:
    """Measures how the clock of a process differs from ours; for one thread at a time.

    Attributes:
        offset: the best estimate of the latest answers.
    """

    def __init__(self) -> None:
        """Start without an answer."""
        self._samples: collections.deque[ClockOffset] = collections.deque(maxlen=_SAMPLES)
        self.offset = UNKNOWN_OFFSET

    def begin(self) -> tuple[float, float]:
        """Return the moment at which a request is sent."""
        return time.time(), time.monotonic()

    def add(self, began: tuple[float, float], stamp: Any) -> None:
        """Take the time that an answer states, to a request that was sent when it ``began``."""
        sent, at = began
        half = (time.monotonic() - at) / 2
        self._samples.append(ClockOffset(stamp.to_sec() - (sent + half), half))
        self.offset = min(self._samples, key=attrgetter("error"))
