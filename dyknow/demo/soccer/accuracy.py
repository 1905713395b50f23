"""How far off is the ball's place on the field? The whole way, without ROS, against the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Dict, List, Sequence

import numpy as np

from dyknow.demo.images import Pixels
from dyknow.demo.soccer import ceiling, nao
from dyknow.demo.soccer.camera import FieldCamera
from dyknow.demo.soccer.colour import ORANGE
from dyknow.demo.soccer.field import BALL_RADIUS
from dyknow.demo.soccer.finder import find_balls
from dyknow.demo.soccer.localizing import on_field
from dyknow.demo.soccer.pinhole import Pinhole
from dyknow.demo.soccer.planes import pyramid
from dyknow.demo.soccer.rigid import Array, apply, inverse
from dyknow.demo.soccer.sighting import ANGLE_ERROR, Geometry, best_sighting
from dyknow.demo.soccer.world import World

FACTORS = (2, 4)

#: The cameras that ``measure`` knows.
EYES = ("bottom_camera", "ceiling_camera")


@dataclass(frozen=True)
class Accuracy:
    """Errors (m) of the ball's place, one for each frame in which it was found.

    Attributes:
        frames: frames in which the ball is in view.
        errors: of the place on the field.
        false_finds: frames with a ball that is more than half a metre off.
    """

    frames: int
    errors: Sequence[float]
    false_finds: int

    def percentile(self, percent: float) -> float:
        """Error in metres that so many percent do not exceed."""
        return float(np.percentile(self.errors, percent))


@dataclass(frozen=True)
class _Eye:
    """A camera, what it truly sees and what its owner believes."""

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


def measure(name: str, seed: int, times: Sequence[float]) -> Accuracy:
    """Let a camera look for the ball at some times (s).

    Args:
        name: one of ``EYES``.
        seed: of the world.
        times: when to look.
    """
    world = World(seed)
    eye = _eyes(world)[name]
    view = FieldCamera(eye.camera, seed)
    frame: Pixels = np.empty((eye.camera.height, eye.camera.width, 2), np.uint8)
    frames = false = 0
    errors: List[float] = []
    for number, time in enumerate(times):
        truth = world.ball_on_field(time)
        pose = eye.true_pose(time)
        frames += int(_in_view(eye.camera, pose, truth))
        view.render(pose, truth, number, frame)
        finds = find_balls(pyramid(frame, FACTORS), ORANGE)
        believed = eye.believed_pose(time)
        geometry = Geometry(eye.camera, believed, BALL_RADIUS, ANGLE_ERROR, min(FACTORS))
        sighting = best_sighting(finds, geometry)
        if sighting is None:
            continue
        found = on_field(eye.believed_place(time), sighting.position)
        error = float(np.hypot(*(found - truth)[:2]))
        if error > 0.5:
            false += 1
        else:
            errors.append(error)
    return Accuracy(frames, errors, false)


def _in_view(camera: Pinhole, field_from_camera: Array, ball: Array) -> bool:
    """Whether the ball's centre is in the picture."""
    centre = apply(inverse(field_from_camera), ball)
    if centre[2] <= BALL_RADIUS:
        return False
    column, row = camera.project(centre)
    return bool(0 <= column < camera.width and 0 <= row < camera.height)
