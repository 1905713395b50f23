# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A ROS graph small enough for a unit test: a master, and processes that are only polled."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import struct
import threading
from io import BytesIO
from typing import Any, Dict, List, Set
from xmlrpc.server import SimpleXMLRPCServer

import rosgraph.network
from dyknow_msgs.msg import Machine, NodeletChanges, NodeletPorts
from dyknow_msgs.srv import Poll, PollResponse
from nodelet.srv import NodeletList, NodeletListResponse

_pids = itertools.count(1000)


class XmlRpc:
    """Answers the functions of an object, in the form of ROS."""

    def __init__(self, functions):
        self._server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        for name, function in functions.items():
            self._server.register_function(_in_form(function), name)
        self.uri = f"http://127.0.0.1:{self._server.server_address[1]}/"
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()

    def close(self):
        self._server.shutdown()
        self._server.server_close()


def _in_form(function):
    def answer(*arguments):
        value = function(*arguments)
        return (1, "", value) if value is not None else (-1, "unknown", 0)

    return answer


class SmallMaster:
    """A master that looks up nodelet managers by name.

    Attributes:
        knows_manager: whether the node `/test`, the DyKnow manager, has registered.
        looked_up: the nodes that were looked up.
    """

    def __init__(self):
        self.knows_manager = True
        self.looked_up: List[str] = []
        self.nodes: Dict[str, SmallManager] = {}
        self._served = XmlRpc(
            {
                "lookupNode": self._look_up,
                "lookupService": lambda caller, name: self._service(*name.rsplit("/", 1)),
            }
        )
        self.uri = self._served.uri

    def _look_up(self, caller, name):
        self.looked_up.append(name)
        return self.uri if name == "/test" and self.knows_manager else self._of(name, "uri")

    def _service(self, name, service):
        kind = getattr(self.nodes.get(name), "kind", "")
        return self._of(name, "service") if service == ("get_config" if kind else "list") else None

    def _of(self, name, what):
        return getattr(self.nodes[name], what) if name in self.nodes else None

    def close(self):
        self._served.close()


class SmallManager:
    """Answers polls and further ``functions``, reports its process id, and ends on request.

    Attributes:
        living: all that have not been closed.
        kind: its kind if it is a re-wirable node; else empty.
        nodelets: names of its nodelets; of a node its own.
        requests: the polls that it answered.
        goes_on: cleared while the process is stopped.
        ended: set when it was requested to end.
        connections: how many clients have connected so far.
        error: sent in the header of each connection for polls; empty: there is none.
    """

    living: Set[SmallManager] = set()

    def __init__(self, kind="", nodelets=(), **functions):
        self.kind = kind
        self.nodelets: List[str] = list(nodelets)
        self.requests: List[Any] = []
        self.pid = next(_pids)
        self.goes_on = threading.Event()
        self.goes_on.set()
        self.ended = threading.Event()
        self.connections = 0
        self.error = ""
        # An address of its own: a client of an ended test may call whatever has its port now.
        host = f"127.{os.getpid() % 254 + 1}.{self.pid >> 8}.{self.pid & 255}"
        self._listener = socket.create_server((host, 0))
        where = self._listener.getsockname()
        self._node = XmlRpc(
            {
                "getPid": lambda caller: self.goes_on.wait() and self.pid,
                "shutdown": lambda caller, reason: self.ended.set() or 0,
                "requestTopic": lambda caller, topic, kinds: ["TCPROS", *where],
                **functions,
            }
        )
        self.uri = self._node.uri
        self.service = f"rosrpc://{host}:{where[1]}"
        self._open: List[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()
        self.living.add(self)

    def close(self):
        """End, as a process that is killed."""
        self.living.remove(self)
        self.goes_on.set()
        self._node.close()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.lose_connections()

    def lose_connections(self):
        while self._open:
            with contextlib.suppress(OSError):
                self._open.pop().shutdown(socket.SHUT_RDWR)

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self._open.append(connection)
                self.connections += 1
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection):
        with contextlib.suppress(OSError, struct.error), connection:
            is_poll = b"/poll" in self._read(connection)
            service = Poll if is_poll else NodeletList
            fields = {"callerid": "/small", "md5sum": service._md5sum, "type": "*"}
            if is_poll and self.error:
                fields = {"error": self.error}
            rosgraph.network.write_ros_handshake_header(connection, fields)
            while True:
                request = service._request_class().deserialize(self._read(connection))
                self.goes_on.wait()
                self.requests.append(request)
                body = BytesIO()
                listed = NodeletListResponse(self.nodelets)
                (self._response(request) if is_poll else listed).serialize(body)
                answer = body.getvalue()
                connection.sendall(b"\1" + struct.pack("<I", len(answer)) + answer)

    def _response(self, request):
        changes = NodeletChanges(str(self.pid), 1, [], self.kind or "nodelet")
        if request.seen < 1:
            changes.nodelets = [NodeletPorts(name, True, [], "", "") for name in self.nodelets]
        return PollResponse(1.0, self.nodelets, changes, [], [], Machine(), 0.0, [])

    @staticmethod
    def _read(connection):
        """Read data that begins with its length."""
        (length,) = struct.unpack("<I", connection.recv(4, socket.MSG_WAITALL))
        return connection.recv(length, socket.MSG_WAITALL) if length else b""


@contextlib.contextmanager
def small_graph():
    """A master, closed with all processes."""
    master = SmallMaster()
    try:
        yield master
    finally:
        close_all()
        master.close()


def close_all():
    for each in [*SmallManager.living]:
        each.close()
