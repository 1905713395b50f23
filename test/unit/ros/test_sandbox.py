# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Threads and finalizers of scripts and of libraries."""

from __future__ import annotations

import contextlib
import gc
import threading
import time
from types import SimpleNamespace

import pytest
from clocks import join, wait_for

from dyknow.ros.scripts import sandbox as sandbox_module
from dyknow.ros.scripts.sandbox import Sandbox, defer_in_finalizers, outside_of_finalizers


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    monkeypatch.setattr(sandbox_module, "_PATIENCE", 0.01)
    monkeypatch.setattr(sandbox_module, "_FORCE", 0.01)
    monkeypatch.setattr(sandbox_module, "_AFTERWARDS", 0.1)


def ended_sandbox(work):
    """End a sandbox while its thread waits; return the thread, and the event that frees it."""
    sandbox, go_on = Sandbox("sandbox"), threading.Event()

    def run():
        go_on.wait()
        with contextlib.suppress(SystemExit):
            work(sandbox)

    thread = threading.Thread(target=run)
    sandbox.adopt(thread)
    thread.start()
    sandbox.shut_down("unloaded")
    sandbox.end_threads(())
    assert thread.is_alive()
    return thread, go_on


def test_a_thread_that_is_late_ends_when_it_waits():
    def work(sandbox):
        while True:
            sandbox.pause(1000.0)

    thread, go_on = ended_sandbox(work)
    go_on.set()
    join(thread)


def test_a_thread_that_catches_its_end_does_not_spin(monkeypatch):
    slept = []
    clock = SimpleNamespace(monotonic=time.monotonic, sleep=slept.append)
    monkeypatch.setattr(sandbox_module, "time", clock)

    def work(sandbox):
        for _ in range(3):
            with pytest.raises(SystemExit):
                while True:
                    sandbox.pause(0.0)

    thread, go_on = ended_sandbox(work)
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
