# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""After its unload the memory of a script is free, without any garbage collection."""

from __future__ import annotations

import gc
import threading
import time
import weakref
from pathlib import Path
from types import SimpleNamespace
from typing import Iterator, List

import pytest
import rospy

from dyknow.errors import LoadFailed
from dyknow.nodelet.context import Runtime
from dyknow.nodelet.loader import Loader
from dyknow.nodelet.local import LocalMiddleware
from dyknow.nodelet.scheduler import ManualExecutor, WorkerPool
from dyknow.ros.scripts.script import ScriptNodelet

PATIENCE = 10.0

HEAD = """#!/usr/bin/env python3
import rospy, threading
from std_msgs.msg import Header
from std_srvs.srv import Empty
import numpy
block = numpy.zeros(10)
numpy.noted.note(block)
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


@pytest.fixture(autouse=True)
def no_collections() -> Iterator[None]:
    gc.collect()
    gc.disable()
    yield
    gc.enable()


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> List[weakref.ReferenceType[object]]:
    """The arrays that scripts have made."""
    import numpy

    made: List[weakref.ReferenceType[object]] = []
    noted = SimpleNamespace(note=lambda block: made.append(weakref.ref(block)))
    monkeypatch.setattr(numpy, "noted", noted, raising=False)
    return made


@pytest.fixture
def loader(monkeypatch: pytest.MonkeyPatch) -> Iterator[Loader]:
    monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
    blocking = WorkerPool(None)
    runtime = Runtime(LocalMiddleware(), ManualExecutor(), blocking=blocking)
    yield Loader(runtime, lambda name, context: ScriptNodelet)
    runtime.close()


def wait_until_gone(blocks: List[weakref.ReferenceType[object]]) -> None:
    deadline = time.monotonic() + PATIENCE
    while blocks[0]() is not None:
        assert time.monotonic() < deadline, gc.get_referrers(blocks[0]())
        threading.Event().wait(0.01)


@pytest.mark.parametrize("kind", SCRIPTS)
def test_an_unload_frees_a_script(
    loader: Loader,
    blocks: List[weakref.ReferenceType[object]],
    tmp_path: Path,
    kind: str,
) -> None:
    script = tmp_path / "script.py"
    script.write_text(HEAD + SCRIPTS[kind])
    loader.load("/n", "dyknow/Script", {}, [str(script)])
    assert blocks[0]() is not None
    loader.unload("/n")
    wait_until_gone(blocks)


def test_a_script_that_fails_is_freed(
    loader: Loader, blocks: List[weakref.ReferenceType[object]], tmp_path: Path
) -> None:
    script = tmp_path / "script.py"
    script.write_text(HEAD + "raise RuntimeError('injected')")
    with pytest.raises(LoadFailed):
        loader.load("/n", "dyknow/Script", {}, [str(script)])
    wait_until_gone(blocks)


def test_a_thread_that_does_not_end_keeps_its_modules(
    loader: Loader, blocks: List[weakref.ReferenceType[object]], tmp_path: Path
) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        HEAD
        + """
def work():
    numpy.go_on.wait()
    numpy.seen.append(block is not None)
threading.Thread(target=work).start()
rospy.spin()
"""
    )
    import numpy

    numpy.go_on, numpy.seen = threading.Event(), []
    loader.load("/n", "dyknow/Script", {}, [str(script)])
    loader.unload("/n")
    assert blocks[0]() is not None
    numpy.go_on.set()
    deadline = time.monotonic() + PATIENCE
    while not numpy.seen:
        assert time.monotonic() < deadline
        threading.Event().wait(0.01)
    assert numpy.seen == [True]
    del numpy.go_on, numpy.seen
