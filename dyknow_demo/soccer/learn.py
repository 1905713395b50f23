# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Trains the ball's forest and evaluates it: ``python3 -m dyknow_demo.soccer.learn --frames DIR``.

Each day is left out once, and a forest trained on the other days is evaluated on it. The threshold
is found from the other days alone: each of them is left out in turn, and the threshold is the
lowest at which the best finds of all these days reach the wanted precision. With ``--model`` a
forest trained on all days is written; the same frames always give the same file.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path
from typing import Any, List, NamedTuple, Sequence, Tuple

import cv2
import numpy as np
from tqdm import tqdm

from dyknow_demo.images import Pixels, pyramid
from dyknow_demo.soccer.finder import YELLOW, Box, find_balls
from dyknow_demo.soccer.geometry import Array
from dyknow_demo.soccer.learnt import Region, best_regions, regions
from dyknow_demo.soccer.rendering import pack, yuv_from_bgr

#: Where real camera frames may lie: beside the checkout.
SHARED_FRAMES = Path(__file__).resolve().parents[3] / "shared" / "data" / "robocup_msl"
_SUFFIXES = (".jpg", ".jpeg", ".png")
#: Wanted precision of the finds, in the validation that sets the threshold.
PRECISION = 0.88
_THRESHOLDS = np.round(np.arange(0.1, 0.97, 0.02), 2)
#: Training pictures made from each frame: itself and some in another light, by gains of the three
#: colours and a gamma, whose logarithms have these standard deviations.
_LIGHTS, _GAIN, _GAMMA = 4, 0.08, 0.2
_FACTOR = 2
_NEGATIVES = 16  # of a picture
_BALL, _NO_BALL = 0.5, 0.3  # intersection over union with a ball
_TREES, _INNER_TREES = 40, 20

#: Of a frame: score of each find, the best first, and whether it is a ball.
Scored = List[Tuple[float, bool]]


class AnnotatedFrame(NamedTuple):
    """An image file and the centre x, y, width and height of balls, as fractions of its size."""

    image: Path
    balls: Sequence[Box]

    @property
    def day(self) -> str:
        """Second part of a name such as cam0_20190606_204236.jpg; otherwise the whole name."""
        parts = self.image.stem.split("_")
        return parts[1] if len(parts) > 1 else self.image.stem

    def pixels(self) -> Pixels:
        """Read the image, BGR; raises ValueError if the file is none."""
        pixels: Pixels | None = cv2.imread(str(self.image), cv2.IMREAD_COLOR)
        if pixels is None:
            raise ValueError(f"{self.image} is no image")
        return pixels

    def boxes(self, pixels: Pixels) -> list[Box]:
        """Boxes of the balls in pixels of the image."""
        height, width = pixels.shape[:2]
        return [
            ((x - w / 2) * width, (y - h / 2) * height, (x + w / 2) * width, (y + h / 2) * height)
            for x, y, w, h in self.balls
        ]


def read_frames(folder: Path) -> list[AnnotatedFrame]:
    """Find the annotated images of a folder, sorted by name.

    Beside each is a text file in the format of the YOLO detectors; class 0 are balls.

    Raises:
        ValueError: an annotation does not have that form; the message names file and line.
    """
    images = sorted(each for each in folder.iterdir() if each.suffix.lower() in _SUFFIXES)
    files = [(image, image.with_suffix(".txt")) for image in images]
    return [AnnotatedFrame(image, _balls(text)) for image, text in files if text.is_file()]


def _balls(file: Path) -> list[Box]:
    balls = []
    for number, line in enumerate(file.read_text().splitlines(), 1):
        if not line.strip():
            continue
        try:
            kind, x, y, width, height = map(float, line.split())
        except ValueError:
            expected = "class x_center y_center width height"
            raise ValueError(f"{file}:{number}: '{line}': expected '{expected}'") from None
        if kind == 0:
            balls.append((x, y, width, height))
    return balls


def planes_from_bgr(pixels: Pixels, factor: int) -> Pixels:
    """Make the planes of a BGR image at one factor, converted to YUV 4:2:2 first."""
    even = pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2]
    packed: Pixels = np.empty((*even.shape[:2], 2), np.uint8)
    pack(yuv_from_bgr(even), packed)
    return pyramid(packed, (factor,))[factor]


def is_hit(ball: Box, find: Box) -> bool:
    """Whether the boxes overlap by half of their union, or each holds the centre of the other.

    A ball of 20 pixels that is off by two has a union that is mostly edge.
    """
    return overlap(ball, find) >= _BALL or (_holds(ball, find) and _holds(find, ball))


def overlap(one: Box, other: Box) -> float:
    """Intersection over union of two boxes."""
    width = max(min(one[2], other[2]) - max(one[0], other[0]), 0)
    height = max(min(one[3], other[3]) - max(one[1], other[1]), 0)
    areas = ((box[2] - box[0]) * (box[3] - box[1]) for box in (one, other))
    return width * height / (sum(areas) - width * height)


def _holds(box: Box, other: Box) -> bool:
    x, y = (other[0] + other[2]) / 2, (other[1] + other[3]) / 2
    return box[0] <= x <= box[2] and box[1] <= y <= box[3]


class Example(NamedTuple):
    """One frame."""

    balls: int  # number of annotated balls
    by_limits: bool  # whether the best find by the fixed limits of the colour yellow is a ball
    found: Sequence[Region]  # regions of the frame as it is
    hits: Sequence[bool]  # for each region whether it hits a ball
    features: Sequence[Array]  # (n, numbers) of regions to learn from, in several lights
    is_ball: Sequence[float]  # 1 for balls, else 0


def example_of(frame: AnnotatedFrame, number: int) -> Example:
    """Make an example of a frame; its number seeds the random lights."""
    pixels = frame.pixels()
    balls = frame.boxes(pixels)
    generator = np.random.default_rng(number)
    found = some = regions(planes_from_bgr(pixels, _FACTOR))
    features, is_ball = [], []
    for light in range(_LIGHTS):
        if light:
            some = regions(planes_from_bgr(_lit(pixels, generator), _FACTOR))
        most = np.array(
            [max((overlap(ball, _box(each)) for ball in balls), default=0) for each in some]
        )
        good = np.flatnonzero(most >= _BALL)
        bad = generator.permutation(np.flatnonzero(most < _NO_BALL))[:_NEGATIVES]
        features += [some[each].features for each in (*good, *bad)]
        is_ball += [1.0] * len(good) + [0.0] * len(bad)
    hits = [any(is_hit(ball, _box(each)) for ball in balls) for each in found]
    limited = find_balls({each: planes_from_bgr(pixels, each) for each in (2, 4)}, YELLOW)[:1]
    by_limits = any(is_hit(ball, each.box) for each in limited for ball in balls)
    return Example(len(balls), by_limits, found, hits, features, is_ball)


def _lit(pixels: Pixels, generator: np.random.Generator) -> Pixels:
    gains = np.exp(generator.normal(0.0, _GAIN, 3))
    gamma = float(np.exp(generator.normal(0.0, _GAMMA)))
    curve = 255 * np.linspace(0.0, 1.0, 256) ** gamma
    table = np.clip(curve[None, :, None] * gains, 0, 255).astype(np.uint8)
    lit: Pixels = cv2.LUT(pixels, table)
    return lit


def _box(region: Region) -> Box:
    left, top, width, height = (float(_FACTOR * each) for each in region.box)
    return left, top, left + width, top + height


def train(examples: Sequence[Example], trees: int = _TREES) -> Any:
    """Train a forest; the same examples always give the same forest."""
    features = np.array([each for some in examples for each in some.features], np.float32)
    is_ball = np.array([each for some in examples for each in some.is_ball], np.float32)
    forest = cv2.ml.RTrees_create()
    forest.setMaxDepth(10)
    forest.setMinSampleCount(4)
    forest.setActiveVarCount(7)
    forest.setRegressionAccuracy(1e-4)
    forest.setTermCriteria((cv2.TERM_CRITERIA_MAX_ITER, trees, 0))
    cv2.setRNGSeed(1)
    forest.train(features, cv2.ml.ROW_SAMPLE, is_ball)
    return forest


def score(examples: Sequence[Example], forest: Any) -> list[Scored]:
    """Score the regions of each frame by the forest."""
    scored = []
    for each in examples:
        hits = {id(region): hit for region, hit in zip(each.found, each.hits)}
        best = best_regions(each.found, forest, float(_THRESHOLDS[0]))
        scored.append([(value, hits[id(region)]) for value, region in best])
    return scored


def count(scored: Sequence[Scored], threshold: float) -> tuple[int, int]:
    """Count balls and false ones among the best finds of the frames."""
    best = [frame[0][1] for frame in scored if frame and frame[0][0] >= threshold]
    return sum(best), len(best) - sum(best)


def precision(found: int, false: int) -> float:
    """Fraction of the finds that are balls; 1 without finds."""
    return found / (found + false) if found + false else 1.0


def choose(scored: Sequence[Scored]) -> float:
    """Choose the lowest threshold with the wanted precision, or else the most precise one."""
    precise = [precision(*count(scored, each)) for each in _THRESHOLDS]
    good = [each for each, value in zip(_THRESHOLDS, precise) if value >= PRECISION]
    return float(good[0] if good else _THRESHOLDS[int(np.argmax(precise))])


def main(argv: Sequence[str] | None = None) -> int:
    """Train, evaluate and print; returns 1 if the frames are of fewer than three days."""
    parser = argparse.ArgumentParser(prog="dyknow_demo.soccer.learn", description=__doc__)
    parser.add_argument(
        "--frames",
        type=Path,
        default=SHARED_FRAMES,
        metavar="DIR",
        help="folder of images CAMERA_DAY_TIME with YOLO annotations (%(default)s)",
    )
    parser.add_argument("--model", type=Path, metavar="YML.GZ", help="write a forest of all days")
    parser.add_argument("--no-judging", action="store_true", help="do not leave days out")
    options = parser.parse_args(argv)
    frames = read_frames(options.frames) if options.frames.is_dir() else []
    if len({each.day for each in frames}) < 3:
        print(f"no annotated frames of three days in '{options.frames}'", file=sys.stderr)
        return 1
    cv2.setNumThreads(1)
    days: dict[str, list[Example]] = {}
    for number, frame in enumerate(tqdm(frames, unit="frame", disable=None, leave=False)):
        days.setdefault(frame.day, []).append(example_of(frame, number))
    if not options.no_judging:
        print(f"threshold for the forest of all days: {_judge(days):.2f}")
    if options.model is not None:
        train([each for day in days.values() for each in day]).save(str(options.model))
        print(f"model: {options.model}, {options.model.stat().st_size // 1000} kB")
    return 0


def _judge(days: dict[str, list[Example]]) -> float:
    """Print the scores of each day that is left out; return the threshold for all days."""
    inner: dict[tuple[str, str], list[Scored]] = {}
    outer: dict[str, list[Scored]] = {}
    pairs = list(itertools.combinations_with_replacement(days, 2))
    for one, other in tqdm(pairs, unit="forest", disable=None, leave=False):
        rest = [each for day in days if day not in (one, other) for each in days[day]]
        forest = train(rest, _TREES if one == other else _INNER_TREES)
        if one == other:
            outer[one] = score(days[one], forest)
        else:
            inner[one, other] = score(days[one], forest)
            inner[other, one] = score(days[other], forest)
    print("best find of a frame, each day left out")
    print(f"{'day':10}{'balls':>6}{'limits':>7}{'regions':>8}{'found':>6}{'false':>6}", end="")
    print(f"{'recall':>8}{'precision':>10}{'threshold':>10}")
    rates = []
    for day, examples in days.items():
        threshold = choose([frame for one in days if one != day for frame in inner[one, day]])
        balls = sum(each.balls for each in examples)
        there = sum(any(each.hits) for each in examples)
        found, false = count(outer[day], threshold)
        rates.append((found / balls if balls else float("nan"), precision(found, false)))
        limited = sum(each.by_limits for each in examples)
        print(f"{day:10}{balls:6}{limited:7}{there:8}{found:6}{false:6}", end="")
        print("{:8.2f}{:10.2f}{:10.2f}".format(*rates[-1], threshold))
    print("{:43}{:8.2f}{:10.2f}\n".format("mean", *np.mean(rates, axis=0)))
    return choose([frame for day in outer.values() for frame in day])


if __name__ == "__main__":
    sys.exit(main())
