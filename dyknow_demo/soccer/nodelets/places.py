# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Places on the field, x, y (m) and yaw (rad), as geometry_msgs/PoseWithCovarianceStamped."""

from __future__ import annotations

from typing import Any, Sequence, Tuple

from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Quaternion
from std_msgs.msg import Header

from dyknow_demo.soccer.rigid import quaternion_of_yaw, yaw_of_quaternion

#: Frame of the field: origin in the middle, x along the longer side, z up.
FIELD = "field"


def place_message(stamp: Any, place: Sequence[float], error: float, heading_error: float) -> Any:
    """Make a message.

    Args:
        stamp: ROS time.
        place: x, y (m), yaw (rad).
        error: standard deviation of x and of y, m.
        heading_error: of the yaw, rad.
    """
    x, y, yaw = place
    message = PoseWithCovarianceStamped(header=Header(stamp=stamp, frame_id=FIELD))
    message.pose.pose.position = Point(x, y, 0.0)
    message.pose.pose.orientation = Quaternion(*quaternion_of_yaw(yaw))
    diagonal = (error**2, error**2, 0.0, 0.0, 0.0, heading_error**2)
    message.pose.covariance = [
        diagonal[row] if row == column else 0.0 for row in range(6) for column in range(6)
    ]
    return message


def place_of(message: Any) -> Tuple[float, float, float]:
    """Read x, y (m) and yaw (rad)."""
    position, turned = message.pose.pose.position, message.pose.pose.orientation
    yaw = yaw_of_quaternion(turned.x, turned.y, turned.z, turned.w)
    return position.x, position.y, yaw
