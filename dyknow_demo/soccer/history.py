# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The last values of a signal, interpolated in between.

An image is older than the joint states that arrive with it, or a little younger. A head that turns
at 1 rad/s is 1 degree further after 20 ms, so the angles have to be those at the image's own time.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from typing import Deque, Optional, Sequence, Tuple

import numpy as np

from dyknow_demo.soccer.rigid import Array

#: Values kept, and seconds beyond the first and last of them for which values are extrapolated.
_LENGTH = 100
_REACH = 0.1


class History:
    """Values by time; differences of angles are taken the short way round."""

    def __init__(self, angular: Sequence[bool]) -> None:
        """Make an empty history; ``angular`` marks the components that are angles in rad."""
        self._angular = np.array(angular)
        self._times: Deque[float] = deque(maxlen=_LENGTH)
        self._values: Deque[Array] = deque(maxlen=_LENGTH)

    def add(self, time: float, values: Sequence[float]) -> None:
        """Add values; a time (s) that is not after the last one starts a new history."""
        if self._times and time <= self._times[-1]:
            self._times.clear()
            self._values.clear()
        self._times.append(time)
        self._values.append(np.array(values, np.float64))

    def at(self, time: float) -> Optional[Tuple[float, ...]]:
        """Interpolate linearly, or extrapolate a little; None further outside."""
        times = self._times
        if not times or not times[0] - _REACH <= time <= times[-1] + _REACH:
            return None
        if len(times) == 1:
            return tuple(self._values[0].tolist())
        after = min(max(bisect_left(times, time), 1), len(times) - 1)
        before = after - 1
        step = self._values[after] - self._values[before]
        turned = np.remainder(step + math.pi, 2 * math.pi) - math.pi
        step = np.where(self._angular, turned, step)
        part = (time - times[before]) / (times[after] - times[before])
        return tuple((self._values[before] + part * step).tolist())
