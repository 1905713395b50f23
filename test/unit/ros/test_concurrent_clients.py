# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Clients that several threads use, close and replace at the same time."""

from __future__ import annotations

import itertools
import threading
import time
from dataclasses import replace
from typing import Any, Callable, Iterator, List

import pytest
from nodelet.srv import NodeletList
from unit.ros.small_graph import SmallManager, SmallMaster, small_graph

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

KIND = NodeletKind.PYTHON
NAME = "/far"
SECONDS = 0.4
PATIENCE = 30.0


@pytest.fixture
def graph() -> Iterator[SmallMaster]:
    with small_graph() as graph:
        graph.nodes[NAME] = SmallManager()
        graph.nodes[NAME].nodelets = ["/b", "/a"]
        yield graph


def together(*works: Callable[[], object], seconds: float = SECONDS) -> None:
    """Repeat each function in its own thread for some time; raises their exceptions."""
    failures: List[BaseException] = []
    end = time.monotonic() + seconds

    def repeat(work: Callable[[], object]) -> None:
        try:
            while time.monotonic() < end and not failures:
                work()
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=repeat, args=(work,), daemon=True) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
        assert not thread.is_alive()
    if failures:
        raise failures[0]


def test_a_persistent_client_is_closed_while_others_call(graph: SmallMaster) -> None:
    client = ServiceClient(Master("/test", graph.uri), f"{NAME}/list", NodeletList, True)
    answers: List[Any] = []

    def call() -> None:
        try:
            answers.append(client.call(PATIENCE).nodelets)
        except HostError:
            return  # it was closed in the middle of the call

    together(call, call, call, client.close)
    client.close()
    assert answers
    assert all(each == ["/b", "/a"] for each in answers)


def test_a_client_that_is_replaced_while_it_is_asked_refuses_or_answers(
    graph: SmallMaster,
) -> None:
    child = Child(PeerContext(Master("/test", graph.uri)), ChildRecord(NAME, KIND))
    child.up = True
    numbers = itertools.count()
    answers: List[List[str]] = []

    def ask() -> None:
        process = ProcessId(1, next(numbers) // 20)
        child.record = replace(child.record, process=process)
        try:
            answers.append(child.list())
        except HostError:
            return

    together(ask, ask, ask, child.close)
    child.close()
    assert answers
    assert all(each == ["/a", "/b"] for each in answers)


def test_who_asks_an_external_manager_while_its_connections_break_is_refused_or_answered(
    graph: SmallMaster,
) -> None:
    manager = External(PeerContext(Master("/test", graph.uri)), NAME)
    manager.start()
    answers: List[List[str]] = []

    def ask() -> None:
        try:
            answers.append(manager.list())
        except HostError:
            manager.look_now()

    def lose() -> None:
        time.sleep(0.05)
        graph.nodes[NAME].lose_connections()

    try:
        together(ask, ask, ask, lose)
        assert answers
        assert all(each == ["/a", "/b"] for each in answers)
    finally:
        manager.close()
