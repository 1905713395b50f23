"""The nodelet dyknow/BallDetector: from planes at two resolutions to a ball on the floor."""

from __future__ import annotations

from typing import Any

import message_filters
import numpy as np
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Quaternion
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Header

import dyknow
from dyknow.demo.soccer import mounts
from dyknow.demo.soccer.colour import COLOURS
from dyknow.demo.soccer.field import BALL_RADIUS
from dyknow.demo.soccer.finder import find_balls
from dyknow.demo.soccer.history import History
from dyknow.demo.soccer.pinhole import Pinhole
from dyknow.demo.soccer.planes_message import planes_of
from dyknow.demo.soccer.sighting import ANGLE_ERROR, Geometry, Sighting, best_sighting
from dyknow.errors import BadParameter
from dyknow.ros.parameters import get_positive


class BallDetector(dyknow.Nodelet):
    """Finds the ball by colour and roundness, and locates it in the frame of the camera's owner.

    It does so for whichever camera it is told of: the intrinsics come with the images, the
    mounting is a parameter, and joints count only where the mounting has some.

    Ports:
        yuv_coarse, yuv_fine (in): sensor_msgs/Image, planes as of ImageSubsampler, of the same
            stamps; the coarse ones are searched, the fine ones decide.
        camera_info (in): sensor_msgs/CameraInfo, of the camera in full resolution.
        joint_states (in): sensor_msgs/JointState; may stay disconnected if the mount is fixed.
        ball (out): geometry_msgs/PoseWithCovarianceStamped, in the owner's frame on the floor;
            nothing is published where no ball is seen.

    Parameters:
        ~mount (string or mapping, nao_bottom): nao_bottom, or {height, pitch, roll} in m and rad.
        ~owner (string, nao): name of the owner's frame.
        ~colour (string, orange): orange or yellow.
        ~radius (double, 0.0325): of the ball, m.
    """

    def on_init(self) -> None:
        """Read the parameters and declare the ports."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.read_parameters()
        self.joints = History([True] * len(self.mount.joints))
        self.camera: Any = None
        self.pub = self.nh.Publisher("ball", PoseWithCovarianceStamped, queue_size=5)
        self.info_sub = self.nh.Subscriber("camera_info", CameraInfo, self.on_info, queue_size=1)
        self.joints_sub = self.nh.Subscriber(
            "joint_states", JointState, self.on_joints, queue_size=20
        )
        inputs = [
            self.nh.Subscriber(port, Image, queue_size=2) for port in ("yuv_coarse", "yuv_fine")
        ]
        self.pairs = message_filters.TimeSynchronizer(inputs, 4)
        self.pairs.registerCallback(self.on_planes)

    def read_parameters(self) -> None:
        """Read the parameters.

        Raises:
            BadParameter: one is not what is expected.
        """
        get = self.nh.get_param
        given = get("~mount", "nao_bottom")
        try:
            self.mount = mounts.mount_of(given)
        except (TypeError, ValueError):
            name = self.nh.resolve_name("~mount")
            raise BadParameter(name, given, mounts.EXPECTED) from None
        colour = get("~colour", "orange")
        if colour not in COLOURS:
            expected = "one of " + ", ".join(sorted(COLOURS))
            raise BadParameter(self.nh.resolve_name("~colour"), colour, expected)
        self.colour = COLOURS[colour]
        self.radius = get_positive(self.nh, "~radius", BALL_RADIUS, "m")
        self.owner = str(get("~owner", "nao"))

    def on_info(self, info: Any) -> None:
        """Take the camera's intrinsics."""
        self.camera = Pinhole.of_matrix(info.width, info.height, info.K)

    def on_joints(self, state: Any) -> None:
        """Keep the angles that move the camera."""
        angles = dict(zip(state.name, state.position))
        if all(name in angles for name in self.mount.joints):
            chosen = [angles[name] for name in self.mount.joints]
            self.joints.add(state.header.stamp.to_sec(), chosen)

    def on_planes(self, coarse: Any, fine: Any) -> None:
        """Look for the ball in one image."""
        stamp = fine.header.stamp
        angles = self.joints.at(stamp.to_sec()) if self.mount.joints else ()
        if self.camera is None or angles is None:
            missing = "camera_info" if self.camera is None else "joint_states"
            self.nh.logwarn_throttle(
                5.0, f"{self.name}: an image without {missing} of its time is left out"
            )
            return
        factors = [self.camera.width // image.width for image in (fine, coarse)]
        pyramid = dict(zip(factors, (planes_of(fine), planes_of(coarse))))
        pose = self.mount.owner_from_camera(angles)
        geometry = Geometry(self.camera, pose, self.radius, ANGLE_ERROR, factors[0])
        sighting = best_sighting(find_balls(pyramid, self.colour), geometry)
        if sighting is not None:
            self.publish(stamp, sighting)

    def publish(self, stamp: Any, sighting: Sighting) -> None:
        """Publish where the ball is; its orientation is not known."""
        message = PoseWithCovarianceStamped(header=Header(stamp=stamp, frame_id=self.owner))
        message.pose.pose.position = Point(*sighting.position.tolist())
        message.pose.pose.orientation = Quaternion(0.0, 0.0, 0.0, 1.0)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = sighting.covariance
        covariance[3:, 3:] = np.pi**2 * np.eye(3)
        message.pose.covariance = covariance.ravel().tolist()
        self.pub.publish(message)
