# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Registrations while the master is there, and while it is not."""

from __future__ import annotations

import socket
import socketserver
import threading
import xmlrpc.server
from contextlib import suppress
from types import SimpleNamespace

import pytest
from clocks import PATIENCE, eventually, patch_here
from rospy.exceptions import TransportInitError
from rospy.impl import registration, tcpros_base, tcpros_pubsub
from rospy.impl.registration import RegManager
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.impl.tcpros_pubsub import TCPROSSub
from rospy.topics import _SubscriberImpl
from std_msgs.msg import Header

from dyknow.errors import PeerTimeout
from dyknow.ros.process import node_process
from dyknow.ros.transport import registrar as registrar_module
from dyknow.ros.transport.registrar import Registrar, services_together
from dyknow.ros.wire.master import Master

STRING = "std_msgs/String"


class Server(socketserver.ThreadingMixIn, xmlrpc.server.SimpleXMLRPCServer):
    allow_reuse_address = True
    daemon_threads = True
    block_on_close = False


class OneMaster:
    """The few calls of the master's API that matter here, over real XML-RPC."""

    def __init__(self):
        self.registered, self.calls, self.looked_up = {}, [], []
        self.newcomer = ""
        self.requests = 0
        self.server = None
        self.port = 0

    def start(self):
        self.server = Server(("127.0.0.1", self.port), logRequests=False, allow_none=True)
        self.port = self.server.server_address[1]
        for kind in ("Publisher", "Subscriber", "Service"):
            self.server.register_function(self.register, f"register{kind}")
            self.server.register_function(self.unregister, f"unregister{kind}")
        self.server.register_function(self.look_up, "lookupNode")
        self.server.register_function(self.call_all, "system.multicall")
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def stop(self):
        if self.server is not None:
            self.server.shutdown()
            self.server.server_close()
            self.server = None

    def register(self, caller, name, what, uri):
        self.calls.append(name)
        self.registered[name] = what
        return 1, "", ["http://other:1"]

    def call_all(self, questions):
        self.requests += 1
        return [[self.register(*each["params"])] for each in questions]

    def look_up(self, caller, name):
        self.looked_up.append(name)
        return (1, "", self.newcomer) if self.newcomer else (-1, "unknown", "")

    def unregister(self, caller, name, what):
        return 1, "", int(self.registered.pop(name, None) is not None)


@pytest.fixture(name="master")
def _master():
    one = OneMaster()
    one.start()
    yield one
    one.stop()


@pytest.fixture(name="registrar")
def _registrar(master, monkeypatch):
    monkeypatch.setattr(registrar_module, "_AGAIN", 0.02)
    return Registrar(Master("/test", f"http://127.0.0.1:{master.port}", timeout=PATIENCE))


def test_the_answer_is_returned_once(master, registrar):
    registrar.reg_added("/a", STRING, "pub")
    assert master.registered == {"/a": STRING}
    assert registrar.subscribers("/a") == {"http://other:1"}
    assert registrar.subscribers("/a") is None
    registrar.reg_removed("/a", STRING, "pub")
    assert master.registered == {}


@pytest.mark.parametrize("is_away", [False, True])
def test_publishers_that_were_left_are_connected_to_again(master, registrar, is_away):
    updates = []
    registrar._manager = SimpleNamespace(
        publisher_update=lambda *update: updates.append(update),
        cond=threading.Condition(),
        updates=[("/a", ["http://new:1/"]), ("/b", ["http://b:1/"])],  # about to be connected to
    )
    state = [[["/a", ["/other"]], ["/b", ["/none"]]], [], []]
    master.newcomer = "http://newcomer:1/"
    if not is_away:
        master.server.register_function(lambda caller: (1, "", state), "getSystemState")
    registrar.connect_again("/a", {"http://left:1/"})
    others = [] if is_away else ["http://newcomer:1/"]
    assert updates == [("/a", ["http://left:1/", "http://new:1/", *others])]


def test_a_publisher_that_came_in_the_same_moment_is_connected_to(master, registrar):
    """The master notified this process of it before the answer, which is older, was read."""
    updates = [("/a", ["http://new:1/"])]
    registrar._manager = SimpleNamespace(
        publisher_update=lambda *update: updates.append(update),
        cond=threading.Condition(),
        updates=updates,
    )
    registrar.reg_added("/a", STRING, "sub")
    assert updates[-1] == ("/a", ["http://new:1/", "http://other:1"])


@pytest.fixture
def again(monkeypatch):
    """Topics to whose publishers a registrar, which makes the connections, connects again."""
    listeners, manager = registration.RegistrationListeners(), RegManager(SimpleNamespace())
    listeners.add_listener(manager)
    monkeypatch.setattr(node_process, "get_registration_listeners", lambda: listeners)
    for name in ("robust_connect_subscriber", "check_if_still_publisher"):  # restored
        monkeypatch.setattr(tcpros_pubsub, name, getattr(tcpros_pubsub, name))
    registrar = Registrar(Master("/test", "http://127.0.0.1:1"))
    topics: list[str] = []
    monkeypatch.setattr(registrar, "connect_again", lambda topic, uris: topics.append(topic))
    return topics


def test_a_connection_that_is_closed_before_it_has_a_socket_is_closed(again, monkeypatch):
    """rospy leaves it open, and silent; its publisher would wait for its header."""
    connection = TCPROSTransport(TCPROSSub("/a", Header), "/a")
    # rospy asks for this just before it keeps the socket; another connection replaces this one.
    patch_here(monkeypatch, tcpros_base, "_is_use_tcp_keepalive", connection.close)
    with socket.create_server(("127.0.0.1", 0)) as publisher:
        publisher.settimeout(PATIENCE)
        where = *publisher.getsockname(), "http://here:1/", None, "/a"
        tcpros_pubsub.robust_connect_subscriber(connection, *where)
        peer, _ = publisher.accept()
        with peer:
            peer.settimeout(PATIENCE)
            assert peer.recv(1) == b""
    assert again == ["/a"]


@pytest.mark.parametrize("is_refused", [True, False])
def test_a_publisher_that_refused_is_connected_to_when_it_is_back(is_refused, again, monkeypatch):
    """Where it is out of reach instead, when rospy has given it up."""
    monkeypatch.setattr(tcpros_pubsub, "check_if_still_publisher", lambda topic, uri: is_refused)
    monkeypatch.setattr(tcpros_pubsub, "time", SimpleNamespace(sleep=lambda seconds: None))
    subscriber = _SubscriberImpl("/a", Header)

    def connect(uri):
        connection = TCPROSTransport(TCPROSSub("/a", Header), "/a")
        connection.set_endpoint_id(uri)

        def fail(*args, **options):
            connection.socket = socket.socket() if is_refused else None
            raise TransportInitError("no topic /a")

        connection.connect = fail
        subscriber.add_connection(connection)
        where = "127.0.0.1", 1, uri, None, "/a"
        tcpros_pubsub.robust_connect_subscriber(connection, *where)
        return subscriber.has_connection(uri)

    assert not connect("http://back:1/") and again == ["/a"]
    assert not connect("http://back:1/") and again == ["/a"], "at once, once"
    assert not connect("http://other:1/") and again == ["/a", "/a"]


def test_a_dead_master_blocks_no_registration_and_receives_it_later(master, registrar):
    master.stop()
    registrar.reg_added("/a", STRING, "pub")
    registrar.reg_added("/s", "rosrpc://here:1", "srv")
    registrar.reg_added("/gone", STRING, "pub")
    registrar.reg_removed("/gone", STRING, "pub")
    assert registrar.subscribers("/a") is None
    master.start()
    eventually(lambda: master.registered == {"/a": STRING, "/s": "rosrpc://here:1"})
    assert master.calls == ["/a", "/s"], "each once, in order"
    registrar.reg_added("/b", STRING, "pub")
    eventually(lambda: "/b" in master.registered)
    registrar.reg_removed("/a", STRING, "pub")
    eventually(lambda: "/a" not in master.registered)  # by the worker, if that is at work


def test_a_node_that_lost_its_name_meanwhile_registers_nothing(master, registrar):
    master.stop()
    registrar.reg_added("/a", STRING, "pub")
    master.newcomer = "http://newcomer:1/"
    master.start()
    eventually(lambda: len(master.looked_up) > 2)
    assert master.calls == []
    master.newcomer = ""
    eventually(lambda: "/a" in master.registered)


def test_a_withdrawal_that_a_dead_master_missed_is_repeated(master, registrar):
    for topic in ("/a", "/b"):
        registrar.reg_added(topic, STRING, "pub")
    master.stop()
    for topic in ("/a", "/b"):
        registrar.reg_removed(topic, STRING, "pub")
    registrar.reg_added("/b", STRING, "pub")
    assert registrar.is_subscribed("/a")
    master.start()
    eventually(lambda: master.registered == {"/b": STRING})


def test_a_silent_master_is_waited_for_once(master, registrar, monkeypatch):
    for topic in ("/a", "/b"):
        registrar.reg_added(topic, STRING, "pub")
    waits = []

    def wait(*question):
        waits.append(question)
        raise PeerTimeout("the ROS master", 3.0)

    with monkeypatch.context() as silence:
        silence.setattr(registrar._master, "ask", wait)
        silence.setattr(registrar._worker, "start", lambda: None)
        for topic in ("/a", "/b"):
            registrar.reg_removed(topic, STRING, "pub")
    assert len(waits) == 1
    registrar._settle()
    assert master.registered == {}


def test_services_that_are_offered_together_take_one_question(master, registrar):
    with services_together():
        registrar.reg_added("/s1", "rosrpc://here:1", "srv")
        registrar.reg_added("/gone", "rosrpc://here:1", "srv")
        registrar.reg_added("/a", STRING, "pub")
        assert master.registered == {"/a": STRING}, "topics at once"
        registrar.reg_removed("/gone", "rosrpc://here:1", "srv")
        registrar.reg_added("/s2", "rosrpc://here:1", "srv")
    assert master.requests == 1
    assert master.calls == ["/a", "/s1", "/s2"]
    registrar.reg_added("/s3", "rosrpc://here:1", "srv")
    registrar.reg_removed("/s1", "rosrpc://here:1", "srv")
    assert master.registered.keys() == {"/a", "/s2", "/s3"}


def test_a_master_that_takes_one_question_at_a_time_is_asked_so(master, registrar):
    del master.server.funcs["system.multicall"]
    with services_together():
        for name in ("/s1", "/s2"):
            registrar.reg_added(name, "rosrpc://here:1", "srv")
    assert master.calls == ["/s1", "/s2"]


@pytest.mark.parametrize("error", [None, KeyError])
def test_services_are_registered_late_and_after_errors_too(master, registrar, error):
    master.stop()
    with suppress(KeyError), services_together():
        registrar.reg_added("/s1", "rosrpc://here:1", "srv")
        registrar.reg_added("/s2", "rosrpc://here:1", "srv")
        if error is not None:
            raise error
    with services_together():
        registrar.reg_added("/s3", "rosrpc://here:1", "srv")
    master.start()
    eventually(lambda: not registrar._owed)
    assert (master.calls, master.requests) == (["/s1", "/s2", "/s3"], 0)


def test_a_service_that_the_master_refuses_keeps_none_from_being_registered(
    master, registrar, caplog
):
    def register(*arguments):
        return (-1, "not here", 0) if arguments[1] == "/s1" else granted(*arguments)

    granted, master.register = master.register, register
    master.server.register_function(register, "registerService")
    with services_together():
        for name in ("/s1", "/s2"):
            registrar.reg_added(name, "rosrpc://here:1", "srv")
    assert master.registered.keys() == {"/s2"}
    assert "refuses to register /s1: not here" in caplog.text


def test_a_topic_that_is_withdrawn_while_it_is_registered_late(master, registrar):
    master.stop()
    registrar.reg_added("/a", STRING, "pub")
    remove = [lambda: registrar.reg_removed("/a", STRING, "pub")]
    register = master.register

    def register_amid(*arguments):
        remove.pop()()
        return register(*arguments)

    master.register = register_amid
    master.start()
    eventually(lambda: not registrar._owed)
    assert (master.calls, master.registered) == (["/a"], {})
