# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Looking up a host's name never takes longer than its time limit."""

from __future__ import annotations

import errno
import socket
import threading
from typing import Tuple

import pytest
from clocks import PATIENCE, HandClock

from dyknow.ros.wire.addresses import FRESH, Addresses, connect, refuses


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

    monkeypatch.setattr(socket, "create_connection", fail)
    found = ("192.0.2.1",) * len(failures)
    monkeypatch.setattr("dyknow.ros.wire.addresses.ADDRESSES", Addresses(lambda host: found))
    with pytest.raises(raised) as caught:
        connect("robot", 1, PATIENCE)
    assert isinstance(caught.value, ConnectionError) == (raised is ConnectionError)
    assert not left
