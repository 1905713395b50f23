#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Uses one topic in both directions, a private one, a global one, and a resolved one."""

import rospy
from std_msgs.msg import String

rospy.init_node("both_ways")
back = rospy.Publisher("shout", String, queue_size=1)
rospy.Subscriber("shout", String, lambda message: None)
rospy.Subscriber("~whisper", String, lambda message: None)
rospy.Subscriber("/siren", String, lambda message: None)
rospy.Subscriber(rospy.resolve_name("told"), String, lambda message: None)
rospy.Subscriber("/rosout_agg", rospy.AnyMsg, lambda message: None)
rospy.spin()
