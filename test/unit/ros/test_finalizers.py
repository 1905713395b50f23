# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a finalizer asks for under a lock is done by another thread, once the lock is free."""

from __future__ import annotations

import gc
import threading

from dyknow.ros.scripts import finalizers

PATIENCE = 10.0


def test_a_finalizer_may_ask_for_what_takes_a_lock_that_its_thread_holds() -> None:
    finalizers.begin()
    finalizers.begin()
    lock, done = threading.Lock(), threading.Event()

    def withdraw() -> None:
        with lock:
            done.set()

    class Listener:
        def __init__(self) -> None:
            self.itself = self  # only the collector ends it

        def __del__(self) -> None:
            finalizers.outside_of_finalizers(withdraw)

    Listener()
    with lock:
        gc.collect()
        assert not done.is_set()
    assert done.wait(PATIENCE)


def test_others_get_it_done_at_once() -> None:
    done = []
    finalizers.outside_of_finalizers(lambda: done.append(threading.get_ident()))
    assert done == [threading.get_ident()]


def test_what_fails_ends_nothing() -> None:
    finalizers.begin()
    done = threading.Event()

    class Asker:
        def __init__(self, do) -> None:  # type: ignore[no-untyped-def]
            self.do = do

        def __del__(self) -> None:
            finalizers.outside_of_finalizers(self.do)

    def fail() -> None:
        raise ValueError("boo")

    Asker(fail)
    Asker(done.set)
    assert done.wait(PATIENCE)
