#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Passes on images."""

import rospy
from sensor_msgs.msg import Image

rospy.init_node("copier")
publisher = rospy.Publisher("copied", Image, queue_size=100)
rospy.Subscriber("original", Image, publisher.publish)
rospy.spin()
