# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Room for many who connect to this node at once, and for one when there is no room any more.

rospy's server has a queue of five connections. When a nodelet manager comes back, all who
subscribed to its topics connect within milliseconds; the kernel drops those that the queue has no
room for, and they try again after 1 s, then after 3 s.

The thread of rospy that accepts connections ends for good when the process has no file descriptor
left, and with it every service of the node. Then nodelets cannot even be unloaded, which would
help.
"""

from __future__ import annotations

import errno
import logging
import os
import socket
import time
from typing import Any, Optional, Tuple

from rospy.impl.tcpros_base import init_tcpros_server

#: Connections that may wait to be accepted; the kernel's own bound is at least that everywhere.
QUEUE = 128
#: Seconds until the next attempt when there is no descriptor left.
_AGAIN = 0.1

_log = logging.getLogger("rosout.dyknow")


def enlarge_queue() -> None:
    """Lengthen the queue of this node's server, which is started if need be, and keep it going.

    The node must be initialised. To listen again on a socket that listens changes its queue and
    nothing else.
    """
    server = init_tcpros_server()
    server.start_server()
    listener = server.tcp_ros_server
    listener.server_sock.listen(QUEUE)
    listener.server_sock = PatientSocket(listener.server_sock)


class PatientSocket:
    """A listening socket whose ``accept`` outlives a lack of file descriptors.

    One descriptor is kept for whoever connects next then; further ones wait until others are free.
    """

    def __init__(self, listening: socket.socket) -> None:
        """Take the place of ``listening``."""
        self._socket = listening
        self._spare: Optional[int] = None
        self._keep_spare()

    def accept(self) -> Tuple[socket.socket, Any]:
        """Accept a connection.

        Raises:
            socket.timeout: there is no descriptor left; to be called again.
        """
        self._keep_spare()
        try:
            return self._socket.accept()
        except OSError as error:
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
                return  # there is none
