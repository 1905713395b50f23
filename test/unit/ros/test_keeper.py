# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A new ROS master gets back what the last one had, of the nodes that live; with real masters."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import stat
import threading
from typing import Any, Dict, List, Tuple
from xmlrpc.client import Binary

import pytest
import rosmaster.master
from clocks import PATIENCE, HandClock
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples
from rosmaster.master_api import ROSMasterHandler
from unit.ros.small_graph import SmallManager, XmlRpc, stop_master

from dyknow.ros.manager import keeper as keeper_module
from dyknow.ros.manager.keeper import MasterKeeper
from dyknow.ros.manager.mirror import MasterMirror, NodeAddress, lost_parameters
from dyknow.ros.nodelets.announcements import TOPIC as NODES_TOPIC
from dyknow.ros.wire.master import Master

ME = "/dyknow_manager"
TYPE = "std_msgs/Empty"
_pids = itertools.count(5000)


class Core:
    """A ROS master, and others in its place later."""

    def __init__(self) -> None:
        self._master = rosmaster.master.Master(port=0)
        self._master.start()
        self._renewed = contextlib.ExitStack()
        self.uri = self._master.uri
        self.api = Master("/test", self.uri)

    def renew(self) -> None:
        """Put a new master at the same address, in a process of the same id."""
        handler = ROSMasterHandler()
        self._renewed.callback(handler._shutdown, "stop")
        handler._ready(self.uri)
        self._master.master_node.server.register_instance(handler)

    def stop(self) -> None:
        self._renewed.close()
        stop_master(self._master)

    def parameters(self) -> Any:
        return self.api.ask("getParam", "/")

    def state(self) -> List[Dict[str, Any]]:
        """Publishers, subscribers and services by name, and addresses and types of topics."""
        publishers, subscribers, services = map(dict, self.api.ask("getSystemState"))
        addresses = {each: self.api.ask("lookupService", each) for each in services}
        return [publishers, subscribers, services, addresses, dict(self.api.ask("getTopicTypes"))]


class SmallNode:
    """A node that registers once, as every node of ROS 1, and lists its topics."""

    def __init__(self, core: Core, name: str) -> None:
        self.name, self.pid = name, next(_pids)
        self.published: Dict[str, str] = {}
        self.subscribed: Dict[str, str] = {}
        #: The notifications that came: topics with the addresses of their publishers.
        self.heard: List[Tuple[str, List[str]]] = []
        self.goes_on = threading.Event()
        self.goes_on.set()
        self.lists_topics = True
        self._core = core
        self._served = XmlRpc(
            {
                "getPid": lambda caller: self.goes_on.wait() and self.pid,
                "getPublications": lambda caller: self._listed(self.published),
                "getSubscriptions": lambda caller: self._listed(self.subscribed),
                "publisherUpdate": lambda caller, *heard: self.heard.append(heard) or 0,
            }
        )
        self.uri = self._served.uri

    def publish(self, topic: str, datatype: str = TYPE) -> None:
        self.published[topic] = datatype
        self._ask("registerPublisher", topic, datatype, self.uri)

    def subscribe(self, topic: str, datatype: str = TYPE) -> None:
        self.subscribed[topic] = datatype
        self._ask("registerSubscriber", topic, datatype, self.uri)

    def offer(self, service: str, address: str) -> None:
        self._ask("registerService", service, address, self.uri)

    def close(self) -> None:
        self.goes_on.set()
        self._served.close()

    def _listed(self, topics: Dict[str, str]) -> Any:
        return [[topic, topics[topic]] for topic in topics] if self.lists_topics else None

    def _ask(self, *question: str) -> None:
        Master(self.name, self._core.uri).ask(*question)


class Graph:
    """A master, the node of a DyKnow manager, and further nodes; all are closed together."""

    def __init__(self, path: str) -> None:
        self.core = Core()
        self.path = path
        self.nodes: List[Any] = []
        self.manager = self.node(ME)
        self.manager.publish("/rosout", "rosgraph_msgs/Log")

    def node(self, name: str) -> SmallNode:
        self.nodes.append(SmallNode(self.core, name))
        return self.nodes[-1]

    def server(self) -> SmallManager:
        """A process that answers connections to services."""
        self.nodes.append(SmallManager())
        return self.nodes[-1]

    def keeper(self) -> MasterKeeper:
        return MasterKeeper(Master(ME, self.core.uri), self.path)

    def set(self, **parameters: Any) -> None:
        for name, value in parameters.items():
            self.core.api.ask("setParam", f"/{name}", value)

    def close(self) -> None:
        for each in self.nodes:
            each.close()
        self.core.stop()


@pytest.fixture
def graph(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    made = Graph(str(tmp_path / "state" / "master"))
    yield made
    made.close()


@pytest.fixture
def keeper(graph):
    return graph.keeper()


def test_everything_is_registered_again(graph, keeper):
    talker, listener, server = graph.node("/talker"), graph.node("/listener"), graph.server()
    talker.publish("/words")
    talker.offer("/talker/ask", server.service)
    listener.subscribe("/words")
    listener.subscribe("/other", "std_msgs/String")
    graph.set(rate=5, robot={"name": "a", "wheels": [1, 2]}, raw=Binary(b"\0\1"), nothing={})
    before = graph.core.state()
    for number in range(3):
        keeper.look()
        graph.core.renew()
        keeper.look()
        assert graph.core.state() == before, number
        found = graph.core.parameters()
        assert found.pop("raw").data == b"\0\1"
        assert found == {"rate": 5, "robot": {"name": "a", "wheels": [1, 2]}}
    assert listener.heard == []  # it is connected to the publisher that it knows


def test_a_look_at_the_same_master_changes_nothing(graph, keeper):
    talker = graph.node("/talker")
    talker.publish("/words")
    graph.set(rate=5)
    keeper.look()
    graph.core.api.ask("deleteParam", "/rate")
    Master("/talker", graph.core.uri).ask("unregisterPublisher", "/words", talker.uri)
    before = graph.core.state()
    keeper.look()
    assert graph.core.state() == before
    assert graph.core.parameters() == {}


def test_topics_that_a_node_has_given_up_stay_away_and_new_ones_come(graph, keeper):
    node = graph.node("/node")
    node.publish("/old")
    node.subscribe("/old_too")
    keeper.look()
    del node.published["/old"], node.subscribed["/old_too"]
    node.published["/new"] = node.subscribed["/new_too"] = "std_msgs/String"
    graph.core.renew()
    keeper.look()
    publishers, subscribers, _, _, types = graph.core.state()
    assert publishers == {"/rosout": [ME], "/new": ["/node"]}
    assert subscribers == {"/new_too": ["/node"]}
    assert types["/new"] == types["/new_too"] == "std_msgs/String"


def test_the_topic_that_rewirable_programs_do_not_list_comes_back(graph, keeper):
    node = graph.node("/program")
    node.publish(NODES_TOPIC)
    keeper.look()
    del node.published[NODES_TOPIC]
    graph.core.renew()
    keeper.look()
    assert graph.core.state()[0][NODES_TOPIC] == ["/program"]


@pytest.mark.parametrize("lists_topics", [True, False])
def test_a_node_that_does_not_answer_gets_back_what_it_had(
    graph, keeper, monkeypatch, lists_topics
):
    node = graph.node("/node")
    node.publish("/words", "std_msgs/String")
    node.subscribe("/more")
    keeper.look()
    before = graph.core.state()
    monkeypatch.setattr(keeper_module, "_PATIENCE", 0.05 if lists_topics else PATIENCE)
    if lists_topics:
        node.goes_on.clear()
    node.lists_topics = lists_topics
    graph.core.renew()
    keeper.look()
    assert graph.core.state() == before


def test_a_node_that_has_ended_stays_away(graph, keeper, caplog):
    gone, replaced = graph.node("/gone"), graph.node("/replaced")
    gone.publish("/words")
    replaced.publish("/more")
    keeper.look()
    gone.close()
    graph.nodes.remove(gone)
    replaced.pid += 1  # another process has the port
    graph.core.renew()
    with caplog.at_level(logging.WARNING):
        keeper.look()
    assert graph.core.state()[0] == {"/rosout": [ME]}
    assert "have ended are not registered again: /gone, /replaced" in caplog.text


def test_a_service_that_its_node_has_given_up_stays_away(graph, keeper):
    node, kept, dropped = graph.node("/node"), graph.server(), graph.server()
    node.offer("/node/kept", kept.service)
    node.offer("/node/poll", dropped.service)
    node.offer("/node/gone", "rosrpc://localhost:9")
    keeper.look()
    dropped.error = "nonexistent service"
    graph.core.renew()
    keeper.look()
    assert graph.core.state()[2] == {"/node/kept": ["/node"]}


def test_what_the_new_master_has_is_newer(graph, keeper):
    elder, server = graph.node("/node"), graph.server()
    elder.publish("/words")
    elder.offer("/shared", server.service)
    graph.set(rate=5, robot={"name": "a", "mass": 1.0}, run_id="first")
    keeper.look()
    graph.core.renew()
    successor, other = graph.node("/node"), graph.node("/other")
    successor.publish("/further")
    other.offer("/shared", "rosrpc://localhost:9")
    graph.set(rate=6, robot={"name": "b"}, run_id="second")
    keeper.look()
    publishers, _, services, addresses, _ = graph.core.state()
    assert publishers == {"/rosout": [ME], "/further": ["/node"]}
    assert (services, addresses) == ({"/shared": ["/other"]}, {"/shared": "rosrpc://localhost:9"})
    assert graph.core.api.node("/node") == successor.uri
    expected = {"rate": 6, "robot": {"name": "b", "mass": 1.0}, "run_id": "second"}
    assert graph.core.parameters() == expected


def test_the_id_of_a_roscore_is_never_set(graph, keeper):
    graph.set(run_id="first", rate=5)
    keeper.look()
    graph.core.renew()
    keeper.look()
    assert graph.core.parameters() == {"rate": 5}
    graph.set(run_id="second")  # it comes a moment after the master
    graph.core.api.ask("deleteParam", "/rate")
    keeper.look()
    assert graph.core.parameters() == {"run_id": "second"}


def test_a_subscriber_hears_of_new_publishers_and_always_of_all(graph, keeper):
    known, listener = graph.node("/known"), graph.node("/listener")
    known.publish("/words")
    listener.subscribe("/words")
    keeper.look()
    del listener.heard[:]
    graph.core.renew()
    graph.node("/new").publish("/words")  # it began while there was no master
    keeper.look()
    uris = {each.uri for each in graph.nodes if each.name in ("/known", "/new")}
    assert [(topic, set(heard)) for topic, heard in listener.heard] == [("/words", uris)]


def test_a_second_keeper_does_no_harm(graph, keeper, tmp_path):
    talker, listener = graph.node("/talker"), graph.node("/listener")
    talker.publish("/words")
    listener.subscribe("/words")
    second = MasterKeeper(Master("/second", graph.core.uri), str(tmp_path / "second"))
    graph.node("/second").publish("/rosout", "rosgraph_msgs/Log")
    before = graph.core.state()
    keeper.look()
    second.look()
    graph.core.renew()
    keeper.look()
    second.look()
    assert [each == now for each, now in zip(before[1:], graph.core.state()[1:])] == [True] * 4
    assert set(graph.core.state()[0]["/rosout"]) == {ME, "/second"}
    assert listener.heard == []


def test_the_manager_itself_comes_last(graph, keeper, monkeypatch):
    """Until then no part of it takes the lack of a registration for an end."""
    server = graph.server()
    for node in (graph.node("/a"), graph.manager, graph.node("/z")):
        node.publish(f"{node.name}/topic")
        node.offer(f"{node.name}/service", server.service)
        node.subscribe("/topics")
    keeper.look()
    asked: List[Any] = []
    ask_all = Master.ask_all

    def noted(master: Master, questions: Any) -> Any:
        questions = list(questions)
        asked.extend(questions)
        return ask_all(master, questions)

    monkeypatch.setattr(Master, "ask_all", noted)
    graph.core.renew()
    keeper.look()
    for function in ("registerService", "registerPublisher", "registerSubscriber"):
        callers = [caller for name, caller, *_ in asked if name == function]
        assert callers[0] == "/a" and callers[-1] == ME, (function, callers)


def begin_another_session(graph: Graph) -> None:
    """End the manager and its master, and begin with another one of each."""
    graph.manager.close()
    graph.nodes.remove(graph.manager)
    graph.core.renew()
    graph.set(run_id="second")
    graph.node(ME).publish("/rosout", "rosgraph_msgs/Log")


def test_the_mirror_outlives_its_manager(graph, keeper):
    node = graph.node("/node")
    node.publish("/words")
    graph.set(run_id="first", rate=5)
    keeper.look()
    assert stat.S_IMODE(os.stat(graph.path).st_mode) == 0o600
    begin_another_session(graph)
    graph.keeper().look()
    assert graph.core.state()[0] == {"/rosout": [ME], "/words": ["/node"]}
    assert graph.core.parameters() == {"run_id": "second", "rate": 5}


def test_the_file_is_written_every_few_seconds_at_most(graph):
    clock = HandClock()
    keeper = MasterKeeper(Master(ME, graph.core.uri), graph.path, clock)

    def saved() -> Any:
        with open(graph.path, encoding="utf-8") as file:
            return MasterMirror.from_text(file.read()).parameters

    graph.set(rate=1)
    keeper.look()
    assert saved() == {"rate": 1}
    graph.set(rate=2)
    keeper.look()
    assert saved() == {"rate": 1}
    clock.time += 10.0
    keeper.look()
    assert saved() == {"rate": 2}


def test_nothing_of_an_earlier_session_comes_back(graph, keeper):
    """All its nodes have ended, so its parameters are not wanted either."""
    graph.set(run_id="first", rate=5)
    keeper.look()
    begin_another_session(graph)
    graph.keeper().look()
    assert graph.core.parameters() == {"run_id": "second"}


def test_a_file_that_cannot_be_read_is_left_out(graph, keeper, caplog):
    keeper.look()
    with open(graph.path, "w", encoding="utf-8") as file:
        file.write("<value>")
    graph.keeper().look()
    assert "is not used" in caplog.text
    keeper.close()
    keeper.close()
    assert not os.path.exists(graph.path)


def test_while_there_is_no_master_the_mirror_stays(graph, keeper):
    keeper.look()
    with open(graph.path, encoding="utf-8") as file:
        before = file.read()
    away = MasterKeeper(Master(ME, "http://localhost:9"), graph.path)
    assert 0.0 < away.look() < 1.0
    with open(graph.path, encoding="utf-8") as file:
        assert file.read() == before


TREES = st.recursive(
    st.integers() | st.text(max_size=3),
    lambda inner: st.dictionaries(st.sampled_from("abc"), inner, min_size=1, max_size=3),
    max_leaves=8,
)
MAPS = st.dictionaries(st.sampled_from("abc"), TREES, max_size=3)


def merged(kept: Any, present: Any) -> Any:
    if isinstance(kept, dict) and isinstance(present, dict):
        both = {key: merged(kept[key], present[key]) for key in kept.keys() & present.keys()}
        return {**kept, **present, **both}
    return present


@examples(100)
@given(MAPS, MAPS)
def test_present_parameters_stay_and_all_others_come_back(kept, present):
    expected = merged(kept, present)
    for name, value in lost_parameters(kept, present):
        *path, last = name[1:].split("/")
        tree = present
        for each in path:
            tree = tree[each]
        assert last not in tree
        tree[last] = value
    assert present == expected


def test_a_mirror_is_read_as_it_was_written():
    mirror = MasterMirror(
        7,
        {"/a": NodeAddress("http://here:1/", 3)},
        {"/t": ["/a"]},
        {"/u": ["/a"]},
        {"/s": "/a"},
        {"/s": "rosrpc://here:2"},
        {"/t": TYPE},
        {"raw": Binary(b"\0"), "tree": {"é": [1, 2.5, True, "x"]}},
    )
    assert MasterMirror.from_text(mirror.to_text()) == mirror
