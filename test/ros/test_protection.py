#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers unload a protected nodelet only for the DyKnow manager that protects it."""

from __future__ import annotations

import rospy
import rostest
from graph import Manager
from manager_suite import CHILD, ManagerCase, eventually
from nodelet.srv import NodeletList, NodeletUnload

from dyknow.errors import Refused

RELAY = "/relay"


def running(manager):
    """The nodelets of a nodelet manager; none while it does not run."""
    try:
        return list(rospy.ServiceProxy(f"{manager}/list", NodeletList)().nodelets)
    except (rospy.ServiceException, rospy.TransportException):
        return []


def refusal(manager, name=RELAY):
    """The reason for which a nodelet manager refuses an unload; empty if it does not."""
    try:
        rospy.ServiceProxy(f"{manager}/unload_nodelet", NodeletUnload)(name)
    except rospy.ServiceException as error:
        return str(error)
    return ""


class ProtectionTest(ManagerCase):
    def test_the_stock_service_is_refused_until_it_is_released(self):
        manager = self.started()
        manager.client.spawn("relay", RELAY, is_protected=True)
        self.assertIn("protected from unloading", refusal(CHILD))
        self.assertEqual(running(CHILD), [RELAY])
        with self.assertRaises(Refused):
            manager.client.destroy(RELAY)
        manager.client.set_protection(RELAY, False)
        eventually(lambda: refusal(CHILD) == "", 5.0, "it is released")
        eventually(lambda: manager.nodelet(RELAY) is None, 5.0, "the user's will is followed")

    def test_what_is_protected_later_and_destroyed_in_the_end(self):
        manager = self.started()
        for name in ("/one", "/two"):
            manager.client.spawn("relay", name)
        manager.client.set_protection("/one", True)
        self.assertIn("protected from unloading", refusal(CHILD, "/one"))
        self.assertEqual(refusal(CHILD, "/two"), "")
        manager.client.set_protection("/one", False)
        manager.client.destroy("/one")
        self.assertEqual(running(CHILD), [])

    def test_a_restarted_nodelet_manager_and_a_restarted_manager(self):
        manager = self.started()
        manager.client.spawn("relay", RELAY, is_protected=True)
        manager.kill_child()
        eventually(lambda: RELAY in running(CHILD), 20.0, "the nodelet is back")
        self.assertIn("protected from unloading", refusal(CHILD))
        manager.kill()
        self.assertIn("protected from unloading", refusal(CHILD))
        manager.start()
        self.assertIn("protected from unloading", refusal(CHILD))
        self.assertEqual(running(CHILD), [RELAY])

    def test_a_nodelet_manager_of_others(self):
        other = Manager("/other")
        self.addCleanup(other.__exit__)
        manager = self.started(nodelet_managers=["/other"])
        manager.client.spawn("relay", RELAY, manager="/other", is_protected=True)
        self.assertIn("protected from unloading", refusal("/other"))
        manager.stop()  # deliberately: its nodelets there end with it
        eventually(lambda: running("/other") == [], 10.0, "nothing is left")


if __name__ == "__main__":
    rospy.init_node("protection_test")
    rostest.rosrun("dyknow", "protection", "__main__")
