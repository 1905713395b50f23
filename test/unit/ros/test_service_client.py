# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Calls of services whose every step has a time limit, and the connections under them."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from types import SimpleNamespace
from typing import Iterator, List, Tuple

import pytest
from nodelet.srv import NodeletList
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.errors import PeerTimeout
from dyknow.ros.wire import service_client
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import (
    ServiceClient,
    ServiceFailed,
    ServiceLost,
    TcprosConnection,
)

LONG = 30.0
SOON = 0.05


@pytest.fixture
def manager(monkeypatch: pytest.MonkeyPatch) -> Iterator[SmallManager]:
    with small_graph() as graph:
        graph.nodes["/manager"] = manager = SmallManager()
        manager.nodelets = ["/a", "/b"]
        monkeypatch.setenv("ROS_MASTER_URI", graph.uri)
        yield manager


def make_client(**options: bool) -> ServiceClient:
    return ServiceClient(Master("/client"), "/manager/list", NodeletList, **options)


@pytest.fixture
def client(manager: SmallManager) -> Iterator[ServiceClient]:
    with contextlib.closing(make_client(persistent=True)) as client:
        yield client


def test_calls_of_a_persistent_client_share_a_connection(
    manager: SmallManager, client: ServiceClient
) -> None:
    answers = []

    def call() -> None:
        for _ in range(20):
            answers.append(client.call(LONG).nodelets)

    threads = [threading.Thread(target=call) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONG)
    assert answers == [["/a", "/b"]] * 80
    assert manager.connections == 1


def test_calls_of_another_client_overlap(manager: SmallManager) -> None:
    client = make_client()
    assert client.call(LONG).nodelets == client.call(LONG).nodelets == ["/a", "/b"]
    assert manager.connections == 2


def test_a_hung_server_holds_up_the_first_call_alone(
    manager: SmallManager, client: ServiceClient
) -> None:
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
            assert client.call(LONG).nodelets == ["/a", "/b"]
            break
    assert manager.connections == 1


def test_the_wait_for_other_threads_counts_with_the_call(
    manager: SmallManager, client: ServiceClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [time.monotonic()]
    deadlines: List[float] = []

    class SlowTurn:
        """A turn that is free only when the time of the call is over."""

        def acquire(self, blocking: bool = True, timeout: float = 0.0) -> bool:
            now[0] += timeout
            return True

        def release(self) -> None:
            pass

    def answer(connection: TcprosConnection, deadline: float) -> Tuple[bool, bytes]:
        deadlines.append(deadline)
        raise socket.timeout

    client.call(LONG)
    client._turn = SlowTurn()  # type: ignore[assignment]
    monkeypatch.setattr(TcprosConnection, "receive_answer", answer)
    monkeypatch.setattr(service_client, "time", SimpleNamespace(monotonic=lambda: now[0]))
    with pytest.raises(PeerTimeout):
        client.call(5.0)
    assert deadlines == [now[0]]


@pytest.mark.parametrize("persistent", [False, True])
def test_a_process_of_another_version_is_reported_with_the_cure(
    manager: SmallManager, persistent: bool
) -> None:
    manager.error = "request from [/client]: md5sums do not match: [a] vs. [b]"
    with contextlib.closing(make_client(persistent=persistent)) as client:
        with pytest.raises(ServiceFailed, match="another version of DyKnow: restart it"):
            client.call(LONG)
        manager.error = "there is no such service"
        with pytest.raises(ServiceFailed, match="there is no such service$"):
            client.call(LONG)


def test_a_lost_connection_is_made_again_for_a_persistent_client(
    manager: SmallManager, client: ServiceClient
) -> None:
    client.call(LONG)
    manager.lose_connections()
    assert client.call(LONG).nodelets == ["/a", "/b"]


def test_a_client_that_must_not_reconnect_says_that_the_server_is_lost(
    manager: SmallManager,
) -> None:
    client = make_client(persistent=True, reconnects=False)
    client.call(LONG)
    manager.lose_connections()
    for _ in range(2):
        with pytest.raises(ServiceLost):
            client.call(LONG)


# Frames


Link = Tuple[TcprosConnection, socket.socket]


@pytest.fixture
def link() -> Iterator[Link]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        connection = TcprosConnection("127.0.0.1", server.getsockname()[1], LONG)
        peer, _ = server.accept()
        with contextlib.closing(connection), peer:
            yield connection, peer


def frame(body: bytes) -> bytes:
    return struct.pack("<I", len(body)) + body


def in_time() -> float:
    return time.monotonic() + LONG


def test_frames_are_read_one_by_one_however_they_arrive(link: Link) -> None:
    connection, peer = link
    peer.sendall(frame(b"one") + frame(b"") + b"\1" + frame(b"yes") + b"\0" + frame(b"no"))
    assert connection.receive_frame(in_time()) == b"one"
    assert connection.receive_frame(in_time()) == b""
    assert connection.receive_answer(in_time()) == (True, b"yes")
    assert connection.receive_answer(in_time()) == (False, b"no")


@pytest.mark.parametrize("cut", [1, 4, 6])
def test_what_came_before_the_deadline_is_kept(link: Link, cut: int) -> None:
    connection, peer = link
    answer = b"\1" + frame(b"whole")
    peer.sendall(answer[:cut])
    with pytest.raises(socket.timeout):
        connection.receive_answer(time.monotonic() + SOON)
    peer.sendall(answer[cut:])
    assert connection.receive_answer(in_time()) == (True, b"whole")


def test_a_connection_that_the_other_side_closes_breaks(link: Link) -> None:
    connection, peer = link
    peer.sendall(frame(b"whole")[:6])
    peer.close()
    with pytest.raises(ConnectionResetError):
        connection.receive_frame(in_time())
