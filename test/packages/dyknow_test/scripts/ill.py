#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Misbehaves as its first argument says, like scripts that cannot share a process."""

import os
import sys

import rospy

what = sys.argv[1]
rospy.init_node("ill")
if what == "keyboard":
    input("go? ")
elif what == "stdin":
    sys.stdin.readline()
elif what == "toolkit":
    __import__("tkinter.ttk")
elif what == "fork":
    os.fork()
elif what == "chdir":
    os.chdir("/")
elif what == "alarm":
    import signal

    signal.alarm(1)
elif what == "processes":
    from multiprocessing import Pool

    Pool(2)
elif what in ("display", "show"):
    import threading

    def show(event=None):
        __import__("cv2").imshow("window", None)

    if what == "show":
        threading.Timer(0.1, show).start()
    else:
        rospy.Timer(rospy.Duration(0.1), show)
    rospy.spin()
elif what == "raises":
    raise ValueError("of its own")
elif what == "exits":
    sys.exit(3)
elif what == "optional":
    try:
        __import__("tkinter")
    except ImportError:
        rospy.Service("~without", __import__("std_srvs.srv").srv.Empty, lambda request: ())
    rospy.spin()
elif what == "later":
    rospy.sleep(0.1)
    raise ValueError("later")
elif what == "quit":
    rospy.Timer(rospy.Duration(0.1), lambda event: rospy.signal_shutdown("enough"), oneshot=True)
    rospy.spin()
elif what == "_exit":
    rospy.sleep(0.1)
    os._exit(4)
elif what == "crash":
    rospy.sleep(0.1)
    import ctypes

    ctypes.string_at(0)
