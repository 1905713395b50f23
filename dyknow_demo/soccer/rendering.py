# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The view of a camera over the simulated field, as YUV 4:2:2.

Colours are ITU-R BT.601 with its narrow range (Y 16 to 235), which OpenCV's conversions from YUV
4:2:2 assume; packed pixels are in the order UYVY, which is ROS's encoding ``yuv422``.
"""

from __future__ import annotations

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.geometry import Array, Pinhole, apply, inverse
from dyknow_demo.soccer.world import BALL_RADIUS, FIELD_LENGTH, FIELD_WIDTH

_YUV_FROM_BGR = np.array(
    [[0.098, 0.504, 0.257, 16.0], [0.439, -0.291, -0.148, 128.0], [-0.071, -0.368, 0.439, 128.0]]
)

# The field's lines in metres, its picture's metres a pixel, and the colours in BGR.
_BORDER, _LINE, CIRCLE_RADIUS = 0.7, 0.05, 0.75
_BOX_DEPTH, _BOX_WIDTH, _PENALTY_CROSS, _CROSS_SIZE = 0.6, 2.2, 1.3, 0.1
_SCALE = 0.005
_GRASS, _PAINT, _ORANGE, _LAB = (70, 120, 50), (225, 225, 225), (20, 105, 245), (120, 118, 112)

_FRACTION = 6  # bits of OpenCV's drawing functions
_RAYS = 3  # rays a pixel in each direction, for smooth edges
_NOISE = 3.0  # standard deviation of the sensor's noise, in grey levels
#: The most pixels, either way, by which the noise pattern is shifted from frame to frame.
_SHIFTS = 256


def yuv_from_bgr(pixels: Pixels) -> Pixels:
    """Convert (rows, columns, 3)."""
    converted: Pixels = cv2.transform(pixels, _YUV_FROM_BGR)
    return converted


def pack(pixels: Pixels, packed: Pixels) -> None:
    """Write YUV (rows, columns, 3) as UYVY into (rows, columns, 2); columns are even.

    Two neighbours share the colour of the left one.
    """
    packed[..., 1] = pixels[..., 0]
    packed[:, 0::2, 0] = pixels[:, 0::2, 1]
    packed[:, 1::2, 0] = pixels[:, 0::2, 2]


class FieldCamera:
    """Renders frames of one camera; the field's picture and the noise are made once."""

    def __init__(self, camera: Pinhole, seed: int) -> None:
        """Make the picture of the field and the noise for these intrinsics."""
        self.camera = camera
        self._field = yuv_from_bgr(_field(seed))
        colours = yuv_from_bgr(np.array([[_LAB, _ORANGE]], np.uint8))[0].tolist()
        self._lab, self._ball = colours
        shape = (camera.height + _SHIFTS, camera.width + _SHIFTS, 2)
        noise = np.random.default_rng([seed, 3]).standard_normal(shape, np.float32)
        noise *= _NOISE
        steps = np.rint(noise, out=noise).astype(np.int8)
        self._brighter = np.maximum(steps, 0).view(np.uint8)
        self._darker = np.maximum(-steps, 0).view(np.uint8)
        self._still: tuple[bytes, Pixels] = (b"", self._field)

    def render(self, field_from_camera: Array, ball: Array, number: int, frame: Pixels) -> None:
        """Render one frame.

        Args:
            field_from_camera: pose of the optical frame on the field.
            ball: centre (3,) on the field, m.
            number: the frame's number; frames with the same number have the same noise.
            frame: (rows, columns, 2) of UYVY to write to.
        """
        camera_from_field = inverse(field_from_camera)
        key = field_from_camera.tobytes()
        if self._still[0] != key:  # field and lab are kept as long as the camera does not move
            self._still = key, self._background(camera_from_field)
        picture = self._still[1].copy()
        centre, up = apply(camera_from_field, ball), camera_from_field[:3, 2]
        draw_ball(picture, self.camera, centre, BALL_RADIUS, self._ball, up)
        pack(picture, frame)
        row, column = np.random.default_rng(number).integers(0, _SHIFTS, 2).tolist()
        window = np.s_[row : row + frame.shape[0], column : column + frame.shape[1]]
        cv2.add(frame, self._brighter[window], dst=frame)
        cv2.subtract(frame, self._darker[window], dst=frame)

    def _background(self, camera_from_field: Array) -> Pixels:
        camera = self.camera
        map_ = camera.matrix @ camera_from_field[:3, (0, 1, 3)] @ np.linalg.inv(_PIXEL_FROM_FIELD)
        size = (camera.width, camera.height)
        warped: Pixels = cv2.warpPerspective(self._field, map_, size, borderValue=self._lab)
        # Above the horizon the field would be mirrored.
        up = camera_from_field[:3, 2]
        columns = (np.arange(camera.width) - camera.cx) / camera.fx * up[0]
        rows = (np.arange(camera.height) - camera.cy) / camera.fy * up[1]
        if columns.max() + rows.max() + up[2] >= 0:
            warped[rows[:, None] + columns + up[2] >= 0] = self._lab
        return warped


#: Homography from metres on the field to pixels of its picture.
_PIXEL_FROM_FIELD: Array = np.array(
    [
        [1 / _SCALE, 0.0, (FIELD_LENGTH / 2 + _BORDER) / _SCALE - 0.5],
        [0.0, -1 / _SCALE, (FIELD_WIDTH / 2 + _BORDER) / _SCALE - 0.5],
        [0.0, 0.0, 1.0],
    ]
)


def _field(seed: int) -> Pixels:
    """Draw the field from above, (rows, columns, 3), BGR; the grass is mottled."""
    rows, columns = (round((each + 2 * _BORDER) / _SCALE) for each in (FIELD_WIDTH, FIELD_LENGTH))
    mottle = np.random.default_rng(seed).normal(0.0, 14.0, (rows // 8, columns // 8))
    shade = cv2.resize(mottle.astype(np.float32), (columns, rows))
    field: Pixels = cv2.merge([cv2.convertScaleAbs(cv2.max(shade + each, 0)) for each in _GRASS])

    def point(x: float, y: float) -> tuple[int, ...]:
        pixel = _PIXEL_FROM_FIELD @ (x, y, 1.0) * (1 << _FRACTION)
        return tuple(round(each) for each in pixel[:2].tolist())

    half, side_line, arm = FIELD_LENGTH / 2, FIELD_WIDTH / 2, _CROSS_SIZE / 2
    strokes = [(-half, -side_line, half, side_line), (0.0, -side_line, 0.0, side_line)]
    for side in (-1, 1):
        spot = side * (half - _PENALTY_CROSS)
        strokes += [
            (side * (half - _BOX_DEPTH), -_BOX_WIDTH / 2, side * half, _BOX_WIDTH / 2),
            (spot - arm, 0.0, spot + arm, 0.0),
            (spot, -arm, spot, arm),
        ]
    pen = (_PAINT, round(_LINE / _SCALE), cv2.LINE_AA, _FRACTION)
    for x0, y0, x1, y1 in strokes:
        cv2.rectangle(field, point(x0, y0), point(x1, y1), *pen)
    cv2.circle(field, point(0.0, 0.0), round(CIRCLE_RADIUS / _SCALE * (1 << _FRACTION)), *pen)
    return field


def draw_ball(
    picture: Pixels,
    camera: Pinhole,
    centre: Array,
    radius: float,
    colour: tuple[int, int, int],
    up: Array,
) -> None:
    """Draw a ball that is lit from above: exactly, from the rays of each pixel.

    Args:
        picture: (rows, columns, 3), YUV; changed.
        camera: intrinsics.
        centre: of the ball (3,), in the optical frame, m.
        radius: m.
        colour: of its upper side, YUV.
        up: unit vector (3,) towards the light, in the optical frame.
    """
    if centre[2] < 2 * radius:
        return
    # A silhouette is an ellipse, longer the further it is from the optical axis.
    reach = radius / (centre[2] - radius) * np.linalg.norm(centre) / centre[2]
    middle, half = camera.project(centre), np.array([camera.fx, camera.fy]) * reach + 2
    size = (camera.width, camera.height)
    left, top = np.clip((middle - half).astype(int), 0, size).tolist()
    right, bottom = np.clip((middle + half).astype(int) + 1, 0, size).tolist()
    if left >= right or top >= bottom:
        return
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
    shape = (bottom - top, _RAYS, right - left, _RAYS)
    part, shade = (
        each.reshape(shape).mean(axis=(1, 3))[..., None] for each in (hit.astype(float), light)
    )
    black = np.array([16.0, 128.0, 128.0])
    patch = picture[top:bottom, left:right]
    lit = shade * (np.array(colour, np.float64) - black) + part * black
    patch[...] = np.clip((1 - part) * patch + lit + 0.5, 0, 255).astype(np.uint8)
