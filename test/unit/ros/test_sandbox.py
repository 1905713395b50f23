# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Threads and finalizers of scripts and of libraries: their waits and their end."""

from __future__ import annotations

import gc
import importlib
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest
from clocks import PATIENCE, in_thread, join, wait_for
from std_msgs.msg import String
from std_srvs.srv import Trigger

from dyknow.errors import LoadFailed, UnloadedMeanwhile
from dyknow.nodelet.loading import loader
from dyknow.nodelet.loading.plugins import Package
from dyknow.ros.scripts import sandbox as sandbox_module
from dyknow.ros.scripts.modules import importer_with_libraries
from dyknow.ros.scripts.process_view import process_views
from dyknow.ros.scripts.rospy_classes import bound_classes
from dyknow.ros.scripts.sandbox import Sandbox, defer_in_finalizers, outside_of_finalizers
from dyknow.ros.scripts.script import ScriptNodelet


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    monkeypatch.setattr(sandbox_module, "_PATIENCE", 0.01)
    monkeypatch.setattr(sandbox_module, "_FORCE", 0.01)
    monkeypatch.setattr(sandbox_module, "_AFTERWARDS", 0.1)


def test_a_late_thread_ends_when_it_waits_and_does_not_spin_if_it_catches_that(
    monkeypatch,
):
    sandbox, go_on, slept = Sandbox("sandbox"), threading.Event(), []
    clock = SimpleNamespace(monotonic=time.monotonic, sleep=slept.append)
    monkeypatch.setattr(sandbox_module, "time", clock)

    def run():
        go_on.wait()
        for seconds in (1000.0, 0.0, 0.0):
            with pytest.raises(SystemExit):
                while True:
                    sandbox.pause(seconds)

    thread = threading.Thread(target=run)
    sandbox.adopt(thread)
    thread.start()
    sandbox.shut_down("unloaded")
    sandbox.end_threads(())
    assert thread.is_alive()
    slept.clear()
    go_on.set()
    join(thread)
    assert slept and min(slept) >= 0.1


class Asker:
    """Asks for a call in its finalizer, which only the collector runs."""

    def __init__(self, call):
        self.call = call
        self.itself = self

    def __del__(self):
        outside_of_finalizers(self.call)


def test_the_call_of_a_finalizer_may_take_a_lock_that_its_thread_holds():
    defer_in_finalizers()
    defer_in_finalizers()
    lock, done = threading.Lock(), threading.Event()

    def withdraw():
        with lock:
            done.set()

    def fail():
        raise ValueError("boo")

    Asker(fail)  # which ends nothing
    Asker(withdraw)
    with lock:
        gc.collect()
        assert not done.is_set()
    wait_for(done)


def test_other_calls_are_made_at_once():
    done = []
    outside_of_finalizers(lambda: done.append(threading.get_ident()))
    assert done == [threading.get_ident()]


class SlicedSandbox(Sandbox):
    """Calls ``at_end`` once: when the first slice of a wait is over, and the second one comes."""

    def __init__(self, at_end):
        super().__init__("sandbox")
        self.at_end = [at_end]
        self.slices = 0

    def end_slice(self):
        if self.at_end and self.slices:
            join(in_thread(self.at_end.pop()))

    def wait_for(self, condition, timeout):
        def sliced(seconds):
            self.end_slice()
            assert self.slices < 3, "the notification was lost"
            self.slices += 1
            return condition(0.0)

        return super().wait_for(sliced, timeout)


class SlowLock:
    """A reentrant lock for conditions that is taken again just after ``before_taking``."""

    def __init__(self, before_taking):
        lock: Any = threading.RLock()
        self.acquire, self.release = lock.acquire, lock.release
        self.__dict__.update(_release_save=lock._release_save, _is_owned=lock._is_owned)
        self._lock, self._before_taking = lock, before_taking

    def __enter__(self):
        return self._lock.__enter__()

    def __exit__(self, *error):
        self._lock.__exit__(*error)

    def _acquire_restore(self, state):
        self._before_taking()
        self._lock._acquire_restore(state)


def threading_of(sandbox):
    return process_views(sandbox)["threading"]()


@pytest.fixture
def condition():
    """Of a script; it is notified at the end of the first slice of a wait."""

    def notify():
        with made:
            made.notify()

    sandbox = SlicedSandbox(notify)
    made = threading_of(sandbox).Condition(SlowLock(sandbox.end_slice))
    return made


@pytest.mark.parametrize("timeout", [None, 1000.0])
def test_a_notification_at_the_end_of_a_slice_is_received(condition, timeout):
    with condition, condition:
        assert condition.wait(timeout)
        assert condition._is_owned() and not condition._waiters
    assert not condition._is_owned()


def test_a_notification_just_after_the_time_is_up_is_received(condition):
    with condition:
        assert condition.wait(0.0)
        assert not condition.wait(-1.0)
        assert not condition._waiters
    with pytest.raises(RuntimeError, match="un-acquired"):
        condition.wait()


@pytest.mark.parametrize("lock", [threading.Lock, threading.RLock])
def test_a_wait_that_the_end_cuts_short_leaves_the_lock_taken_and_no_waiter(lock):
    sandbox = Sandbox("sandbox")
    condition = threading_of(sandbox).Condition(lock())
    sandbox.closing.set()
    with condition:
        with pytest.raises(SystemExit):
            condition.wait()
        assert condition._is_owned() and not condition._waiters
    assert condition.acquire(blocking=False)


def test_what_comes_true_at_the_end_of_the_sandbox_is_taken_once():
    sandbox, calls = Sandbox("sandbox"), []

    def condition(seconds):
        sandbox.closing.set()
        calls.append(seconds)
        return len(calls) == 2

    assert sandbox.wait_for(condition, None)
    assert len(calls) == 2


def test_everything_that_waits_for_a_condition_goes_on(monkeypatch):
    monkeypatch.setattr(sandbox_module, "_SLICE", 0.001)
    own = threading_of(Sandbox("sandbox"))
    event, semaphore, barrier = own.Event(), own.Semaphore(0), own.Barrier(2)
    thread = own.Thread(target=lambda: (event.wait(), semaphore.acquire(), barrier.wait()))
    thread.start()
    assert thread.daemon
    threading.Event().wait(0.02)  # some slices
    event.set()
    semaphore.release()
    barrier.wait()
    thread.join()
    assert event.wait(0.0)
    assert not semaphore.acquire(timeout=0.002)


# Nothing of a script, or of the libraries of a nodelet, outlives a load that fails


LIBRARY = """
import atexit, queue, threading, time
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

def hungry():
    queue.SimpleQueue().get()

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
KINDS = ["polite", "busy", "sleepy", "hungry"]


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

    monkeypatch.setattr(loader, "SHUTDOWN_PATIENCE", 0.01)
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


def test_what_is_unregistered_before_init_node_is_never_registered():
    sandbox: Any = Sandbox("/sandbox", is_alone=True)
    made = []
    classes = bound_classes(sandbox)
    for is_kept in (False, True):
        ends = (
            classes["Publisher"]("out", String, queue_size=1),
            classes["Subscriber"]("in", String, print),
            classes["Service"]("obey", Trigger, print),
        )
        if not is_kept:
            for each in ends[:2]:
                each.unregister()
            ends[2].shutdown()

    def make(name, *args, **kwds):
        made.append(name)
        return SimpleNamespace(name=name, resolved_name=name)

    makers = dict.fromkeys(("Publisher", "Subscriber", "Service"), make)
    sandbox.begin(SimpleNamespace(get_name=str, **makers))
    assert made == ["out", "in", "obey"]


def test_a_script_in_a_process_of_its_own_ends_that_without_a_callback_of_its_node():
    """The log would tell of it."""
    sandbox: Any = Sandbox("/sandbox", is_alone=True)
    ended = threading.Event()
    sandbox.begin(SimpleNamespace(context=SimpleNamespace(unload=ended.set)))
    sandbox.signal_shutdown("enough")
    wait_for(ended)
