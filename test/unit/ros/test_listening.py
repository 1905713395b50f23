"""A node's server has room for many who connect at once."""

from __future__ import annotations

import socket
import struct
from typing import Iterator

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
    listening.make_room()
    listener = server.tcp_ros_server.server_sock
    information = listener.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 64)
    assert struct.unpack_from("<I", information, _QUEUE_AT)[0] == listening.QUEUE
