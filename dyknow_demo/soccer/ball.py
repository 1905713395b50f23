# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How the ball rolls: kicked from place to place along a loop, it slows down and comes to rest."""

from __future__ import annotations

import math

import numpy as np

from dyknow_demo.soccer.rigid import Array

#: Kicks in a round, seconds from one kick to the next, and for how many of these the ball rolls.
KICKS = 24
INTERVAL = 4.0
ROLLING = 3.0

#: Half axes (m) of the loop, and how far the places lie off it.
_LOOP = (2.6, 1.6)
_SPREAD = 0.15


class Ball:
    """Where the ball is, as a function of time; a round takes ``KICKS * INTERVAL`` seconds."""

    def __init__(self, seed: int) -> None:
        """Choose at random the places from which the ball is kicked."""
        generator = np.random.default_rng([seed, 1])
        angles = 2 * math.pi * np.arange(KICKS) / KICKS
        loop = np.stack((_LOOP[0] * np.cos(angles), _LOOP[1] * np.sin(angles)), axis=1)
        self._places: Array = loop + generator.uniform(-_SPREAD, _SPREAD, loop.shape)

    def positions(self, times: Array) -> Array:
        """Positions (..., 2) on the field in metres at the times (...) in seconds.

        Friction is constant: the speed falls evenly to zero.
        """
        kicks = np.floor(times / INTERVAL)
        passed = np.minimum((times - kicks * INTERVAL) / ROLLING, 1.0)
        way = (1.0 - (1.0 - passed) ** 2)[..., None]
        number = kicks.astype(np.int64)
        start, end = self._places[number % KICKS], self._places[(number + 1) % KICKS]
        position: Array = start + way * (end - start)
        return position
