# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A node's server lets many peers connect at once."""

from __future__ import annotations

import errno
import os
import socket
import struct
from typing import Any, Iterator

import pytest
from rospy.impl import tcpros_base

from dyknow.ros import listening

#: In the kernel's struct tcp_info: of a socket that listens this is the length of its queue.
_QUEUE_AT = 28


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[tcpros_base.TCPROSServer]:
    server = tcpros_base.TCPROSServer()
    monkeypatch.setattr(tcpros_base, "_tcpros_server", server)
    yield server
    server.shutdown()


def test_the_queue_of_the_server_is_lengthened(server: tcpros_base.TCPROSServer) -> None:
    listening.enlarge_queue()
    listener = server.tcp_ros_server.server_sock
    information = listener.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 64)
    assert struct.unpack_from("<I", information, _QUEUE_AT)[0] == listening.QUEUE


def test_the_server_outlives_a_lack_of_descriptors() -> None:
    class Exhausted:
        """A socket whose process has no descriptor left until one is closed."""

        def __init__(self) -> None:
            self.outcomes: list[Any] = []

        def accept(self) -> str:
            outcome = self.outcomes.pop(0)
            if isinstance(outcome, int):
                raise OSError(outcome, os.strerror(outcome))
            return str(outcome)

        def getsockname(self) -> str:
            return "here"

    exhausted = Exhausted()
    patient = listening.PatientSocket(exhausted)  # type: ignore[arg-type]
    assert patient.getsockname() == "here"
    exhausted.outcomes = ["a", errno.EMFILE, "b", errno.EINVAL]
    assert [patient.accept(), patient.accept()] == ["a", "b"]
    with pytest.raises(OSError, match="Invalid argument"):
        patient.accept()


def test_who_connects_when_nothing_is_left_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def accept(self) -> None:
            raise OSError(errno.EMFILE, "full")

    def refuse(*unused: object) -> int:
        raise OSError(errno.EMFILE, "full")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(socket.timeout):
        listening.PatientSocket(Full()).accept()  # type: ignore[arg-type]
