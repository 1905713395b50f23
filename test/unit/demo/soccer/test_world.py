# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The simulated truth, and the images of its cameras."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from dyknow_demo.soccer.geometry import (
    BOTTOM_CAMERA,
    CEILING_CAMERA,
    ENCODER_STEP,
    HEAD_PITCH_LIMITS,
    HEAD_YAW_LIMITS,
    Pinhole,
    apply,
    inverse,
)
from dyknow_demo.soccer.rendering import FieldCamera, draw_ball, pack, yuv_from_bgr
from dyknow_demo.soccer.world import (
    BALL_RADIUS,
    FIELD_LENGTH,
    FIELD_WIDTH,
    INTERVAL,
    KICKS,
    ROLLING,
    SoccerWorld,
)

ROUND = KICKS * INTERVAL
FASTEST_WALK = 0.25  # m/s


def frame_of(seed, time, number=0):
    world, view = SoccerWorld(seed), FieldCamera(BOTTOM_CAMERA, seed)
    frame = np.empty((480, 640, 2), np.uint8)
    view.render(world.field_from_bottom_camera(time), world.ball_on_field(time), number, frame)
    return frame


def test_seed_and_time_tell_everything():
    assert np.array_equal(frame_of(3, 12.5), frame_of(3, 12.5))
    assert not np.array_equal(frame_of(3, 12.5), frame_of(4, 12.5))
    assert not np.array_equal(frame_of(3, 12.5), frame_of(3, 12.6))
    one, other = SoccerWorld(5), SoccerWorld(5)
    assert one.encoders(7.0) == other.encoders(7.0)
    assert one.believed_place(7.0) == other.believed_place(7.0)


def test_the_ball_rolls_slows_down_and_rests():
    ball = SoccerWorld(0).ball_on_field
    start, soon, late, rest, end = ball(
        np.array([0.0, 0.1, ROLLING - 0.1, ROLLING, INTERVAL - 1e-9])
    )
    assert np.linalg.norm(soon - start) > 5 * np.linalg.norm(rest - late)
    assert rest == pytest.approx(end)
    assert ball(INTERVAL) == pytest.approx(rest)


def test_the_ball_stays_on_the_field_and_comes_round():
    ball = SoccerWorld(1).ball_on_field
    times = np.arange(0.0, ROUND, 0.1)
    way = ball(times)
    assert (np.abs(way[:, :2]) < (FIELD_LENGTH / 2, FIELD_WIDTH / 2)).all()
    assert (way[:, 2] == BALL_RADIUS).all()
    assert ball(times + 1e6 * ROUND) == pytest.approx(way, abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_the_robot_walks_as_a_nao_can_and_keeps_the_ball_in_view(seed):
    world = SoccerWorld(seed)
    times = np.arange(0.0, ROUND, 0.25)
    places = np.array([world.robot(time).place for time in times])
    speeds = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1) / 0.25
    assert speeds.max() < FASTEST_WALK
    for time in times:
        head_yaw, head_pitch, *_ = world.robot(time).angles
        assert HEAD_YAW_LIMITS[0] <= head_yaw <= HEAD_YAW_LIMITS[1]
        assert HEAD_PITCH_LIMITS[0] <= head_pitch <= HEAD_PITCH_LIMITS[1]
        centre = apply(inverse(world.field_from_bottom_camera(time)), world.ball_on_field(time))
        column, row = BOTTOM_CAMERA.project(centre)
        assert centre[2] > 0
        assert 0 < column < 640
        assert 0 < row < 480


def test_beliefs_are_a_little_wrong():
    world = SoccerWorld(0)
    off = np.array([np.subtract(world.believed_place(t), world.robot(t).place) for t in range(96)])
    assert 0.01 < np.abs(off[:, 0]).mean() < 0.05  # m
    assert 0.002 < np.abs(off[:, 2]).mean() < 0.02  # rad
    read = np.array(world.encoders(11.0))
    assert np.abs(read - world.robot(11.0).angles).max() <= ENCODER_STEP / 2 + 1e-12
    assert read / ENCODER_STEP == pytest.approx(np.round(read / ENCODER_STEP))


def test_a_ball_is_drawn_where_the_pinhole_camera_says():
    camera = Pinhole.of_view(640, 480, 1.0, 0.78)
    centre, radius = np.array([0.3, -0.2, 2.0]), 0.15
    picture = np.full((480, 640, 3), 16, np.uint8)
    draw_ball(picture, camera, centre, radius, (235, 128, 128), np.array([0.0, 0.0, -1.0]))
    rows, columns = np.nonzero(picture[..., 0] > 100)
    rays = camera.rays(np.stack((columns, rows), axis=-1).astype(float))
    off = np.arccos(np.clip(rays @ (centre / np.linalg.norm(centre)), -1, 1))
    assert off.max() == pytest.approx(math.asin(radius / np.linalg.norm(centre)), rel=0.03)
    assert len(rows) > 0.95 * math.pi * (camera.fx * radius / 2.0) ** 2


def test_lines_are_where_the_field_has_them():
    world = SoccerWorld(0)
    view = FieldCamera(CEILING_CAMERA, 0)
    frame = np.empty((960, 1280, 2), np.uint8)
    pose = world.field_from_ceiling_camera()
    view.render(pose, world.ball_on_field(0.0), 0, frame)
    brightness = frame[..., 1]
    for x, y, line in ((4.5, 1.0, True), (0.0, -1.5, True), (0.75, 0.0, True), (2.0, 2.0, False)):
        on_field = np.array([x, y, 0.0])
        column, row = np.round(CEILING_CAMERA.project(apply(inverse(pose), on_field))).astype(int)
        assert (brightness[row, column] > 160) is np.bool_(line)


def test_yuv_is_what_opencv_takes_for_yuv():
    colours = [(60, 130, 40), (240, 240, 240), (20, 105, 245), (0, 0, 0), (200, 30, 90)]
    bgr = np.repeat(np.array([colours], np.uint8), 2, axis=1)  # pairs share their colour
    packed = np.empty((1, bgr.shape[1], 2), np.uint8)
    pack(yuv_from_bgr(bgr), packed)
    back = cv2.cvtColor(packed, cv2.COLOR_YUV2BGR_UYVY)
    assert np.abs(back.astype(int) - bgr).max() <= 3
