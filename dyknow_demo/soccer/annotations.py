# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Annotated frames: images with a text file beside each, in the format of the YOLO detectors.

A line is ``class x_center y_center width height``, the last four as fractions of the image's size.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import List, Tuple

#: The class of balls.
BALL = 0

_SUFFIXES = (".jpg", ".jpeg", ".png")


@dataclass(frozen=True)
class AnnotatedFrame:
    """An image file and where the balls in it are.

    Attributes:
        image: the file.
        balls: x and y of the centre, width, height, as fractions of the image's size.
    """

    image: Path
    balls: Tuple[Tuple[float, float, float, float], ...]

    @property
    def day(self) -> str:
        """Second part of a name such as cam0_20190606_204236.jpg; otherwise the whole name."""
        parts = self.image.stem.split("_")
        return parts[1] if len(parts) > 1 else self.image.stem


def read_frames(folder: Path) -> List[AnnotatedFrame]:
    """Find the annotated images of a folder, sorted by name.

    Raises:
        ValueError: an annotation does not have that form; the message names file and line.
    """
    images = sorted(each for each in folder.iterdir() if each.suffix.lower() in _SUFFIXES)
    return [
        AnnotatedFrame(image, tuple(_balls(image.with_suffix(".txt"))))
        for image in images
        if image.with_suffix(".txt").is_file()
    ]


def _balls(file: Path) -> List[Tuple[float, float, float, float]]:
    balls = []
    for number, line in enumerate(file.read_text().splitlines(), 1):
        words = line.split()
        if not words:
            continue
        try:
            kind, (x, y, width, height) = int(words[0]), map(float, words[1:])
        except ValueError:
            expected = "class x_center y_center width height"
            raise ValueError(f"{file}:{number}: '{line}': expected '{expected}'") from None
        if kind == BALL:
            balls.append((x, y, width, height))
    return balls
