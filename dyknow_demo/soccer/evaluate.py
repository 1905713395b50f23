# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Measures the case study: ``python3 -m dyknow_demo.soccer.evaluate``.

Prints how far the ball's place on the simulated field is off, for both cameras, and, where there
are annotated frames of real cameras, how many of their balls the fixed limits of a colour find.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional, Sequence

import numpy as np

from dyknow_demo.images import SHARED_FRAMES, Pixels
from dyknow_demo.soccer.finder import ORANGE, YELLOW, Find, Limits, find_balls
from dyknow_demo.soccer.geometry import (
    BOTTOM_CAMERA,
    CEILING_CAMERA,
    CEILING_HEIGHT,
    CEILING_PLACE,
    apply,
    field_from_owner,
    floor_from_camera,
    inverse,
    robot_from_bottom_camera,
)
from dyknow_demo.soccer.learn import AnnotatedFrame, is_hit, planes_from_bgr, read_frames
from dyknow_demo.soccer.planes import pyramid
from dyknow_demo.soccer.rendering import FieldCamera
from dyknow_demo.soccer.sighting import Geometry, best_sighting
from dyknow_demo.soccer.world import BALL_RADIUS, World

SEEDS = range(5)
CAMERAS = {"bottom_camera": BOTTOM_CAMERA, "ceiling_camera": CEILING_CAMERA}
_TIMES = [0.48 * number for number in range(200)]  # a round of the ball, 96 s
#: A find further than this (m) from the truth does not count.
_FALSE = 0.5
_FACTORS = (2, 4)
#: Omnidirectional cameras distort near balls; balls of less than 10 pixels do not count.
_LIMITS = Limits(area=25, size=0.25, stretch=2.2)


class Accuracy(NamedTuple):
    """Errors of the ball's place on the field.

    Attributes:
        frames: number of frames in which the ball's centre is in the picture.
        errors: m, one for each frame in which it was found.
        false_finds: number of frames with a find more than half a metre off.
    """

    frames: int
    errors: List[float]
    false_finds: int


def measure(name: str, seed: int, times: Sequence[float]) -> Accuracy:
    """Measure the errors of one of ``CAMERAS`` in the world of a seed, at some times (s)."""
    world, camera = World(seed), CAMERAS[name]
    view = FieldCamera(camera, seed)
    frame: Pixels = np.empty((camera.height, camera.width, 2), np.uint8)
    believed, place = floor_from_camera(CEILING_HEIGHT, math.pi / 2), CEILING_PLACE
    pose, frames, distances = world.field_from_ceiling_camera(), 0, []
    for number, time in enumerate(times):
        if name == "bottom_camera":
            pose = world.field_from_bottom_camera(time)
            believed = robot_from_bottom_camera(world.encoders(time))
            place = world.believed_place(time)
        truth = world.ball_on_field(time)
        column, row = camera.project(apply(inverse(pose), truth))
        frames += int(0 <= column < camera.width and 0 <= row < camera.height)
        view.render(pose, truth, number, frame)
        geometry = Geometry(camera, believed, BALL_RADIUS, min(_FACTORS))
        sighting = best_sighting(find_balls(pyramid(frame, _FACTORS), ORANGE), geometry)
        if sighting is not None:
            found = apply(field_from_owner(place), sighting.position)
            distances.append(float(np.hypot(*(found - truth)[:2])))
    errors = [each for each in distances if each <= _FALSE]
    return Accuracy(frames, errors, len(distances) - len(errors))


class FrameResult(NamedTuple):
    """The finds in a frame, the best first, and for each ball the number of the one that hits it.

    Each ball is hit by at most one find; all other finds are false.
    """

    frame: AnnotatedFrame
    finds: Sequence[Find]
    hits: Sequence[Optional[int]]

    @property
    def found(self) -> int:
        """Balls that are hit by some find."""
        return sum(hit is not None for hit in self.hits)


def evaluate_frame(frame: AnnotatedFrame) -> FrameResult:
    """Look for yellow balls in one frame, by the fixed limits."""
    pixels = frame.pixels()
    planes = {factor: planes_from_bgr(pixels, factor) for factor in _FACTORS}
    finds = find_balls(planes, YELLOW, _LIMITS)
    taken: Dict[int, int] = {}
    boxes = frame.boxes(pixels)
    for number, find in enumerate(finds):
        free = (each for each in range(len(boxes)) if each not in taken)
        ball = next((each for each in free if is_hit(boxes[each], find.box)), None)
        if ball is not None:
            taken[ball] = number
    return FrameResult(frame, finds, [taken.get(each) for each in range(len(boxes))])


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Measure and print.

    Returns:
        0, or 1 if there are no frames where the arguments say.
    """
    parser = argparse.ArgumentParser(prog="dyknow_demo.soccer.evaluate", description=__doc__)
    parser.add_argument(
        "--frames",
        type=Path,
        metavar="DIR",
        help="folder of images with YOLO annotations; by default shared/data/robocup_msl beside "
        "the checkout, if it is there",
    )
    parser.add_argument("--no-simulation", action="store_true", help="real frames only")
    options = parser.parse_args(argv)
    if not options.no_simulation:
        _print_accuracy()
    folder = options.frames or (SHARED_FRAMES if SHARED_FRAMES.is_dir() else None)
    if folder is None:
        print("real frames: skipped, there are none (--frames DIR)")
        return 0
    frames = read_frames(folder)
    if not frames:
        print(f"no annotated frames in '{folder}'", file=sys.stderr)
        return 1
    print(f"Real frames: {len(frames)} from {folder}")
    _print_recall([evaluate_frame(frame) for frame in frames])
    return 0


def _print_accuracy() -> None:
    print(f"Simulated field, {len(SEEDS)} seeds x {len(_TIMES)} frames: error on the field in m")
    print(f"{'camera':16}{'in view':>8}{'found':>7}{'false':>7}{'median':>8}{'p95':>7}{'max':>7}")
    for name in CAMERAS:
        runs = [measure(name, seed, _TIMES) for seed in SEEDS]
        errors = [error for run in runs for error in run.errors]
        in_view, false = sum(run.frames for run in runs), sum(run.false_finds for run in runs)
        median, high, most = np.percentile(errors, (50, 95, 100))
        counts = f"{in_view:8}{len(errors):7}{false:7}"
        print(f"{name:16}{counts}{median:8.3f}{high:7.3f}{most:7.3f}")
    print()


def _print_recall(results: Sequence[FrameResult]) -> None:
    print(f"{'frames':34}{'balls':>6}{'found':>7}{'recall':>8}{'best':>6}{'false':>7}")
    days: Dict[str, List[FrameResult]] = {}
    for each in results:
        days.setdefault(each.frame.day, []).append(each)
    for label, some in (*days.items(), ("all", results)):
        balls, found = sum(len(each.hits) for each in some), sum(each.found for each in some)
        best = sum(0 in each.hits for each in some)
        false = sum(len(each.finds) - each.found for each in some)
        recall = found / balls if balls else float("nan")
        print(f"{label:34}{balls:6}{found:7}{recall:8.2f}{best:6}{false:7}")
    missed = [each.frame.image.name for each in results if None in each.hits]
    print(f"missed in: {', '.join(missed) or 'none'}")


if __name__ == "__main__":
    sys.exit(main())
