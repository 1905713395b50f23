# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Connections without a node: to hosts by their names, and to publishers of topics."""

from __future__ import annotations

import errno
import queue
import socket
import threading
from io import BytesIO
from types import SimpleNamespace
from typing import Any, Tuple

import pytest
import rosgraph.network
from clocks import PATIENCE, HandClock, patch_here
from dyknow_msgs.srv import Poll
from std_msgs.msg import String, UInt32
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.nodelet.leases import Sight
from dyknow.ros.nodelets.peer_services import probe
from dyknow.ros.wire import topic_reader as module
from dyknow.ros.wire.addresses import FRESH, Addresses, connect, host_of, refuses
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient, ServiceLost, is_offered
from dyknow.ros.wire.topic_reader import TopicFollower, TopicReader

# Looking up a host's name never takes longer than its time limit


class NameServer:
    """A name server that answers when the test allows it; of "known" at once."""

    def __init__(self):
        self.asked = threading.Semaphore(0)
        self.count = 0
        self.answers = threading.Event()
        self.addresses: Tuple[str, ...] = ("192.0.2.1",)

    def look_up(self, host):
        if host == "known":
            return ("192.0.2.2",)
        self.count += 1
        self.asked.release()
        assert self.answers.wait(PATIENCE)
        if not self.addresses:
            raise socket.gaierror(socket.EAI_NONAME, "no such host")
        return self.addresses


@pytest.fixture
def server():
    server = NameServer()
    yield server
    server.answers.set()


def test_callers_of_a_silent_name_server_share_one_thread_and_its_answer(server):
    addresses = Addresses(server.look_up)
    assert addresses.of("192.0.2.7", 0.0) == ("192.0.2.7",)
    assert addresses.of("::1", 0.0) == ("::1",)
    assert server.count == 0, "an address is not looked up"
    for _ in range(20):
        with pytest.raises(socket.timeout):
            addresses.of("alone", 0.001)
    names = [thread.name for thread in threading.enumerate()]
    assert names.count("address of alone") == 1
    assert addresses.of("known", PATIENCE) == ("192.0.2.2",), "another name is not held up"
    server.answers.set()
    assert addresses.of("alone", PATIENCE) == ("192.0.2.1",)
    assert server.count == 1


def test_a_name_that_is_none_says_so_and_is_asked_for_again(server):
    server.addresses = ()
    server.answers.set()
    addresses = Addresses(server.look_up)
    with pytest.raises(socket.gaierror, match="no such host"):
        addresses.of("robot", PATIENCE)
    server.addresses = ("192.0.2.3",)
    assert addresses.of("robot", PATIENCE) == ("192.0.2.3",)
    with pytest.raises(OSError, match="."):
        Addresses().of("x" * 300, PATIENCE)  # it can be no name


def test_an_old_address_serves_while_the_name_server_is_silent(server):
    clock = HandClock()
    server.answers.set()
    addresses = Addresses(server.look_up, clock)
    for _ in range(2):
        assert addresses.of("robot", PATIENCE) == ("192.0.2.1",)
    assert server.count == 1
    server.answers.clear()
    server.addresses = ("192.0.2.4",)
    assert server.asked.acquire(timeout=PATIENCE)
    clock.time += FRESH
    assert addresses.of("robot", 0.0) == ("192.0.2.1",)
    assert server.asked.acquire(timeout=PATIENCE)
    server.answers.set()
    while addresses.of("robot", 0.0) == ("192.0.2.1",):
        pass
    assert addresses.of("robot", 0.0) == ("192.0.2.4",)


def test_an_address_refuses_once_nothing_listens_there():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        uri = f"http://127.0.0.1:{server.getsockname()[1]}/"
        assert refuses(uri, PATIENCE)
        server.listen()
        assert not refuses(uri, PATIENCE)
    assert refuses(uri, PATIENCE)


@pytest.mark.parametrize(
    "address", ["", "http://[::1", "http://192.0.2.1:11311:45123/", "rosrpc://robot:99999"]
)
def test_nobody_answers_at_an_address_that_is_none(monkeypatch, address):
    """Nodes whose ROS_IP or ROS_HOSTNAME is wrong register one."""
    assert "/" not in host_of(address)
    assert not refuses(address, PATIENCE)
    assert not is_offered("/ask", address, "/test", PATIENCE)
    assert probe(address) is Sight.SILENT
    master = Master("/test")
    monkeypatch.setattr(master, "ask", lambda *question: address)
    with pytest.raises(ServiceLost, match="/ask is gone: '.*' is no address"):
        ServiceClient(master, "/ask", Poll).call(PATIENCE)


@pytest.mark.parametrize(
    ("failures", "raised"),
    [
        ([OSError(errno.ENETUNREACH, "no route"), ConnectionRefusedError()], ConnectionError),
        ([ConnectionRefusedError(), OSError(errno.ENETUNREACH, "no route")], ConnectionError),
        ([ConnectionRefusedError(), socket.timeout()], socket.timeout),
        ([OSError(errno.ENETUNREACH, "no route")], OSError),
    ],
    ids=["no route and refused", "refused and no route", "refused and silent", "no route"],
)
def test_all_addresses_of_a_host_say_whether_it_is_there(monkeypatch, failures, raised):
    """A host that is silent at one of its addresses may be cut off: it refuses nothing."""
    left = list(failures)

    def fail(address, timeout):
        raise left.pop(0)

    patch_here(monkeypatch, socket, "create_connection", fail)
    found = ("192.0.2.1",) * len(failures)
    monkeypatch.setattr("dyknow.ros.wire.addresses.ADDRESSES", Addresses(lambda host: found))
    with pytest.raises(raised) as caught:
        connect("robot", 1, PATIENCE)
    assert isinstance(caught.value, ConnectionError) == (raised is ConnectionError)
    assert not left


# Topics that are read without a node, over one connection after the other


class SmallPublisher(SmallManager):
    """Accepts connections, to which a test sends messages.

    Attributes:
        asked: an entry for each requested connection.
        readers: the connections.
        answers: cleared while requests are not answered.
    """

    def __init__(self):
        super().__init__()
        self.asked: queue.SimpleQueue[None] = queue.SimpleQueue()
        self.readers: queue.SimpleQueue[socket.socket] = queue.SimpleQueue()
        self.answers = threading.Event()
        self.answers.set()

    def _serve(self, connection):
        self._read(connection)
        self.asked.put(None)
        self.answers.wait()
        fields = {"callerid": "/small", "md5sum": String._md5sum, "type": String._type}
        rosgraph.network.write_ros_handshake_header(connection, fields)
        self.readers.put(connection)


def send(reader, *texts):
    """Send messages in one piece."""
    sent = BytesIO()
    for text in texts:
        body = BytesIO()
        String(text).serialize(body)
        sent.write(len(body.getvalue()).to_bytes(4, "little") + body.getvalue())
    reader.sendall(sent.getvalue())


def is_left(reader):
    reader.settimeout(PATIENCE)
    return reader.recv(1) == b""


@pytest.fixture
def graph():
    with small_graph() as graph:
        yield graph


@pytest.fixture
def publisher(graph):
    graph.nodes["/talker"] = made = SmallPublisher()
    return made


class Following:
    """A follower, and the messages that it has handed on."""

    def __init__(self, graph, last_only=False):
        self.heard: queue.SimpleQueue[str] = queue.SimpleQueue()
        master = Master("/reader", graph.uri)
        self.follower = TopicFollower(
            master, "/talker", "/words", String, lambda m: self.heard.put(m.data), last_only
        )
        self.follower.start()

    def __enter__(self):
        return self

    def __exit__(self, *unused):
        self.follower.close()

    def next(self, count=1):
        return [self.heard.get(timeout=PATIENCE) for _ in range(count)]


@pytest.mark.parametrize("last_only", [False, True])
def test_messages_are_handed_on_in_order_or_the_last_alone(graph, publisher, last_only):
    with Following(graph, last_only) as following:
        reader = publisher.readers.get(timeout=PATIENCE)
        send(reader, "one", "two", "three")
        assert following.next(1 if last_only else 3)[-1] == "three"
        assert following.follower.is_connected
        send(reader, "four")
        assert following.next() == ["four"]
    assert is_left(reader)


def test_the_last_message_is_not_looked_for_for_ever(monkeypatch):
    """On a fast topic, or a link that is full, the next one is always there."""
    now, numbers = [0.0], iter(range(1000))

    def next_frame(deadline):
        now[0] += 0.001
        return next(numbers).to_bytes(4, "little")

    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    reader: Any = object.__new__(TopicReader)
    reader._class = UInt32
    reader._connection = SimpleNamespace(receive_frame=next_frame)
    first, second = (reader.read(1.0, last_only=True) for _ in range(2))
    assert 0 < first.data < second.data == next(numbers) - 1


def test_a_publisher_that_comes_late_is_found_and_a_lost_connection_made_again(graph):
    with Following(graph) as following:
        assert not following.follower.is_connected
        graph.nodes["/talker"] = publisher = SmallPublisher()
        send(publisher.readers.get(timeout=PATIENCE), "late")
        assert following.next() == ["late"]
        publisher.lose_connections()
        send(publisher.readers.get(timeout=PATIENCE), "again")
        assert following.next() == ["again"]


@pytest.mark.parametrize("is_made", [True, False])
def test_the_next_connection_is_to_the_node_that_has_the_name_now(graph, publisher, is_made):
    if not is_made:
        publisher.answers.clear()
    with Following(graph) as following:
        publisher.asked.get(timeout=PATIENCE)
        reader = publisher.readers.get(timeout=PATIENCE) if is_made else None
        graph.nodes["/talker"] = successor = SmallPublisher()
        following.follower.reconnect()
        publisher.answers.set()
        send(successor.readers.get(timeout=PATIENCE), "new")
        assert following.next() == ["new"]
        assert reader is None or is_left(reader)


def test_a_callback_that_raises_does_not_end_it(graph, publisher, caplog):
    with Following(graph) as following:
        following.follower._hand_on = lambda message: following.heard.put(message.data[3])
        send(publisher.readers.get(timeout=PATIENCE), "no", "good")
        assert following.next() == ["d"]
        assert "IndexError" in caplog.text
