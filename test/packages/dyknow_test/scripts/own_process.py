#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes settings of a process, and prints their effects: `own_process.py FUNCTION`."""

import atexit
import contextlib
import importlib
import io
import os
import pickle
import signal
import sys
import tempfile
import threading
import time
import types

import rospy
from std_srvs.srv import Empty

FOLDERS = []


def write_module(name):
    FOLDERS.append(tempfile.TemporaryDirectory())
    folder = FOLDERS[-1].name
    with open(os.path.join(folder, f"{name}.py"), "w") as file:
        file.write("import rospy\nclass Thing: pass\n")
    return folder


def settings():
    printed = io.StringIO()
    sys.stdout, before = printed, sys.stdout
    print("captured")
    sys.stdout = before
    with contextlib.redirect_stdout(printed):
        print("redirected")
    print("stdout", printed.getvalue().split())
    sys.displayhook = lambda value: print("displayed", value)
    exec(compile("4", "prompt", "single"))
    sys.unraisablehook = lambda event: print("unraisable", event.exc_type.__name__)
    type("Falling", (), {"__del__": lambda self: 1 / 0})()
    threading.excepthook = lambda event: print("thread", event.exc_type.__name__)
    thread = threading.Thread(target=lambda: 1 / 0)
    thread.start()
    thread.join()
    print("path", sys.path[0] == os.path.dirname(os.path.abspath(__file__)), "" in sys.path)
    sys.path.insert(0, write_module("own_inserted"))
    sys.path = [write_module("own_replaced"), *sys.path]
    import own_inserted
    import own_replaced

    for module in (own_inserted, own_replaced):
        name = module.__name__
        is_same = sys.modules[name] is module is importlib.import_module(name)
        print(name, is_same, type(pickle.loads(pickle.dumps(module.Thing()))) is module.Thing)
        print(module.rospy is rospy)
    del sys.modules["own_inserted"]
    print("again", importlib.import_module("own_inserted") is own_inserted)
    sys.modules["own_fake"] = types.ModuleType("own_fake")
    print("fake", importlib.import_module("own_fake") is sys.modules["own_fake"])
    sys.argv = ["other", "word", "_rate:=5"]
    print("argv", rospy.myargv(), sys.argv)
    rospy.init_node("own_process", anonymous=True)
    for number in (1, 2):
        atexit.register(lambda number=number: print("exit", number, rospy.is_shutdown()))
    atexit.register(settings)
    atexit.unregister(settings)
    rospy.on_shutdown(lambda: print("on_shutdown"))
    sys.excepthook = lambda kind, error, trace: print("hook", kind.__name__, error)
    raise ValueError("the end")


def interrupt_soon():
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()


def catches():
    rospy.init_node("own_process", anonymous=True)
    interrupt_soon()
    try:
        rospy.ServiceProxy("no_such_service", Empty).wait_for_service()
    except rospy.ROSInterruptException:
        print("caught", rospy.is_shutdown())
    with contextlib.suppress(rospy.ROSInterruptException):
        rospy.wait_for_message("no_such_topic", rospy.AnyMsg)
    print("and again", rospy.is_shutdown())


def handles():
    rospy.init_node("own_process", anonymous=True)
    signal.signal(signal.SIGINT, lambda number, frame: print("handled"))
    interrupt_soon()
    time.sleep(1.0)
    print("runs on", not rospy.is_shutdown())


def no_node():
    interrupt_soon()
    time.sleep(60.0)


globals()[sys.argv[1]]()
