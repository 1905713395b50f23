# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""File descriptors of this process, and the connections that it accepts.

rospy opens an epoll for each topic, and leaves it to the garbage collector when the topic is gone:
a nodelet manager with a thousand topics would be at the usual limit of 1,024.

rospy's server has a queue of five connections. When a nodelet manager comes back, all subscribers
of its topics connect within milliseconds; the kernel drops connections that do not fit, and these
are tried again after 1 s, then after 3 s. And rospy's accepting thread ends for good when the
process has no file descriptor left, and every service of the node with it: nodelets could not even
be unloaded to free descriptors. And it waits for the header of each connection: a process that is
suspended before it has sent its own would hold up all other connections.
"""

from __future__ import annotations

import errno
import logging
import os
import resource
import select
import socket
import time
from typing import Any, Callable, Iterator

import rospy.topics
from rospy.impl.tcpros_base import init_tcpros_server

from dyknow.errors import LimitExceeded
from dyknow.periodic import NO_THREAD, in_background

#: The limit is not raised further: some programs visit every possible descriptor.
MOST = 65536
#: Descriptors that have to be left for connections when a nodelet is loaded, and their largest
#: part of all that there may be.
_RESERVE = 64
_PART = 8

#: Connections that may wait to be accepted; no kernel's own bound is smaller.
QUEUE = 128
#: Seconds before the next attempt when no descriptor is left.
_AGAIN = 0.1
#: Milliseconds for which the header of a connection holds up the next connection.
_HEADER_PATIENCE = 20

Handler = Callable[[socket.socket, Any], None]

_FAILED = select.POLLHUP | select.POLLERR | select.POLLRDHUP

_log = logging.getLogger("rosout.dyknow")


class Poller:
    """Finds failed connections of one topic, in place of ``rospy.topics.Poller``."""

    def __init__(self) -> None:
        self._descriptors: set[int] = set()

    def add_fd(self, descriptor: int) -> None:
        self._descriptors.add(descriptor)

    def remove_fd(self, descriptor: int) -> None:
        self._descriptors.discard(descriptor)

    def error_iter(self) -> Iterator[int]:
        """Yield the connections whose other end is gone."""
        poll = select.poll()
        for descriptor in list(self._descriptors):
            if descriptor >= 0:
                poll.register(descriptor, _FAILED)
        for descriptor, event in poll.poll(0):
            if event & select.POLLNVAL:  # closed here
                self._descriptors.discard(descriptor)
            elif event & _FAILED:
                yield descriptor


def spare() -> None:
    """Let topics hold no descriptor from now on, and raise the soft limit to the hard one."""
    rospy.topics.Poller = Poller
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST if hard == resource.RLIM_INFINITY else min(MOST, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def check_left() -> None:
    """Raise `LimitExceeded` if too few descriptors are left for the connections of a nodelet."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = len(os.listdir("/proc/self/fd"))
    if limit != resource.RLIM_INFINITY and used + min(_RESERVE, limit // _PART) > limit:
        raise LimitExceeded("file descriptors of the process (ulimit -n)", used, limit)


def enlarge_queue() -> None:
    """Lengthen the queue of this node's server, starting it if need be, and keep it accepting."""
    server = init_tcpros_server()
    server.start_server()
    listener = server.tcp_ros_server
    listener.server_sock.listen(QUEUE)  # changes only the queue of a socket that listens
    listener.server_sock = PatientSocket(listener.server_sock)
    listener.inbound_handler = once_it_speaks(listener.inbound_handler)


def once_it_speaks(handle: Handler) -> Handler:
    """Return a handler of connections that lets no silent one hold up those after it."""

    def begin(connection: socket.socket, address: Any) -> None:
        poll = select.poll()
        poll.register(connection, select.POLLIN)

        def finish() -> None:
            poll.poll()
            handle(connection, address)

        if poll.poll(_HEADER_PATIENCE):
            handle(connection, address)
            return
        try:
            in_background("header of a connection", finish)
        except NO_THREAD:
            connection.close()

    return begin


class PatientSocket:
    """A listening socket whose ``accept`` outlives a lack of file descriptors.

    One descriptor is kept in reserve for the next connection; further connections wait until
    descriptors are free.
    """

    def __init__(self, listening: socket.socket) -> None:
        self._socket = listening
        self._spare: int | None = None
        self._keep_spare()

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection; raises ``socket.timeout`` if no descriptor is left.

        rospy's thread ends here, without a traceback, if it begins after the node has ended.
        """
        self._keep_spare()
        try:
            return self._socket.accept()
        except OSError as error:
            if self._socket.fileno() < 0:
                raise SystemExit from None
            if error.errno not in (errno.EMFILE, errno.ENFILE):
                raise
        if self._spare is None:
            time.sleep(_AGAIN)
            raise socket.timeout
        _log.error(
            "this process has no file descriptor left (ulimit -n): what connects to it has to "
            "wait, and loading nodelets fails"
        )
        os.close(self._spare)
        self._spare = None
        return self._socket.accept()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._socket, name)

    def _keep_spare(self) -> None:
        if self._spare is None:
            try:
                self._spare = os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
            except OSError:
                return  # none is left
