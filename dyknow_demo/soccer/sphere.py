# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Draws a ball as a camera sees it: exactly, from the ray of each pixel."""

from __future__ import annotations

from typing import Optional, Tuple

import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.rigid import Array

#: Rays a pixel in each direction, for smooth edges.
_RAYS = 3


def draw_ball(
    picture: Pixels,
    camera: Pinhole,
    centre: Array,
    radius: float,
    colour: Tuple[int, int, int],
    up: Array,
) -> None:
    """Draw a ball that is lit from above.

    Args:
        picture: (rows, columns, 3), YUV; changed.
        camera: intrinsics.
        centre: of the ball (3,), in the optical frame, m.
        radius: m.
        colour: of its upper side, YUV.
        up: unit vector (3,) towards the light, in the optical frame.
    """
    window = _window(camera, centre, radius)
    if window is None:
        return
    left, top, right, bottom = window
    steps = (np.arange(_RAYS) + 0.5) / _RAYS - 0.5
    columns = (np.arange(left, right)[:, None] + steps).ravel()
    rows = (np.arange(top, bottom)[:, None] + steps).ravel()
    rays = camera.rays(np.stack(np.meshgrid(columns, rows), axis=-1))
    along = rays @ centre
    inside = along**2 - (centre @ centre - radius**2)
    hit = inside > 0
    distance = along - np.sqrt(np.where(hit, inside, 0.0))
    normal = (distance[..., None] * rays - centre) / radius
    # The sky lights the upper side, the grass reflects some of the light to the lower side.
    light = np.where(hit, 0.7 + 0.3 * (normal @ up), 0.0)
    part = _means(hit.astype(np.float64))[..., None]
    shade = _means(light)[..., None]
    black = np.array([16.0, 128.0, 128.0])
    patch = picture[top:bottom, left:right]
    lit = shade * (np.array(colour, np.float64) - black) + part * black
    patch[...] = np.clip((1 - part) * patch + lit + 0.5, 0, 255).astype(np.uint8)


def _window(camera: Pinhole, centre: Array, radius: float) -> Optional[Tuple[int, int, int, int]]:
    """Pixels that the ball can touch: left, top, right, bottom, the last two exclusive."""
    if centre[2] < 2 * radius:
        return None
    column, row = camera.project(centre)
    # A silhouette is an ellipse, longer the further it is from the optical axis.
    reach = radius / (centre[2] - radius) * np.linalg.norm(centre) / centre[2]
    across, down = camera.fx * reach + 2, camera.fy * reach + 2
    left, right = max(0, int(column - across)), min(camera.width, int(column + across) + 1)
    top, bottom = max(0, int(row - down)), min(camera.height, int(row + down) + 1)
    return (left, top, right, bottom) if left < right and top < bottom else None


def _means(values: Array) -> Array:
    """Average the rays of each pixel."""
    rows, columns = values.shape[0] // _RAYS, values.shape[1] // _RAYS
    means: Array = values.reshape(rows, _RAYS, columns, _RAYS).mean(axis=(1, 3))
    return means
