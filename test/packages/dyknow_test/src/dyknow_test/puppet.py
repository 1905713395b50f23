# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets whose methods a test can call from another process."""

from __future__ import annotations

import json
import threading

import rospy
from std_msgs.msg import Header, String

import dyknow


class Call:
    """Service type of ``/NODELET/call``: a method and its arguments, and its result, in JSON."""

    _type = "dyknow_test/Call"
    _md5sum = "dyknow_test_call"
    _request_class = String
    _response_class = String


class Echo:
    """Service type that has a Header both ways."""

    _type = "dyknow_test/Echo"
    _md5sum = "dyknow_test_echo"
    _request_class = Header
    _response_class = Header


class Puppet(dyknow.Nodelet):
    """Runs its methods for a test, through a service.

    The service is an ordinary one of rospy, beside the nodelet's queue, so that a test can look
    into a nodelet whose callback hangs.
    """

    def on_init(self):
        self.nh = dyknow.NodeHandle(self.node_handle)
        self._calls = rospy.Service(f"{self.name}/call", Call, self._answer)
        try:
            self.set_up()
        except BaseException:
            self._calls.shutdown()
            raise

    def set_up(self):
        """Set the nodelet up; called by ``on_init``."""

    def on_shutdown(self):
        self._calls.shutdown()

    def _answer(self, request):
        method, args = json.loads(request.data)
        return String(json.dumps(getattr(self, method)(*args)))


class Gate:
    """Holds callbacks up until a test lets them go on."""

    def __init__(self):
        self._open = threading.Event()
        self._open.set()

    def close(self):
        self._open.clear()

    def open(self):
        self._open.set()

    def pass_through(self):
        if not self._open.wait(60.0):
            raise TimeoutError("the test has forgotten to open the gate")
