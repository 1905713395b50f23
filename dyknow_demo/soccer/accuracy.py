# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How far off is the ball's place on the field? Measured without ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Dict, Iterator, List, Optional, Sequence

import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer import ceiling, nao
from dyknow_demo.soccer.camera import FieldCamera
from dyknow_demo.soccer.colour import ORANGE
from dyknow_demo.soccer.field import BALL_RADIUS
from dyknow_demo.soccer.finder import find_balls
from dyknow_demo.soccer.localizing import on_field
from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.planes import pyramid
from dyknow_demo.soccer.rigid import Array, apply, inverse
from dyknow_demo.soccer.sighting import ANGLE_ERROR, Geometry, best_sighting
from dyknow_demo.soccer.world import World

FACTORS = (2, 4)

#: A find further than this (m) from the truth does not count.
_FALSE = 0.5

#: The cameras that ``measure`` accepts.
EYES = ("bottom_camera", "ceiling_camera")


@dataclass(frozen=True)
class Accuracy:
    """Errors (m) of the ball's place, one for each frame in which it was found.

    Attributes:
        frames: number of frames in which the ball is in view.
        errors: of the place on the field.
        false_finds: number of frames with a find more than half a metre off.
    """

    frames: int
    errors: Sequence[float]
    false_finds: int

    def percentile(self, percent: float) -> float:
        """Error in metres that so many percent do not exceed."""
        return float(np.percentile(self.errors, percent))


@dataclass(frozen=True)
class _Eye:
    """A camera: its true view, and the pose that its owner assumes."""

    camera: Pinhole
    true_pose: Callable[[float], Array]
    believed_pose: Callable[[float], Array]
    believed_place: Callable[[float], Sequence[float]]


def _eyes(world: World) -> Dict[str, _Eye]:
    down = ceiling.floor_from_camera(ceiling.HEIGHT, math.pi / 2)
    return {
        "bottom_camera": _Eye(
            nao.BOTTOM_CAMERA,
            world.field_from_bottom_camera,
            lambda time: nao.robot_from_bottom_camera(world.encoders(time)),
            world.believed_place,
        ),
        "ceiling_camera": _Eye(
            ceiling.CEILING_CAMERA,
            lambda time: world.field_from_ceiling_camera(),
            lambda time: down,
            lambda time: ceiling.PLACE,
        ),
    }


@dataclass(frozen=True)
class Look:
    """One frame.

    Attributes:
        truth: true centre (3,) of the ball on the field, m.
        in_view: whether the centre is in the picture.
        found: estimated centre of the ball (3,), m, or None.
    """

    truth: Array
    in_view: bool
    found: Optional[Array]


def measure(name: str, seed: int, times: Sequence[float]) -> Accuracy:
    """Measure the errors of one camera at some times (s).

    Args:
        name: one of ``EYES``.
        seed: of the world.
        times: when to look.
    """
    frames = false_finds = 0
    errors: List[float] = []
    for each in looks(name, seed, times):
        frames += int(each.in_view)
        if each.found is None:
            continue
        error = float(np.hypot(*(each.found - each.truth)[:2]))
        if error > _FALSE:
            false_finds += 1
        else:
            errors.append(error)
    return Accuracy(frames, errors, false_finds)


def looks(name: str, seed: int, times: Sequence[float]) -> Iterator[Look]:
    """Look for the ball as ``measure`` does, frame by frame."""
    world = World(seed)
    eye = _eyes(world)[name]
    view = FieldCamera(eye.camera, seed)
    frame: Pixels = np.empty((eye.camera.height, eye.camera.width, 2), np.uint8)
    for number, time in enumerate(times):
        truth, pose = world.ball_on_field(time), eye.true_pose(time)
        view.render(pose, truth, number, frame)
        believed = eye.believed_pose(time)
        geometry = Geometry(eye.camera, believed, BALL_RADIUS, ANGLE_ERROR, min(FACTORS))
        sighting = best_sighting(find_balls(pyramid(frame, FACTORS), ORANGE), geometry)
        place = eye.believed_place(time)
        found = None if sighting is None else on_field(place, sighting.position)
        yield Look(truth, _in_view(eye.camera, pose, truth), found)


def _in_view(camera: Pinhole, field_from_camera: Array, ball: Array) -> bool:
    """Whether the ball's centre is in the picture."""
    centre = apply(inverse(field_from_camera), ball)
    if centre[2] <= BALL_RADIUS:
        return False
    column, row = camera.project(centre)
    return bool(0 <= column < camera.width and 0 <= row < camera.height)
