# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nothing of a script, or of the libraries of a nodelet, outlives a load that fails."""

from __future__ import annotations

import importlib

import pytest
from clocks import PATIENCE, in_thread, join, wait_for

from dyknow.errors import LoadFailed, UnloadedMeanwhile
from dyknow.nodelet.plugins import Package
from dyknow.ros.scripts import sandbox as sandbox_module
from dyknow.ros.scripts.modules import importer_with_libraries
from dyknow.ros.scripts.script import ScriptNodelet

LIBRARY = """
import atexit, threading, time
import rospy
import script_witness

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
            script_witness.ended.set()
    atexit.register(script_witness.exited.set)
    threading.Thread(target=run).start()

def wait_in_vain():
    script_witness.entered.set()
    threading.Event().wait()
"""
NODELETS = """
import ends_library, script_witness
from dyknow.nodelet.handle import Nodelet

class Broken(Nodelet):
    def on_init(self):
        ends_library.start(script_witness.kind)
        raise ValueError("no camera")

class Unmade(Nodelet):
    def __init__(self):
        ends_library.start(script_witness.kind)
        raise ValueError("no camera")

class Waiting(Nodelet):
    def on_init(self):
        ends_library.start(script_witness.kind)
        ends_library.wait_in_vain()

class Fine(Nodelet):
    def on_init(self):
        ends_library.start(script_witness.kind)

class Hanging(Fine):
    def on_shutdown(self):
        script_witness.go_on.wait()
"""
IMPORTED = """
import ends_library, script_witness
ends_library.start(script_witness.kind)
raise ValueError("no camera")
"""
KINDS = ["polite", "busy", "sleepy"]


@pytest.fixture
def process(scripts, tmp_path, monkeypatch):
    """Loads nodelets whose library starts a thread of a ``kind``, and scripts that do."""

    def find(type_name, context):
        module, _, name = type_name.partition(".")
        if not name:
            return ScriptNodelet
        importer = importer_with_libraries(context, module, Package.find(module, "/nonexistent"))
        assert importer is not None
        return getattr(importer.import_module(module), name)

    monkeypatch.setattr(sandbox_module, "_PATIENCE", 0.01)
    monkeypatch.setattr(sandbox_module, "_FORCE", PATIENCE)  # on a busy machine, too
    monkeypatch.syspath_prepend(str(tmp_path))
    files = {"ends_library": LIBRARY, "ends_nodelets": NODELETS, "ends_imported": IMPORTED}
    for name, text in files.items():
        (tmp_path / f"{name}.py").write_text(text)
    importlib.invalidate_caches()
    scripts.witness.kind, scripts.find = "polite", find
    return scripts


def all_has_ended(process):
    wait_for(process.witness.ended)
    wait_for(process.witness.exited)
    return process.loader.list() == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("nodelet", ["nodelets.Broken", "nodelets.Unmade", "imported.Any"])
def test_a_failed_load_ends_the_threads_of_libraries(process, nodelet, kind):
    process.witness.kind = kind
    with pytest.raises((LoadFailed, ValueError), match="no camera"):
        process.load_nodelet(f"ends_{nodelet}")
    assert all_has_ended(process)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("nodelet", ["Fine", "Hanging"])
def test_an_unload_ends_them_too(process, nodelet, kind):
    process.witness.kind = kind
    process.load_nodelet(f"ends_nodelets.{nodelet}")
    process.unload()
    assert all_has_ended(process)


def unload_amid(process, load):
    """Unload what is being loaded, once it has ``entered``; returns its context."""

    def load_until_then():
        with pytest.raises(UnloadedMeanwhile):
            load()

    loading = in_thread(load_until_then)
    wait_for(process.witness.entered)
    context = process.loader.known("/script")
    process.unload()
    join(loading)
    return context


def test_an_unload_ends_an_on_init_that_waits_in_a_library(process):
    context = unload_amid(process, lambda: process.load_nodelet("ends_nodelets.Waiting"))
    assert all_has_ended(process)
    join(*context.late_threads)


@pytest.mark.parametrize("kind", KINDS)
def test_a_script_that_fails_leaves_no_thread(scripts, process, kind):
    with pytest.raises(LoadFailed, match="no camera"):
        scripts.load(f"{LIBRARY}start('{kind}')\nraise ValueError('no camera')")
    assert all_has_ended(process)


def test_a_script_that_is_unloaded_while_it_shuts_down_leaves_no_thread(process):
    end = "script_witness.entered.set()\nscript_witness.go_on.wait()"
    text = f"{LIBRARY}start('busy')\nrospy.signal_shutdown('')\n{end}"
    unload_amid(process, lambda: process.load(text))
    process.witness.go_on.set()
    assert all_has_ended(process)
