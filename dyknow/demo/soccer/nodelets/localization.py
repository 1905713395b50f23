"""The nodelet dyknow/Localization: from an observer's frame to the field's."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import Point, PointStamped, PoseWithCovarianceStamped
from std_msgs.msg import Header

import dyknow
from dyknow.demo.soccer.history import History
from dyknow.demo.soccer.localizing import on_field
from dyknow.demo.soccer.nodelets.places import FIELD, place_of


class Localization(dyknow.Nodelet):
    """Transforms objects that an observer sees to the field, by where the observer was then.

    Ports:
        pose (in): geometry_msgs/PoseWithCovarianceStamped, of the observer's frame on the field.
        objects (in): geometry_msgs/PoseWithCovarianceStamped, in the observer's frame.
        field_position (out): geometry_msgs/PointStamped, in the frame ``field``, with the stamp of
            the object.
    """

    def on_init(self) -> None:
        """Declare the ports."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.places = History([False, False, True])
        self.pub = self.nh.Publisher("field_position", PointStamped, queue_size=5)
        self.pose_sub = self.nh.Subscriber(
            "pose", PoseWithCovarianceStamped, self.on_pose, queue_size=20
        )
        self.objects_sub = self.nh.Subscriber(
            "objects", PoseWithCovarianceStamped, self.on_object, queue_size=5
        )

    def on_pose(self, pose: Any) -> None:
        """Keep where the observer is."""
        self.places.add(pose.header.stamp.to_sec(), place_of(pose))

    def on_object(self, observed: Any) -> None:
        """Transform one object."""
        stamp = observed.header.stamp
        place = self.places.at(stamp.to_sec())
        if place is None:
            self.nh.logwarn_throttle(
                5.0, f"{self.name}: an object without a pose of its time is left out"
            )
            return
        position = observed.pose.pose.position
        x, y, z = on_field(place, np.array([position.x, position.y, position.z]))
        self.pub.publish(PointStamped(Header(stamp=stamp, frame_id=FIELD), Point(x, y, z)))
