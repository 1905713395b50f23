# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The ball's place on the field against the truth, the whole way from pixels.

The bounds are those of geometry. A camera at a height h above the ball's centre, looking in a
direction that is wrong by a, sees a ball at the distance d off by a (d^2 + h^2) / h along the
line of sight. To that come the owner's own place and heading. Errors are drawn from normal
distributions, so the 95th percentile over many seeds is about two standard deviations; a third
one is granted because there are only a few seeds, and some errors stay the same for a whole one.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from dyknow_demo.soccer.evaluate import FALSE, measure
from dyknow_demo.soccer.geometry import (
    BOTTOM_CAMERA,
    CEILING_CAMERA,
    CEILING_HEIGHT,
    ENCODER_STEP,
)
from dyknow_demo.soccer.world import (
    BALL_RADIUS,
    HEADING_ERROR,
    MOUNTING_ERROR,
    PLACE_ERROR,
    SoccerWorld,
)

TIMES = [1.6e9 + 9.6 * number for number in range(10)]
SEEDS = range(5)
PIXEL = 0.25  # of the planes, of the outline's centre


def stray(distance, height, angle, place, heading):
    along = (distance**2 + height**2) / height * angle
    return math.sqrt(along**2 + 2 * place**2 + (heading * distance) ** 2)


def standard_deviation(name, seed):
    """Of the error, at the distance that 95 % of the balls do not exceed."""
    if name == "ceiling_camera":
        pixel = 2 * PIXEL / CEILING_CAMERA.fx
        angle = math.hypot(MOUNTING_ERROR, pixel)
        return stray(3.0, CEILING_HEIGHT - BALL_RADIUS, angle, 0.0, 0.0)
    world = SoccerWorld(seed)
    distances = [
        np.hypot(*(world.ball_on_field(time)[:2] - world.robot(time).place[:2])) for time in TIMES
    ]
    encoders = math.sqrt(5 / 12) * ENCODER_STEP  # five joints, rounded
    angle = math.sqrt(MOUNTING_ERROR**2 + encoders**2 + (2 * PIXEL / BOTTOM_CAMERA.fx) ** 2)
    distance = float(np.percentile(distances, 95))
    return stray(distance, 0.4, angle, PLACE_ERROR, HEADING_ERROR)


@pytest.mark.parametrize("name", ["bottom_camera", "ceiling_camera"])
def test_errors_are_within_what_geometry_allows(name):
    errors, bounds = [], []
    for seed in SEEDS:
        frames, distances = measure(name, seed, TIMES)
        assert frames == len(distances) == len(TIMES)  # in view: found
        assert max(distances) < FALSE
        errors += distances
        bounds.append(3 * standard_deviation(name, seed))
    median, high = np.percentile(errors, (50, 95))
    print(f"{name}: median {median:.3f} m, p95 {high:.3f} m, bound {max(bounds):.3f} m")
    assert high < max(bounds)
    assert max(bounds) < 0.2  # the bound is one
    assert median < max(bounds) / 3


def test_without_errors_of_its_owner_the_ceiling_camera_sees_to_a_centimetre(monkeypatch):
    monkeypatch.setattr("dyknow_demo.soccer.world.MOUNTING_ERROR", 0.0)
    _, errors = measure("ceiling_camera", 0, TIMES)
    assert np.percentile(errors, 95) < 2 * PIXEL * 2 * CEILING_HEIGHT / CEILING_CAMERA.fx
