#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Plain C++ nodelets of image_proc under the DyKnow manager, in one graph with Python ones."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path

import rospkg
import rospy
import rostest
from dyknow_msgs.srv import GetStatistics
from manager_suite import LIBRARY, ManagerCase, eventually, registrations, specification
from processes import BUSY
from sensor_msgs.msg import CameraInfo, Image

from dyknow.errors import Refused
from dyknow.model.graph import State

EXAMPLE = Path(rospkg.RosPack().get_path("dyknow")) / "examples/transformations/image_proc.xml"
CPP = "/dyknow_cpp_nodelet_manager"
RELAY = specification("images", "dyknow_manager_test/ImageRelay", ">in out>")


class Camera:
    """Publishes images of 8 × 6 pixels, with camera_info, in a namespace until it is closed."""

    def __init__(self, namespace: str) -> None:
        self._images = rospy.Publisher(f"{namespace}/image_raw", Image, queue_size=1)
        self._infos = rospy.Publisher(f"{namespace}/camera_info", CameraInfo, queue_size=1)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._closed.wait(0.05):
            image = Image(height=6, width=8, encoding="mono8", step=8, data=bytes(48))
            info = CameraInfo(height=6, width=8)
            image.header.stamp = info.header.stamp = rospy.Time.now()
            self._images.publish(image)
            self._infos.publish(info)

    def close(self) -> None:
        self._closed.set()
        self._thread.join()
        self._images.unregister()
        self._infos.unregister()


def size_on(topic: str, timeout: float = 10.0) -> tuple[int, int]:
    image = rospy.wait_for_message(topic, Image, timeout)
    return image.width, image.height


class CppTest(ManagerCase):
    def setUp(self):
        self.manager = self.started()
        self.client = self.manager.client
        self.client.add_transformation(EXAMPLE.read_text())
        self.client.add_transformation(RELAY)
        for namespace in ("/cam", "/cam2"):
            camera = Camera(namespace)
            self.addCleanup(camera.close)

    def test_a_chain_of_both_kinds(self):
        self.client.spawn("images", "/relay", {"in": "/cam/image_raw", "out": "/copy"})
        self.client.spawn("resize", "/robot/resize", {"image": "/copy", "~image": "/small"})
        self.assertEqual(size_on("/small"), (4, 3))
        found = self.manager.nodelet("/robot/resize")
        self.assertTrue(found.rewired_by_reload)
        self.assertEqual((found.manager, found.state), (CPP, State.RUNNING))
        self.assertEqual(
            self.manager.topics("/robot/resize"),
            {"image": "/copy", "camera_info": "", "~image": "/small", "~camera_info": ""},
        )
        self.assertEqual(rospy.get_param("/robot/resize/scale_width"), 0.5)

        self.client.set_config("/robot/resize", {"image": "/cam2/image_raw"})
        self.assertEqual(size_on("/small"), (4, 3))
        ports = {port.name: port.topic for port in self.client.get_config("/robot/resize")}
        self.assertEqual(ports["image"], "/cam2/image_raw")
        self.assertEqual(self.manager.topics("/robot/resize"), ports)
        with self.assertRaisesRegex(Refused, "sideways"):
            self.client.set_config("/robot/resize", {"sideways": "/x"})
        statistics = rospy.ServiceProxy("/robot/resize/get_statistics", GetStatistics)()
        self.assertEqual(statistics.reconfigurations, 1)
        self.assertEqual([math.isnan(port.rate) for port in statistics.ports], [True] * 4)
        traffic = self.client.get_statistics("/robot/resize").ports
        self.assertEqual([port.messages for port in traffic], [None] * 4)

        self.client.destroy("/robot/resize")
        eventually(lambda: registrations("/robot") == [], 2.0, "nothing is left")
        eventually(lambda: registrations("/small") == [], 2.0, "nothing is left")

    def test_crop_decimate_finds_camera_info_beside_its_image(self):
        config = {"camera/image_raw": "/cam/image_raw", "camera_out/image_raw": "/half/image_raw"}
        self.client.spawn("crop_decimate", "/crop", config)
        self.assertEqual(size_on("/half/image_raw"), (4, 3))
        self.assertEqual(rospy.wait_for_message("/half/camera_info", CameraInfo, 5.0).width, 8)

    def test_kill_9_of_the_cpp_nodelet_manager_and_of_the_manager(self):
        config = {"image": "/cam/image_raw", "~image": "/small"}
        self.client.spawn("resize", "/resize", config)
        self.assertEqual(size_on("/small"), (4, 3))
        self.manager.kill_child(CPP)
        eventually(
            lambda: self.manager.nodelet("/resize").state is State.RUNNING, 10.0, "it is back"
        )
        self.assertEqual(size_on("/small"), (4, 3))
        process = self.manager.child(CPP)
        self.manager.kill()
        self.assertEqual(size_on("/small"), (4, 3))
        self.manager.start()
        self.assertEqual(self.manager.child(CPP), process)
        self.client.set_config("/resize", {"image": "/cam2/image_raw"})
        self.assertEqual(size_on("/small"), (4, 3))
        self.assertLess(self.manager.stop(), 24)
        self.assertFalse(process.alive)
        self.assertEqual(registrations("/resize"), [])

    def test_the_cpp_nodelet_manager_ends_when_nobody_looks_after_it(self):
        self.manager.stop()
        self.manager.parameters["orphan_timeout"] = 1.0
        self.manager.start()
        self.client.spawn("resize", "/resize", {"image": "/cam/image_raw"})
        process = self.manager.child(CPP)
        self.manager.kill()
        time.sleep(0.5)
        self.assertTrue(process.alive)
        self.assertTrue(process.wait(5.0 * BUSY))

    def test_a_type_that_its_package_cannot_provide(self):
        self.client.add_transformation(specification("gone", "image_proc/nothing", ""))
        with self.assertRaisesRegex(Refused, "image_proc/nothing"):
            self.client.spawn("gone", "/gone")
        self.client.add_transformation(LIBRARY)


if __name__ == "__main__":
    rospy.init_node("manager_cpp_test")
    rostest.rosrun("dyknow", "manager_cpp", "__main__")
