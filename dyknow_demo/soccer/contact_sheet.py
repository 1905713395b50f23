# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""One picture of all frames, with the annotated balls and the finds."""

from __future__ import annotations

from pathlib import Path
from typing import Sequence

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.recall import FrameResult

_BALL, _HIT, _FALSE = (255, 0, 255), (255, 120, 0), (0, 0, 255)  # BGR
_COLUMNS = 9
_TILE = (304, 400)  # width and height


def write_sheet(results: Sequence[FrameResult], file: Path) -> None:
    """Write the sheet as PNG: balls in magenta, finds in blue if they hit one, else in red.

    Raises:
        ValueError: the file cannot be written.
    """
    tiles = [_tile(each) for each in results]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % _COLUMNS)
    rows = [np.hstack(tiles[at : at + _COLUMNS]) for at in range(0, len(tiles), _COLUMNS)]
    if not cv2.imwrite(str(file), np.vstack(rows)):
        raise ValueError(f"cannot write '{file}'")


def _tile(result: FrameResult) -> Pixels:
    drawn = result.pixels.copy()
    for box in result.balls:
        left, top, right, bottom = (round(each) for each in box)
        cv2.rectangle(drawn, (left, top), (right, bottom), _BALL, 2)
    for number, find in enumerate(result.finds):
        colour = _HIT if number in result.hits else _FALSE
        centre = round(find.centre[0]), round(find.centre[1])
        cv2.circle(drawn, centre, round(find.radius) + 3, colour, 3)
    tile: Pixels = cv2.resize(drawn, _TILE, interpolation=cv2.INTER_AREA)
    return tile
