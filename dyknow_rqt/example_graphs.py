# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Graphs for pictures and tests: a soccer robot's, and trees of any size."""

from __future__ import annotations

from typing import Dict, Tuple

from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import NodeletKind, State
from dyknow.model.transformation import Parameter
from dyknow_rqt.simulated import SimulatedRemote

_IMAGE, _POINT, _JOINTS = (
    "sensor_msgs/Image",
    "geometry_msgs/PointStamped",
    "sensor_msgs/JointState",
)
#: Label, source, ports (`>name` for in, `name>` for out) with their types and tags.
_LIBRARY = (
    ("camera(nao1, bottom)", "soccer/Camera", (("yuv>", _IMAGE, "RawYUV(nao1, bottom)"),)),
    ("camera(nao1, top)", "soccer/Camera", (("yuv>", _IMAGE, "RawYUV(nao1, top)"),)),
    (
        "ceiling_camera",
        "soccer/CeilingCamera",
        (("field_position>", _POINT, "FieldPosition(ball)"),),
    ),
    (
        "subsampler",
        "soccer/Subsampler",
        (
            (">yuv", _IMAGE, "RawYUV(?robot, ?camera)"),
            ("bgr>", _IMAGE, "BGR(?robot, ?camera)"),
            ("hsv>", _IMAGE, "HSV(?robot, ?camera)"),
            ("channels>", _IMAGE, "SubsampledYUV(?robot, ?camera)"),
        ),
    ),
    (
        "ball_detector",
        "soccer/BallDetector",
        (
            (">channels", _IMAGE, "SubsampledYUV(?robot, ?camera)"),
            (">joint_states", _JOINTS, ""),
            ("ball>", _POINT, "BallObject(?robot)"),
        ),
    ),
    (
        "line_detector",
        "soccer/LineDetector",
        (
            (">hsv", _IMAGE, "HSV(?robot, ?camera)"),
            ("lines>", "sensor_msgs/PointCloud2", "Lines(?robot)"),
        ),
    ),
    (
        "localization",
        "soccer/Localization",
        (
            (">objects", _POINT, "BallObject(?robot)"),
            (">lines", "sensor_msgs/PointCloud2", "Lines(?robot)"),
            ("field_position>", _POINT, "FieldPosition(ball)"),
        ),
    ),
    (
        "tracker",
        "soccer/Tracker",
        ((">position", _POINT, "FieldPosition(ball)"), ("track>", "nav_msgs/Path", "Track(ball)")),
    ),
    ("resize", "image_proc/resize", ((">image", _IMAGE, ""), ("resized>", _IMAGE, ""))),
    ("recorder", "dyknow/Sink", ((">in", _IMAGE, ""),)),
)
_PARAMETERS = {
    "ball_detector": '<param name="mount" type="string">${?robot}_bottom_camera</param>'
    '<param name="colour" type="string">orange</param>'
}
_GIVEN = {"/nao1/ball_detector": (Parameter("?robot", "", "nao1"),)}
#: Name, label, topics of ports.
_NODELETS: Tuple[Tuple[str, str, Dict[str, str]], ...] = (
    ("/nao1/bottom_camera", "camera(nao1, bottom)", {"yuv": "/nao1/bottom_camera/yuv"}),
    ("/nao1/top_camera", "camera(nao1, top)", {"yuv": "/nao1/top_camera/yuv"}),
    (
        "/nao1/subsampler",
        "subsampler",
        {
            "yuv": "/nao1/bottom_camera/yuv",
            "hsv": "/nao1/subsampler/hsv",
            "channels": "/nao1/subsampler/channels",
        },
    ),
    (
        "/nao1/ball_detector",
        "ball_detector",
        {
            "channels": "/nao1/subsampler/channels",
            "joint_states": "/nao1/joint_states",
            "ball": "/nao1/ball_detector/ball",
        },
    ),
    (
        "/nao1/line_detector",
        "line_detector",
        {"hsv": "/nao1/subsampler/hsv", "lines": "/nao1/line_detector/lines"},
    ),
    (
        "/nao1/localization",
        "localization",
        {
            "objects": "/nao1/ball_detector/ball",
            "lines": "/nao1/line_detector/lines",
            "field_position": "/field/ball",
        },
    ),
    ("/field/ceiling_camera", "ceiling_camera", {}),
    ("/field/tracker", "tracker", {"position": "/field/ball", "track": "/field/tracker/track"}),
    ("/nao1/resize", "resize", {"image": "/nao1/top_camera/yuv", "resized": "/nao1/preview"}),
    ("/nao1/recorder", "recorder", {"in": "/nao1/preview"}),
)


def soccer() -> SimulatedRemote:
    """A robot on a soccer field: from its cameras to the track of the ball."""
    remote = SimulatedRemote()
    client = remote.client
    client.add_transformation(_specification())
    for name, label, topics in _NODELETS:
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


def _specification() -> str:
    parts = []
    for label, source, ports in _LIBRARY:
        lines = [
            f"<transformation><label>{label}</label><source>{source}</source>"
            f"<params>{_PARAMETERS.get(label, '')}</params><ports>"
        ]
        tags = []
        for name, datatype, tag in ports:
            side, plain = ("in" if name[0] == ">" else "out"), name.strip(">")
            lines.append(f'<port type="{side}" datatype="{datatype}">{plain}</port>')
            tags += [f'<tag port="{plain}">{tag}</tag>'] if tag else []
        lines.append("</ports>" + (f"<tags>{''.join(tags)}</tags>" if tags else ""))
        parts.append("".join(lines) + "</transformation>")
    return f"<transformations>{''.join(parts)}</transformations>"


_RELAY = (
    "<transformation><label>relay</label><source>dyknow/Relay</source><ports>"
    '<port type="in">in</port><port type="out">out</port></ports></transformation>'
)


def tree(count: int) -> SimulatedRemote:
    """A simulated manager with so many nodelets."""
    remote = SimulatedRemote()
    remote.client.add_transformation(_RELAY)
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
