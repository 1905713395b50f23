# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/NaoBody: joint angles and self-localization of a simulated NAO."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

import dyknow
from dyknow.ros.parameters import get_positive
from dyknow_demo.soccer.nao import JOINT_NAMES
from dyknow_demo.soccer.nodelets.places import place_message
from dyknow_demo.soccer.world import HEADING_ERROR, PLACE_ERROR, World


class NaoBody(dyknow.Nodelet):
    """Publishes joint angles and the robot's own estimate of its place.

    Self-localization by the field's lines is not simulated, only its result: the true place with
    slowly changing errors of a few centimetres.

    Ports:
        joint_states (out): sensor_msgs/JointState: HeadYaw, HeadPitch and a leg's pitch joints,
            with the resolution of the NAO's encoders.
        pose (out): geometry_msgs/PoseWithCovarianceStamped, of the robot's frame on the field.

    Parameters:
        ~rate (double, 50): messages a second on each port.
        ~seed (int, 0): of the simulated world.
    """

    def on_init(self) -> None:
        """Declare the ports and start the timer."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        rate = get_positive(self.nh, "~rate", 50.0, "Hz")
        self.world = World(int(self.nh.get_param("~seed", 0)))
        self.joints_pub = self.nh.Publisher("joint_states", JointState, queue_size=10)
        self.pose_pub = self.nh.Publisher("pose", PoseWithCovarianceStamped, queue_size=10)
        self.timer = self.nh.Timer(self.nh.Duration(1.0 / rate), self.on_timer)

    def on_timer(self, event: Any) -> None:
        """Publish the current state."""
        stamp = self.nh.Time.now()
        time = stamp.to_sec()
        angles = self.world.encoders(time).angles
        joints = JointState(header=Header(stamp=stamp), name=JOINT_NAMES, position=angles)
        self.joints_pub.publish(joints)
        place = self.world.believed_place(time)
        self.pose_pub.publish(place_message(stamp, place, PLACE_ERROR, HEADING_ERROR))
