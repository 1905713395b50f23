# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Scripts end: in order during their load, and without garbage collection in memory."""

from __future__ import annotations

import gc
import threading
import weakref
from types import SimpleNamespace

import numpy
import pytest
import rospy
from clocks import eventually

from dyknow.errors import LoadFailed
from dyknow.nodelet.context import Runtime
from dyknow.nodelet.loader import Loader
from dyknow.nodelet.local import LocalMiddleware
from dyknow.nodelet.scheduler import ManualExecutor, WorkerPool
from dyknow.ros.scripts.script import ScriptNodelet

HEAD = """#!/usr/bin/env python3
import rospy, threading
from std_msgs.msg import Header
from std_srvs.srv import Empty
import numpy
block = numpy.zeros(10)
numpy.witness.blocks.append(numpy.witness.ref(block))
rospy.init_node("script")
"""
SCRIPTS = {
    "global": "rospy.spin()",
    "object with a callback": """
class Node:
    def __init__(self):
        self.block = block
        self.sub = rospy.Subscriber("in", Header, self.receive)
        self.service = rospy.Service("service", Empty, self.receive)
        self.timer = rospy.Timer(rospy.Duration(0.01), self.receive)
        rospy.on_shutdown(self.end)
    def receive(self, message):
        pass
    def end(self):
        pass
def main():
    node = Node()
    rospy.spin()
main()
""",
    "thread": """
def work():
    mine = block
    while not rospy.is_shutdown():
        rospy.sleep(0.01)
threading.Thread(target=work).start()
""",
    "callback in a list": """
received = []
def receive(message, more):
    received.append(message)
sub = rospy.Subscriber("in", Header, receive, callback_args=received)
rospy.spin()
""",
}
LATE = """
def work():
    numpy.witness.go_on.wait()
    numpy.witness.seen.append(block is not None)
threading.Thread(target=work).start()
rospy.spin()
"""


class Process:
    """Loads one script, without garbage collection; ``blocks`` refers weakly to its array."""

    def __init__(self, folder, monkeypatch):
        self.blocks, self.seen, self.go_on = [], [], threading.Event()
        shared = SimpleNamespace(ref=weakref.ref, **vars(self))
        monkeypatch.setattr(numpy, "witness", shared, raising=False)
        monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
        self.runtime = Runtime(LocalMiddleware(), ManualExecutor(), blocking=WorkerPool(None))
        self.loader = Loader(self.runtime, lambda name, context: ScriptNodelet)
        self.script = folder / "script.py"

    def load(self, text):
        self.script.write_text(HEAD + text)
        self.loader.load("/n", "dyknow/Script", {}, [str(self.script)])

    def holds_the_block(self):
        return self.blocks[0]() is not None


@pytest.fixture(name="process")
def _process(tmp_path, monkeypatch):
    gc.collect()
    gc.disable()
    process = Process(tmp_path, monkeypatch)
    yield process
    process.runtime.close()
    gc.enable()


@pytest.mark.parametrize("kind", SCRIPTS)
def test_an_unload_frees_a_script_and_so_does_its_failure(process, kind):
    process.load(SCRIPTS[kind])
    assert process.holds_the_block()
    process.loader.unload("/n")
    eventually(lambda: not process.holds_the_block())
    process.blocks.clear()
    with pytest.raises(LoadFailed):
        process.load("raise RuntimeError('injected')")
    eventually(lambda: not process.holds_the_block())


def test_a_thread_that_does_not_end_keeps_its_modules(process):
    process.load(LATE)
    process.loader.unload("/n")
    assert process.holds_the_block()
    process.go_on.set()
    eventually(lambda: process.seen == [True])


def test_a_script_that_shuts_down_during_its_load_is_loaded_and_then_gone(process):
    process.load("rospy.signal_shutdown('enough')\nnumpy.witness.go_on.wait(0.5)")
    eventually(lambda: process.loader.list() == [])
