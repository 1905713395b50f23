# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/Localization: from an observer's frame to the field's."""

from __future__ import annotations

from typing import Any, Tuple

import numpy as np
from geometry_msgs.msg import Point, PointStamped, PoseWithCovarianceStamped
from std_msgs.msg import Header

import dyknow
from dyknow.errors import BadParameter
from dyknow_demo.soccer.history import History
from dyknow_demo.soccer.localizing import on_field
from dyknow_demo.soccer.nodelets.places import FIELD, place_of


class Localization(dyknow.Nodelet):
    """Transforms objects to the field's frame, by the observer's place at the time of their stamp.

    Ports:
        pose (in): geometry_msgs/PoseWithCovarianceStamped, of the observer's frame on the field.
        objects (in): geometry_msgs/PoseWithCovarianceStamped, in the observer's frame, or in that
            of a fixed camera.
        field_position (out): geometry_msgs/PointStamped, in the frame ``field``, with the stamp of
            the object.

    Parameters:
        ~fixed_cameras (mapping, empty): places on the field of frames that do not move, by their
            names: {x, y, yaw} in m and rad.
    """

    def on_init(self) -> None:
        """Declare the ports."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.places = History([False, False, True])
        self.fixed = {
            frame: self.read_place(given)
            for frame, given in self.nh.get_param("~fixed_cameras", {}).items()
        }
        self.pub = self.nh.Publisher("field_position", PointStamped, queue_size=5)
        self.pose_sub = self.nh.Subscriber(
            "pose", PoseWithCovarianceStamped, self.on_pose, queue_size=20
        )
        self.objects_sub = self.nh.Subscriber(
            "objects", PoseWithCovarianceStamped, self.on_object, queue_size=5
        )

    def read_place(self, given: Any) -> Tuple[float, ...]:
        """Read the place of one camera.

        Raises:
            BadParameter: it is not a place.
        """
        try:
            return tuple(float(given[name]) for name in ("x", "y", "yaw"))
        except (KeyError, TypeError, ValueError):
            name = self.nh.resolve_name("~fixed_cameras")
            raise BadParameter(name, given, "the numbers x, y (m) and yaw (rad)") from None

    def on_pose(self, pose: Any) -> None:
        """Store the observer's place."""
        self.places.add(pose.header.stamp.to_sec(), place_of(pose))

    def on_object(self, observed: Any) -> None:
        """Transform one object."""
        stamp = observed.header.stamp
        place = self.fixed.get(observed.header.frame_id) or self.places.at(stamp.to_sec())
        if place is None:
            self.nh.logwarn_throttle(
                5.0, f"{self.name}: an object without a pose of its time is left out"
            )
            return
        position = observed.pose.pose.position
        x, y, z = on_field(place, np.array([position.x, position.y, position.z]))
        self.pub.publish(PointStamped(Header(stamp=stamp, frame_id=FIELD), Point(x, y, z)))
