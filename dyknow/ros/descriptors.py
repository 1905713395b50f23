# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""File descriptors of this process: as many as it may have, and none that rospy need not hold.

rospy opens an epoll for each topic, to find the connections that have failed, and leaves it to the
garbage collector when the topic is gone. A nodelet manager with a thousand topics would be at the
usual limit of 1,024, and a manager to which nodes come and go would grow.
"""

from __future__ import annotations

import os
import resource
import select
from typing import Iterator, Set

import rospy.topics

from dyknow.errors import LimitExceeded

#: A process that may have more is not given more: some programs visit every possible descriptor.
MOST = 65536
#: Descriptors that have to be left for connections when a nodelet is loaded, and their largest
#: part of all that there may be.
_RESERVE = 64
_PART = 8

_FAILED = select.POLLHUP | select.POLLERR | select.POLLRDHUP


class Poller:
    """Finds failed connections of one topic, in place of ``rospy.topics.Poller``."""

    def __init__(self) -> None:
        self._descriptors: Set[int] = set()

    def add_fd(self, descriptor: int) -> None:
        """Watch a connection."""
        self._descriptors.add(descriptor)

    def remove_fd(self, descriptor: int) -> None:
        """Watch it no more."""
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
    """Refuse more work when the descriptors are about to run out.

    Raises:
        LimitExceeded: too few are left for the connections of a nodelet.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = len(os.listdir("/proc/self/fd"))
    if limit != resource.RLIM_INFINITY and used + min(_RESERVE, limit // _PART) > limit:
        raise LimitExceeded("file descriptors of the process (ulimit -n)", used, limit)
