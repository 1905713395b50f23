# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Memory that processes share: its regions, packed messages, and queues of subscribers."""

from __future__ import annotations

import contextlib
import errno
import io
import mmap
import os
import socket
import struct
import subprocess
import sys
import threading
from subprocess import PIPE
from types import SimpleNamespace
from typing import Any

import genpy.dynamic
import numpy as np
import pytest
import rosgraph.network
import rospy
import rospy.msg
from clocks import eventually, patch_here
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples
from rospy.exceptions import TransportTerminated
from rospy.numpy_msg import numpy_msg
from sensor_msgs.msg import CompressedImage, Image, LaserScan, PointCloud2
from std_msgs.msg import ByteMultiArray, Float64MultiArray, Header, String

from dyknow.errors import HostError
from dyknow.ros.transport import arena as module
from dyknow.ros.transport import packing
from dyknow.ros.transport.arena import Arena, ArenaReader
from dyknow.ros.transport.outbound import WINDOW, Outbound, Share
from dyknow.ros.transport.packing import FRAME, LARGE, Packed, assembled, largest_field
from dyknow.ros.transport.shared_memory import Inbound, InboundTransport

MB = 1 << 20
IMPORT = "from dyknow.ros.transport.arena import Arena, ArenaReader"


@pytest.fixture
def arena():
    return Arena()


def held_by(arena):
    """Bytes of memory that the file takes."""
    return os.fstat(arena._file).st_blocks * 512


def copy(reader, region):
    return reader.read(region.offset, region.number, region.size)


def run(code: str, *arguments: str, wrapper: tuple[str, ...] = ()) -> str:
    """Run code in a process of its own; returns all that it prints, at its end as well."""
    program = f"import os, resource, sys\nfrom dyknow.errors import HostError\n{IMPORT}\n{code}\n"
    command = (*wrapper, sys.executable, "-c", program, *arguments)
    ended = subprocess.run(
        command, check=True, text=True, timeout=120, stdout=PIPE, stderr=subprocess.STDOUT
    )
    return ended.stdout


#: Leaves one descriptor: for the socket of a reader, and none for what comes through it.
EXHAUST = """
files = []
resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
try:
    while True:
        files.append(os.open("/dev/null", os.O_RDONLY))
except OSError:
    os.close(files.pop())
"""
READ = """
try:
    ArenaReader(sys.argv[1])
except HostError as error:
    print(error)
"""


@pytest.mark.parametrize("is_mapped", [False, True])
def test_a_file_that_has_grown_is_mapped_again_or_read(arena, monkeypatch, is_mapped):
    """A mapping takes a descriptor and address space, which may be lacking for a while."""
    reader = ArenaReader(arena.address)
    if is_mapped:
        assert copy(reader, arena.write(b"first"))
    regions = [arena.write(bytes([number]) * (9 * MB)) for number in range(10)]

    def is_refused(*unused, **options):
        raise OSError(errno.EMFILE, "too many open files")

    with monkeypatch.context() as patch:
        patch.setattr(mmap, "mmap", is_refused)
        for number, region in enumerate(regions):
            assert copy(reader, region) == bytes([number]) * (9 * MB)
        last = regions[-1]
        assert reader.read(last.offset, last.number + 1, last.size) is None
    assert copy(reader, regions[-1])[:1] == b"\x09"


def test_a_region_is_used_again_and_the_message_that_is_gone_is_no_other_one(arena):
    reader = ArenaReader(arena.address)
    region = arena.write(b"old" * MB)
    where = (region.offset, region.number, region.size)
    del region
    kept = [arena.write(b"new" * MB) for _ in range(2)]
    assert where[0] in [each.offset for each in kept]
    assert reader.read(*where) is None


def test_the_memory_of_many_free_regions_is_given_back(arena, monkeypatch):
    monkeypatch.setattr(module, "IDLE", 4 * MB)
    regions = [arena.write(bytes(MB)) for _ in range(20)]
    assert held_by(arena) >= 20 * MB
    del regions
    last = arena.write(b"x" * MB)
    assert held_by(arena) < 8 * MB
    assert copy(ArenaReader(arena.address), last) == b"x" * MB


def test_regions_linger_for_readers_that_cannot_answer():
    now = [100.0]
    arena = Arena(lambda: now[0])
    reader = ArenaReader(arena.address)
    region = arena.write(b"late" * MB)
    assert region is not None
    where = (region.offset, region.number, region.size)
    arena.linger((region,))
    del region
    kept = [arena.write(b"more" * MB)]
    assert reader.read(*where) == b"late" * MB
    now[0] += module.LINGER + 0.1
    kept += [arena.write(b"more" * MB) for _ in range(2)]
    assert reader.read(*where) is None


def test_where_memory_is_lacking_nothing_is_written_and_nothing_is_lost(arena, monkeypatch):
    kept = arena.write(b"kept" * MB)

    def is_full(*unused):
        raise OSError(errno.ENOSPC, "no space")

    with monkeypatch.context() as patch:
        patch_here(patch, os, "posix_fallocate", is_full)
        assert arena.write(bytes(MB)) is None
    reader = ArenaReader(arena.address)
    assert copy(reader, kept) == b"kept" * MB
    assert copy(reader, arena.write(b"y" * MB)) == b"y" * MB


def test_a_limit_of_address_space_is_no_end():
    code = """
arena = Arena()
used = int(open("/proc/self/statm").read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
resource.setrlimit(resource.RLIMIT_AS, (used + (96 << 20),) * 2)
kept = [arena.write(bytes(10 << 20)) for _ in range(12)]
print(kept.count(None) > 0, arena.write(b"small") is not None)
reader = ArenaReader(arena.address)
arena.linger((arena.write(b"late"),))
"""
    assert run(code) == "True True\n", "it says nothing of what is left at its end"


def test_a_process_of_another_network_does_not_reach_it(arena):
    wrapper = ("unshare", "--net")
    if subprocess.run([*wrapper, "true"], check=False).returncode:
        pytest.skip("namespaces cannot be made here")
    assert "out of reach" in run(READ, arena.address, wrapper=wrapper)


def test_another_user_is_refused(arena):
    if os.geteuid():
        pytest.skip("only root can be another user")
    code = f"""
import socket
os.setuid(65534)
with socket.socket(socket.AF_UNIX) as bare:
    bare.connect(chr(0) + sys.argv[1])
    print(bare.recvmsg(1, 100)[:2])
{READ}"""
    said = run(code, arena.address)
    assert said.startswith("(b'', [])\n") and "another user's" in said
    ArenaReader(arena.address)


def test_a_reader_without_a_free_descriptor_is_told_so(arena):
    assert "no descriptor is free" in run(EXHAUST + READ, arena.address)
    ArenaReader(arena.address)


def test_what_a_killed_owner_wrote_can_be_read(tmp_path):
    code = """
arena = Arena()
region = arena.write(b"last" * (1 << 20))
print(arena.address, region.offset, region.number, region.size, flush=True)
sys.stdin.read()
"""
    command = [sys.executable, "-c", f"import sys\n{IMPORT}\n{code}"]
    with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, text=True) as owner:
        try:
            address, *where = owner.stdout.readline().split()
            reader = ArenaReader(address)
        finally:
            owner.kill()
    assert reader.read(*map(int, where)) == b"last" * MB
    with pytest.raises(HostError, match="out of reach"):
        ArenaReader(address)


def test_a_child_that_was_forked_writes_nothing(arena):
    kept = arena.write(b"parent" * MB)
    child = os.fork()
    if not child:
        os._exit(0 if arena.write(bytes(MB)) is None else 1)
    assert os.waitpid(child, 0)[1] == 0
    assert copy(ArenaReader(arena.address), kept) == b"parent" * MB


def test_an_owner_that_had_no_descriptor_hands_out_when_it_has():
    code = f"""
arena = Arena()
ArenaReader(arena.address)
{EXHAUST}
for _ in range(3):
    try:
        ArenaReader(arena.address)
    except HostError:
        pass
while files:
    os.close(files.pop())
region = arena.write(bytearray(b"again"))
print(ArenaReader(arena.address).read(region.offset, region.number, region.size))
"""
    assert run(code).endswith("b'again'\n")


def test_a_reader_can_only_read(arena):
    reader = ArenaReader(arena.address)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.write(reader._file, b"x")
    with pytest.raises(OSError, match="Operation not permitted"):
        os.ftruncate(arena._file, 0)


# A packed message equals the ordinary one, in every class that may receive it


PAIR = genpy.dynamic.generate_dynamic(
    "test/Pair",
    f"sensor_msgs/Image left\nsensor_msgs/Image right\nuint8[] more\n{'=' * 80}\n"
    f"MSG: sensor_msgs/Image\n{Image._full_text}",
)["test/Pair"]
ARENA = Arena()
READER = ArenaReader(ARENA.address)


def ordinary(message, number=7):
    """The frame that rospy would send."""
    buffer = io.BytesIO()
    rospy.msg.serialize_message(buffer, number, message)
    return buffer.getvalue()


def through_memory(message, datatype=None):
    """The message as a subscriber receives it."""
    packed = Packed(message, 7)
    region = ARENA.write(packed.content)
    assert region is not None
    frame = packed.frame(region)
    _, length, place, number, *where = FRAME.unpack_from(frame)
    text = frame[FRAME.size :]
    assert len(text) == length
    content = READER.read(*where)
    assert content is not None
    return assembled(datatype or type(message), text, place, number, content)


def image(size=LARGE, fill=b"\7"):
    header = Header(frame_id="camera", stamp=rospy.Time(3, 5))
    return Image(header=header, height=3, encoding="rgb8", step=9, data=fill * size)


LARGE_ONES = [
    image(),
    image(10 * LARGE, b"\xff"),
    Image(data=bytearray(2 * LARGE)),
    CompressedImage(format="jpeg", data=bytes(range(256)) * (LARGE // 256)),
    PointCloud2(width=5, data=b"point" * LARGE, is_dense=True),
    Float64MultiArray(data=list(range(LARGE))),
    ByteMultiArray(data=[1] * LARGE),
    LaserScan(ranges=[1.5] * LARGE),
    String("word" * LARGE),
    PAIR(left=image(100), right=image(2 * LARGE), more=b"m" * LARGE),
    PAIR(left=image(2 * LARGE), more=b"m"),
]


@pytest.mark.parametrize("message", LARGE_ONES, ids=lambda each: type(each).__name__)
def test_the_message_arrives_as_over_tcpros(message):
    expected = ordinary(message)
    before = [getattr(message, slot) for slot in message.__slots__]
    received = through_memory(message)
    assert ordinary(received) == expected
    assert type(received) is type(message)
    again = type(message)().deserialize(expected[4:])
    assert received == again
    slots = message.__slots__
    assert [type(getattr(received, s)) for s in slots] == [type(getattr(again, s)) for s in slots]
    assert through_memory(message, rospy.AnyMsg)._buff == expected[4:]
    packed = Packed(message, 7)
    assert all(getattr(message, slot) is each for slot, each in zip(slots, before))
    assert packed.plain() == expected
    assert packed.size == len(expected) - 4


def test_subscribers_with_arrays_of_numpy_get_what_rospy_makes():
    for message in (image(), Float64MultiArray(data=[2.5] * LARGE)):
        datatype = numpy_msg(type(message))
        received = through_memory(message, datatype)
        again = datatype().deserialize(ordinary(message)[4:])
        assert type(received.data) is type(again.data)
        assert np.array_equal(received.data, again.data)
    published = numpy_msg(Float64MultiArray)(data=np.full(LARGE, 2.5))
    assert through_memory(published, Float64MultiArray).data == (2.5,) * LARGE


def test_messages_of_any_type_are_passed_on():
    message = rospy.AnyMsg()
    message._buff = ordinary(image())[4:]
    assert ordinary(through_memory(message, Image)) == ordinary(image())


@pytest.mark.parametrize(
    ("message", "size"),
    [
        (image(), LARGE),
        (image(LARGE - 1), 0),
        (Float64MultiArray(), 0),
        (String(), 0),
        (PAIR(left=image(LARGE), right=image(3 * LARGE), more=b"m" * LARGE), 3 * LARGE),
    ],
)
def test_the_largest_field_goes_through_memory_if_it_is_worth_a_region(message, size):
    assert len(largest_field(message)[2]) == size


def test_a_message_with_wrong_content_is_refused_as_ever():
    for wrong in (Image(height="three", data=bytes(LARGE)), Image(data=[300] * LARGE)):
        with pytest.raises(genpy.SerializationError):
            ordinary(wrong)
        with pytest.raises(genpy.SerializationError):
            Packed(wrong, 7)


@given(
    st.text(max_size=20), st.binary(max_size=600), st.binary(max_size=600), st.binary(max_size=600)
)
def test_any_content_arrives(text, left, right, more):
    message = PAIR(left=Image(data=left, encoding=text), right=Image(data=right), more=more)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(packing, "LARGE", 100)
        assert ordinary(through_memory(message)) == ordinary(message)
        assert Packed(message, 7).plain() == ordinary(message)


# The queue of one subscriber: messages that are sent at once, wait, or are dropped


class Connection:
    """rospy's side of a connection to a subscriber."""

    name = "/topic"
    transport_type = "TCPROS"
    stat_bytes = stat_num_msg = 0

    def __init__(self):
        self.socket: Any
        self.socket, self.other = socket.socketpair()
        self.done = False

    def close(self):
        if not self.done:
            self.socket.close()
            self.other.close()
            self.socket, self.done = None, True


@pytest.fixture
def connection():
    made = Connection()
    yield made
    made.close()


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
    threads = {*threading.enumerate()}
    for number in range(100):
        outbound.write_data(frame(number))
    assert {*threading.enumerate()} <= threads
    assert [read(connection) for _ in range(100)] == list(range(100))
    assert outbound.is_idle()
    assert connection.stat_num_msg == 100


@pytest.mark.parametrize("size", [3, None])
def test_what_a_slow_subscriber_does_not_take_waits_and_beyond_a_bound_the_oldest_goes(
    connection, size
):
    outbound = Outbound(connection, size, ARENA)
    for number in range(50):
        outbound.write_data(frame(number, 1 << 18))
    assert not outbound.is_idle()
    received = [read(connection)]
    while received[-1] != 49:
        received.append(read(connection))
    assert received == sorted(received)
    assert received[-3:] == [47, 48, 49]
    assert (len(received) < 50) is (size is not None)
    eventually(outbound.is_idle)


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


def test_a_subscriber_that_goes_between_two_attempts(connection, monkeypatch):
    outbound = Outbound(connection, 3, ARENA)
    write_on = outbound._write_on

    def and_close():
        awaited = write_on()
        connection.close()
        return awaited

    monkeypatch.setattr(outbound, "_write_on", and_close)
    outbound.write_data(frame(1, 10 << 20))
    eventually(lambda: not outbound._is_sending)


@pytest.mark.parametrize("greets", [False, True])
def test_only_who_greets_with_our_address_shares_also_in_pieces(connection, greets):
    outbound = Outbound(connection, 3, ARENA)
    address = ARENA.address.encode() if greets else b"\6" * len(ARENA.address)
    for piece in (address[:5], address[5:]):
        assert not outbound.shares()
        connection.other.sendall(piece)
    if greets:
        eventually(outbound.shares)
    assert (outbound.shares(), outbound.transport_type) == (
        (True, "SHMROS") if greets else (False, "TCPROS")
    )


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
    with contextlib.closing(Connection()) as second:
        both = [Outbound(each, 1, ARENA) for each in (connection, second)]
        one = share(0)
        offset = one.region.offset
        for each, outbound in zip((connection, second), both):
            greet(each, outbound)
            outbound.write_data(one)
        del one
        connection.other.sendall(b"\6")
        eventually(both[0].is_idle)
        other = ARENA.write(bytes(WINDOW))
        assert other.offset != offset
        second.other.sendall(b"\6")
        eventually(both[1].is_idle)
        assert offset in [ARENA.write(bytes(WINDOW)).offset for _ in range(2)]


def test_what_a_lost_subscriber_may_still_copy_lingers(connection):
    outbound = Outbound(connection, 1, ARENA)
    greet(connection, outbound)
    one = share(0)
    offset = one.region.offset
    outbound.write_data(one)
    connection.close()
    del one, outbound
    assert offset not in [each.offset for each in [ARENA.write(bytes(WINDOW)) for _ in range(3)]]


@examples(120)
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
    assert received == list(range(len(messages)))


def test_a_connection_made_again_owes_and_reads_nothing_of_the_one_before():
    subscriber = SimpleNamespace(data_class=Header, queue_size=1, buff_size=1, tcp_nodelay=True)
    connection = InboundTransport(Inbound("/topic", subscriber, READER), "/topic", "address")
    connection.read_buff.write(FRAME.pack(packing.ELSEWHERE, 0, 0, 0, 0, 0, 0))
    connection.protocol.owed = 2  # a message after these could not be read
    with socket.create_server(("127.0.0.1", 0)) as server:
        connection.socket = socket.create_connection(server.getsockname())
        peer, _ = server.accept()
    with peer:
        fields = {"md5sum": Header._md5sum, "type": Header._type, "callerid": "/talker"}
        rosgraph.network.write_ros_handshake_header(peer, fields)
        content = io.BytesIO()
        Header(seq=5).serialize(content)
        peer.sendall(struct.pack("<I", content.tell()) + content.getvalue())
        peer.shutdown(socket.SHUT_WR)
        connection.read_header()
        assert connection.callerid_pub == "/talker"
        assert [message.seq for message in connection.receive_once()] == [5]
        connection.close()
        assert exactly(peer, 7) + peer.recv(1) == b"address"
