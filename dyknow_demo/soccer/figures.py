# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Draws the figures of the documentation: ``python3 -m dyknow_demo.soccer.figures doc/images``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Optional, Sequence

import cv2
import matplotlib
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer import field
from dyknow_demo.soccer.accuracy import EYES, FACTORS, looks
from dyknow_demo.soccer.camera import FieldCamera
from dyknow_demo.soccer.ceiling import CEILING_CAMERA
from dyknow_demo.soccer.colour import ORANGE
from dyknow_demo.soccer.finder import find_balls
from dyknow_demo.soccer.nao import BOTTOM_CAMERA
from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.planes import pyramid
from dyknow_demo.soccer.rigid import Array
from dyknow_demo.soccer.world import World

matplotlib.use("Agg")
from matplotlib import pyplot  # the back end has to be chosen before

SEED = 0
_TIME = 17.0
_ROUND = [0.48 * number for number in range(200)]
_MARK = (255, 0, 255)  # BGR
_SIZE = (480, 360)


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Write the figures into a folder."""
    (folder,) = map(Path, sys.argv[1:] if argv is None else argv)
    folder.mkdir(parents=True, exist_ok=True)
    world = World(SEED)
    own = _frame(world, BOTTOM_CAMERA, world.field_from_bottom_camera(_TIME))
    above = _frame(world, CEILING_CAMERA, world.field_from_ceiling_camera())
    _write(folder / "soccer_views.png", np.hstack((_marked(own), _marked(above))))
    _write(folder / "soccer_planes.png", np.hstack(list(pyramid(own, (4,))[4])))
    _draw_ways(folder / "soccer_ways.png")
    return 0


def _frame(world: World, camera: Pinhole, pose: Array) -> Pixels:
    frame: Pixels = np.empty((camera.height, camera.width, 2), np.uint8)
    FieldCamera(camera, SEED).render(pose, world.ball_on_field(_TIME), 0, frame)
    return frame


def _marked(frame: Pixels) -> Pixels:
    """BGR with circles around what is found."""
    picture = cv2.cvtColor(frame, cv2.COLOR_YUV2BGR_UYVY)
    scale = picture.shape[1] / _SIZE[0]
    small: Pixels = cv2.resize(picture, _SIZE, interpolation=cv2.INTER_AREA)
    for find in find_balls(pyramid(frame, FACTORS), ORANGE):
        centre = round(find.centre[0] / scale), round(find.centre[1] / scale)
        cv2.circle(small, centre, round(find.radius / scale) + 4, _MARK, 2, cv2.LINE_AA)
    return small


def _write(file: Path, picture: Pixels) -> None:
    # Noise makes large files: its last bits show nothing.
    if not cv2.imwrite(str(file), picture & 0xF0, [cv2.IMWRITE_PNG_COMPRESSION, 9]):
        raise ValueError(f"cannot write '{file}'")


def _draw_ways(file: Path) -> None:
    """Draw the ball's way over the field, and where the cameras see it."""
    figure, axes = pyplot.subplots(figsize=(7.0, 4.7), dpi=100)
    length, width = field.LENGTH / 2, field.WIDTH / 2
    axes.plot(
        [-length, length, length, -length, -length], [-width, -width, width, width, -width], "0.6"
    )
    axes.plot([0, 0], [-width, width], "0.6")
    axes.add_patch(pyplot.Circle((0, 0), field.CIRCLE_RADIUS, fill=False, color="0.6"))
    for name, mark in zip(EYES, ("C0.", "C1.")):
        seen = [each for each in looks(name, SEED, _ROUND) if each.found is not None]
        found = np.array([each.found for each in seen])
        axes.plot(found[:, 0], found[:, 1], mark, markersize=4, label=f"by the {name}")
    truth = np.array([World(SEED).ball_on_field(time) for time in _ROUND])
    axes.plot(truth[:, 0], truth[:, 1], "k-", linewidth=0.8, label="truth")
    axes.set(aspect="equal", xlabel="x / m", ylabel="y / m")
    axes.legend(loc="center")
    figure.tight_layout()
    figure.savefig(file)
    pyplot.close(figure)


if __name__ == "__main__":
    sys.exit(main())
