# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Balls in annotated frames: how hits are counted, candidates, training, the shipped model."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from dyknow_demo.soccer import learn, learnt
from dyknow_demo.soccer.learn import SHARED_FRAMES, planes_from_bgr, read_frames
from dyknow_demo.soccer.learnt import regions
from dyknow_demo.soccer.nodelets import BallDetector

YELLOWS = {"warm": (40, 210, 230), "pale": (150, 205, 215), "dim": (25, 95, 100)}
OFF_LIMITS = (75, 120, 130)  # as in a dim hall
RED = (40, 40, 200)


def field(seed=0):
    mottle = np.random.default_rng(seed).normal(0, 6, (400, 300, 3))
    image = np.clip(mottle + np.array([60, 120, 50]), 0, 255).astype(np.uint8)
    cv2.rectangle(image, (0, 0), (299, 150), (70, 70, 75), -1)
    return image


def with_ball(centre, radius, colour, seed=0):
    image = field(seed)
    cv2.rectangle(image, (30, 220), (50, 310), colour, -1)
    cv2.circle(image, centre, radius, colour, -1)
    return image


@pytest.fixture
def folder(tmp_path):
    for day in range(4):
        for number in range(2):
            x, y, radius = 120 + 40 * number, 200 + 30 * day, 12 + 3 * number
            colour = list(YELLOWS.values())[day % 3]
            name = tmp_path / f"cam0_2026010{day}_{number}"
            cv2.imwrite(f"{name}.png", with_ball((x, y), radius, colour, 10 * day + number))
            size = 2 * radius + 1
            line = f"0 {x / 300} {y / 400} {size / 300} {size / 400}"
            name.with_suffix(".txt").write_text(line)
    return tmp_path


@pytest.mark.parametrize("colour", YELLOWS.values(), ids=list(YELLOWS))
def test_a_ball_is_a_region_of_its_own_in_any_light(colour):
    found = regions(planes_from_bgr(with_ball((200, 250), 20, colour), 2))
    near = [each.box for each in found if abs(each.box[0] + each.box[2] / 2 - 100) < 2]
    assert any(abs(width - 20) <= 3 and abs(height - 20) <= 3 for _, _, width, height in near)


def test_the_same_frames_give_the_same_file(folder, tmp_path):
    files = [tmp_path / "one.yml.gz", tmp_path / "other.yml.gz"]
    for file in files:
        arguments = ["--frames", str(folder), "--no-judging", "--model", str(file)]
        assert learn.main(arguments) == 0
    assert files[0].read_bytes() == files[1].read_bytes()


def test_days_that_are_left_out_are_judged(folder, capsys):
    assert learn.main(["--frames", str(folder)]) == 0
    output = capsys.readouterr().out
    assert output.count("20260103") == 1
    assert "mean" in output and "threshold for the forest of all days" in output


def test_fewer_than_three_days_are_an_error(tmp_path, capsys):
    assert learn.main(["--frames", str(tmp_path)]) == 1
    assert "three days" in capsys.readouterr().err


def test_a_threshold_is_the_least_one_that_is_precise():
    scored = [[(0.9, True)], [(0.6, True), (0.3, False)], [(0.5, False)]]
    assert learn.choose(scored) == pytest.approx(0.52)
    assert learn.count(scored, 0.2) == (2, 1)
    assert learn.count(scored, 0.52) == (2, 0)


def test_the_shipped_forest_is_small_and_prefers_a_drawn_ball_to_a_bar():
    assert learnt.MODEL.stat().st_size < 500_000
    model = learnt.load_forest()
    planes = planes_from_bgr(with_ball((200, 250), 20, YELLOWS["warm"]), 2)
    find = learnt.find_learnt(planes, 2, model)[0]
    assert find.centre == pytest.approx((200, 250), abs=2)
    assert find.radius == pytest.approx(20, abs=3)
    red = field()
    cv2.rectangle(red, (100, 200), (250, 260), RED, -1)
    others = learnt.find_learnt(planes_from_bgr(red, 2), 2, model)
    assert all(other.score < find.score / 2 for other in others)


def test_the_nodelet_finds_a_dim_pale_ball_only_by_what_was_learnt():
    planes = planes_from_bgr(with_ball((200, 250), 20, OFF_LIMITS), 2)
    pyramid = {2: planes, 4: planes_from_bgr(with_ball((200, 250), 20, OFF_LIMITS), 4)}
    assert BallDetector.finder_of("yellow")(pyramid) == []
    finds = BallDetector.finder_of("learnt")(pyramid)
    assert any(find.centre == pytest.approx((200, 250), abs=2) for find in finds)


def test_what_is_no_forest_is_named(tmp_path):
    file = tmp_path / "some.yml.gz"
    with pytest.raises(ValueError, match="no forest"):
        learnt.load_forest(file)


@pytest.mark.long
@pytest.mark.skipif(not SHARED_FRAMES.is_dir(), reason=f"no real frames in {SHARED_FRAMES}")
def test_the_shipped_forest_is_of_the_frames(tmp_path):
    file = tmp_path / "again.yml.gz"
    assert learn.main(["--no-judging", "--model", str(file)]) == 0
    assert file.stat().st_size == pytest.approx(learnt.MODEL.stat().st_size, rel=0.05)


@pytest.fixture
def annotated(tmp_path):
    grass = np.full((400, 300, 3), (60, 120, 50), np.uint8)
    ball = cv2.circle(grass.copy(), (150, 200), 20, YELLOWS["warm"], -1)
    for name, image in (("a", grass), ("b", ball), ("unannotated", ball)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    (tmp_path / "a.txt").write_text("0 0.5 0.5 0.1 0.1")
    (tmp_path / "b.txt").write_text("2 0.1 0.1 0.1 0.1\n0 0.5 0.5 0.1333 0.1\n\n")
    return tmp_path


def test_only_annotated_frames_are_read(annotated):
    missed, found = read_frames(annotated)
    assert [frame.image.name for frame in (missed, found)] == ["a.png", "b.png"]
    assert list(found.balls) == [(0.5, 0.5, 0.1333, 0.1)]  # class 2 is not a ball
    without, example = learn.example_of(missed, 0), learn.example_of(found, 1)
    assert (without.balls, without.by_limits, any(without.hits)) == (1, False, False)
    assert (example.balls, example.by_limits, any(example.hits)) == (1, True, True)


def test_a_bad_annotation_names_its_line(annotated):
    (annotated / "b.txt").write_text("0 0.5 0.5 0.1 0.1\n0 0.5 x 0.1 0.1\n")
    with pytest.raises(ValueError, match=r"b\.txt:2: '0 0\.5 x 0\.1 0\.1': expected 'class x_"):
        read_frames(annotated)
