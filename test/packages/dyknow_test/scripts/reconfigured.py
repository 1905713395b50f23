#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A server of dynamic_reconfigure, and a client that asks another server."""

import dynamic_reconfigure.client
import dynamic_reconfigure.server
import rospy
from dynamic_reconfigure.cfg import TestConfig
from std_msgs.msg import Int32

rospy.init_node("reconfigured")
publisher = rospy.Publisher("~size", Int32, queue_size=10, latch=True)


def changed(config, level):
    publisher.publish(config["int_"])
    return config


servers = rospy.myargv()[1:]
if servers:
    client = dynamic_reconfigure.client.Client(servers[0], timeout=20.0)
    client.update_configuration({"int_": 7})
else:
    dynamic_reconfigure.server.Server(TestConfig, changed)
rospy.spin()
