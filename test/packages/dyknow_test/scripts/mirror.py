#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Prints a node's view of itself: its names, parameters and topics."""

import threading
import xmlrpc.client

import rospy
from rosgraph_msgs.msg import Log
from std_msgs.msg import String

rospy.init_node("mirror")
rospy.set_param("here", 1)
rospy.set_param("~private", 2)
print("name", rospy.get_name(), rospy.get_caller_id(), rospy.get_namespace())
print("mappings", sorted(rospy.names.get_mappings().items()))
wanted = ("here", "~here", "/here", "~/here", "other", "", "~", "~/", "/")
print("resolved", [(rospy.resolve_name(name), rospy.remap_name(name)) for name in wanted])
print("found", [rospy.search_param(name) for name in ("here", "private", "absent")])
print("parameters", rospy.get_param("~"), rospy.get_param("here"), rospy.has_param("absent"))
below = rospy.get_namespace()
print("all", sorted(name for name in rospy.get_param_names() if name.startswith(below)))

publishers = [rospy.Publisher(name, String, queue_size=1) for name in ("words", "~/words")]
logged = threading.Event()


def on_log(log):
    if log.msg == "look" and not logged.is_set():  # the next one may have been sent already
        print("log", log.name, sorted(log.topics))
        logged.set()


subscriber = rospy.Subscriber("/rosout", Log, on_log)
while not logged.wait(0.05):
    rospy.loginfo("look")
node = xmlrpc.client.ServerProxy(rospy.get_node_uri())
print("publications", sorted(node.getPublications("/test")[2]))
print("subscriptions", sorted(node.getSubscriptions("/test")[2]))
