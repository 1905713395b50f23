#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Resists every request to end: each argument starts a kind of endless thread."""

import contextlib
import queue
import socket
import sys
import threading
import time

import rospy


def busy():
    while True:
        pass


def deaf():
    while True:
        with contextlib.suppress(BaseException):
            rospy.sleep(0.01)


def sleepy():
    while True:
        time.sleep(1000)


def waiting():
    threading.Event().wait()


def working():
    jobs = queue.Queue()
    while True:
        jobs.get()


def listening():
    left, right = socket.socketpair()
    left.recv(1)


kinds = {each.__name__: each for each in (busy, deaf, sleepy, waiting, working, listening)}
rospy.init_node("endless")
for kind in sys.argv[1:]:
    threading.Thread(target=kinds[kind], name=kind).start()
threading.Timer(1000, busy).start()
rospy.Timer(rospy.Duration(0.01), lambda event: None)
rospy.spin()
