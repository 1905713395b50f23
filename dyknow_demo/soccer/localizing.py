# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""From the frame of a camera's owner to that of the field."""

from __future__ import annotations

from typing import Sequence

from dyknow_demo.soccer.rigid import Array, apply, shift, turn


def on_field(place: Sequence[float], position: Array) -> Array:
    """Transform a position (3,), m, by the owner's place on the field: x, y (m), yaw (rad)."""
    x, y, yaw = place
    return apply(shift(x, y, 0.0) @ turn(0.0, 0.0, yaw), position)
