# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The detector on real frames, and how hits are counted."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from dyknow_demo.shared_frames import SHARED_FRAMES
from dyknow_demo.soccer import evaluate
from dyknow_demo.soccer.annotations import read_frames
from dyknow_demo.soccer.finder import Find
from dyknow_demo.soccer.recall import evaluate_frame, is_hit, match, overlap

real_frames = pytest.mark.skipif(
    not SHARED_FRAMES.is_dir(), reason=f"there are no real frames in {SHARED_FRAMES}"
)


def find(box, score=1.0):
    return Find((0.0, 0.0), 0.0, box, np.zeros((0, 2)), score)


@pytest.fixture
def folder(tmp_path):
    image = np.full((400, 300, 3), (60, 120, 50), np.uint8)
    cv2.circle(image, (150, 200), 20, (40, 210, 230), -1)
    cv2.imwrite(str(tmp_path / "b.png"), image)
    (tmp_path / "b.txt").write_text("2 0.1 0.1 0.1 0.1\n0 0.5 0.5 0.1333 0.1\n\n")
    cv2.imwrite(str(tmp_path / "a.png"), np.full((400, 300, 3), (60, 120, 50), np.uint8))
    (tmp_path / "a.txt").write_text("0 0.5 0.5 0.1 0.1")
    cv2.imwrite(str(tmp_path / "unannotated.png"), image)
    return tmp_path


def test_overlap_is_intersection_over_union():
    assert overlap((0, 0, 10, 10), (0, 0, 10, 10)) == 1.0
    assert overlap((0, 0, 10, 10), (5, 0, 15, 10)) == pytest.approx(1 / 3)
    assert overlap((0, 0, 10, 10), (20, 0, 30, 10)) == 0.0


def test_a_hit_overlaps_or_shares_the_middle():
    ball = (0.0, 0.0, 20.0, 20.0)
    assert is_hit(ball, (2.0, 2.0, 20.0, 20.0))
    assert is_hit(ball, (5.0, 5.0, 15.0, 15.0))  # small, but about the same middle
    assert not is_hit(ball, (12.0, 12.0, 32.0, 32.0))
    assert not is_hit(ball, (0.0, 0.0, 4.0, 4.0))


def test_each_ball_takes_one_find():
    ball = (0.0, 0.0, 10.0, 10.0)
    finds = [find((50.0, 50.0, 60.0, 60.0)), find(ball), find(ball)]
    assert match([ball], finds) == (1,)
    assert match([ball, (40.0, 0.0, 50.0, 10.0)], finds) == (1, None)


def test_balls_found_and_missed_are_counted(folder, capsys):
    frames = read_frames(folder)
    assert [frame.image.name for frame in frames] == ["a.png", "b.png"]
    missed, found = (evaluate_frame(frame) for frame in frames)
    assert (missed.found, missed.false_finds) == (0, 0)
    assert (found.found, found.false_finds, found.best_is_ball) == (1, 0, True)
    sheet = folder / "sheet.png"
    code = evaluate.main(["--no-simulation", "--frames", str(folder), "--sheet", str(sheet)])
    assert code == 0
    output = capsys.readouterr().out
    assert "missed in: a.png" in output
    assert cv2.imread(str(sheet)).shape == (400, 9 * 304, 3)


def test_a_bad_annotation_names_its_line(folder):
    (folder / "b.txt").write_text("0 0.5 0.5 0.1 0.1\n0 0.5 x 0.1 0.1\n")
    with pytest.raises(ValueError, match=r"b\.txt:2: '0 0\.5 x 0\.1 0\.1': expected 'class x_"):
        read_frames(folder)


def test_no_frames_is_an_error(tmp_path, capsys):
    assert evaluate.main(["--no-simulation", "--frames", str(tmp_path)]) == 1
    assert "no annotated frames" in capsys.readouterr().err


@real_frames
def test_recall_on_real_frames():
    days = ("20190606", "20220715")  # of these the colour's limits are
    frames = [frame for frame in read_frames(SHARED_FRAMES) if frame.day in days]
    results = [evaluate_frame(frame) for frame in frames]
    held_out = results[1::2]  # the thresholds were set on the others
    assert sum(len(each.balls) for each in results) == len(results) == 36
    # What doc/soccer.rst states, less one for another version of OpenCV.
    assert sum(each.found for each in results) >= 32 - 1
    assert sum(each.found for each in held_out) >= 15 - 1
    assert sum(each.best_is_ball for each in results) >= 32 - 1
    assert sum(each.false_finds for each in results) <= 18 + 3
