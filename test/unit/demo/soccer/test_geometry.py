# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Rigid transformations, the pinhole camera and the NAO's kinematics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dyknow_demo.soccer.geometry import (
    BOTTOM_CAMERA,
    BOTTOM_CAMERA_PITCH,
    JOINTS,
    Pinhole,
    floor_from_camera,
    mount_of,
    robot_from_bottom_camera,
)

UPRIGHT = (0.0, 0.0, 0.0, 0.0, 0.0)
TIBIA, THIGH = 0.1029, 0.1


def test_intrinsics_survive_camera_info():
    camera = BOTTOM_CAMERA
    assert Pinhole.of_matrix(camera.width, camera.height, camera.matrix.ravel().tolist()) == camera


def test_the_bottom_camera_of_a_nao_that_stands_straight():
    camera = robot_from_bottom_camera(UPRIGHT)
    legs = 0.04519 + TIBIA + THIGH + 0.085
    expected = [0.05071, 0.0, legs + 0.1265 + 0.01774]
    assert camera[:3, 3] == pytest.approx(expected)
    ahead = camera[:3, 2]  # the optical axis
    assert math.degrees(math.asin(-ahead[2])) == pytest.approx(39.7, abs=0.01)
    assert camera[:3, 0] == pytest.approx([0.0, -1.0, 0.0])  # the picture's right


def test_joints_turn_the_camera_as_their_names_say():
    left = robot_from_bottom_camera((0.5, 0.0, 0.0, 0.0, 0.0))
    assert left[1, 2] > 0  # a positive HeadYaw looks left
    down = robot_from_bottom_camera((0.0, 0.3, 0.0, 0.0, 0.0))
    assert math.asin(-down[2, 2]) == pytest.approx(BOTTOM_CAMERA_PITCH + 0.3)
    crouched = robot_from_bottom_camera((0.0, 0.0, -0.35, 0.7, -0.35))
    upright = robot_from_bottom_camera(UPRIGHT)
    assert crouched[:3, :3] == pytest.approx(upright[:3, :3])  # hip, knee and ankle cancel out
    lowered = (1 - math.cos(0.35)) * (TIBIA + THIGH)
    assert upright[2, 3] - crouched[2, 3] == pytest.approx(lowered)


def test_mounts_from_parameters():
    nao = mount_of("nao_bottom")
    assert nao.joints == JOINTS
    assert np.array_equal(nao.owner_from_camera(UPRIGHT), robot_from_bottom_camera(UPRIGHT))
    fixed = mount_of({"height": 3, "pitch": 1.5})
    assert fixed.joints == ()
    assert np.array_equal(fixed.owner_from_camera(()), floor_from_camera(3.0, 1.5))
    rolled = mount_of({"height": 3, "pitch": 1.5, "roll": 0.1}).owner_from_camera(())
    assert np.array_equal(rolled, floor_from_camera(3.0, 1.5, 0.1))


@pytest.mark.parametrize(
    "given_",
    ["nao_top", {}, {"height": 3}, {"height": 0, "pitch": 1}, {"height": 3, "pitch": "x"}],
)
def test_a_bad_mount_is_refused(given_):
    with pytest.raises(ValueError):
        mount_of(given_)
