# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Threads of scripts and of libraries, which end with them."""

from __future__ import annotations

import contextlib
import threading
import time
from types import SimpleNamespace

import pytest

from dyknow.ros.scripts import guest as guest_module
from dyknow.ros.scripts.guest import Guest

PATIENCE = 10.0


def ended_guest(work):
    """A guest that has ended while a thread of it was elsewhere; the thread, and what frees it."""
    guest, go_on = Guest("guest"), threading.Event()

    def run():
        go_on.wait()
        with contextlib.suppress(SystemExit):
            work(guest)

    thread = threading.Thread(target=run)
    guest.adopt(thread)
    thread.start()
    guest.shut_down("unloaded")
    guest.end_threads(())
    assert thread.is_alive()
    return thread, go_on


def test_a_thread_that_is_late_ends_when_it_waits():
    def work(guest):
        while True:
            guest.pause(1000.0)

    thread, go_on = ended_guest(work)
    go_on.set()
    thread.join(PATIENCE)
    assert not thread.is_alive()


def test_a_thread_that_catches_its_end_does_not_spin(monkeypatch):
    slept = []
    clock = SimpleNamespace(monotonic=time.monotonic, sleep=slept.append)
    monkeypatch.setattr(guest_module, "time", clock)

    def work(guest):
        for _ in range(3):
            with pytest.raises(SystemExit):
                while True:
                    guest.pause(0.0)

    thread, go_on = ended_guest(work)
    slept.clear()
    go_on.set()
    thread.join(PATIENCE)
    assert not thread.is_alive() and slept and min(slept) >= 1.0
