# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Moments from which a later process can measure, although the wall clock may have been set."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from typing import Callable


@dataclass(frozen=True)
class Moment:
    """A moment on two clocks.

    Attributes:
        steady: seconds on the steady clock, which all processes share until the machine restarts.
        wall: seconds of the wall clock, which may be set.
        boot: names the steady clock; empty where it cannot be named.
    """

    steady: float
    wall: float
    boot: str

    @classmethod
    def now(cls, steady: Callable[[], float]) -> Moment:
        """Return this moment."""
        return cls(steady(), time.time(), _boot())

    def since(self, earlier: Moment) -> float:
        """Seconds from an earlier moment, at least 0: on the steady clock if it is the same."""
        if self.boot and self.boot == earlier.boot:
            return max(0.0, self.steady - earlier.steady)
        return max(0.0, self.wall - earlier.wall)


@functools.lru_cache(maxsize=None)
def _boot() -> str:
    try:
        with open("/proc/sys/kernel/random/boot_id") as file:
            return file.read().strip()
    except OSError:
        return ""
