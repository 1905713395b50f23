# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""External processes: which thread looks for them, and which calls never wait for them."""

from __future__ import annotations

import threading
import time
from typing import List

import pytest
from clocks import eventually, wait_for
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.errors import HostError, HostTimeout
from dyknow.model.graph import NodeletKind
from dyknow.ros.hosting import external
from dyknow.ros.hosting.counts import counts_of
from dyknow.ros.hosting.external import External, Externals
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.wire.master import Master

FAR = "/far"


@pytest.fixture
def graph(monkeypatch):
    monkeypatch.setattr(external, "_PERIOD", 0.05)
    with small_graph() as graph:
        yield graph


def context(graph):
    return PeerContext(Master("/test", graph.uri))


@pytest.fixture
def peer(graph):
    graph.nodes[FAR] = SmallManager()
    graph.nodes[FAR].nodelets = ["/b", "/a"]
    peer = External(context(graph), FAR)
    peer.start()
    eventually(lambda: peer.state.responsive)
    yield peer
    peer.close()


def test_no_call_waits_for_one_that_was_never_seen():
    asked, answer = threading.Event(), threading.Event()

    class SilentMaster(Master):
        def node(self, name):
            asked.set()
            answer.wait()
            return ""

    peers = Externals(PeerContext(SilentMaster("/test", "http://127.0.0.1:9")), [FAR])
    peers.start()
    wait_for(asked)
    (peer,) = peers.all()
    assert (peer.state.unseen, peer.state.away, peer.state.alive) == (True, True, False)
    with pytest.raises(HostTimeout, match="has not answered yet"):
        peer.list()
    answer.set()
    eventually(lambda: not peer.state.unseen)
    with pytest.raises(HostError, match="is not running"):
        peer.list()
    assert not peer.state.away
    peers.close()


def test_one_that_hangs_is_asked_again_by_its_thread_alone(graph, peer):
    manager, before = graph.nodes[FAR], peer.state.incarnation
    assert before == f"{manager.uri}@{manager.pid}"
    manager.goes_on.clear()
    with pytest.raises(HostTimeout):
        peer.list()
    assert (peer.state.alive, peer.state.responsive, peer.state.away) == (True, False, True)
    connections = manager.connections
    with pytest.raises(HostTimeout):
        peer.list()
    assert manager.connections == connections
    manager.goes_on.set()
    eventually(lambda: peer.state.responsive)
    assert peer.state.incarnation == before
    assert peer.list() == ["/a", "/b"]


def test_one_that_ended_is_gone_and_not_away(graph, peer):
    graph.nodes[FAR].close()
    with pytest.raises(HostError):
        peer.list()
    eventually(lambda: not peer.state.away)
    assert (peer.state.alive, peer.state.responsive) == (False, False)
    for number in range(1, 4):  # at any moment of the pause between two looks
        graph.nodes[FAR] = SmallManager()
        peer.look_now()
        assert peer.state.responsive and peer.state.alive, number
        graph.nodes.pop(FAR).close()
        eventually(lambda: not peer.state.alive)


def test_a_lost_connection_is_no_other_process(graph, peer):
    before = peer.state.incarnation
    graph.nodes[FAR].lose_connections()
    with pytest.raises(HostError):
        peer.list()
    eventually(lambda: peer.state.responsive)
    assert peer.state.incarnation == before


def test_a_successor_is_never_taken_for_its_predecessor(graph, peer):
    before = peer.state.incarnation
    elder, graph.nodes[FAR] = graph.nodes[FAR], SmallManager()
    elder.close()
    with pytest.raises(HostError):
        peer.list(before)
    eventually(lambda: peer.state.responsive)
    with pytest.raises(HostError, match="another process"):
        peer.list(before)
    assert peer.list() == []


@pytest.mark.parametrize("hangs", [False, True])
def test_one_that_lost_its_name_is_ended_once_it_can_be_reached(graph, peer, hangs):
    elder = graph.nodes[FAR]
    if hangs:
        elder.goes_on.clear()
        with pytest.raises(HostTimeout):
            peer.list()
    graph.nodes[FAR] = SmallManager()
    try:
        eventually(lambda: peer.state.responsive and not peer.list())
        assert elder.ended.is_set() <= (not hangs)
        elder.goes_on.set()
        wait_for(elder.ended)
        assert not graph.nodes[FAR].ended.is_set()
    finally:
        elder.close()


def test_another_process_at_the_same_address_is_left_alone(graph, peer):
    elder, newcomer = graph.nodes[FAR], SmallManager()
    elder.pid += 1
    graph.nodes[FAR] = newcomer
    try:
        eventually(lambda: peer.state.incarnation.startswith(newcomer.uri))
        eventually(lambda: not peer.displaced)
        assert not elder.ended.is_set()
    finally:
        elder.close()


def test_a_master_that_is_away_changes_nothing(graph, peer):
    graph.close()
    peer.look()
    assert peer.state.responsive
    assert peer.list() == ["/a", "/b"]


def test_a_nodelet_is_where_it_was_seen_last(graph, peer):
    peers = Externals(context(graph), [FAR])
    peers.start()
    eventually(lambda: peers.hosting("/a"))
    found = peers.hosting("/a")
    assert found is not None and found.name == FAR
    found.forget("/a")
    assert peers.hosting("/a") is None
    peers.close()


# Re-wirable nodes


@pytest.fixture
def nodes(graph, monkeypatch):
    monkeypatch.setattr(external, "_NODE_PATIENCE", 0.5)
    graph.nodes[FAR] = SmallManager("cpp_node")
    nodes = Externals(context(graph))
    nodes.look_for([FAR])
    yield nodes
    nodes.close()


def test_a_node_that_ended_is_gone_at_once_and_forgotten_soon(graph, nodes):
    (node,) = nodes.all()
    assert (node.state.kind, node.state.own) == (NodeletKind.CPP_NODE, False)
    assert node.answers and node.list() == [FAR] and nodes.hosting(FAR) is node
    graph.nodes[FAR].close()
    with pytest.raises(HostError):
        node.list()
    eventually(lambda: not nodes.all())
    assert nodes.find(FAR) is None and not node.may_publish
    eventually(lambda: not nodes._externals)
    eventually(lambda: not node.loop.running)
    del graph.nodes[FAR]


@pytest.mark.parametrize("hangs", [False, True])
def test_a_node_that_does_not_answer_is_there_all_along(graph, nodes, hangs):
    (node,) = nodes.all()
    before = node.state.incarnation
    if hangs:
        graph.nodes[FAR].goes_on.clear()
    else:
        graph.nodes[FAR].lose_connections()
    with pytest.raises(HostTimeout):
        node.list()
    if hangs:
        assert (node.state.alive, node.state.responsive, node.state.away) == (True, False, True)
        eventually(lambda: time.monotonic() > node._expected_until)
    assert nodes.all() == [node]
    graph.nodes[FAR].goes_on.set()
    eventually(lambda: node.answers)
    assert node.state.incarnation == before and node.list() == [FAR]


def test_counts_are_those_of_the_process_that_bears_the_name_now(graph, nodes):
    (node,) = nodes.all()

    def is_counted():
        return counts_of([(node.counts, [FAR])]) == {FAR: None}

    assert is_counted()
    elder, graph.nodes[FAR] = graph.nodes[FAR], SmallManager("node")
    elder.goes_on.clear()
    try:
        with pytest.raises(HostTimeout):
            node.list()
        eventually(lambda: node.answers)
        eventually(is_counted)
    finally:
        elder.close()


def test_a_node_that_was_announced_too_early_or_is_none_is_not_shown(graph):
    changes: List[str] = []
    graph.nodes["/manager"] = SmallManager()
    nodes = Externals(
        PeerContext(Master("/test", graph.uri), on_change=lambda: changes.append("")),
        is_child=lambda name: name == "/child",
    )
    try:
        nodes._expect([FAR, "/manager", "/child"])
        assert sorted(nodes._externals) == [FAR, "/manager"]
        graph.nodes[FAR] = SmallManager("node")
        eventually(lambda: [each.name for each in nodes.all()] == [FAR])
        eventually(lambda: changes)
    finally:
        nodes.close()
