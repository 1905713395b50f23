#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A nodelet manager that two DyKnow managers share is under the guards of both."""

from __future__ import annotations

import rospy
import rostest
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import SetConfig
from manager_suite import CHILD, ManagerCase, eventually, parameters
from nodelet.srv import NodeletUnload

RELAY = "/relay"
OTHER = "/other/manager"


class SharedGuardsTest(ManagerCase):
    def setUp(self):
        self.first = self.started(denied_topics=["/e_stop"])
        self.first.client.spawn("relay", RELAY)

    def other(self, **guards):
        """Another DyKnow manager that uses the nodelet manager of the first."""
        manager = self.make(OTHER, num_nodelet_managers=0, nodelet_managers=[CHILD], **guards)
        manager.start()
        return manager

    def refusal(self, topic):
        """The reason for which the proxy refuses a connection; empty if it does not."""
        call = rospy.ServiceProxy(f"{RELAY}/set_config", SetConfig)
        try:
            return call([PortConfig("out", topic)]).message
        except rospy.ServiceException as error:  # while it is being brought back
            return str(error)

    def denies(self, *topics):
        eventually(
            lambda: all("deny list" in self.refusal(topic) for topic in topics),
            5.0,
            f"{topics} are denied",
        )

    def test_only_its_owner_takes_a_guard_away(self):
        self.denies("/e_stop")
        other = self.other(denied_topics=["/wheels"])
        self.denies("/e_stop", "/wheels")
        other.stop()
        eventually(lambda: not self.refusal("/wheels"), 5.0, "/wheels is free")
        self.denies("/e_stop")
        self.first.kill_child()  # it starts under the guards that it had
        self.denies("/e_stop")
        self.assertEqual(self.refusal("/wheels"), "")

    def test_guards_of_a_killed_owner_stay_until_it_comes_again(self):
        other = self.other(denied_topics=["/wheels"], read_only=True)
        eventually(lambda: "read-only" in self.refusal("/fine"), 5.0, "read-only")
        other.kill()
        self.assertIn("read-only", self.refusal("/fine"))
        with self.assertRaises(rospy.ServiceException):
            rospy.ServiceProxy(f"{CHILD}/unload_nodelet", NodeletUnload)(RELAY)
        other.parameters.update(denied_topics=["/arm"], read_only=False)
        other.start()
        eventually(lambda: not self.refusal("/wheels"), 10.0, "its new guards hold")
        self.denies("/arm", "/e_stop")
        other.stop()
        left = [name for name in parameters(f"{CHILD}/guards") if "other" in name]
        self.assertEqual(left, [])


if __name__ == "__main__":
    rospy.init_node("shared_guards_test")
    rostest.rosrun("dyknow", "shared_guards", "__main__")
