# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Topics without descriptors of their own, and the limit of descriptors."""

from __future__ import annotations

import os
import resource
import socket
from typing import Iterator

import pytest
import rospy.topics
from std_msgs.msg import Header

from dyknow.errors import LimitExceeded
from dyknow.ros import descriptors


def used() -> int:
    return len(os.listdir("/proc/self/fd"))


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(rospy.topics, "Poller", rospy.topics.Poller)
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.usefixtures("limits")
def test_topics_hold_no_descriptor() -> None:
    descriptors.spare()
    before = used()
    topics = [rospy.topics._SubscriberImpl(f"/t{number}", Header) for number in range(20)]
    assert used() == before
    assert len(topics) == 20


@pytest.mark.usefixtures("limits")
def test_the_limit_is_raised_to_what_is_allowed() -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
    descriptors.spare()
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == (min(hard, descriptors.MOST), hard)


@pytest.mark.usefixtures("limits")
def test_more_work_is_refused_before_descriptors_run_out() -> None:
    descriptors.check_left()
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = used() + 20
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
    descriptors.check_left()
    with socket.socket(), socket.socket():
        resource.setrlimit(resource.RLIMIT_NOFILE, (used() + 1, hard))
        with pytest.raises(LimitExceeded, match=r"file descriptors .*ulimit -n"):
            descriptors.check_left()


def test_a_connection_whose_other_end_is_gone_is_found() -> None:
    poller = descriptors.Poller()
    here, there = socket.socketpair()
    other, stays = socket.socketpair()
    with here, other, stays:
        poller.add_fd(here.fileno())
        poller.add_fd(other.fileno())
        assert list(poller.error_iter()) == []
        there.close()
        assert list(poller.error_iter()) == [here.fileno()]
        poller.remove_fd(here.fileno())
        poller.remove_fd(here.fileno())
        assert list(poller.error_iter()) == []


def test_a_connection_that_was_closed_here_is_forgotten() -> None:
    poller = descriptors.Poller()
    here, there = socket.socketpair()
    poller.add_fd(here.fileno())
    poller.add_fd(-1)
    here.close()
    assert list(poller.error_iter()) == []
    there.close()
    assert list(poller.error_iter()) == []
