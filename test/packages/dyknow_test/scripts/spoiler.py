#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Publishes one message over and over, and writes into the messages that it receives."""

import rospy
from sensor_msgs.msg import JointState

rospy.init_node("spoiler")
state = JointState(name=["a"], position=[0.0])
publisher = rospy.Publisher("~states", JointState, queue_size=10)
seen = rospy.Publisher("~seen", JointState, queue_size=10)


def spoil(message):
    seen.publish(message)
    message.name[0] = "spoilt"
    message.position[0] = -2.0


rospy.Subscriber("~states", JointState, spoil)
rospy.Subscriber("~states", JointState, spoil)
number = 0
while not rospy.is_shutdown():
    state.position[0] = number
    publisher.publish(state)
    state.position[0] = -1.0
    number += 1
    rospy.sleep(0.02)
