# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Calls of services and polls whose every step has a time limit, and their connections."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import struct
import threading
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, List
from unittest import mock

import pytest
from clocks import PATIENCE, eventually, in_thread, join
from dyknow_msgs.srv import Poll, RemoveTransformation
from dynamic_reconfigure.msg import Config, DoubleParameter
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.errors import HostError, NotUtf8, PeerTimeout
from dyknow.model.graph import NodeletKind
from dyknow.model.transformation import Parameter
from dyknow.ros.hosting import reconfigure
from dyknow.ros.hosting.child import Child
from dyknow.ros.hosting.child_records import ChildRecord
from dyknow.ros.hosting.external import External
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.process.os_process import ProcessId
from dyknow.ros.wire import service_client
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.poll_client import PollClient
from dyknow.ros.wire.service_client import ServiceClient, ServiceLost, TcprosConnection

NAME = "/manager"
SOON = 0.05


@pytest.fixture
def manager(monkeypatch):
    with small_graph() as graph:
        graph.nodes[NAME] = manager = SmallManager(nodelets=["/b", "/a"])
        monkeypatch.setenv("ROS_MASTER_URI", graph.uri)
        yield manager


def make_client(master=None, **options):
    master = master or Master("/client")
    return ServiceClient(master, f"{NAME}/poll", Poll, beside=f"{NAME}/list", **options)


@pytest.fixture
def client(manager):
    with contextlib.closing(make_client(persistent=True)) as client:
        yield client


def test_a_text_that_cannot_be_sent_is_named(manager):
    """As a word of the command line that is not UTF-8."""
    client = ServiceClient(Master("/client"), f"{NAME}/remove", RemoveTransformation)
    with pytest.raises(NotUtf8, match=r"^'a\\udce9' is not UTF-8$"):
        client.call(PATIENCE, label=os.fsdecode(b"a\xe9"))


@pytest.mark.parametrize("is_persistent", [False, True])
def test_a_call_may_take_as_long_as_it_takes(manager, is_persistent):
    with contextlib.closing(make_client(persistent=is_persistent)) as client:
        assert client.call(float("inf")).nodelets == ["/b", "/a"]


def test_calls_of_a_persistent_client_share_a_connection(manager, client):
    answers = []

    def call():
        for _ in range(20):
            answers.append(client.call(PATIENCE).nodelets)

    join(*[in_thread(call) for _ in range(4)])
    assert answers == [["/b", "/a"]] * 80
    assert manager.connections == 1
    make_client().call(PATIENCE)
    make_client().call(PATIENCE)
    assert manager.connections == 3
    proud = make_client(persistent=True, reconnects=False)
    proud.call(PATIENCE)
    manager.lose_connections()
    assert client.call(PATIENCE).nodelets == ["/b", "/a"]
    for _ in range(2):
        with pytest.raises(ServiceLost):
            proud.call(PATIENCE)


class SlowMaster(Master):
    """Answers each third question in time."""

    questions = 0
    cause: Any = socket.timeout

    def ask(self, question: str, *args: Any) -> Any:
        self.questions += 1
        if self.questions % 3:
            raise PeerTimeout("the ROS master", 3.0) from self.cause()
        return super().ask(question, *args)


class GoneMaster(SlowMaster):
    """Refuses every connection."""

    cause = ConnectionRefusedError


@pytest.mark.parametrize(
    ("kind", "seconds", "questions"),
    [(SlowMaster, PATIENCE, 3), (SlowMaster, 0.0, 1), (GoneMaster, PATIENCE, 1)],
)
def test_a_slow_master_is_asked_again_within_the_time_of_the_call(
    manager, kind, seconds, questions
):
    master = kind("/client")
    client = make_client(master)
    if questions == 3:
        assert client.call(seconds).nodelets == ["/b", "/a"]
    else:
        with pytest.raises(PeerTimeout):
            client.call(seconds)
    assert master.questions == questions


def test_a_hung_server_holds_up_the_first_call_alone(manager, client):
    client.call(PATIENCE)
    manager.goes_on.clear()
    with pytest.raises(PeerTimeout):
        client.call(SOON)
    refused: List[PeerTimeout] = []

    def ask():
        try:
            client.call(10 * PATIENCE)
        except PeerTimeout as error:
            refused.append(error)

    join(in_thread(ask))
    assert refused
    manager.goes_on.set()
    while True:  # the late answer is on its way
        with contextlib.suppress(PeerTimeout):
            assert client.call(PATIENCE).nodelets == ["/b", "/a"]
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

    client.call(PATIENCE)
    turn: Any = SimpleNamespace(acquire=acquire, release=lambda: None)
    client._turn = turn
    monkeypatch.setattr(TcprosConnection, "receive_answer", answer)
    monkeypatch.setattr(service_client, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with pytest.raises(PeerTimeout):
        client.call(5.0)
    assert deadlines == [now[0]]


# Several threads use, close and replace clients at the same time


def of_a_service(manager):
    client = make_client(persistent=True)
    yield lambda: sorted(client.call(PATIENCE).nodelets)
    yield client.close


def of_a_child(manager):
    record = ChildRecord(NAME, NodeletKind.PYTHON, "", ProcessId(1, 1))
    child = Child(PeerContext(Master("/test")), record)
    child.wake()
    eventually(lambda: child.up)
    numbers = itertools.count(2)

    def disturb():
        manager.lose_connections()
        number = next(numbers)
        if number % 2:  # another process bears the name
            child.record = replace(record, process=ProcessId(1, number))
            child.went_down()
            child.wake()

    yield lambda: sorted(child.nodelets())
    yield disturb
    child.close()


def of_an_external(manager):
    external = External(PeerContext(Master("/test")), NAME)
    external.look_now(PATIENCE)

    def ask():
        try:
            return sorted(external.nodelets())
        except HostError:
            external.look_now()
            raise

    yield ask
    yield manager.lose_connections
    external.close()


@pytest.mark.usefixtures("impatient_interpreter")
@pytest.mark.parametrize("made", [of_a_service, of_a_child, of_an_external])
def test_a_client_that_is_closed_while_it_is_asked_refuses_or_answers(manager, made):
    steps = made(manager)
    ask, disturb = next(steps), next(steps)
    answers: List[object] = []
    failures: List[BaseException] = []
    over = threading.Event()

    def repeat():
        try:
            while not over.is_set():
                with contextlib.suppress(HostError):
                    answers.append(ask())
        except BaseException as error:
            failures.append(error)

    threads = [in_thread(repeat) for _ in range(3)]
    for _ in range(30):
        count = len(answers)
        eventually(lambda count=count: len(answers) > count or failures)
        disturb()
    over.set()
    join(*threads)
    assert list(steps) == failures == []
    assert all(each == ["/a", "/b"] for each in answers)


# Frames


@pytest.fixture
def link():
    with socket.create_server(("127.0.0.1", 0)) as server:
        connection = TcprosConnection("127.0.0.1", server.getsockname()[1], PATIENCE)
        peer, _ = server.accept()
        with contextlib.closing(connection), peer:
            yield connection, peer


def frame(body):
    return struct.pack("<I", len(body)) + body


def test_frames_are_read_one_by_one_however_they_arrive(link):
    connection, peer = link
    in_time = time.monotonic() + PATIENCE
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


# Polls: the changes that they request, and processes that answer none


UNKNOWN_TO_ROSCPP = "received a tcpros connection for a nonexistent service [/manager/poll]."


@contextlib.contextmanager
def polled(kind="", error=""):
    """A client of one process, and the process."""
    with small_graph() as graph:
        graph.nodes[NAME] = process = SmallManager(kind, ["/b", "/a"])
        process.error = error
        with contextlib.closing(PollClient(Master("/test", graph.uri), NAME, bool(kind))) as each:
            yield each, process


def test_changes_are_sent_once():
    with polled() as (client, process):
        described = [len(client.ask(PATIENCE).changes.nodelets) for _ in range(3)]
    assert described == [2, 0, 0]
    assert [each.seen for each in process.requests] == [0, 1, 1]
    assert process.connections == 1


def test_a_stock_nodelet_manager_is_asked_for_its_list():
    with polled(error=UNKNOWN_TO_ROSCPP) as (client, process):
        answers = [client.ask(PATIENCE) for _ in range(2)]
    assert client.is_stock
    found = [(each.changes.kind, each.nodelets) for each in answers]
    assert found == [("cpp_nodelet", ["/a", "/b"])] * 2
    assert process.connections == 2, "the refused one, and the one that is kept"


@pytest.mark.parametrize(
    ("kind", "error"),
    [
        ("", "request from [/test]: md5sums do not match: [a] vs. [b]"),
        ("", "[/manager] is not a provider of  [/manager/poll]"),
        ("node", "[/manager] is not a provider of  [/manager/poll]"),
        ("cpp_node", UNKNOWN_TO_ROSCPP),
    ],
)
def test_a_process_of_another_version_is_named_as_such(kind, error):
    with polled(kind, error) as (client, _):
        with pytest.raises(HostError, match="another version of DyKnow: restart it"):
            client.ask(PATIENCE)
        assert not client.is_stock


# Parameters that a nodelet takes at once, by dynamic_reconfigure


def test_a_double_takes_a_whole_number(monkeypatch):
    """A server in C++ passes over a parameter among those of another type."""
    rate = DoubleParameter("rate", 30.0)

    def call(timeout: float, config: Config) -> Any:
        for each in config.doubles:
            rate.value = each.value
        return SimpleNamespace(config=Config(doubles=[rate]))

    made = mock.Mock(return_value=SimpleNamespace(call=call))
    monkeypatch.setattr(reconfigure, "ServiceClient", made)
    master: Any = None
    assert reconfigure.reconfigure(master, "/camera", Parameter("rate", "int", "5"))
    assert rate.value == 5.0
    assert [each[0][1] for each in made.call_args_list] == ["/camera/set_parameters"] * 2
