# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Graphs for pictures and tests: a soccer robot's, and trees of any size."""

from __future__ import annotations

from typing import List

from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import NodeletKind, State
from dyknow.model.transformation import IN, OUT, Parameter, Port, Transformation, as_specification
from dyknow_rqt.simulated import SimulatedRemote

#: Label, source, ports (`>name` for in, `name>` for out) with their types and tags.
_LIBRARY = """
camera(nao1, bottom); soccer/Camera; yuv> sensor_msgs/Image RawYUV(nao1, bottom)
camera(nao1, top); soccer/Camera; yuv> sensor_msgs/Image RawYUV(nao1, top)
ceiling_camera; soccer/CeilingCamera; \
field_position> geometry_msgs/PointStamped FieldPosition(ball)
subsampler; soccer/Subsampler; >yuv sensor_msgs/Image RawYUV(?robot, ?camera); \
bgr> sensor_msgs/Image BGR(?robot, ?camera); hsv> sensor_msgs/Image HSV(?robot, ?camera); \
channels> sensor_msgs/Image SubsampledYUV(?robot, ?camera)
ball_detector; soccer/BallDetector; >channels sensor_msgs/Image SubsampledYUV(?robot, ?camera); \
>joint_states sensor_msgs/JointState; ball> geometry_msgs/PointStamped BallObject(?robot)
line_detector; soccer/LineDetector; >hsv sensor_msgs/Image HSV(?robot, ?camera); \
lines> sensor_msgs/PointCloud2 Lines(?robot)
localization; soccer/Localization; >objects geometry_msgs/PointStamped BallObject(?robot); \
>lines sensor_msgs/PointCloud2 Lines(?robot); \
field_position> geometry_msgs/PointStamped FieldPosition(ball)
tracker; soccer/Tracker; >position geometry_msgs/PointStamped FieldPosition(ball); \
track> nav_msgs/Path Track(ball)
resize; image_proc/resize; >image sensor_msgs/Image; resized> sensor_msgs/Image
recorder; dyknow/Sink; >in sensor_msgs/Image
"""
_PARAMETERS = {
    "ball_detector": (
        Parameter("mount", "string", "${?robot}_bottom_camera"),
        Parameter("colour", "string", "orange"),
    )
}
_GIVEN = {"/nao1/ball_detector": (Parameter("?robot", "", "nao1"),)}
#: Name, label, topics of ports.
_NODELETS = """
/nao1/bottom_camera; camera(nao1, bottom); yuv=/nao1/bottom_camera/yuv
/nao1/top_camera; camera(nao1, top); yuv=/nao1/top_camera/yuv
/nao1/subsampler; subsampler; yuv=/nao1/bottom_camera/yuv hsv=/nao1/subsampler/hsv \
channels=/nao1/subsampler/channels
/nao1/ball_detector; ball_detector; channels=/nao1/subsampler/channels \
joint_states=/nao1/joint_states ball=/nao1/ball_detector/ball
/nao1/line_detector; line_detector; hsv=/nao1/subsampler/hsv lines=/nao1/line_detector/lines
/nao1/localization; localization; objects=/nao1/ball_detector/ball \
lines=/nao1/line_detector/lines field_position=/field/ball
/field/ceiling_camera; ceiling_camera;
/field/tracker; tracker; position=/field/ball track=/field/tracker/track
/nao1/resize; resize; image=/nao1/top_camera/yuv resized=/nao1/preview
/nao1/recorder; recorder; in=/nao1/preview
"""


def soccer() -> SimulatedRemote:
    """A robot on a soccer field: from its cameras to the track of the ball."""
    remote = SimulatedRemote()
    client = remote.client
    client.add_transformation(as_specification([_transformation(row) for row in _rows(_LIBRARY)]))
    for name, label, ports in _rows(_NODELETS):
        topics = dict(port.split("=") for port in ports.split())
        client.spawn(label, name, topics, parameters=_GIVEN.get(name, ()))
    client.set_protection("/nao1/bottom_camera", True)
    client.alter("/nao1/resize", kind=NodeletKind.CPP, manager="/dyknow_cpp_nodelet_manager")
    client.alter("/nao1/recorder", state=State.LOST, detail="its process is gone")
    client.alter("/field/ceiling_camera", state=State.FAILED, detail="no device /dev/video4")
    for nodelet, port, rate, lost in (
        ("/nao1/bottom_camera", "yuv", 30.0, 0.0),
        ("/nao1/top_camera", "yuv", 15.0, 0.0),
        ("/nao1/subsampler", "hsv", 30.0, 0.0),
        ("/nao1/subsampler", "channels", 29.9, 0.0),
        ("/nao1/ball_detector", "ball", 21.4, 0.0),
        ("/nao1/ball_detector", "channels", 21.4, 8.5),
        ("/nao1/ball_detector", "joint_states", 50.0, 0.0),
        ("/nao1/line_detector", "lines", 29.8, 0.0),
        ("/nao1/localization", "field_position", 21.4, 0.0),
        ("/field/tracker", "track", 10.0, 0.0),
        ("/nao1/resize", "resized", 15.0, 0.0),
    ):
        client.rates[nodelet, port] = (rate, lost)
    remote.publishers = {"/nao1/joint_states": ["/nao1/driver"]}
    remote.subscribers = {"/field/tracker/track": ["/team_view"]}
    return remote


def _rows(table: str) -> List[List[str]]:
    return [[cell.strip() for cell in row.split(";")] for row in table.strip().splitlines()]


def _transformation(row: List[str]) -> Transformation:
    label, source, *ports = row
    parameters = _PARAMETERS.get(label, ())
    return Transformation(label, source, parameters=parameters, ports=tuple(map(_port, ports)))


def _port(text: str) -> Port:
    name, datatype, *tag = text.split(" ", 2)
    return Port(name.strip(">"), IN if name.startswith(">") else OUT, datatype, tuple(tag))


def tree(count: int) -> SimulatedRemote:
    """A simulated manager with so many nodelets."""
    remote = SimulatedRemote()
    relay = Transformation("relay", "dyknow/Relay", ports=(Port("in", IN), Port("out", OUT)))
    remote.client.add_transformation(as_specification([relay]))
    for number in range(count):
        spawn_relay(remote.client, number)
    return remote


def spawn_relay(client: BaseManagerClient, number: int) -> None:
    """Spawn the next relay of a tree.

    There are ten in a namespace, where each leads to two of them; a namespace leads to five.
    """
    group, place = divmod(number, 10)
    topics = {"out": f"/part{group}/stream{place}"}
    if number:
        source = (group, (place - 1) // 2) if place else ((group - 1) // 5, 9)
        topics["in"] = "/part{}/stream{}".format(*source)
    client.spawn("relay", f"/part{group}/nodelet{place}", topics)
