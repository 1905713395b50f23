# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet dyknow_demo/BallDetector: from planes at two resolutions to a ball on the floor."""

from __future__ import annotations

from typing import Any, Callable, Dict, List, Mapping

import message_filters
import numpy as np
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, Quaternion
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Header

import dyknow
from dyknow.errors import BadParameter
from dyknow.ros.parameters import get_positive
from dyknow_demo.images import Pixels
from dyknow_demo.soccer import forest, mounts
from dyknow_demo.soccer.colour import COLOURS
from dyknow_demo.soccer.field import BALL_RADIUS
from dyknow_demo.soccer.finder import Find, find_balls
from dyknow_demo.soccer.history import History
from dyknow_demo.soccer.pinhole import Pinhole
from dyknow_demo.soccer.planes_message import planes_of
from dyknow_demo.soccer.sighting import ANGLE_ERROR, Geometry, Sighting, best_sighting

LEARNT = "learnt"

Finder = Callable[[Mapping[int, Pixels]], List[Find]]


class BallDetector(dyknow.Nodelet):
    """Finds the ball by colour and roundness, and locates it in the frame of the camera's owner.

    It works with any camera that it is connected to: the intrinsics come with the images, the
        mounting is a parameter, and joints matter only for a mounting that has some. The frame of
        the images identifies the camera; intrinsics with another frame are ignored.

    Ports:
        yuv_coarse, yuv_fine (in): sensor_msgs/Image, planes as published by ImageSubsampler, with
            equal stamps; balls are searched for in the coarse ones and confirmed in the fine ones.
        camera_info (in): sensor_msgs/CameraInfo, of the camera in full resolution, with the frame
            of the images.
        joint_states (in): sensor_msgs/JointState; may stay disconnected if the mount is fixed.
        ball (out): geometry_msgs/PoseWithCovarianceStamped, in the owner's frame on the floor;
            nothing is published when no ball is seen.

    Parameters:
        ~mount (string or mapping, nao_bottom): nao_bottom, or {height, pitch, roll} in m and rad.
        ~owner (string, nao): name of the owner's frame.
        ~fixed_cameras (mapping, empty): mounts of other cameras whose images may arrive, by the
            frame of the images: {height, pitch, roll} as above. Each is its own owner.
        ~colour (string, orange): orange or yellow, by fixed limits; or learnt: by a forest trained
            on real frames, in any light.
        ~radius (double, 0.0325): of the ball, m.
    """

    def on_init(self) -> None:
        """Read the parameters and declare the ports."""
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.read_parameters()
        self.joints = History([True] * len(self.mount.joints))
        self.cameras: Dict[str, Pinhole] = {}
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
            BadParameter: one of them is not valid.
        """
        get = self.nh.get_param
        self.mount = self.read_mount("~mount", get("~mount", "nao_bottom"))
        self.fixed = {
            frame: self.read_mount("~fixed_cameras", given)
            for frame, given in get("~fixed_cameras", {}).items()
        }
        colour = get("~colour", "orange")
        if colour not in (*COLOURS, LEARNT):
            expected = "one of " + ", ".join(sorted((*COLOURS, LEARNT)))
            raise BadParameter(self.nh.resolve_name("~colour"), colour, expected)
        self.find = self.finder_of(colour)
        self.radius = get_positive(self.nh, "~radius", BALL_RADIUS, "m")
        self.owner = str(get("~owner", "nao"))

    @staticmethod
    def finder_of(colour: str) -> Finder:
        """Return the function that finds balls in planes by their factors."""
        if colour == LEARNT:
            model = forest.load()
            return lambda pyramid: forest.find_learnt(pyramid[min(pyramid)], min(pyramid), model)
        return lambda pyramid: find_balls(pyramid, COLOURS[colour])

    def read_mount(self, parameter: str, given: Any) -> mounts.Mount:
        """Read the mount of one camera."""
        try:
            return mounts.mount_of(given)
        except (TypeError, ValueError):
            name = self.nh.resolve_name(parameter)
            raise BadParameter(name, given, mounts.EXPECTED) from None

    def on_info(self, info: Any) -> None:
        """Store the camera's intrinsics."""
        camera = Pinhole.of_matrix(info.width, info.height, info.K)
        self.cameras[info.header.frame_id] = camera

    def on_joints(self, state: Any) -> None:
        """Store the angles that move the camera."""
        angles = dict(zip(state.name, state.position))
        if all(name in angles for name in self.mount.joints):
            chosen = [angles[name] for name in self.mount.joints]
            self.joints.add(state.header.stamp.to_sec(), chosen)

    def on_planes(self, coarse: Any, fine: Any) -> None:
        """Look for the ball in one image."""
        stamp, frame = fine.header.stamp, fine.header.frame_id
        camera, mount = self.cameras.get(frame), self.fixed.get(frame, self.mount)
        angles = self.joints.at(stamp.to_sec()) if mount.joints else ()
        if camera is None or angles is None:
            missing = f"camera_info of '{frame}'" if camera is None else "joint_states of its time"
            self.nh.logwarn_throttle(5.0, f"{self.name}: an image without {missing} is left out")
            return
        factors = [camera.width // image.width for image in (fine, coarse)]
        pyramid = dict(zip(factors, (planes_of(fine), planes_of(coarse))))
        pose = mount.owner_from_camera(angles)
        geometry = Geometry(camera, pose, self.radius, ANGLE_ERROR, factors[0])
        sighting = best_sighting(self.find(pyramid), geometry)
        if sighting is not None:
            owner = frame if frame in self.fixed else self.owner
            self.publish(Header(stamp=stamp, frame_id=owner), sighting)

    def publish(self, header: Any, sighting: Sighting) -> None:
        """Publish the ball's position; its orientation is unknown."""
        message = PoseWithCovarianceStamped(header=header)
        message.pose.pose.position = Point(*sighting.position.tolist())
        message.pose.pose.orientation = Quaternion(0.0, 0.0, 0.0, 1.0)
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = sighting.covariance
        covariance[3:, 3:] = np.pi**2 * np.eye(3)
        message.pose.covariance = covariance.ravel().tolist()
        self.pub.publish(message)
