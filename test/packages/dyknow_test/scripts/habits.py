#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Relies on undocumented behaviour of rospy; waits as its first argument says."""

import rospy
from std_msgs.msg import String

how = rospy.myargv()[1]
rospy.init_node("habits")
words = rospy.Publisher("~words", String, queue_size=10)
reasons = []


def stop():
    """As drivers of robots do: a last command must arrive."""
    words.publish("stopping")
    rospy.sleep(1.0)
    words.publish("stopped")


rospy.on_shutdown(stop)
rospy.core.add_preshutdown_hook(reasons.append)
rospy.set_param("~remapped", [rospy.remap_name(each) for each in ("camera", "lamp")])


class Farewell:
    def __del__(self):
        words.publish("never heard, and no error")


farewell = Farewell()
farewell.itself = farewell  # so that it goes late
if how == "service":
    rospy.wait_for_service("/never")
elif how == "message":
    rospy.wait_for_message("/never", String)
elif how == "quit":
    rospy.signal_shutdown("enough")
    rospy.set_param("~quit", [rospy.is_shutdown(), *reasons])
rospy.spin()
