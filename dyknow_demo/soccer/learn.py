# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Trains the ball's forest and evaluates it: ``python3 -m dyknow_demo.soccer.learn --frames DIR``.

Each day is left out once, and a forest trained on the other days is evaluated on it. The threshold
is found from the other days alone: each of them is left out in turn, and the threshold is the
lowest at which the finds of all these days together reach the wanted precision. With ``--model`` a
forest trained on all days is written; the same frames always give the same file.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np
from tqdm import tqdm

from dyknow_demo.images import Pixels
from dyknow_demo.shared_frames import SHARED_FRAMES
from dyknow_demo.soccer.annotations import AnnotatedFrame, read_frames
from dyknow_demo.soccer.forest import best_regions, train
from dyknow_demo.soccer.recall import Box, boxes_of, is_hit, overlap, planes_from_bgr, read_image
from dyknow_demo.soccer.regions import Region, regions
from dyknow_demo.soccer.rigid import Array

#: Wanted precision of the finds, in the validation that sets the threshold.
PRECISION = 0.88
_THRESHOLDS = np.round(np.arange(0.1, 0.97, 0.02), 2)

#: Training pictures made from each frame: itself and some in another light.
_LIGHTS = 4
_GAIN, _GAMMA = 0.08, 0.2  # standard deviations of their logarithms

_FACTOR = 2
_NEGATIVES = 16  # of a picture
_BALL, _NO_BALL = 0.5, 0.3  # intersection over union with a ball
_INNER_TREES = 20

Scored = List[Tuple[float, bool]]


@dataclass(frozen=True)
class Example:
    """One frame.

    Attributes:
        day: the day on which it was taken.
        balls: number of annotated balls.
        found: regions of the frame as it is.
        hits: for each region whether it hits a ball.
        features: (n, numbers) of regions to learn from, in several lights.
        is_ball: (n,) 1 for balls, else 0.
    """

    day: str
    balls: int
    found: Sequence[Region]
    hits: Sequence[bool]
    features: Array
    is_ball: Array


@dataclass(frozen=True)
class DetectionScore:
    """What was found on some days.

    Attributes:
        balls: number of annotated balls.
        hits: balls that were found.
        false: number of finds that are not balls.
    """

    balls: int
    hits: int
    false: int

    @property
    def recall(self) -> float:
        """Fraction of the balls that were found."""
        return self.hits / self.balls if self.balls else float("nan")

    @property
    def precision(self) -> float:
        """Fraction of the finds that are balls; 1 without finds."""
        finds = self.hits + self.false
        return self.hits / finds if finds else 1.0


def example_of(frame: AnnotatedFrame, number: int) -> Example:
    """Make an example of a frame; its number seeds the random lights."""
    pixels = read_image(frame)
    balls = boxes_of(frame, pixels)
    generator = np.random.default_rng(number)
    found = regions(planes_from_bgr(pixels, _FACTOR))
    features, is_ball = [], []
    for light in range(_LIGHTS):
        some = found if light == 0 else regions(planes_from_bgr(_lit(pixels, generator), _FACTOR))
        most = np.array([_most(balls, each) for each in some])
        good = np.flatnonzero(most >= _BALL)
        bad = generator.permutation(np.flatnonzero(most < _NO_BALL))[:_NEGATIVES]
        features += [some[each].features for each in (*good, *bad)]
        is_ball += [1.0] * len(good) + [0.0] * len(bad)
    hits = [any(is_hit(ball, _box(each)) for ball in balls) for each in found]
    return Example(frame.day, len(balls), found, hits, np.array(features), np.array(is_ball))


def learn(examples: Sequence[Example], trees: Optional[int] = None) -> Any:
    """Train a forest of examples."""
    some = [each for each in examples if len(each.is_ball)]
    features = np.vstack([each.features for each in some])
    is_ball = np.hstack([each.is_ball for each in some])
    return train(features, is_ball) if trees is None else train(features, is_ball, trees)


def score(examples: Sequence[Example], forest: Any) -> List[Scored]:
    """Score the regions of each frame by the forest, with whether each is a ball."""
    scored = []
    for each in examples:
        hits = {id(region): hit for region, hit in zip(each.found, each.hits)}
        best = best_regions(each.found, forest, float(_THRESHOLDS[0]))
        scored.append([(value, hits[id(region)]) for value, region in best])
    return scored


def judge(
    scored: Sequence[Scored], balls: int, threshold: float, only_best: bool
) -> DetectionScore:
    """Count finds and balls, with only the best find of each frame, or with all of them."""
    hits = false = 0
    for frame in scored:
        finds = [hit for value, hit in frame if value >= threshold][: 1 if only_best else None]
        hits += int(any(finds))
        false += len(finds) - int(any(finds))
    return DetectionScore(balls, hits, false)


def choose(scored: Sequence[Scored], only_best: bool) -> float:
    """Choose the lowest threshold with the wanted precision, or else the most precise one."""
    precise = [judge(scored, 1, float(each), only_best).precision for each in _THRESHOLDS]
    good = [number for number, value in enumerate(precise) if value >= PRECISION]
    return float(_THRESHOLDS[good[0] if good else int(np.argmax(precise))])


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Train, evaluate and print.

    Returns:
        0, or 1 if the frames are of fewer than three days.
    """
    options = _parse(argv)
    frames = read_frames(options.frames) if options.frames.is_dir() else []
    if len({each.day for each in frames}) < 3:
        print(f"no annotated frames of three days in '{options.frames}'", file=sys.stderr)
        return 1
    cv2.setNumThreads(1)
    quiet = not sys.stderr.isatty()
    bar = tqdm(frames, desc="frames", unit="frame", disable=quiet, leave=False)
    days: Dict[str, List[Example]] = {}
    for number, frame in enumerate(bar):
        days.setdefault(frame.day, []).append(example_of(frame, number))
    thresholds = _judge_days(days, quiet) if not options.no_judging else {}
    for kind, threshold in thresholds.items():
        print(f"threshold for the forest of all days, {kind}: {threshold:.2f}")
    if options.model is not None:
        learn([each for day in days.values() for each in day]).save(str(options.model))
        print(f"model: {options.model}, {options.model.stat().st_size // 1000} kB")
    return 0


def _judge_days(days: Dict[str, List[Example]], quiet: bool) -> Dict[str, float]:
    """Print the scores of each day that is left out; return the thresholds for all days."""
    inner: Dict[Tuple[str, str], List[Scored]] = {}
    outer: Dict[str, List[Scored]] = {}
    pairs = [*itertools.combinations(days, 2), *((day, day) for day in days)]
    for one, other in tqdm(pairs, desc="forests", unit="forest", disable=quiet, leave=False):
        rest = [each for day in days if day not in (one, other) for each in days[day]]
        if one == other:
            outer[one] = score(days[one], learn(rest))
        else:
            forest = learn(rest, _INNER_TREES)
            inner[one, other] = score(days[one], forest)
            inner[other, one] = score(days[other], forest)
    answer = {}
    for kind, only_best in (("best find of a frame", True), ("all finds", False)):
        print(f"{kind}, each day left out")
        print(f"{'day':10}{'balls':>6}{'regions':>8}{'found':>6}{'false':>6}", end="")
        print(f"{'recall':>8}{'precision':>10}{'threshold':>10}")
        verdicts = []
        for day, examples in days.items():
            others = [frame for one in days if one != day for frame in inner[one, day]]
            threshold = choose(others, only_best)
            balls = sum(each.balls for each in examples)
            there = sum(any(each.hits) for each in examples)
            verdict = judge(outer[day], balls, threshold, only_best)
            verdicts.append(verdict)
            print(f"{day:10}{balls:6}{there:8}{verdict.hits:6}{verdict.false:6}", end="")
            print(f"{verdict.recall:8.2f}{verdict.precision:10.2f}{threshold:10.2f}")
        recall = np.mean([each.recall for each in verdicts])
        precision = np.mean([each.precision for each in verdicts])
        print(f"{'mean':36}{recall:8.2f}{precision:10.2f}\n")
        answer[kind] = choose([frame for day in outer.values() for frame in day], only_best)
    return answer


def _parse(argv: Optional[Sequence[str]]) -> Any:
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
    return parser.parse_args(argv)


def _lit(pixels: Pixels, generator: np.random.Generator) -> Pixels:
    """Show the picture in another light: gains of the three colours, and a gamma."""
    gains = np.exp(generator.normal(0.0, _GAIN, 3))
    gamma = float(np.exp(generator.normal(0.0, _GAMMA)))
    curve = 255 * np.linspace(0.0, 1.0, 256) ** gamma
    table = np.clip(curve[None, :, None] * gains, 0, 255).astype(np.uint8)
    lit: Pixels = cv2.LUT(pixels, table)
    return lit


def _box(region: Region) -> Box:
    left, top, width, height = (float(_FACTOR * each) for each in region.box)
    return left, top, left + width, top + height


def _most(balls: Sequence[Box], region: Region) -> float:
    return max((overlap(ball, _box(region)) for ball in balls), default=0.0)


if __name__ == "__main__":
    sys.exit(main())
