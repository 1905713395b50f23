# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A forest that tells balls from other regions: learnt by ``dyknow_demo.soccer.learn``."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List, Sequence, Tuple

import cv2
import numpy as np

from dyknow_demo.images import Pixels
from dyknow_demo.soccer.finder import Find, full_resolution
from dyknow_demo.soccer.outline import fit_round
from dyknow_demo.soccer.regions import Region, regions
from dyknow_demo.soccer.rigid import Array

#: The shipped model, trained on all days.
MODEL = Path(__file__).with_name("ball_forest.yml.gz")
#: Threshold of the shipped model: what ``learn`` prints for the best find of a frame.
THRESHOLD = 0.16

#: Two finds overlap by at most this fraction of the smaller one's box.
_SHARED = 0.3
#: Omnidirectional cameras draw near balls as ellipses.
_STRETCH = 2.2
_TREES, _DEPTH, _LEAST, _TRIED = 40, 10, 4, 7


def train(features: Array, is_ball: Array, trees: int = _TREES) -> Any:
    """Train a forest; the same examples always give the same forest.

    Args:
        features: (n, numbers) of regions.
        is_ball: (n,), 1 for balls, else 0.
        trees: how many.
    """
    forest = cv2.ml.RTrees_create()
    forest.setMaxDepth(_DEPTH)
    forest.setMinSampleCount(_LEAST)
    forest.setActiveVarCount(_TRIED)
    forest.setRegressionAccuracy(1e-4)
    forest.setTermCriteria((cv2.TERM_CRITERIA_MAX_ITER, trees, 0))
    cv2.setRNGSeed(1)
    forest.train(features.astype(np.float32), cv2.ml.ROW_SAMPLE, is_ball.astype(np.float32))
    return forest


def load(file: Path = MODEL) -> Any:
    """Read a forest.

    Raises:
        ValueError: the file holds no forest.
    """
    try:
        return cv2.ml.RTrees_load(str(file))
    except (cv2.error, SystemError):
        raise ValueError(f"{file} is no forest") from None


def best_regions(
    found: Sequence[Region], forest: Any, threshold: float
) -> List[Tuple[float, Region]]:
    """Choose regions of at least the threshold that overlap no better one, the best first."""
    if not found:
        return []
    features = np.array([each.features for each in found], np.float32)
    scores = forest.predict(features)[1].ravel()
    chosen: List[Tuple[float, Region]] = []
    for number in np.argsort(-scores, kind="stable"):
        region, score = found[number], float(scores[number])
        if score < threshold:
            break
        if all(_shared(region.box, other.box) <= _SHARED for _, other in chosen):
            chosen.append((score, region))
    return chosen


def find_learnt(
    planes: Pixels, factor: int, forest: Any, threshold: float = THRESHOLD
) -> List[Find]:
    """Find balls in planes (3, rows, columns) at a factor, the best first."""
    finds: List[Find] = []
    for score, region in best_regions(regions(planes), forest, threshold):
        points = region.outline.reshape(-1, 2).astype(np.float64)
        limits = np.array([planes.shape[2], planes.shape[1]]) - 1
        points = points[np.all((points > 0) & (points < limits), axis=1)]
        fit = fit_round(points, _STRETCH)
        if fit is None:
            continue
        column, row = full_resolution(fit.curve.centre, factor).tolist()
        left, top, width, height = (factor * each for each in region.box)
        box = (left, top, left + width, top + height)
        outline = full_resolution(fit.points, factor)
        finds.append(Find((column, row), (fit.curve.radius + 0.5) * factor, box, outline, score))
    return finds


def _shared(one: Sequence[int], other: Sequence[int]) -> float:
    """Intersection of two boxes (left, top, width, height) as a fraction of the smaller one."""
    width = min(one[0] + one[2], other[0] + other[2]) - max(one[0], other[0])
    height = min(one[1] + one[3], other[1] + other[3]) - max(one[1], other[1])
    if width <= 0 or height <= 0:
        return 0.0
    return width * height / min(one[2] * one[3], other[2] * other[3])
