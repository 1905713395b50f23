# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets that break the rules for nodelets."""

from __future__ import annotations

import sys
import threading

import rospy
from std_msgs.msg import Header

import dyknow
from dyknow_test.puppet import Echo, Gate, Puppet


class Fragile(Puppet):
    """Its callback follows the order in the message's `frame_id`: raise, exit or hang."""

    def set_up(self):
        self.gate = Gate()
        self.numbers = []
        self.ended = 0
        self.out = self.nh.Publisher("out", Header, queue_size=10)
        self.sub = self.nh.Subscriber("in", Header, self.obey)
        self.service = self.nh.Service("~obey", Echo, self.obey)

    def obey(self, message):
        self.numbers.append(message.seq)
        order = message.frame_id
        if order == "raise":
            raise RuntimeError(f"fragile at {message.seq}")
        if order == "exit":
            sys.exit(3)
        if order == "hang":
            self.gate.close()
            self.gate.pass_through()
        return Header(seq=message.seq)

    def on_shutdown(self):
        self.ended += 1
        rospy.loginfo("%s: shut down for the %d. time", self.name, self.ended)
        super().on_shutdown()

    def received(self):
        return self.numbers


def register_much(nodelet):
    """Register one thing of each kind."""
    handle = nodelet.nh
    nodelet.things = [
        handle.Publisher("out", Header, queue_size=1),
        handle.Subscriber("in", Header, lambda message: None),
        nodelet.node_handle.Publisher("plain_out", Header, queue_size=1, latch=True),
        nodelet.node_handle.Subscriber("plain_in", Header, lambda message: None),
        nodelet.mt_private_node_handle.Subscriber("mt_in", Header, lambda message: None),
        handle.Service("~service", Echo, lambda request: request),
        handle.Timer(handle.Duration(0.01), lambda event: None),
    ]


class FailsInInit(dyknow.Nodelet):
    """Registers everything there is, and raises."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        register_much(self)
        raise ValueError("the camera is not plugged in")


class ExitsInInit(dyknow.Nodelet):
    """Ends the process, so it believes."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        register_much(self)
        sys.exit("enough")


class WaitsInInit(dyknow.Nodelet):
    """Waits in `on_init` for a parameter, and registers things after that."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        pause = threading.Event()
        while not rospy.get_param("/go_on", False):
            pause.wait(0.05)
        try:
            register_much(self)
        finally:
            rospy.loginfo("%s: on_init is through", self.name)


class HangsAtTheEnd(dyknow.Nodelet):
    """Its `on_shutdown` does not return."""

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)

    def on_shutdown(self):
        rospy.loginfo("%s: shutting down for ever", self.name)
        threading.Event().wait()


class NoNodelet:
    """Has the looks of a nodelet, but is none."""

    def on_init(self):
        """Set up."""
