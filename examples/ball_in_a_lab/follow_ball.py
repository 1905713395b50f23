#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Follows the ball, whoever sees it."""

import rospy
from geometry_msgs.msg import PointStamped

import dyknow


def on_position(position):
    where = f"({position.point.x:.2f}, {position.point.y:.2f})"
    rospy.loginfo_throttle(1.0, f"the ball is at {where}, seen by {position.header.frame_id}")


def on_event(event):
    rospy.loginfo("%s is %s: %s", event.after.bound_tag, event.after.state.name, event.reason)


rospy.init_node("follow_ball")
asked = "Position(ball, ?camera)"
with dyknow.acquire(asked, PointStamped, max_silence=1.0, on_event=on_event) as stream:
    rospy.Subscriber(stream.topic, PointStamped, on_position)
    rospy.spin()
