# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The queue of one subscriber: what is sent at once, what waits, what is dropped."""

from __future__ import annotations

import socket
import struct
import threading

import pytest
from clocks import eventually
from hypothesis import given, settings
from hypothesis import strategies as st
from rospy.exceptions import TransportTerminated

from dyknow.ros.transport.arena import Arena
from dyknow.ros.transport.outbound import WINDOW, Outbound, Share

ARENA = Arena()


class Connection:
    """rospy's side of a connection to a subscriber."""

    name = "/topic"
    transport_type = "TCPROS"
    stat_bytes = stat_num_msg = 0

    def __init__(self):
        self.socket, self.other = socket.socketpair()
        self.done = False

    def close(self):
        self.done = True
        self.socket.close()


@pytest.fixture
def connection():
    made = Connection()
    yield made
    made.close()
    made.other.close()


def frame(number, size=8):
    return struct.pack("<II", number, size) + bytes(size)


def read(connection):
    """Read a frame; returns its number."""
    number, size = struct.unpack("<II", exactly(connection.other, 8))
    exactly(connection.other, size)
    return number


def exactly(sock, size):
    data = b""
    while len(data) < size:
        data += sock.recv(size - len(data))
    return data


def share(number, size=WINDOW):
    region = ARENA.write(bytes(size))
    assert region is not None
    return Share(frame(number), region)


def greet(connection, outbound):
    connection.other.sendall(ARENA.address.encode())
    eventually(outbound.shares)


def test_a_message_is_sent_by_the_thread_that_publishes_it(connection):
    outbound = Outbound(connection, 1, ARENA)
    threads = threading.active_count()
    for number in range(100):
        outbound.write_data(frame(number))
    assert threading.active_count() == threads
    assert [read(connection) for _ in range(100)] == list(range(100))
    assert outbound.is_idle()
    assert connection.stat_num_msg == 100


def test_what_a_slow_subscriber_does_not_take_waits_and_the_oldest_goes(connection):
    outbound = Outbound(connection, 3, ARENA)
    for number in range(50):
        outbound.write_data(frame(number, 1 << 18))
    assert not outbound.is_idle()
    received = [read(connection)]
    while received[-1] != 49:
        received.append(read(connection))
    assert received == sorted(received)
    assert received[-3:] == [47, 48, 49]
    assert len(received) < 50
    eventually(outbound.is_idle)


def test_without_a_bound_nothing_goes(connection):
    outbound = Outbound(connection, None, ARENA)
    for number in range(50):
        outbound.write_data(frame(number, 1 << 18))
    assert [read(connection) for _ in range(50)] == list(range(50))


def test_a_subscriber_that_has_gone_is_an_error_of_the_next_message(connection):
    outbound = Outbound(connection, 3, ARENA)
    connection.other.close()
    with pytest.raises(TransportTerminated):
        outbound.write_data(frame(1))
    assert outbound.is_idle()


def test_a_subscriber_that_goes_while_messages_wait(connection):
    outbound = Outbound(connection, 3, ARENA)
    for number in range(5):
        outbound.write_data(frame(number, 1 << 20))
    connection.other.close()
    eventually(outbound.is_idle)


def test_only_who_greets_with_our_address_shares(connection):
    outbound = Outbound(connection, 3, ARENA)
    assert not outbound.shares()
    for _ in range(3):
        connection.other.sendall(b"\6" * len(ARENA.address))
        assert not outbound.shares()
    assert outbound.transport_type == "TCPROS"


def test_a_greeting_in_pieces(connection):
    outbound = Outbound(connection, 3, ARENA)
    address = ARENA.address.encode()
    connection.other.sendall(address[:5])
    assert not outbound.shares()
    connection.other.sendall(address[5:])
    eventually(outbound.shares)
    assert outbound.transport_type == "SHMROS"


def test_a_subscriber_is_sent_no_more_than_it_can_copy(connection):
    outbound = Outbound(connection, 10, ARENA)
    greet(connection, outbound)
    for number in range(4):
        outbound.write_data(share(number))
    assert read(connection) == 0
    connection.other.setblocking(False)
    with pytest.raises(BlockingIOError):
        connection.other.recv(1)
    connection.other.setblocking(True)
    for number in range(1, 4):
        connection.other.sendall(b"\6")
        assert read(connection) == number
    assert not outbound.is_idle()
    connection.other.sendall(b"\6")
    eventually(outbound.is_idle)


def test_a_region_is_free_when_its_last_subscriber_has_copied_it(connection):
    second = Connection()
    try:
        both = [Outbound(each, 1, ARENA) for each in (connection, second)]
        for each, outbound in zip((connection, second), both):
            greet(each, outbound)
        one = share(0)
        offset = one.region.offset
        for outbound in both:
            outbound.write_data(one)
        del one
        connection.other.sendall(b"\6")
        eventually(both[0].is_idle)
        other = ARENA.write(bytes(WINDOW))
        assert other.offset != offset
        second.other.sendall(b"\6")
        eventually(both[1].is_idle)
        assert offset in [ARENA.write(bytes(WINDOW)).offset for _ in range(2)]
    finally:
        second.close()
        second.other.close()


def test_what_a_lost_subscriber_may_still_copy_lingers():
    connection = Connection()
    outbound = Outbound(connection, 1, ARENA)
    greet(connection, outbound)
    one = share(0)
    offset = one.region.offset
    outbound.write_data(one)
    connection.close()
    del one, outbound
    assert offset not in [each.offset for each in [ARENA.write(bytes(WINDOW)) for _ in range(3)]]
    connection.other.close()


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.sampled_from([8, 1 << 12, 1 << 18, WINDOW]))))
def test_any_mixture_arrives_in_order(messages):
    connection = Connection()
    outbound = Outbound(connection, None, ARENA)
    greet(connection, outbound)
    received = []

    def receive():
        for is_share, _ in messages:
            received.append(read(connection))
            if is_share:
                connection.other.sendall(b"\6")

    reader = threading.Thread(target=receive)
    reader.start()
    try:
        for number, (is_share, size) in enumerate(messages):
            outbound.write_data(share(number, size) if is_share else frame(number, size))
    finally:
        reader.join()
        connection.close()
        connection.other.close()
    assert received == list(range(len(messages)))
