# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The camera on the ceiling of the lab, above the middle of the field.

Its own frame lies on the floor below it, as a robot's does, so the robot's software fits it too.
"""

from __future__ import annotations

import math

from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.rigid import BODY_FROM_OPTICAL, Array, shift, turn

#: Metres above the floor.
HEIGHT = 6.5

#: With these, the field of 9 m x 6 m and its border fit into the picture.
CEILING_CAMERA = Pinhole.of_view(1280, 960, math.radians(78.0), math.radians(62.5))

#: Place of the camera's own frame on the field: x, y (m), yaw (rad).
PLACE = (0.0, 0.0, math.pi / 2)


def floor_from_camera(height: float, pitch: float, roll: float = 0.0) -> Array:
    """Pose of the optical frame of a fixed camera in its own frame.

    Args:
        height: metres above the floor.
        pitch: rad from the horizontal downwards; at pi/2 the camera looks straight down, and the
            picture's top is ahead.
        roll: rad about the line of sight.
    """
    return (
        shift(0.0, 0.0, height) @ turn(0.0, pitch, 0.0) @ turn(roll, 0.0, 0.0) @ BODY_FROM_OPTICAL
    )
