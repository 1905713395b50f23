# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How far off is the ball on the simulated field? ``python3 -m dyknow_demo.soccer.evaluate``."""

from __future__ import annotations

import math
from typing import Sequence

import numpy as np

from dyknow_demo.images import Pixels, pyramid
from dyknow_demo.soccer import geometry
from dyknow_demo.soccer.finder import ORANGE, find_balls
from dyknow_demo.soccer.rendering import FieldCamera
from dyknow_demo.soccer.sighting import Geometry, best_sighting
from dyknow_demo.soccer.world import BALL_RADIUS, SoccerWorld

SEEDS = range(5)
CAMERAS = {"bottom_camera": geometry.BOTTOM_CAMERA, "ceiling_camera": geometry.CEILING_CAMERA}
_TIMES = [0.48 * number for number in range(200)]  # a round of the ball, 96 s
#: A find further than this (m) from the truth does not count.
FALSE = 0.5
_FACTORS = (2, 4)


def measure(name: str, seed: int, times: Sequence[float]) -> tuple[int, list[float]]:
    """Measure the errors of one of ``CAMERAS`` in the world of a seed, at some times (s).

    Returns the number of frames in which the ball's centre is in the picture, and for each frame
    with a find its distance (m) from the truth.
    """
    world, camera = SoccerWorld(seed), CAMERAS[name]
    view = FieldCamera(camera, seed)
    frame: Pixels = np.empty((camera.height, camera.width, 2), np.uint8)
    believed = geometry.floor_from_camera(geometry.CEILING_HEIGHT, math.pi / 2)
    place = geometry.CEILING_PLACE
    pose, frames, distances = world.field_from_ceiling_camera(), 0, []
    for number, time in enumerate(times):
        if name == "bottom_camera":
            pose = world.field_from_bottom_camera(time)
            believed = geometry.robot_from_bottom_camera(world.encoders(time))
            place = world.believed_place(time)
        truth = world.ball_on_field(time)
        column, row = camera.project(geometry.apply(geometry.inverse(pose), truth))
        frames += int(0 <= column < camera.width and 0 <= row < camera.height)
        view.render(pose, truth, number, frame)
        known = Geometry(camera, believed, BALL_RADIUS, min(_FACTORS))
        sighting = best_sighting(find_balls(pyramid(frame, _FACTORS), ORANGE), known)
        if sighting is not None:
            found = geometry.apply(geometry.field_from_owner(place), sighting.position)
            distances.append(float(np.hypot(*(found - truth)[:2])))
    return frames, distances


def main() -> None:
    print(f"Simulated field, {len(SEEDS)} seeds x {len(_TIMES)} frames: error on the field in m")
    print(f"{'camera':16}{'in view':>8}{'found':>7}{'false':>7}{'median':>8}{'p95':>7}{'max':>7}")
    for name in CAMERAS:
        runs = [measure(name, seed, _TIMES) for seed in SEEDS]
        finds = [distance for _, distances in runs for distance in distances]
        errors = [each for each in finds if each <= FALSE]
        in_view, false = sum(frames for frames, _ in runs), len(finds) - len(errors)
        median, high, most = np.percentile(errors, (50, 95, 100))
        counts = f"{in_view:8}{len(errors):7}{false:7}"
        print(f"{name:16}{counts}{median:8.3f}{high:7.3f}{most:7.3f}")


if __name__ == "__main__":
    main()
