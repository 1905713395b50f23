# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Polls: which changes are asked for, and processes that answer none."""

from __future__ import annotations

import contextlib

import pytest
from clocks import PATIENCE
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.errors import HostError
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.poll_client import PollClient

NAME = "/n"
UNKNOWN_TO_ROSCPP = "received a tcpros connection for a nonexistent service [/n/poll]."


@contextlib.contextmanager
def polled(kind="", error=""):
    """A client of one process, and the process."""
    with small_graph() as graph:
        graph.nodes[NAME] = process = SmallManager(kind)
        process.nodelets, process.error = ["/b", "/a"], error
        with contextlib.closing(PollClient(Master("/test", graph.uri), NAME, bool(kind))) as each:
            yield each, process


def test_changes_are_sent_once():
    with polled() as (client, process):
        described = [len(client.ask(PATIENCE).changes.nodelets) for _ in range(3)]
    assert described == [2, 0, 0]
    assert [each.seen for each in process.requests] == [0, 1, 1]
    assert process.connections == 1


def test_a_stock_nodelet_manager_is_asked_for_its_list():
    with polled(error=UNKNOWN_TO_ROSCPP) as (client, process):
        answers = [client.ask(PATIENCE) for _ in range(2)]
    assert client.is_stock
    found = [(each.changes.kind, each.nodelets) for each in answers]
    assert found == [("cpp_nodelet", ["/a", "/b"])] * 2
    assert process.connections == 2, "the refused one, and the one that is kept"


@pytest.mark.parametrize(
    ("kind", "error"),
    [
        ("", "request from [/test]: md5sums do not match: [a] vs. [b]"),
        ("", "[/n] is not a provider of  [/n/poll]"),
        ("node", "[/n] is not a provider of  [/n/poll]"),
        ("cpp_node", UNKNOWN_TO_ROSCPP),
    ],
)
def test_a_process_of_another_version_is_named_as_such(kind, error):
    with polled(kind, error) as (client, _):
        with pytest.raises(HostError, match="another version of DyKnow: restart it"):
            client.ask(PATIENCE)
        assert not client.is_stock
