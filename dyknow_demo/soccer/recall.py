# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Recall and false finds of the detector in annotated frames.

A find hits a ball when the intersection of their boxes is at least ``OVERLAP`` of their union, or
when its centre lies inside the ball's box and the ball's centre inside the find's box: a
ball of 20 pixels that is off by two has a union that is mostly edge. The box of a find is that of
its region, so a ball that is half out of the image is compared by its visible part.
Each ball is hit by at most one find; all other finds are false.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.annotations import AnnotatedFrame
from dyknow_demo.soccer.colour import YELLOW, Colour
from dyknow_demo.soccer.finder import Find, Limits, find_balls
from dyknow_demo.soccer.planes import pyramid
from dyknow_demo.soccer.yuv import pack, yuv_from_bgr

#: Least intersection over union.
OVERLAP = 0.5
FACTORS = (2, 4)

#: Omnidirectional cameras distort near balls; balls of less than 10 pixels do not count.
LIMITS = Limits(area=25, size=0.25, stretch=2.2)

Box = Tuple[float, float, float, float]


@dataclass(frozen=True)
class FrameResult:
    """What was found in a frame; boxes are left, top, right, bottom in pixels.

    Attributes:
        frame: the frame.
        pixels: its image, BGR.
        balls: boxes of the annotated balls.
        finds: all finds, the best first.
        hits: for each ball the index of the find that hits it, or None.
    """

    frame: AnnotatedFrame
    pixels: Pixels
    balls: Tuple[Box, ...]
    finds: Tuple[Find, ...]
    hits: Tuple[Any, ...]

    @property
    def found(self) -> int:
        """Balls that are hit by some find."""
        return sum(hit is not None for hit in self.hits)

    @property
    def best_is_ball(self) -> bool:
        """Whether the best find hits a ball."""
        return 0 in self.hits

    @property
    def false_finds(self) -> int:
        """Finds that hit no ball."""
        return len(self.finds) - self.found


def evaluate_frame(
    frame: AnnotatedFrame, colour: Colour = YELLOW, limits: Limits = LIMITS
) -> FrameResult:
    """Look for balls in one frame.

    Raises:
        ValueError: the file is no image.
    """
    pixels = read_image(frame)
    finds = tuple(find_in_bgr(pixels, colour, limits))
    balls = boxes_of(frame, pixels)
    return FrameResult(frame, pixels, balls, finds, match(balls, finds))


def read_image(frame: AnnotatedFrame) -> Pixels:
    """Read the image of a frame, BGR.

    Raises:
        ValueError: the file is no image.
    """
    pixels: Optional[Pixels] = cv2.imread(str(frame.image), cv2.IMREAD_COLOR)
    if pixels is None:
        raise ValueError(f"{frame.image} is no image")
    return pixels


def boxes_of(frame: AnnotatedFrame, pixels: Pixels) -> Tuple[Box, ...]:
    """Boxes of a frame's balls in pixels of its image."""
    height, width = pixels.shape[:2]
    return tuple(
        ((x - w / 2) * width, (y - h / 2) * height, (x + w / 2) * width, (y + h / 2) * height)
        for x, y, w, h in frame.balls
    )


def find_in_bgr(pixels: Pixels, colour: Colour, limits: Limits = LIMITS) -> List[Find]:
    """Find balls in a BGR image, converted to YUV 4:2:2 first as a camera would deliver it."""
    return find_balls(pyramid(_packed(pixels), FACTORS), colour, limits)


def planes_from_bgr(pixels: Pixels, factor: int) -> Pixels:
    """Make the planes of a BGR image at one factor, converted to YUV 4:2:2 first."""
    return pyramid(_packed(pixels), (factor,))[factor]


def _packed(pixels: Pixels) -> Pixels:
    even = pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2]
    packed: Pixels = np.empty((*even.shape[:2], 2), np.uint8)
    pack(yuv_from_bgr(even), packed)
    return packed


def match(balls: Sequence[Box], finds: Sequence[Find]) -> Tuple[Any, ...]:
    """Assign to each ball the best find that hits it and is not assigned yet."""
    taken: Dict[int, int] = {}
    for number, find in enumerate(finds):
        for ball, box in enumerate(balls):
            if ball not in taken and is_hit(box, find.box):
                taken[ball] = number
                break
    return tuple(taken.get(ball) for ball in range(len(balls)))


def is_hit(ball: Box, find: Box) -> bool:
    """Whether a find's box hits a ball's box."""
    if overlap(ball, find) >= OVERLAP:
        return True
    return _holds(ball, find) and _holds(find, ball)


def overlap(one: Box, other: Box) -> float:
    """Intersection over union of two boxes."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    if width <= 0 or height <= 0:
        return 0.0
    both = width * height
    return both / (_area(one) + _area(other) - both)


def _area(box: Box) -> float:
    return (box[2] - box[0]) * (box[3] - box[1])


def _holds(box: Box, other: Box) -> bool:
    """Whether the middle of the other box lies in a box."""
    x, y = (other[0] + other[2]) / 2, (other[1] + other[3]) / 2
    return box[0] <= x <= box[2] and box[1] <= y <= box[3]
