# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from __future__ import annotations

import sys
import threading
from types import SimpleNamespace

import pytest
import rospy
from clocks import eventually

from dyknow.nodelet.context import Runtime
from dyknow.nodelet.loading.loader import Loader
from dyknow.nodelet.local import LocalMiddleware
from dyknow.nodelet.scheduler import ManualExecutor, WorkerPool
from dyknow.ros.scripts.script import ScriptNodelet


class Scripts:
    """Loads `/script`: scripts, which share ``script_witness`` with the test, and nodelets.

    Attributes:
        find: finds the class of a nodelet, as the loader does.
    """

    def __init__(self, folder):
        self.folder = folder
        events = ("go_on", "entered", "ended", "exited")
        self.witness = SimpleNamespace(**{each: threading.Event() for each in events})
        self.runtime = Runtime(LocalMiddleware(), ManualExecutor(), blocking=WorkerPool(None))
        self.find = lambda type_name, context: ScriptNodelet
        self.loader = Loader(self.runtime, lambda *asked: self.find(*asked))

    def load_nodelet(self, type_name):
        self.loader.load("/script", type_name)

    def load(self, text, word=""):
        file = self.folder / "script.py"
        begin = "import rospy, script_witness\nrospy.init_node('script')\n"
        file.write_text(f"#!/usr/bin/env python3\n{begin}{text}\n")
        self.loader.load("/script", "script", {}, [word or str(file)])

    def unload(self):
        self.loader.unload("/script")

    def is_gone(self):
        eventually(lambda: self.loader.list() == [])


@pytest.fixture
def scripts(tmp_path, monkeypatch):
    scripts = Scripts(tmp_path)
    monkeypatch.setitem(sys.modules, "script_witness", scripts.witness)
    monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
    yield scripts
    scripts.witness.go_on.set()
    scripts.runtime.close()
