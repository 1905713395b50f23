# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rigid transformations, the pinhole camera and the NAO's kinematics."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_demo.soccer import ceiling, nao
from dyknow_demo.soccer.mounts import Fixed, NaoBottom, mount_of
from dyknow_demo.soccer.nao import BOTTOM_CAMERA, Posture, robot_from_bottom_camera
from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.rigid import (
    apply,
    inverse,
    quaternion_of_yaw,
    shift,
    turn,
    yaw_of_quaternion,
)

ANGLES = st.floats(-3.0, 3.0)
UPRIGHT = Posture(0.0, 0.0, 0.0, 0.0, 0.0)


@given(ANGLES, ANGLES, ANGLES)
def test_an_inverse_undoes_a_transformation(roll, pitch, yaw):
    pose = shift(1.0, -2.0, 3.0) @ turn(roll, pitch, yaw)
    assert np.allclose(inverse(pose) @ pose, np.eye(4))
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_turns_are_right_handed():
    assert apply(turn(0.0, 0.0, math.pi / 2), np.array([1.0, 0, 0])) == pytest.approx([0, 1, 0])
    assert apply(turn(0.0, math.pi / 2, 0.0), np.array([1.0, 0, 0])) == pytest.approx([0, 0, -1])
    assert apply(turn(math.pi / 2, 0.0, 0.0), np.array([0, 1.0, 0])) == pytest.approx([0, 0, 1])


@given(ANGLES)
def test_yaw_survives_the_quaternion(yaw):
    assert yaw_of_quaternion(*quaternion_of_yaw(yaw)) == pytest.approx(yaw)


@given(st.floats(0.0, 639.0), st.floats(0.0, 479.0))
def test_a_pixels_ray_meets_the_pixel(column, row):
    ray = BOTTOM_CAMERA.rays(np.array([column, row]))
    assert np.linalg.norm(ray) == pytest.approx(1.0)
    assert BOTTOM_CAMERA.project(2.5 * ray) == pytest.approx([column, row])


def test_angles_of_view_reach_from_border_to_border():
    camera = Pinhole.of_view(640, 480, math.radians(60.97), math.radians(47.64))
    borders = np.array([[-0.5, camera.cy], [639.5, camera.cy]])
    left, right = camera.rays(borders)
    assert math.degrees(math.acos(left @ right)) == pytest.approx(60.97)
    assert camera.fx == pytest.approx(camera.fy, rel=0.01)  # square pixels


def test_intrinsics_survive_camera_info():
    camera = BOTTOM_CAMERA
    assert Pinhole.of_matrix(camera.width, camera.height, camera.matrix.ravel().tolist()) == camera


def test_the_bottom_camera_of_a_nao_that_stands_straight():
    camera = robot_from_bottom_camera(UPRIGHT)
    legs = nao.FOOT_HEIGHT + nao.TIBIA_LENGTH + nao.THIGH_LENGTH + nao.HIP_OFFSET_Z
    expected = [0.05071, 0.0, legs + 0.1265 + 0.01774]
    assert camera[:3, 3] == pytest.approx(expected)
    ahead = camera[:3, 2]  # the optical axis
    assert math.degrees(math.asin(-ahead[2])) == pytest.approx(39.7, abs=0.01)
    assert camera[:3, 0] == pytest.approx([0.0, -1.0, 0.0])  # the picture's right


def test_joints_turn_the_camera_as_their_names_say():
    left = robot_from_bottom_camera(Posture(0.5, 0.0, 0.0, 0.0, 0.0))
    assert left[1, 2] > 0  # a positive HeadYaw looks left
    down = robot_from_bottom_camera(Posture(0.0, 0.3, 0.0, 0.0, 0.0))
    assert math.asin(-down[2, 2]) == pytest.approx(nao.BOTTOM_CAMERA_PITCH + 0.3)
    crouched = robot_from_bottom_camera(Posture(0.0, 0.0, -0.35, 0.7, -0.35))
    upright = robot_from_bottom_camera(UPRIGHT)
    assert crouched[:3, :3] == pytest.approx(upright[:3, :3])  # hip, knee and ankle cancel out
    lowered = (1 - math.cos(0.35)) * (nao.TIBIA_LENGTH + nao.THIGH_LENGTH)
    assert upright[2, 3] - crouched[2, 3] == pytest.approx(lowered)


def test_a_ceiling_camera_looks_straight_down_and_its_picture_begins_ahead():
    pose = ceiling.floor_from_camera(6.5, math.pi / 2)
    assert pose[:3, 3] == pytest.approx([0.0, 0.0, 6.5])
    assert pose[:3, 2] == pytest.approx([0.0, 0.0, -1.0])
    assert pose[:3, 1] == pytest.approx([-1.0, 0.0, 0.0])  # the picture's down is behind


def test_mounts_from_parameters():
    assert mount_of("nao_bottom") == NaoBottom()
    assert mount_of({"height": 3, "pitch": 1.5}) == Fixed(3.0, 1.5)
    assert mount_of({"height": 3, "pitch": 1.5, "roll": 0.1}) == Fixed(3.0, 1.5, 0.1)


@pytest.mark.parametrize(
    "given_",
    ["nao_top", {}, {"height": 3}, {"height": 0, "pitch": 1}, {"height": 3, "pitch": "x"}],
)
def test_a_bad_mount_is_refused(given_):
    with pytest.raises(ValueError):
        mount_of(given_)
