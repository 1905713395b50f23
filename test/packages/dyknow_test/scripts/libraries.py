#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Uses libraries of rospy: actions, transforms, diagnostics, filters."""

import sys
import threading

import actionlib
import diagnostic_updater
import message_filters
import rospy
import tf2_ros
from actionlib.msg import TestAction, TestGoal, TestResult
from geometry_msgs.msg import PointStamped, TransformStamped
from std_msgs.msg import String


def serve():
    def execute(goal):
        server.set_succeeded(TestResult(result=goal.goal + 1))

    server = actionlib.SimpleActionServer("~count", TestAction, execute, auto_start=False)
    server.start()
    updater = diagnostic_updater.Updater()
    updater.setHardwareID("none")
    updater.add("all", lambda status: status)
    rospy.Timer(rospy.Duration(0.1), lambda event: updater.force_update())
    broadcaster = tf2_ros.StaticTransformBroadcaster()
    transform = TransformStamped(child_frame_id="tool")
    transform.header.frame_id = "base"
    transform.transform.translation.x = 2.0
    transform.transform.rotation.w = 1.0
    broadcaster.sendTransform(transform)
    rospy.spin()


def ask(server):
    told = rospy.Publisher("~told", String, queue_size=10, latch=True)
    client = actionlib.SimpleActionClient(server, TestAction)
    if not client.wait_for_server(rospy.Duration(20.0)):
        raise RuntimeError(f"no action server {server}")
    client.send_goal(TestGoal(goal=41))
    # It does not know of the result of a goal that is reached before its `send_goal` returns.
    while not client.wait_for_result(rospy.Duration(5.0)):
        client.send_goal(TestGoal(goal=41))
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    found = buffer.lookup_transform("base", "tool", rospy.Time(0), rospy.Duration(20.0))
    listener.unregister()
    both = threading.Event()
    filters = [message_filters.Subscriber(f"~{side}", PointStamped) for side in ("left", "right")]
    synchroniser = message_filters.TimeSynchronizer(filters, 10)
    synchroniser.registerCallback(lambda left, right: both.set())
    ends = [rospy.Publisher(f"~{side}", PointStamped, queue_size=10) for side in ("left", "right")]
    while not both.is_set():
        point = PointStamped()
        point.header.stamp = rospy.Time(1)
        for end in ends:
            end.publish(point)
        rospy.sleep(0.05)
    x = found.transform.translation.x
    told.publish(f"{client.get_result().result} {x} {client.get_goal_status_text()}")
    rospy.spin()


if __name__ == "__main__":
    rospy.init_node("libraries")
    words = rospy.myargv(sys.argv)
    if words[1:]:
        ask(words[1])
    else:
        serve()
