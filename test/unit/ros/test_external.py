# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""External processes: the search for them, calls that never wait for them, and their leases."""

from __future__ import annotations

import contextlib
import threading
import time
from types import SimpleNamespace
from typing import Any, List
from unittest import mock

import pytest
from clocks import PATIENCE, HandClock, eventually, wait_for
from dyknow_msgs.msg import NodeletChanges, NodeletPorts, Port
from unit.ros.small_graph import SmallManager, small_graph

from dyknow.errors import HostError, HostTimeout
from dyknow.guards import NO_GUARDS, Guards
from dyknow.manager.host import Reported
from dyknow.model.graph import NodeletKind, PortState
from dyknow.nodelet.leases import DURATION
from dyknow.periodic import LONGEST_TICK, RunningClock
from dyknow.ros.hosting import external
from dyknow.ros.hosting.external import External, Externals
from dyknow.ros.hosting.grants import PARTING, YOUTH, Lease, PeerContext
from dyknow.ros.hosting.host import RosHost
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.messages import guards_message

FAR = "/far"


@pytest.fixture
def graph(monkeypatch):
    monkeypatch.setattr(external, "_NAME_PERIOD", 0.05)
    with small_graph() as graph:
        yield graph


def context(graph):
    return PeerContext(Master("/test", graph.uri))


@pytest.fixture
def peer(graph):
    graph.nodes[FAR] = SmallManager(nodelets=["/b", "/a"])
    peer = External(context(graph), FAR)
    peer.wake()
    eventually(lambda: peer.state.responsive)
    yield peer
    peer.close()


def test_no_call_waits_for_one_that_was_never_seen():
    asked, answer = threading.Event(), threading.Event()

    class SilentMaster(Master):
        def node(self, name):
            asked.set()
            answer.wait()
            return "" if name == FAR else self.uri

    peers = Externals(PeerContext(SilentMaster("/test", "http://127.0.0.1:9")), [FAR])
    peers.start()
    wait_for(asked)
    (peer,) = peers.all()
    assert (peer.state.unseen, peer.state.away, peer.state.alive) == (True, True, False)
    with pytest.raises(HostTimeout, match="has not answered yet"):
        peer.nodelets()
    answer.set()
    eventually(lambda: not peer.state.unseen)
    with pytest.raises(HostError, match="is not running"):
        peer.nodelets()
    assert not peer.state.away
    peers.close()


def test_those_with_nodelets_of_an_earlier_life_are_used_unless_they_are_gone(graph):
    graph.nodes.update({FAR: SmallManager(), "/gone": SmallManager()})
    graph.nodes["/gone"].close()  # it stays registered
    externals = Externals(context(graph), ["/named"], lambda name: name == "/child")
    externals.use([FAR, "/gone", "/never_was", "/child", "/named"])
    assert [each.name for each in externals.all()] == [FAR, "/named"]
    assert externals.find(FAR).state.responsive
    assert not externals.find(FAR).is_foreign
    externals.close()


def test_late_nodelets_are_unloaded_though_the_unload_of_one_takes_long(graph, monkeypatch):
    graph.nodes[FAR] = SmallManager(nodelets=["/a", "/b", "/c"])
    children: Any = SimpleNamespace(find=lambda name: None, all=list)
    host = RosHost(context(graph), children, mock.Mock(), [FAR])
    tries = []

    def unload(manager, name):
        tries.append(name)
        if len(tries) == 1:
            raise HostTimeout(f"{name} is not unloaded yet")
        graph.nodes[FAR].nodelets.remove(name)

    monkeypatch.setattr(host, "unload", unload)
    host.start()
    eventually(lambda: host.states()[FAR].responsive)
    host._external.find(FAR).late.update(["/a", "/b"])
    with pytest.raises(HostTimeout):
        host.list(FAR)
    assert host.list(FAR) == ["/c"]
    host.close()


def test_one_of_an_earlier_life_is_forgotten_when_a_slow_master_says_that_it_is_gone(
    graph, monkeypatch
):
    monkeypatch.setattr(external, "_PATIENCE", 0.0)
    monkeypatch.setattr(External.look_now, "__defaults__", (0.05,))
    answer = threading.Event()

    class SlowMaster(Master):
        def node(self, name):
            answer.wait()
            return super().node(name)

    externals = Externals(PeerContext(SlowMaster("/test", graph.uri)))
    externals.use([FAR])
    (kept,) = externals.all()
    assert kept.state.unseen
    answer.set()
    eventually(lambda: externals.all() == [])
    externals.close()


def test_one_that_hangs_is_asked_again_by_its_thread_alone(graph, peer):
    manager, before = graph.nodes[FAR], peer.state.incarnation
    assert before == f"{manager.uri}@{manager.pid}"
    manager.goes_on.clear()
    with pytest.raises(HostTimeout):
        peer.nodelets()
    assert (peer.state.alive, peer.state.responsive, peer.state.away) == (True, False, True)
    connections = manager.connections
    with pytest.raises(HostTimeout):
        peer.nodelets()
    assert manager.connections == connections
    manager.goes_on.set()
    eventually(lambda: peer.state.responsive)
    assert peer.state.incarnation == before
    assert sorted(peer.nodelets()) == ["/a", "/b"]


def test_one_that_ended_is_gone_and_not_away(graph, peer):
    graph.nodes[FAR].close()
    with pytest.raises(HostError):
        peer.nodelets()
    eventually(lambda: not peer.state.away)
    assert (peer.state.alive, peer.state.responsive) == (False, False)
    for number in range(1, 4):  # at any moment of the pause between two looks
        graph.nodes[FAR] = SmallManager()
        peer.look_now()
        assert peer.state.responsive and peer.state.alive, number
        graph.nodes.pop(FAR).close()
        eventually(lambda: not peer.state.alive)


def test_a_successor_is_never_taken_for_its_predecessor(graph, peer):
    before = peer.state.incarnation
    elder, graph.nodes[FAR] = graph.nodes[FAR], SmallManager()
    elder.close()
    with pytest.raises(HostError):
        peer.nodelets(incarnation=before)
    eventually(lambda: peer.state.responsive)
    with pytest.raises(HostError, match="another process"):
        peer.nodelets(incarnation=before)
    assert peer.nodelets() == {}


def test_a_new_master_says_nothing_of_it(graph, peer):
    """The manager is not registered either: both will be again."""
    before, manager = peer.state.incarnation, graph.nodes.pop(FAR)
    graph.knows_manager = False
    del graph.looked_up[:]
    eventually(lambda: graph.looked_up.count(FAR) > 3)
    assert (peer.state.responsive, peer.state.incarnation) == (True, before)
    graph.nodes[FAR] = manager
    graph.knows_manager = True
    manager.lose_connections()
    eventually(lambda: sorted(peer.presence.nodelets) == ["/a", "/b"] and peer.state.responsive)
    assert peer.state.incarnation == before


@pytest.mark.parametrize("hangs", [False, True])
def test_one_that_lost_its_name_is_ended_once_it_can_be_reached(graph, peer, hangs):
    elder = graph.nodes[FAR]
    if hangs:
        elder.goes_on.clear()
        with pytest.raises(HostTimeout):
            peer.nodelets()
    graph.nodes[FAR] = SmallManager()
    eventually(lambda: peer.state.responsive and not peer.nodelets())
    assert elder.ended.is_set() <= (not hangs)
    elder.goes_on.set()
    wait_for(elder.ended)
    assert not graph.nodes[FAR].ended.is_set()


def test_another_process_at_the_same_address_is_left_alone(graph, peer):
    elder, newcomer = graph.nodes[FAR], SmallManager()
    elder.pid += 1
    graph.nodes[FAR] = newcomer
    eventually(lambda: peer.state.incarnation.startswith(newcomer.uri))
    eventually(lambda: not peer.displaced)
    assert not elder.ended.is_set()


def test_polls_renew_a_lease_that_was_granted_with_the_clock_of_the_last_answer(graph, peer):
    requests = graph.nodes[FAR].requests
    peer.nodelets()
    assert {each.duration for each in requests} == {0.0}
    peer.context.producers = {"/topic": "/a"}
    peer.lease.grant()
    peer.wake()
    eventually(lambda: len([each for each in requests if each.duration]) > 2)
    assert (requests[-1].topics, requests[-1].nodelets) == (["/topic"], ["/a"])
    granted = {(each.confirmed, each.duration) for each in requests if each.duration}
    assert granted == {(1.0, DURATION)}
    peer.lease.part()
    peer.wait(peer.wake(), time.monotonic() + PATIENCE)
    assert (requests[-1].topics, requests[-1].duration) == (["/topic"], PARTING)
    peer.release()
    assert (requests[-1].topics, requests[-1].duration) == ([], PARTING)


def test_guards_are_handed_over_once_and_when_they_change(graph, peer):
    manager, context = graph.nodes[FAR], peer.context
    context.guards = Guards(denied_topics=("/e_stop",), read_only=True)
    context.protected = {FAR: ["/b", "/a"], "/other": ["/c"]}

    def received():  # other requests come in between
        return [guards for request in manager.requests for guards in request.guards]

    peer.hand_over_guards()
    handed, before = guards_message(context.guards, ["/a", "/b"]), len(received()) - 1
    for _ in range(2):
        peer.hand_over_guards()
        peer.nodelets()
        assert received()[before:] == [handed]
    manager.lose_connections()  # perhaps to another process
    eventually(lambda: peer.state.responsive and received()[before:] == [handed, handed])
    context.protected = {}
    peer.hand_over_guards()
    assert received()[-1].protected_nodelets == []
    peer.release()
    assert received()[-1] == guards_message(NO_GUARDS)


def test_an_older_answer_never_replaces_a_newer_announcement(graph, peer):
    """Nor do announcements of another process of that name."""
    process = peer.presence.process
    assert peer.presence.nodelets == {"/a": Reported(sequence=1), "/b": Reported(sequence=1)}
    port = Port("in", Port.IN, "std_msgs/Header", "/t", [], 0.0, 0.0)
    for sequence, of, ports, expected in (
        (3, process, [port], Reported((PortState("in", "in", "std_msgs/Header", "/t"),), "", 3)),
        (2, process, [], None),
        (4, "another", [], None),
        (4, process, [], Reported(sequence=4)),
    ):
        before = peer.presence.nodelets["/a"]
        changes = [
            NodeletPorts(name, True, has, "", "") for name, has in (("/a", ports), ("/new", []))
        ]
        peer.hear(NodeletChanges(of, sequence, changes, "nodelet"))
        assert peer.presence.nodelets["/a"] == (expected or before)
        assert set(peer.nodelets()) == {"/a", "/b"}
    assert peer.presence.nodelets["/a"].sequence == 4


# Re-wirable nodes


@pytest.fixture
def nodes(graph, monkeypatch):
    monkeypatch.setattr(external, "_PATIENCE", 0.5)
    graph.nodes[FAR] = SmallManager("cpp_node", [FAR])
    nodes = Externals(context(graph))
    nodes.look_for([FAR])
    yield nodes
    nodes.close()


def test_a_node_that_ended_is_gone_at_once_and_forgotten_soon(graph, nodes):
    (node,) = nodes.all()
    assert (node.state.kind, node.state.own) == (NodeletKind.CPP_NODE, False)
    assert node.state.responsive and list(node.nodelets()) == [FAR]
    graph.nodes[FAR].close()
    with pytest.raises(HostError):
        node.nodelets()
    eventually(lambda: not nodes.all())
    assert nodes.find(FAR) is None and not node.may_publish
    eventually(lambda: not nodes._externals)
    eventually(lambda: not node.loop.running)


def test_an_announcement_beats_the_end_of_looking_for_a_node(nodes):
    """Its loop has just seen that it looked for long enough; it is not announced again."""
    (node,) = nodes.all()
    node._expected_until = 0.0
    (announced,) = nodes._expect([FAR])
    node._on_gone(node)
    assert announced is node and node.loop.running and nodes.all() == [node]


def test_a_node_that_was_forgotten_does_not_take_its_successor_along(nodes):
    (node,) = nodes.all()
    nodes._drop(node)
    (successor,) = nodes._expect([FAR])
    node._expected_until = 0.0
    node._on_gone(node)
    assert nodes._externals == {FAR: successor}


@pytest.mark.parametrize("hangs", [False, True])
def test_a_node_that_does_not_answer_is_there_all_along(graph, nodes, hangs):
    (node,) = nodes.all()
    before = node.state.incarnation
    graph.nodes[FAR].goes_on.clear()  # no poll makes a lost connection again meanwhile
    if not hangs:
        graph.nodes[FAR].lose_connections()
    with pytest.raises(HostTimeout):
        node.nodelets()
    if hangs:
        assert (node.state.alive, node.state.responsive, node.state.away) == (True, False, True)
        eventually(lambda: time.monotonic() > node._expected_until)
    assert nodes.all() == [node]
    graph.nodes[FAR].goes_on.set()
    eventually(lambda: node.state.responsive)
    assert node.state.incarnation == before and list(node.nodelets()) == [FAR]


def test_counts_are_those_of_the_process_that_bears_the_name_now(graph, nodes):
    (node,) = nodes.all()

    def is_counted():
        deadline = time.monotonic() + PATIENCE
        return node.counts(node.ask_counts([FAR]), [FAR], deadline) == {FAR: None}

    assert is_counted()
    graph.nodes[FAR].goes_on.clear()
    with pytest.raises(HostTimeout):
        node.nodelets()
    graph.nodes[FAR] = SmallManager("node", [FAR])
    eventually(lambda: node.state.responsive)
    eventually(is_counted)


def test_a_node_that_was_announced_too_early_or_is_none_is_not_shown(graph):
    changes: List[str] = []
    graph.nodes["/manager"] = SmallManager()
    context = PeerContext(Master("/test", graph.uri), on_change=lambda: changes.append(""))
    with contextlib.closing(Externals(context, is_child=lambda name: name == "/child")) as nodes:
        nodes._expect([FAR, "/manager", "/child"])
        assert sorted(nodes._externals) == [FAR, "/manager"]
        graph.nodes[FAR] = SmallManager("node")
        eventually(lambda: [each.name for each in nodes.all()] == [FAR])
        eventually(lambda: changes)


# Leases, by the time for which the manager has run


def lease(clock):
    context = PeerContext(Master("/manager"), running=clock, producers={"/topic": "/camera"})
    return Lease(context)


def test_a_renewal_confirms_the_last_answer_of_the_same_process():
    kept = lease(HandClock())
    kept.note_clock(5.0)
    assert kept.renewal() == {}
    kept.grant()
    kept.answered(6.0)
    assert kept.renewal()["confirmed"] == 6.0
    assert kept.renewal()["duration"] == DURATION
    kept.part()
    assert kept.renewal()["duration"] == PARTING
    kept.note_clock(0.0)  # of another process
    assert kept.renewal()["confirmed"] == 0.0


def test_a_lease_is_out_when_it_was_not_answered_for_its_duration():
    """One may be held that an earlier life of the manager granted."""
    clock = HandClock()
    kept = lease(clock)
    assert kept.may_be_held
    clock.time = YOUTH
    assert not kept.may_be_held and kept.has_just_run_out()
    kept.grant()
    clock.time += DURATION - 0.1
    assert kept.may_be_held and not kept.has_just_run_out()
    clock.time += 0.2
    assert not kept.may_be_held
    assert [kept.has_just_run_out() for _ in range(2)] == [True, False]


def test_a_pause_of_the_manager_does_not_count():
    steady = HandClock()
    running = RunningClock(steady)
    for _ in range(10):
        steady.time += 0.1
        running()
    steady.time += 10.0  # it was stopped
    assert running() == pytest.approx(1.0 + LONGEST_TICK)
