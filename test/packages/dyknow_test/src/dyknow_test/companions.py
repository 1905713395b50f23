# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that use libraries made for rospy's nodes."""

from __future__ import annotations

import actionlib
import diagnostic_msgs.msg
import diagnostic_updater
import message_filters
import rospy
import tf2_ros
from actionlib.msg import TestAction, TestGoal, TestResult
from dynamic_reconfigure.server import Server
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import Image
from tf2_msgs.msg import TFMessage

from dyknow_test.puppet import Puppet


class Synchroniser(Puppet):
    """Puts the images of two ports together by their stamps."""

    def set_up(self):
        self.pairs = []
        self.synchroniser = message_filters.TimeSynchronizer(
            [self.nh.Subscriber("left", Image), self.nh.Subscriber("right", Image)], 10
        )
        self.synchroniser.registerCallback(self.note)

    def note(self, left, right):
        self.pairs.append([left.height, right.height])

    def received(self):
        return self.pairs


class Frames(Puppet):
    """Sends transforms and looks them up."""

    def set_up(self):
        self.buffer = tf2_ros.Buffer()
        self.listener = tf2_ros.TransformListener(self.buffer)
        self.broadcaster = tf2_ros.TransformBroadcaster()
        self.static_broadcaster = tf2_ros.StaticTransformBroadcaster()

    def on_shutdown(self):
        self.listener.unregister()
        super().on_shutdown()

    def send(self, parent, child, x):
        self.broadcaster.sendTransform(self._transform(parent, child, x))

    def send_static(self, parent, child, x):
        self.static_broadcaster.sendTransform(self._transform(parent, child, x))

    def look_up(self, parent, child, timeout):
        try:
            found = self.buffer.lookup_transform(
                parent, child, rospy.Time(0), rospy.Duration(timeout)
            )
        except tf2_ros.TransformException as error:
            return str(error)
        return found.transform.translation.x

    @staticmethod
    def _transform(parent, child, x):
        transform = TransformStamped()
        transform.header.stamp = rospy.Time.now()
        transform.header.frame_id = parent
        transform.child_frame_id = child
        transform.transform.translation.x = x
        transform.transform.rotation.w = 1.0
        return transform


class FramesByBus(Frames):
    """Sends transforms through the bus, as a nodelet does that publishes `/tf` itself."""

    def set_up(self):
        super().set_up()
        self.broadcaster.pub_tf.unregister()
        self.broadcaster.pub_tf = self.node_handle.Publisher("/tf", TFMessage, queue_size=10)
        self.static_broadcaster.pub_tf.unregister()
        self.static_broadcaster.pub_tf = self.node_handle.Publisher(
            "/tf_static", TFMessage, queue_size=10, latch=True
        )


class Diagnosed(Puppet):
    """Tells how it is, from a timer."""

    def set_up(self):
        self.updater = diagnostic_updater.Updater()
        self.updater.setHardwareID(self.name)
        self.updater.add("state", self.diagnose)
        self.timer = self.nh.Timer(
            self.nh.Duration(0.05), lambda event: self.updater.force_update()
        )

    @staticmethod
    def diagnose(status):
        status.summary(diagnostic_msgs.msg.DiagnosticStatus.WARN, "a little warm")
        status.add("temperature", "71")
        return status


def _described(name, kind, default, level):
    return {
        "name": name,
        "type": kind,
        "default": default,
        "level": level,
        "description": "",
        "edit_method": "",
    }


class ConfigType:
    """The class that dynamic_reconfigure would generate from a .cfg file with these parameters."""

    defaults = {"gain": 1.0, "size": 3}
    min = {"gain": 0.0, "size": 1}
    max = {"gain": 10.0, "size": 9}
    level = {"gain": 1, "size": 2}
    all_level = 3
    config_description = {
        "name": "Default",
        "type": "",
        "id": 0,
        "parent": 0,
        "state": True,
        "groups": [],
        "parameters": [
            _described("gain", "double", 1.0, 1),
            _described("size", "int", 3, 2),
        ],
    }


class Reconfigurable(Puppet):
    """Has parameters of dynamic_reconfigure in its own namespace."""

    def set_up(self):
        self.configs = []
        self.server = Server(ConfigType, self.configure, namespace=self.name)

    def on_shutdown(self):
        self.server.set_service.shutdown()
        self.server.descr_topic.unregister()
        self.server.update_topic.unregister()
        super().on_shutdown()

    def configure(self, config, level):
        self.configs.append([config["gain"], config["size"]])
        return config

    def seen(self):
        return self.configs


class Careless(Puppet):
    """Uses every library and takes nothing back."""

    def on_init(self):
        super().on_init()
        actions = actionlib.SimpleActionServer("~count", TestAction, self._count, auto_start=False)
        actions.start()
        self._actions = actions
        self._server = Server(ConfigType, lambda config, level: config)
        updater = diagnostic_updater.Updater()
        updater.setHardwareID(self.name)
        updater.add("state", Diagnosed.diagnose)
        self._listener = tf2_ros.TransformListener(tf2_ros.Buffer())
        subscriber = message_filters.Subscriber("~image", Image)
        self._cache = message_filters.Cache(subscriber, 10)

    def ask(self, server, goal):
        client = actionlib.SimpleActionClient(server, TestAction)
        client.wait_for_server()
        client.send_goal(TestGoal(goal))
        # It does not know of the result of a goal that is reached before its `send_goal` returns.
        while not client.wait_for_result(rospy.Duration(5.0)):
            client.send_goal(TestGoal(goal))
        return client.get_result().result

    def _count(self, goal):
        rospy.set_param("/counted", goal.goal)
        self._actions.set_succeeded(TestResult(goal.goal + 1))
