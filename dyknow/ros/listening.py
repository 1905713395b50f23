# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Lets many peers connect to this node at once, and one more when descriptors run out.

rospy's server has a queue of five connections. When a nodelet manager comes back, all subscribers
of its topics connect within milliseconds; the kernel drops the connections that do not fit into
the queue, and these are tried again after 1 s, then after 3 s.

rospy's accepting thread ends for good when the process has no file descriptor left, and every
service of the node ends with it. Then nodelets cannot even be unloaded to free descriptors.
"""

from __future__ import annotations

import errno
import logging
import os
import socket
import time
from typing import Any, Optional, Tuple

from rospy.impl.tcpros_base import init_tcpros_server

#: Connections that may wait to be accepted; no kernel's own bound is smaller.
QUEUE = 128
#: Seconds before the next attempt when no descriptor is left.
_AGAIN = 0.1

_log = logging.getLogger("rosout.dyknow")


def enlarge_queue() -> None:
    """Lengthen the queue of this node's server, starting it if need be, and keep it accepting.

    The node must be initialised. Calling ``listen`` again on a listening socket changes only its
    queue.
    """
    server = init_tcpros_server()
    server.start_server()
    listener = server.tcp_ros_server
    listener.server_sock.listen(QUEUE)
    listener.server_sock = PatientSocket(listener.server_sock)


class PatientSocket:
    """A listening socket whose ``accept`` outlives a lack of file descriptors.

    One descriptor is kept in reserve for the next connection; further connections wait until
    descriptors are free.
    """

    def __init__(self, listening: socket.socket) -> None:
        """Wrap ``listening``, and reserve a descriptor."""
        self._socket = listening
        self._spare: Optional[int] = None
        self._keep_spare()

    def accept(self) -> Tuple[socket.socket, Any]:
        """Accept a connection.

        Raises:
            socket.timeout: no descriptor is left; call it again.
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
                return  # none is left
