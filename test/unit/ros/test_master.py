# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Questions to a ROS master, with a real one."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

import psutil
import pytest
import rosmaster.master
from unit.ros.small_graph import stop_master

from dyknow.errors import PeerTimeout
from dyknow.ros.wire import master as module
from dyknow.ros.wire.master import Master

URI = "http://localhost:9/"


@pytest.fixture
def uri(monkeypatch):
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    started = rosmaster.master.Master(port=0)
    started.start()
    yield started.uri
    stop_master(started)


def test_the_master_forgets_a_node_that_is_purged(uri):
    """Else it would tell whoever has that address by then to end, as soon as the name is back."""
    dead = Master("/dead", uri)
    dead.ask("registerPublisher", "/topic", "std_msgs/Empty", URI)
    dead.ask("registerSubscriber", "/topic", "std_msgs/Empty", URI)
    dead.ask("registerService", "/dead/service", "rosrpc://localhost:9", URI)
    dead.ask("subscribeParam", URI, "/rosout_disable_topics_generation")
    asking = Master("/asking", uri)
    assert asking.node("/dead") == URI
    asking.purge("/dead", URI)
    assert asking.node("/dead") == ""


def test_a_successor_stays(uri):
    Master("/dead", uri).ask("registerPublisher", "/topic", "std_msgs/Empty", URI)
    other = "http://localhost:10/"
    Master("/dead", uri).ask("registerPublisher", "/topic", "std_msgs/Empty", other)
    asking = Master("/asking", uri)
    asking.purge("/dead", URI)
    assert asking.node("/dead") == other
    assert asking.publishers("/topic") == {"/dead"}


def test_a_topic_has_a_type_while_somebody_publishes_it(uri):
    node = Master("/node", uri)
    node.ask("registerPublisher", "/space/topic", "std_msgs/Empty", URI)
    node.ask("registerPublisher", "/top", "std_msgs/Header", URI)
    assert node.datatype("/space/topic") == "std_msgs/Empty"
    assert node.datatype("/top") == "std_msgs/Header"
    assert node.datatype("/space/other") == ""
    node.ask("unregisterPublisher", "/space/topic", URI)
    assert node.datatype("/space/topic") == ""


def test_many_questions_at_a_time_leave_two_connections(uri, monkeypatch):
    """Each would keep a descriptor here, and a thread of the master, for good."""
    count = 8
    together = threading.Barrier(count)
    connect = module._Connection.connect

    def connect_together(self):
        together.wait(20.0)
        connect(self)

    monkeypatch.setattr(module._Connection, "connect", connect_together)
    node = Master("/node", uri)
    with ThreadPoolExecutor(count) as pool:
        assert [*pool.map(node.node, ["/none"] * count)] == [""] * count
    port = urlsplit(uri).port
    connections = psutil.Process().connections("tcp")
    kept = [each for each in connections if each.raddr and each.raddr.port == port]
    assert 0 < len(kept) <= 2


def test_many_questions_are_one_request(uri):
    asking = Master("/asking", uri)
    asking.ask("setParam", "/a", 1)
    questions = [("getParam", "/asking", name) for name in ("/a", "/b", "")]
    assert asking.ask_all([*questions, ("nothing",)]) == [1, None, None, None]
    assert asking.ask_all([]) == []


def test_a_master_that_does_not_know_the_caller_is_new(uri):
    """What it lacks, it lacks for a moment."""
    Master("/node", uri).ask("registerPublisher", "/topic", "std_msgs/Empty", URI)
    asking = Master("/asking", uri)
    with pytest.raises(PeerTimeout, match="new"):
        asking.publications()
    with pytest.raises(PeerTimeout, match="new"):
        asking.bearer("/unknown")
    assert asking.bearer("/node") == URI
    asking.ask("registerPublisher", "/rosout", "rosgraph_msgs/Log", "http://localhost:10/")
    assert asking.publications() == {"/topic": ["/node"], "/rosout": ["/asking"]}
    assert asking.bearer("/unknown") == ""


def test_an_answer_like_the_one_before_is_not_parsed(uri):
    asking = Master("/asking", uri, compares=True)
    question = [("getParam", "/asking", "/")]
    asking.ask("setParam", "/words", ["long " * 1000])
    asking.ask_all(question)
    first, second = (asking.ask_all(question)[0] for _ in range(2))
    assert first is second and first == {"words": ["long " * 1000]}
    Master("/other", uri).ask("setParam", "/words", ["short"])
    assert asking.ask_all(question) == [{"words": ["short"]}]
