# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Clients that several threads use, close and replace at the same time."""

from __future__ import annotations

import itertools
import threading
import time
from dataclasses import replace

import pytest
from nodelet.srv import NodeletList
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.errors import HostError
from dyknow.model.graph import NodeletKind
from dyknow.ros.hosting.child import Child
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.external import External
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.process.os_process import ProcessId
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient

pytestmark = pytest.mark.usefixtures("impatient_interpreter")

NAME = "/far"
SECONDS = 0.4
PATIENCE = 30.0


@pytest.fixture(name="graph")
def _graph():
    with small_graph() as graph:
        graph.nodes[NAME] = SmallManager()
        graph.nodes[NAME].nodelets = ["/b", "/a"]
        yield graph


def together(ask, failed, *works):
    """Repeat a question in three threads, and other work in one each; return the answers.

    Args:
        ask: returns an answer, or raises a HostError.
        failed: is called after a HostError.
        *works: what may make the question fail.
    """
    answers, failures = [], []
    end = time.monotonic() + SECONDS

    def ask_once():
        try:
            answers.append(sorted(ask()))
        except HostError:
            failed()

    def repeat(work):
        try:
            while time.monotonic() < end and not failures:
                work()
        except BaseException as error:
            failures.append(error)

    threads = [
        threading.Thread(target=repeat, args=(work,), daemon=True)
        for work in (ask_once, ask_once, ask_once, *works)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
        assert not thread.is_alive()
    if failures:
        raise failures[0]
    return answers


def test_a_persistent_client_is_closed_during_calls(graph):
    client = ServiceClient(Master("/test", graph.uri), f"{NAME}/list", NodeletList, True)
    answers = together(lambda: client.call(PATIENCE).nodelets, lambda: None, client.close)
    client.close()
    assert answers and all(each == ["/a", "/b"] for each in answers)


def test_a_client_that_is_replaced_during_a_question_refuses_or_answers(graph):
    child = Child(PeerContext(Master("/test", graph.uri)), ChildRecord(NAME, NodeletKind.PYTHON))
    child.up = True
    numbers = itertools.count()

    def ask():
        child.record = replace(child.record, process=ProcessId(1, next(numbers) // 20))
        return child.list()

    answers = together(ask, lambda: None, child.close)
    child.close()
    assert answers and all(each == ["/a", "/b"] for each in answers)


def test_an_external_manager_whose_connections_break_refuses_or_answers(graph):
    manager = External(PeerContext(Master("/test", graph.uri)), NAME)
    manager.start()

    def lose():
        time.sleep(0.05)
        graph.nodes[NAME].lose_connections()

    try:
        answers = together(manager.list, manager.look_now, lose)
        assert answers and all(each == ["/a", "/b"] for each in answers)
    finally:
        manager.close()
