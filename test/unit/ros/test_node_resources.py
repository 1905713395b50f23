# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Resources of a node: descriptors of topics, their limit, connections at once, and memory."""

from __future__ import annotations

import errno
import os
import re
import resource
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import pytest
import rosgraph.network
import rospy.topics
from clocks import PATIENCE, eventually, patch_here
from rospy.impl import paramserver, tcpros_base
from std_msgs.msg import Header

from dyknow.errors import CannotRun, LimitExceeded
from dyknow.names import LOG_PARAMETER
from dyknow.ros.process import descriptors
from dyknow.ros.process.node_process import init_node, log_without_the_master

#: In the kernel's struct tcp_info: of a socket that listens this is the length of its queue.
_QUEUE_AT = 28


def test_a_log_that_cannot_be_written_is_named_with_the_cure(monkeypatch):
    def fail(*args, **options):
        raise PermissionError(errno.EACCES, "Permission denied", "/logs/m.log")

    patch_here(monkeypatch, rospy, "init_node", fail)
    told = "the log cannot be written: Permission denied: '/logs/m.log'; set ROS_LOG_DIR to"
    with pytest.raises(CannotRun, match=told):
        init_node("m")


def used():
    return len(os.listdir("/proc/self/fd"))


@pytest.fixture
def limits(monkeypatch):
    monkeypatch.setattr(rospy.topics, "Poller", rospy.topics.Poller)
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.usefixtures("limits")
def test_topics_hold_no_descriptor_and_the_limit_is_raised():
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
    descriptors.spare()
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == (min(hard, descriptors.MOST), hard)
    before = used()
    topics = [rospy.topics._SubscriberImpl(f"/t{number}", Header) for number in range(20)]
    assert used() < before + len(topics)  # threads of earlier tests may still close theirs


@pytest.mark.usefixtures("limits")
def test_more_work_is_refused_before_descriptors_run_out():
    descriptors.check_left()
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (used() + 20, hard))
    descriptors.check_left()

    def refusal():
        with socket.socket(), socket.socket():
            resource.setrlimit(resource.RLIMIT_NOFILE, (used() + 1, hard))
            try:
                descriptors.check_left()
            except LimitExceeded as refused:
                return str(refused)
        return ""  # a thread of an earlier test has closed some

    eventually(lambda: re.search(r"file descriptors .*ulimit -n", refusal()))


def test_a_connection_whose_other_end_is_gone_is_found():
    poller = descriptors.Poller()
    here, there = socket.socketpair()
    other, stays = socket.socketpair()
    with here, other, stays:
        for descriptor in (here.fileno(), other.fileno(), -1):
            poller.add_fd(descriptor)
        assert list(poller.error_iter()) == []
        there.close()
        assert list(poller.error_iter()) == [here.fileno()]
        poller.remove_fd(here.fileno())
        poller.remove_fd(here.fileno())
        other.close()  # closed here: it is forgotten
        assert list(poller.error_iter()) == []


@pytest.fixture
def server(monkeypatch):
    server = tcpros_base.TCPROSServer()
    monkeypatch.setattr(tcpros_base, "_tcpros_server", server)
    yield server
    address = server.tcp_ros_server.server_sock.getsockname()
    server.shutdown()
    with suppress(OSError):  # its thread accepts until something comes
        socket.create_connection(address, PATIENCE).close()


def test_the_queue_of_the_server_is_lengthened(server):
    descriptors.enlarge_queue()
    listener = server.tcp_ros_server.server_sock
    information = listener.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 64)
    assert struct.unpack_from("<I", information, _QUEUE_AT)[0] == descriptors.QUEUE


def test_a_connection_that_sends_nothing_holds_up_no_other_one(server):
    """Such is that of a process which is suspended before it has sent its header."""
    descriptors.enlarge_queue()
    address = ("127.0.0.1", server.tcp_ros_server.port)
    connections = [socket.create_connection(address, PATIENCE) for _ in range(3)]
    for each in reversed(connections):
        with each:
            rosgraph.network.write_ros_handshake_header(each, {"neither": "topic nor service"})
            assert each.recv(4), "the answer"


class Exhausted:
    """A socket whose process has no descriptor left, as often as its outcomes say."""

    def __init__(self, *outcomes):
        self.outcomes = list(outcomes)

    def accept(self):
        outcome = self.outcomes.pop(0)
        if isinstance(outcome, int):
            raise OSError(outcome, os.strerror(outcome))
        return str(outcome)

    def getsockname(self):
        return "here"

    def fileno(self):
        return 100


def test_the_server_outlives_a_lack_of_descriptors(monkeypatch):
    exhausted: Any = Exhausted("a", errno.EMFILE, "b", errno.EINVAL, errno.EMFILE)
    patient = descriptors.PatientSocket(exhausted)
    assert patient.getsockname() == "here"
    assert [patient.accept(), patient.accept()] == ["a", "b"]
    with pytest.raises(OSError, match="Invalid argument"):
        patient.accept()

    def refuse(*unused):
        raise OSError(errno.EMFILE, "full")

    patch_here(monkeypatch, os, "open", refuse)
    with pytest.raises(socket.timeout):  # without a spare one the peer waits
        descriptors.PatientSocket(exhausted).accept()


@pytest.mark.parametrize("is_away", [False, True])
def test_the_log_asks_for_its_parameter_once(monkeypatch, is_away):
    asked = []

    def subscribe(*question):
        asked.append(question[-1])
        if is_away:
            raise ConnectionRefusedError
        return 1, "", {}

    master = rospy.msproxy.MasterProxy("http://localhost:9")
    master.target = SimpleNamespace(subscribeParam=subscribe)
    cache = paramserver.ParamServerCache()
    monkeypatch.setattr(rospy.client, "_param_server", master)
    monkeypatch.setattr(paramserver, "_param_server_cache", cache)
    log_without_the_master()
    for value in (False, True):
        cache.update(LOG_PARAMETER, value)  # as the master tells it
        assert rospy.get_param_cached(LOG_PARAMETER, False) is value
    assert asked == [LOG_PARAMETER]


def test_a_server_that_begins_after_its_end_has_no_traceback():
    made = tcpros_base.TCPServer(lambda *connection: None)
    made.server_sock = descriptors.PatientSocket(made.server_sock)
    made.shutdown()
    with pytest.raises(SystemExit):  # which ends a thread in silence
        made.run()


CODE = """
import threading
from dyknow.nodelet.loading.memory import return_free_memory
from dyknow.ros.process.node_process import NodeProcess

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096

def work():
    for _ in range(3):
        block = b"x" * 20_000_000
        together.wait()

NodeProcess("test", ["test"], lambda: None)
before = resident()
together = threading.Barrier(4)
threads = [threading.Thread(target=work) for _ in range(4)]
for each in threads:
    each.start()
for each in threads:
    each.join()
return_free_memory()
print(resident() - before)
"""


def printed_by(code):
    """The numbers that code prints in a process of its own."""
    command = [sys.executable, "-c", code]
    return [*map(int, subprocess.check_output(command, timeout=120).split())]


def test_nothing_stays_with_the_process():
    (more,) = printed_by(CODE)
    assert more < 10_000_000


STARTED = """
import gc
import rospy
from dyknow.ros.process import node_process

rospy.init_node = lambda *words, **options: None
node_process.log_without_the_master = lambda: None
start = lambda: print(gc.get_freeze_count(), len(gc.get_objects()))
node_process.NodeProcess("test", ["test"], start).run()
"""


def test_collections_of_garbage_spare_what_was_imported():
    spared, others = printed_by(STARTED)
    assert spared > 10_000 > 10 * others
