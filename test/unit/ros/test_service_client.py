# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Calls of services whose every step has a time limit, and the connections under them."""

from __future__ import annotations

import contextlib
import itertools
import socket
import struct
import threading
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, List, Tuple

import pytest
from clocks import eventually
from nodelet.srv import NodeletList
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.errors import HostError, PeerTimeout
from dyknow.model.graph import NodeletKind
from dyknow.ros.hosting.child import Child
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.external import External
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.process.os_process import ProcessId
from dyknow.ros.wire import service_client
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import (
    ServiceClient,
    ServiceFailed,
    ServiceLost,
    TcprosConnection,
)

NAME = "/manager"
LONG = 30.0
SOON = 0.05


@pytest.fixture
def manager(monkeypatch):
    with small_graph() as graph:
        graph.nodes[NAME] = manager = SmallManager()
        manager.nodelets = ["/b", "/a"]
        monkeypatch.setenv("ROS_MASTER_URI", graph.uri)
        yield manager


def make_client(**options):
    return ServiceClient(Master("/client"), f"{NAME}/list", NodeletList, **options)


@pytest.fixture
def client(manager):
    with contextlib.closing(make_client(persistent=True)) as client:
        yield client


def test_calls_of_a_persistent_client_share_a_connection(manager, client):
    answers = []

    def call():
        for _ in range(20):
            answers.append(client.call(LONG).nodelets)

    threads = [threading.Thread(target=call) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONG)
    assert answers == [["/b", "/a"]] * 80
    assert manager.connections == 1
    make_client().call(LONG)
    make_client().call(LONG)
    assert manager.connections == 3
    manager.lose_connections()
    assert client.call(LONG).nodelets == ["/b", "/a"]


def test_a_hung_server_holds_up_the_first_call_alone(manager, client):
    client.call(LONG)
    manager.goes_on.clear()
    with pytest.raises(PeerTimeout):
        client.call(SOON)
    began = time.monotonic()
    with pytest.raises(PeerTimeout):
        client.call(LONG)
    assert time.monotonic() - began < LONG / 2
    manager.goes_on.set()
    while True:  # the late answer is on its way
        with contextlib.suppress(PeerTimeout):
            assert client.call(LONG).nodelets == ["/b", "/a"]
            break
    assert manager.connections == 1


def test_the_wait_for_other_threads_counts_with_the_call(client, monkeypatch):
    now = [time.monotonic()]
    deadlines: List[float] = []

    def acquire(blocking=True, timeout=0.0):
        now[0] += timeout  # the turn is free only when the time of the call is over
        return True

    def answer(connection, deadline):
        deadlines.append(deadline)
        raise socket.timeout

    client.call(LONG)
    turn: Any = SimpleNamespace(acquire=acquire, release=lambda: None)
    client._turn = turn
    monkeypatch.setattr(TcprosConnection, "receive_answer", answer)
    monkeypatch.setattr(service_client, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with pytest.raises(PeerTimeout):
        client.call(5.0)
    assert deadlines == [now[0]]


@pytest.mark.parametrize("persistent", [False, True])
def test_a_process_of_another_version_is_reported_with_the_cure(manager, persistent):
    manager.error = "request from [/client]: md5sums do not match: [a] vs. [b]"
    with contextlib.closing(make_client(persistent=persistent)) as client:
        with pytest.raises(ServiceFailed, match="another version of DyKnow: restart it"):
            client.call(LONG)
        manager.error = "there is no such service"
        with pytest.raises(ServiceFailed, match="there is no such service$"):
            client.call(LONG)


def test_a_client_that_must_not_reconnect_says_that_the_server_is_lost(
    manager,
):
    client = make_client(persistent=True, reconnects=False)
    client.call(LONG)
    manager.lose_connections()
    for _ in range(2):
        with pytest.raises(ServiceLost):
            client.call(LONG)


# Several threads use, close and replace clients at the same time


def of_a_service(manager):
    client = make_client(persistent=True)
    yield lambda: sorted(client.call(LONG).nodelets)
    yield client.close


def of_a_child(manager):
    child = Child(PeerContext(Master("/test")), ChildRecord(NAME, NodeletKind.PYTHON))
    child.up = True
    numbers = itertools.count()

    def ask():
        process = ProcessId(1, next(numbers) // 20)  # another one now and then
        child.record = replace(child.record, process=process)
        return child.list()

    yield ask
    yield child.close


def of_an_external(manager):
    external = External(PeerContext(Master("/test")), NAME)
    external.start()
    eventually(lambda: external.answers)

    def ask():
        try:
            return external.list()
        except HostError:
            external.look_now()
            raise

    def lose():
        time.sleep(SOON)
        manager.lose_connections()

    yield ask
    yield lose
    external.close()


@pytest.mark.usefixtures("impatient_interpreter")
@pytest.mark.parametrize("made", [of_a_service, of_a_child, of_an_external])
def test_a_client_that_is_closed_while_it_is_asked_refuses_or_answers(manager, made):
    steps = made(manager)
    ask, disturb = next(steps), next(steps)
    answers: List[object] = []
    failures: List[BaseException] = []
    end = time.monotonic() + 0.4

    def repeat(work):
        try:
            while (time.monotonic() < end or not any(answers)) and not failures:
                with contextlib.suppress(HostError):
                    answers.append(work())
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=repeat, args=(each,)) for each in (ask, ask, ask, disturb)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONG)
        assert not thread.is_alive()
    disturb()
    assert list(steps) == failures == []
    assert ["/a", "/b"] in answers
    assert all(each in (None, ["/a", "/b"]) for each in answers)


# Frames


Link = Tuple[TcprosConnection, socket.socket]


@pytest.fixture
def link():
    with socket.create_server(("127.0.0.1", 0)) as server:
        connection = TcprosConnection("127.0.0.1", server.getsockname()[1], LONG)
        peer, _ = server.accept()
        with contextlib.closing(connection), peer:
            yield connection, peer


def frame(body):
    return struct.pack("<I", len(body)) + body


def test_frames_are_read_one_by_one_however_they_arrive(link):
    connection, peer = link
    in_time = time.monotonic() + LONG
    peer.sendall(frame(b"one") + frame(b"") + b"\1" + frame(b"yes") + b"\0" + frame(b"no"))
    assert connection.receive_frame(in_time) == b"one"
    assert connection.receive_frame(in_time) == b""
    assert connection.receive_answer(in_time) == (True, b"yes")
    assert connection.receive_answer(in_time) == (False, b"no")
    answer = b"\1" + frame(b"whole")
    for cut in (1, 4, 6):  # received before the deadline, and kept
        peer.sendall(answer[:cut])
        with pytest.raises(socket.timeout):
            connection.receive_answer(time.monotonic() + SOON)
        peer.sendall(answer[cut:])
        assert connection.receive_answer(in_time) == (True, b"whole")
    peer.sendall(answer[:6])
    peer.close()
    with pytest.raises(ConnectionResetError):
        connection.receive_frame(in_time)
