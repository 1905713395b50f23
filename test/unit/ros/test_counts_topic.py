# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The counts of messages, which the topic ~counts and the diagnostics both need."""

from __future__ import annotations

import threading
from typing import Any, List

from clocks import in_thread, join, wait_for
from dyknow_msgs.msg import Counts, NodeletCounts

from dyknow.ros.manager import services
from dyknow.ros.manager.services import CountsTopic


class Turn:
    """A lock that says when a second thread comes."""

    def __init__(self, comes: threading.Event) -> None:
        self._comes = comes
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        if self._lock.locked():
            self._comes.set()
        self._lock.acquire()

    def __exit__(self, *unused: object) -> None:
        self._lock.release()


class HeardPublisher:
    """A publisher with a subscriber."""

    def __init__(self, *unused: object, **options: object) -> None:
        self.published: List[Any] = []
        self.publish = self.published.append
        self.unregister = lambda: None

    def get_num_connections(self) -> int:
        return 1


def test_diagnostics_take_the_counts_that_are_under_way(monkeypatch):
    """Of two requests at once, a process answered one, and the other lacked its nodelets."""
    comes = threading.Event()
    monkeypatch.setattr(services.rospy, "Publisher", HeardPublisher)
    monkeypatch.setattr(services, "turn_lock", lambda name: Turn(comes))
    counted, diagnosed, threads = [], [], []

    def diagnose():
        diagnosed.append(topic.latest())
        comes.set()

    def count():
        counted.append([NodeletCounts(nodelet=f"/{len(counted)}")])
        if not threads:
            threads.append(in_thread(diagnose))
            wait_for(comes)
        return counted[-1]

    topic = CountsTopic(count)
    topic.publish()
    join(*threads)
    assert counted == diagnosed == [[NodeletCounts(nodelet="/0")]]
    assert topic._publisher.published == [Counts(counted[0])]
