# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""External nodelet managers: which thread looks for them, and which never wait for them."""

from __future__ import annotations

import threading
import time
from typing import Callable, Iterator

import pytest
from unit.ros.small_graph import SmallManager, SmallMaster, small_graph

from dyknow.errors import HostError, HostTimeout
from dyknow.ros.hosting.external_managers import ExternalManager, ExternalManagers
from dyknow.ros.master import Master

LONG = 30.0
FAR = "/far"


@pytest.fixture
def graph() -> Iterator[SmallMaster]:
    with small_graph() as graph:
        yield graph


def eventually(condition: Callable[[], object]) -> None:
    end = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def peer(graph: SmallMaster) -> Iterator[ExternalManager]:
    graph.nodes[FAR] = SmallManager()
    graph.nodes[FAR].nodelets = ["/b", "/a"]
    peer = ExternalManager(Master("/test", graph.uri), FAR)
    eventually(lambda: peer.state.responsive)
    yield peer
    peer.close()


def test_nobody_waits_for_one_that_was_never_seen() -> None:
    asked, answer = threading.Event(), threading.Event()

    class SilentMaster(Master):
        def node(self, name: str) -> str:
            asked.set()
            answer.wait()
            return ""

    peers = ExternalManagers(SilentMaster("/test", "http://127.0.0.1:9"), [FAR])
    assert asked.wait(LONG)
    (peer,) = peers.all()
    assert (peer.state.unseen, peer.state.away, peer.state.alive) == (True, True, False)
    with pytest.raises(HostTimeout, match="has not answered yet"):
        peer.list()
    answer.set()
    eventually(lambda: not peer.state.unseen)
    assert not peer.state.away
    with pytest.raises(HostError, match="is not running"):
        peer.list()
    peers.close()


def test_one_that_answers_is_asked_for_its_nodelets(
    graph: SmallMaster, peer: ExternalManager
) -> None:
    assert peer.list() == ["/a", "/b"]
    state = peer.state
    assert (state.alive, state.responsive, state.away, state.own) == (True, True, False, False)
    assert state.incarnation == f"{graph.nodes[FAR].uri}@{graph.nodes[FAR].pid}"


def test_one_that_hangs_is_asked_by_nobody_until_it_is_back(
    graph: SmallMaster, peer: ExternalManager
) -> None:
    manager, before = graph.nodes[FAR], peer.state.incarnation
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


def test_one_that_ended_is_gone_and_not_away(graph: SmallMaster, peer: ExternalManager) -> None:
    graph.nodes[FAR].close()
    with pytest.raises(HostError):
        peer.list()
    eventually(lambda: not peer.state.away)
    assert (peer.state.alive, peer.state.responsive) == (False, False)
    graph.nodes[FAR] = SmallManager()
    eventually(lambda: peer.state.responsive)


def test_a_lost_connection_is_no_other_process(graph: SmallMaster, peer: ExternalManager) -> None:
    before = peer.state.incarnation
    graph.nodes[FAR].lose_connections()
    with pytest.raises(HostError):
        peer.list()
    eventually(lambda: peer.state.responsive)
    assert peer.state.incarnation == before


def test_a_successor_is_never_taken_for_its_predecessor(
    graph: SmallMaster, peer: ExternalManager
) -> None:
    before = peer.state.incarnation
    elder, graph.nodes[FAR] = graph.nodes[FAR], SmallManager()
    elder.close()
    with pytest.raises(HostError):
        peer.list(before)
    eventually(lambda: peer.state.responsive)
    with pytest.raises(HostError, match="another process"):
        peer.list(before)
    assert peer.list() == []


def test_who_lost_its_name_is_told_to_end(graph: SmallMaster, peer: ExternalManager) -> None:
    elder, graph.nodes[FAR] = graph.nodes[FAR], SmallManager()
    try:
        assert elder.ended.wait(LONG)
        assert peer.list() == []
        assert not graph.nodes[FAR].ended.is_set()
    finally:
        elder.close()


def test_who_lost_its_name_while_it_hung_is_told_when_it_goes_on(
    graph: SmallMaster, peer: ExternalManager
) -> None:
    elder = graph.nodes[FAR]
    elder.goes_on.clear()
    with pytest.raises(HostTimeout):
        peer.list()
    graph.nodes[FAR] = SmallManager()
    try:
        eventually(lambda: peer.state.responsive)
        assert peer.list() == []
        assert not elder.ended.is_set()
        elder.goes_on.set()
        assert elder.ended.wait(LONG)
    finally:
        elder.close()


def test_another_process_at_the_same_address_is_left_alone(
    graph: SmallMaster, peer: ExternalManager
) -> None:
    elder, newcomer = graph.nodes[FAR], SmallManager()
    elder.pid += 1
    graph.nodes[FAR] = newcomer
    try:
        eventually(lambda: peer.state.incarnation.startswith(newcomer.uri))
        eventually(lambda: not peer.displaced)
        assert not elder.ended.is_set()
    finally:
        elder.close()


def test_a_master_that_is_away_changes_nothing(graph: SmallMaster, peer: ExternalManager) -> None:
    graph.close()
    assert peer.list() == ["/a", "/b"]
    peer.look()
    assert peer.state.responsive
    assert peer.list() == ["/a", "/b"]


def test_a_nodelet_is_where_it_was_seen_last(graph: SmallMaster, peer: ExternalManager) -> None:
    peer.list()
    peers = ExternalManagers(Master("/test", graph.uri), [FAR])
    eventually(lambda: peers.hosting("/a"))
    found = peers.hosting("/a")
    assert found is not None
    assert found.name == FAR
    found.forget("/a")
    assert peers.hosting("/a") is None
    peers.close()


def test_one_that_has_just_come_is_found_by_who_names_it(graph: SmallMaster) -> None:
    peer = ExternalManager(Master("/test", graph.uri), FAR)
    try:
        eventually(lambda: not peer.state.unseen)
        assert not peer.state.alive
        for number in range(1, 6):  # at any moment of the pause between two looks
            graph.nodes[FAR] = SmallManager()
            peer.look_now()
            assert peer.state.responsive and peer.state.alive, number
            graph.nodes.pop(FAR).close()
            eventually(lambda: not peer.state.alive)
    finally:
        peer.close()
