# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about live ports of C++ nodelets."""

from __future__ import annotations

import json
from typing import Any

import graph
import rospy
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import SetConfig
from processes import DYKNOW, STOCK_NODELET
from roslib.packages import find_node
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger

OURS = (*find_node("dyknow", "cpp_nodelet_manager"),)
STOCK = (*STOCK_NODELET, "manager")
#: Runs a node with the library.
RUN = (*DYKNOW, "run")
PRELOADED = (*RUN, "nodelet", "nodelet", "manager")
#: Report of a sink to which everything has come once, in order and by reference.
FLAWLESS = {"lost": 0, "doubled": 0, "reordered": 0, "copied": 0}


class CppManager(graph.Manager):
    """A nodelet manager in C++."""

    package = "dyknow_cpp_test"

    def __init__(self, name: str, *command: str) -> None:
        super().__init__(name, command=command or OURS)


def start(source: str) -> None:
    """Let a source publish its messages."""
    rospy.ServiceProxy(f"{source}/start", Trigger)()


def report(nodelet: str) -> dict[str, int]:
    """The report of a source or a sink."""
    return json.loads(rospy.ServiceProxy(f"{nodelet}/report", Trigger)().message)


def flaws(sink: str) -> dict[str, int]:
    """The part of a sink's report that is to be flawless."""
    return {key: value for key, value in report(sink).items() if key in FLAWLESS}


class Camera:
    """Publishes images with camera_info in a namespace until it is closed."""

    def __init__(self, namespace: str, width: int) -> None:
        self._images = rospy.Publisher(f"{namespace}/image_raw", Image, queue_size=1)
        self._infos = rospy.Publisher(f"{namespace}/camera_info", CameraInfo, queue_size=1)
        self._width = width
        self._timer = rospy.Timer(rospy.Duration(0.05), self._publish)

    def _publish(self, event: Any) -> None:
        width = self._width
        image = Image(height=6, width=width, encoding="mono8", step=width, data=bytes(6 * width))
        info = CameraInfo(height=6, width=width)
        image.header.stamp = info.header.stamp = rospy.Time.now()
        self._images.publish(image)
        self._infos.publish(info)

    def __enter__(self) -> Camera:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        self._timer.shutdown()
        self._timer.join()
        self._images.unregister()
        self._infos.unregister()


class Mover:
    """Connects one port of a nodelet elsewhere, over a connection that it keeps."""

    def __init__(self, nodelet: str, port: str) -> None:
        self._port = port
        self._set_config = rospy.ServiceProxy(f"{nodelet}/set_config", SetConfig, persistent=True)

    def __call__(self, topic: str) -> None:
        answer = self._set_config([PortConfig(self._port, topic)])
        assert answer.success, answer.message

    def __enter__(self) -> Mover:
        return self

    def __exit__(self, *unused: object) -> None:
        self._set_config.close()
