# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelets of the soccer case study, as the paper lists them, and the simulated sources."""

from __future__ import annotations

import math
from typing import Any, Callable, Mapping, Sequence

import cv2
import message_filters
import numpy as np
from geometry_msgs.msg import Point, PointStamped, PoseWithCovarianceStamped, Quaternion
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Header

import dyknow
from dyknow.errors import BadParameter
from dyknow.ros.parameters import get_positive
from dyknow_demo import images
from dyknow_demo.images import Pixels, blank_planes, planes_of, shrink
from dyknow_demo.soccer import geometry, learnt
from dyknow_demo.soccer.finder import COLOURS, Find, find_balls
from dyknow_demo.soccer.geometry import Array
from dyknow_demo.soccer.rendering import FieldCamera
from dyknow_demo.soccer.sighting import Geometry, History, Sighting, best_sighting
from dyknow_demo.soccer.world import BALL_RADIUS, HEADING_ERROR, PLACE_ERROR, SoccerWorld

#: Frame of the field: origin in the middle, x along the longer side, z up.
FIELD = "field"
_LEARNT = "learnt"


class Simulated(dyknow.Nodelet):
    """Publishes part of the simulated world.

    Parameters:
        ~rate (double): times a second.
        ~seed (int, 0): of the simulated world.
    """

    default_rate: float

    def on_init(self) -> None:
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.seed = int(self.nh.get_param("~seed", 0))
        rate = get_positive(self.nh, "~rate", self.default_rate, "Hz")
        self.world = SoccerWorld(self.seed)
        self.declare()
        self.timer = self.nh.Timer(self.nh.Duration(1.0 / rate), self.on_timer)

    def declare(self) -> None:
        """Declare the ports."""
        raise NotImplementedError

    def on_timer(self, event: Any) -> None:
        """Publish on all ports."""
        raise NotImplementedError


class SimulatedCamera(Simulated):
    """Publishes a camera's view of the world, with its intrinsics.

    Ports:
        image (out): sensor_msgs/Image, yuv422 (YUV 4:2:2 in the order UYVY).
        camera_info (out): sensor_msgs/CameraInfo, with each frame.

    Parameters, besides those of all simulated nodelets:
        ~frame_id (string, the nodelet's name): of the optical frame.
    """

    camera: geometry.Pinhole

    def declare(self) -> None:
        self.frame_id = str(self.nh.get_param("~frame_id", self.name.rpartition("/")[2]))
        self.view, self.count = FieldCamera(self.camera, self.seed), 0
        k = self.camera.matrix
        self.intrinsics = {
            "height": self.camera.height,
            "width": self.camera.width,
            "distortion_model": "plumb_bob",
            "D": [0.0] * 5,
            "K": k.ravel().tolist(),
            "R": np.eye(3).ravel().tolist(),
            "P": np.column_stack((k, np.zeros(3))).ravel().tolist(),
        }
        self.image_pub = self.nh.Publisher("image", Image, queue_size=5)
        self.info_pub = self.nh.Publisher("camera_info", CameraInfo, queue_size=5)

    def pose(self, time: float) -> Array:
        """True pose of the optical frame on the field."""
        raise NotImplementedError

    def on_timer(self, event: Any) -> None:
        stamp = self.nh.Time.now()
        header, time = Header(self.count, stamp, self.frame_id), stamp.to_sec()
        self.info_pub.publish(CameraInfo(header=header, **self.intrinsics))
        image = images.blank(header, self.camera.height, self.camera.width, "yuv422")
        ball = self.world.ball_on_field(time)
        self.view.render(self.pose(time), ball, self.count, images.array_of(image))
        self.image_pub.publish(image)
        self.count += 1


class BottomCamera(SimulatedCamera):
    """The NAO's view of the floor before its feet, 640 x 480; ``~rate`` is 20 if it is not set."""

    camera, default_rate = geometry.BOTTOM_CAMERA, 20.0

    def pose(self, time: float) -> Array:
        return self.world.field_from_bottom_camera(time)


class CeilingCamera(SimulatedCamera):
    """The view from the ceiling, 1280 x 960; ``~rate`` is 15 if it is not set.

    Ports, besides those of every simulated camera:
        pose (out): geometry_msgs/PoseWithCovarianceStamped, with each frame: place on the field of
            the camera's own frame, which is on the floor right below it.
    """

    camera, default_rate = geometry.CEILING_CAMERA, 15.0

    def declare(self) -> None:
        self.pose_pub = self.nh.Publisher("pose", PoseWithCovarianceStamped, queue_size=5)
        super().declare()

    def pose(self, time: float) -> Array:
        return self.world.field_from_ceiling_camera()

    def on_timer(self, event: Any) -> None:
        self.pose_pub.publish(_place_message(self.nh.Time.now(), geometry.CEILING_PLACE, 0.0, 0.0))
        super().on_timer(event)


class NaoBody(Simulated):
    """Publishes the joint angles and the self-localization of a simulated NAO.

    Self-localization by the field's lines is not simulated, only its result: the true place with
    slowly changing errors of a few centimetres. ``~rate`` is 50 if it is not set.

    Ports:
        joint_states (out): sensor_msgs/JointState: HeadYaw, HeadPitch and a leg's pitch joints,
            with the resolution of the NAO's encoders.
        pose (out): geometry_msgs/PoseWithCovarianceStamped, of the robot's frame on the field.
    """

    default_rate = 50.0

    def declare(self) -> None:
        self.joints_pub = self.nh.Publisher("joint_states", JointState, queue_size=10)
        self.pose_pub = self.nh.Publisher("pose", PoseWithCovarianceStamped, queue_size=10)

    def on_timer(self, event: Any) -> None:
        stamp = self.nh.Time.now()
        time = stamp.to_sec()
        angles = self.world.encoders(time)
        self.joints_pub.publish(JointState(Header(stamp=stamp), geometry.JOINTS, angles, [], []))
        place = self.world.believed_place(time)
        self.pose_pub.publish(_place_message(stamp, place, PLACE_ERROR, HEADING_ERROR))


class ImageSubsampler(dyknow.Nodelet):
    """Converts and shrinks camera images; makes only those that have subscribers.

    Ports:
        yuv (in): sensor_msgs/Image, yuv422 (UYVY), rows and columns even.
        bgr (out): sensor_msgs/Image, bgr8, full size.
        hsv (out): sensor_msgs/Image, 8UC3 (OpenCV's: H 0 to 179), full size.
        yuv_half, yuv_quarter, yuv_eighth (out): sensor_msgs/Image, the planes Y, U and V one below
            the other in mono8, each with a half, a quarter, an eighth of the columns and rows.
    """

    def on_init(self) -> None:
        self.nh = dyknow.NodeHandle(self.node_handle)
        ports = ("bgr", "hsv", "yuv_half", "yuv_quarter", "yuv_eighth")
        pubs = [self.nh.Publisher(port, Image, queue_size=5) for port in ports]
        self.bgr_pub, self.hsv_pub, *self.plane_pubs = pubs
        self.sub = self.nh.Subscriber("yuv", Image, self.on_image, queue_size=2)

    def on_image(self, image: Any) -> None:
        if image.encoding != "yuv422" or image.height % 2 or image.width % 2:
            raise ValueError(
                f"an image of {image.width} x {image.height} in '{image.encoding}': "
                "expected yuv422 with even numbers of columns and rows"
            )
        heard = [pub.get_num_connections() > 0 for pub in self.plane_pubs]
        if any(heard):
            levels = max(level for level, is_heard in enumerate(heard, 1) if is_heard)
            planes = blank_planes(image, levels)
            shrink(images.array_of(image), [planes_of(each) for each in planes])
            for pub, is_heard, message in zip(self.plane_pubs, heard, planes):
                if is_heard:
                    pub.publish(message)
        wants_hsv = self.hsv_pub.get_num_connections() > 0
        if wants_hsv or self.bgr_pub.get_num_connections():
            bgr = images.blank(image.header, image.height, image.width, "bgr8")
            pixels = images.array_of(bgr)
            cv2.cvtColor(images.array_of(image), cv2.COLOR_YUV2BGR_UYVY, dst=pixels)
            self.bgr_pub.publish(bgr)
            if wants_hsv:
                hsv = images.blank(image.header, image.height, image.width, "8UC3")
                cv2.cvtColor(pixels, cv2.COLOR_BGR2HSV, dst=images.array_of(hsv))
                self.hsv_pub.publish(hsv)


class BallDetector(dyknow.Nodelet):
    """Finds the ball by colour and roundness, and locates it in the frame of the camera's owner.

    It works with any camera that it is connected to: the intrinsics come with the images, the
    mounting is a parameter, and joints matter only for a mounting that has some. The frame of the
    images identifies the camera; intrinsics with another frame are ignored.

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
        self.nh = dyknow.NodeHandle(self.node_handle)
        get = self.nh.get_param
        self.mount = self.read_mount("~mount", get("~mount", "nao_bottom"))
        fixed = get("~fixed_cameras", {}).items()
        self.fixed = {frame: self.read_mount("~fixed_cameras", given) for frame, given in fixed}
        colour, known = get("~colour", "orange"), sorted((*COLOURS, _LEARNT))
        if colour not in known:
            expected = "one of " + ", ".join(known)
            raise BadParameter(self.nh.resolve_name("~colour"), colour, expected)
        self.find = self.finder_of(colour)
        self.radius = get_positive(self.nh, "~radius", BALL_RADIUS, "m")
        self.owner = str(get("~owner", "nao"))
        self.joints = History([True] * len(self.mount.joints))
        self.cameras: dict[str, geometry.Pinhole] = {}
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

    @staticmethod
    def finder_of(colour: str) -> Callable[[Mapping[int, Pixels]], list[Find]]:
        """Return the function that finds balls in planes by their factors."""
        if colour == _LEARNT:
            forest = learnt.load_forest()
            return lambda pyramid: learnt.find_learnt(pyramid[min(pyramid)], min(pyramid), forest)
        return lambda pyramid: find_balls(pyramid, COLOURS[colour])

    def read_mount(self, parameter: str, given: Any) -> geometry.Mount:
        try:
            return geometry.mount_of(given)
        except (TypeError, ValueError):
            raise BadParameter(self.nh.resolve_name(parameter), given, geometry.MOUNT) from None

    def on_info(self, info: Any) -> None:
        camera = geometry.Pinhole.of_matrix(info.width, info.height, info.K)
        self.cameras[info.header.frame_id] = camera

    def on_joints(self, state: Any) -> None:
        angles = dict(zip(state.name, state.position))
        if all(name in angles for name in self.mount.joints):
            chosen = [angles[name] for name in self.mount.joints]
            self.joints.add(state.header.stamp.to_sec(), chosen)

    def on_planes(self, coarse: Any, fine: Any) -> None:
        stamp, frame = fine.header.stamp, fine.header.frame_id
        camera, mount = self.cameras.get(frame), self.fixed.get(frame, self.mount)
        angles = self.joints.at(stamp.to_sec()) if mount.joints else ()
        if camera is None or angles is None:
            missing = f"camera_info of '{frame}'" if camera is None else "joint_states of its time"
            self.nh.logwarn_throttle(5.0, f"{self.name}: an image without {missing} is left out")
            return
        pyramid = {camera.width // image.width: planes_of(image) for image in (fine, coarse)}
        pose = mount.owner_from_camera(angles)
        known = Geometry(camera, pose, self.radius, min(pyramid))
        sighting = best_sighting(self.find(pyramid), known)
        if sighting is not None:
            owner = frame if frame in self.fixed else self.owner
            self.publish(Header(stamp=stamp, frame_id=owner), sighting)

    def publish(self, header: Any, sighting: Sighting) -> None:
        """Publish the ball's position; its orientation is unknown."""
        message = PoseWithCovarianceStamped(header=header)
        message.pose.pose.position = Point(*sighting.position.tolist())
        message.pose.pose.orientation = Quaternion(0.0, 0.0, 0.0, 1.0)
        covariance = np.pi**2 * np.eye(6)
        covariance[:3, :3] = sighting.covariance
        message.pose.covariance = covariance.ravel().tolist()
        self.pub.publish(message)


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
        self.nh = dyknow.NodeHandle(self.node_handle)
        self.places = History([False, False, True])
        fixed = self.nh.get_param("~fixed_cameras", {}).items()
        self.fixed = {frame: self.read_place(given) for frame, given in fixed}
        self.pub = self.nh.Publisher("field_position", PointStamped, queue_size=5)
        pose = PoseWithCovarianceStamped
        self.pose_sub = self.nh.Subscriber("pose", pose, self.on_pose, queue_size=20)
        self.objects_sub = self.nh.Subscriber("objects", pose, self.on_object, queue_size=5)

    def read_place(self, given: Any) -> tuple[float, ...]:
        try:
            return tuple(float(given[name]) for name in ("x", "y", "yaw"))
        except (KeyError, TypeError, ValueError):
            name = self.nh.resolve_name("~fixed_cameras")
            raise BadParameter(name, given, "the numbers x, y (m) and yaw (rad)") from None

    def on_pose(self, message: Any) -> None:
        """Store the observer's place: x, y and the last of three turns about x, y and z."""
        position, q = message.pose.pose.position, message.pose.pose.orientation
        yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
        self.places.add(message.header.stamp.to_sec(), (position.x, position.y, yaw))

    def on_object(self, observed: Any) -> None:
        stamp = observed.header.stamp
        place = self.fixed.get(observed.header.frame_id) or self.places.at(stamp.to_sec())
        if place is None:
            self.nh.logwarn_throttle(
                5.0, f"{self.name}: an object without a pose of its time is left out"
            )
            return
        position = observed.pose.pose.position
        x, y, z = geometry.apply(
            geometry.field_from_owner(place), np.array([position.x, position.y, position.z])
        )
        self.pub.publish(PointStamped(Header(stamp=stamp, frame_id=FIELD), Point(x, y, z)))


def _place_message(stamp: Any, place: Sequence[float], error: float, heading_error: float) -> Any:
    """A place on the field, and the standard deviations of x and y (m) and of the yaw (rad)."""
    x, y, yaw = place
    message = PoseWithCovarianceStamped(header=Header(stamp=stamp, frame_id=FIELD))
    message.pose.pose.position = Point(x, y, 0.0)
    message.pose.pose.orientation = Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    covariance = np.diag((error**2, error**2, 0.0, 0.0, 0.0, heading_error**2))
    message.pose.covariance = covariance.ravel().tolist()
    return message
