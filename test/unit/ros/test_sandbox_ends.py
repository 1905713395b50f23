# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nothing of a script, or of the libraries of a nodelet, outlives a load that fails."""

from __future__ import annotations

import importlib
import sys
import threading
from types import SimpleNamespace

import pytest
import rospy
from clocks import PATIENCE, in_thread, join, wait_for

from dyknow.errors import LoadFailed, UnloadedMeanwhile
from dyknow.nodelet.context import Runtime
from dyknow.nodelet.loader import Loader
from dyknow.nodelet.local import LocalMiddleware
from dyknow.nodelet.plugins import Package
from dyknow.nodelet.scheduler import ManualExecutor, WorkerPool
from dyknow.ros.scripts import sandbox as sandbox_module
from dyknow.ros.scripts.modules import importer_with_libraries
from dyknow.ros.scripts.script import ScriptNodelet

LIBRARY = """
import atexit, threading, time
import rospy
import ends_witness

def polite():
    while not rospy.is_shutdown():
        time.sleep(0.001)

def busy():
    while True:
        pass

def sleepy():
    while True:
        time.sleep(1000.0)

def start(name):
    def run():
        try:
            globals()[name]()
        except SystemExit:
            pass
        finally:
            ends_witness.ended.set()
    atexit.register(ends_witness.exited.set)
    threading.Thread(target=run).start()

def wait_in_vain():
    ends_witness.entered.set()
    threading.Event().wait()
"""
NODELETS = """
import ends_library, ends_witness
from dyknow.nodelet.handle import Nodelet

class Broken(Nodelet):
    def on_init(self):
        ends_library.start(ends_witness.kind)
        raise ValueError("no camera")

class Unmade(Nodelet):
    def __init__(self):
        ends_library.start(ends_witness.kind)
        raise ValueError("no camera")

class Waiting(Nodelet):
    def on_init(self):
        ends_library.start(ends_witness.kind)
        ends_library.wait_in_vain()

class Hanging(Nodelet):
    def on_init(self):
        ends_library.start(ends_witness.kind)
    def on_shutdown(self):
        ends_witness.go_on.wait()

class Fine(Nodelet):
    def on_init(self):
        ends_library.start(ends_witness.kind)
"""
IMPORTED = """
import ends_library, ends_witness
ends_library.start(ends_witness.kind)
raise ValueError("no camera")
"""
SCRIPT = "#!/usr/bin/env python3\n" + LIBRARY + 'rospy.init_node("script")\n'
KINDS = ["polite", "busy", "sleepy"]


class Process:
    """Loads nodelets whose library starts a thread of a ``kind``, and scripts that do."""

    def __init__(self, folder, monkeypatch, kind="polite"):
        monkeypatch.setattr(sandbox_module, "_PATIENCE", 0.01)
        monkeypatch.setattr(sandbox_module, "_FORCE", PATIENCE)  # on a busy machine, too
        monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
        events = ("ended", "exited", "entered", "go_on")
        self.witness = SimpleNamespace(kind=kind, **{each: threading.Event() for each in events})
        monkeypatch.setitem(sys.modules, "ends_witness", self.witness)
        monkeypatch.syspath_prepend(str(folder))
        self.folder = folder
        files = {"ends_library": LIBRARY, "ends_nodelets": NODELETS, "ends_imported": IMPORTED}
        for name, text in files.items():
            (folder / f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        self.runtime = Runtime(LocalMiddleware(), ManualExecutor(), blocking=WorkerPool(None))
        self.loader = Loader(self.runtime, self._find)

    def _find(self, type_name, context):
        if type_name == "script":
            return ScriptNodelet
        module, _, name = type_name.partition(".")
        importer = importer_with_libraries(context, module, Package.find(module, "/nonexistent"))
        assert importer is not None
        return getattr(importer.import_module(module), name)

    def load_script(self, text):
        file = self.folder / "script.py"
        file.write_text(SCRIPT + text)
        self.loader.load("/n", "script", {}, [str(file)])

    def expect_ended(self):
        wait_for(self.witness.ended)
        wait_for(self.witness.exited)
        assert self.loader.list() == []


@pytest.fixture(name="process")
def _process(request, tmp_path, monkeypatch):
    process = Process(tmp_path, monkeypatch, getattr(request, "param", "polite"))
    yield process
    process.witness.go_on.set()
    process.runtime.close()


@pytest.mark.parametrize("process", KINDS, indirect=True)
@pytest.mark.parametrize("nodelet", ["nodelets.Broken", "nodelets.Unmade", "imported.Any"])
def test_a_failed_load_ends_the_threads_of_libraries(process, nodelet):
    with pytest.raises((LoadFailed, ValueError), match="no camera"):
        process.loader.load("/n", f"ends_{nodelet}")
    process.expect_ended()


@pytest.mark.parametrize("process", KINDS, indirect=True)
def test_an_unload_ends_them_too(process):
    process.loader.load("/n", "ends_nodelets.Fine")
    process.loader.unload("/n")
    process.expect_ended()


def test_an_unload_ends_an_on_init_that_waits_in_a_library(process):
    def load():
        with pytest.raises(UnloadedMeanwhile):
            process.loader.load("/n", "ends_nodelets.Waiting")

    loading = in_thread(load)
    wait_for(process.witness.entered)
    context = process.loader.known("/n")
    process.loader.unload("/n")
    join(loading)
    process.expect_ended()
    join(*context.late_threads)


def test_an_on_shutdown_that_hangs_keeps_no_library_alive(process):
    process.loader.load("/n", "ends_nodelets.Hanging")
    process.loader.unload("/n")
    process.expect_ended()


@pytest.mark.parametrize("kind", KINDS)
def test_a_script_that_fails_leaves_no_thread(process, kind):
    with pytest.raises(LoadFailed, match="no camera"):
        process.load_script(f"start('{kind}')\nraise ValueError('no camera')")
    process.expect_ended()


def test_a_script_that_is_unloaded_while_it_shuts_down_leaves_no_thread(process):
    def load():
        with pytest.raises(UnloadedMeanwhile):
            process.load_script(
                "start('busy')\nrospy.signal_shutdown('')\n"
                "ends_witness.entered.set()\nends_witness.go_on.wait()"
            )

    loading = in_thread(load)
    wait_for(process.witness.entered)
    process.loader.unload("/n")
    join(loading)
    process.witness.go_on.set()
    process.expect_ended()
