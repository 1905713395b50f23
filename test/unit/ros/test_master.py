# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Questions to a real ROS master, and the registrations that a new one gets of living nodes."""

from __future__ import annotations

import contextlib
import functools
import http.server
import logging
import os
import socket
import stat
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Dict, List, Tuple
from xmlrpc.client import Binary, DateTime, dumps

import pytest
import rosmaster.master
from clocks import PATIENCE, HandClock, in_thread, join
from hypothesis import given
from hypothesis import strategies as st
from property_tests import examples
from rosmaster.master_api import ROSMasterHandler
from unit.ros.small_graph import SmallManager, close_all

from dyknow.errors import PeerTimeout
from dyknow.ros.manager import keeper as keeper_module
from dyknow.ros.manager.keeper import MasterKeeper
from dyknow.ros.manager.mirror import MasterMirror, lost_parameters
from dyknow.ros.nodelets.announcements import TOPIC as NODES_TOPIC
from dyknow.ros.wire import master as module
from dyknow.ros.wire.master import Master

ME = "/dyknow_manager"
TYPE = "std_msgs/Empty"
#: A master as it answers on a machine that is busy.
patient = functools.partial(Master, timeout=PATIENCE)


class Core:
    """A ROS master, and its successors at the same address."""

    def __init__(self) -> None:
        self._master = rosmaster.master.Master(port=0)
        self._master.start()
        self._renewed = contextlib.ExitStack()
        self.uri = self._master.uri
        self.api = patient("/test", self.uri)

    def renew(self) -> None:
        """Put a new master at the same address, in a process of the same id."""
        handler = ROSMasterHandler()
        self._renewed.callback(handler._shutdown, "stop")
        handler._ready(self.uri)
        self._master.master_node.server.register_instance(handler)

    def stop(self) -> None:
        """End with its threads: its own ``stop`` lets one of them accept for ever."""
        self._renewed.close()
        node = self._master.master_node
        node.is_shutdown = True
        ending = in_thread(node.server.shutdown)
        socket.create_connection(node.server.server_address[:2]).close()  # it looks twice a second
        join(ending)
        self._master.stop()

    def parameters(self) -> Any:
        return self.api.ask("getParam", "/")

    def state(self) -> List[Dict[str, Any]]:
        """Publishers, subscribers and services by name, and addresses and types of topics."""
        publishers, subscribers, services = map(dict, self.api.ask("getSystemState"))
        addresses = {each: self.api.ask("lookupService", each) for each in services}
        return [publishers, subscribers, services, addresses, dict(self.api.ask("getTopicTypes"))]


class SmallNode(SmallManager):
    """A node that registers once, as every node of ROS 1, and lists its topics.

    Attributes:
        heard: the notifications that came: topics with the addresses of their publishers.
    """

    def __init__(self, core: Core, name: str) -> None:
        super().__init__(
            getPublications=lambda caller: self._listed(self.published),
            getSubscriptions=lambda caller: self._listed(self.subscribed),
            publisherUpdate=lambda caller, *heard: self.heard.append(heard) or 0,
        )
        self.name, self.lists_topics = name, True
        self.published: Dict[str, str] = {}
        self.subscribed: Dict[str, str] = {}
        self.heard: List[Tuple[str, List[str]]] = []
        self._core = core

    def publish(self, topic: str, datatype: str = TYPE) -> None:
        self.published[topic] = datatype
        self._ask("registerPublisher", topic, datatype, self.uri)

    def subscribe(self, topic: str, datatype: str = TYPE) -> None:
        self.subscribed[topic] = datatype
        self._ask("registerSubscriber", topic, datatype, self.uri)

    def offer(self, service: str, address: str) -> None:
        self._ask("registerService", service, address, self.uri)

    def _listed(self, topics: Dict[str, str]) -> Any:
        return [[topic, topics[topic]] for topic in topics] if self.lists_topics else None

    def _ask(self, *question: str) -> None:
        patient(self.name, self._core.uri).ask(*question)


class Graph:
    """A master, and the node of a DyKnow manager; all nodes are closed with it."""

    def __init__(self, path: str) -> None:
        self.core = Core()
        self.path = path
        self.manager = self.node(ME)
        self.manager.publish("/rosout", "rosgraph_msgs/Log")

    def node(self, name: str) -> SmallNode:
        return SmallNode(self.core, name)

    def keeper(self) -> MasterKeeper:
        return MasterKeeper(patient(ME, self.core.uri), self.path)

    def set(self, **parameters: Any) -> None:
        for name, value in parameters.items():
            self.core.api.ask("setParam", f"/{name}", value)

    def close(self) -> None:
        close_all()
        self.core.stop()


@pytest.fixture
def graph(monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    monkeypatch.setattr(keeper_module, "_PATIENCE", PATIENCE)  # but for nodes that are silent
    made = Graph(str(tmp_path / "state" / "master"))
    yield made
    made.close()


@pytest.fixture
def keeper(graph):
    return graph.keeper()


@pytest.mark.parametrize("uri", ["", "http://x:1"])
def test_its_address_is_that_of_rospy(monkeypatch, uri):
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    assert Master("/test").uri == (uri or "http://localhost:11311")


def test_everything_is_registered_again(graph, keeper):
    talker, listener, server = graph.node("/talker"), graph.node("/listener"), SmallManager()
    talker.publish("/words")
    talker.offer("/talker/ask", server.service)
    listener.subscribe("/words")
    listener.subscribe("/other", "std_msgs/String")
    graph.set(rate=5, robot={"name": "a", "wheels": [1, 2]}, raw=Binary(b"\0\1"), nothing={})
    graph.set(run_id="that of another roscore")
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
    graph.set(run_id="second")  # it comes a moment after the master
    graph.core.api.ask("deleteParam", "/rate")
    patient("/talker", graph.core.uri).ask("unregisterPublisher", "/words", talker.uri)
    before = graph.core.state()
    keeper.look()
    assert graph.core.state() == before
    assert graph.core.parameters() == {"run_id": "second"}


def test_what_was_given_up_or_has_ended_stays_away_and_what_is_new_comes(graph, keeper, caplog):
    node, gone, replaced = (graph.node(f"/{name}") for name in ("node", "gone", "replaced"))
    kept, dropped = SmallManager(), SmallManager()
    gone.publish("/words")
    replaced.publish("/more")
    node.publish("/old")
    node.publish(NODES_TOPIC)
    node.subscribe("/old_too")
    node.offer("/node/kept", kept.service)
    node.offer("/node/poll", dropped.service)
    node.offer("/node/gone", "rosrpc://localhost:9")
    keeper.look()
    del node.published["/old"], node.subscribed["/old_too"]
    node.published["/new"] = node.subscribed["/new_too"] = "std_msgs/String"
    del node.published[NODES_TOPIC]  # re-wirable programs do not list it
    dropped.error = "nonexistent service"
    gone.close()
    replaced.pid += 1  # another process has the port
    graph.core.renew()
    with caplog.at_level(logging.WARNING):
        keeper.look()
    publishers, subscribers, services, _, types = graph.core.state()
    assert publishers == {"/rosout": [ME], "/new": ["/node"], NODES_TOPIC: ["/node"]}
    assert subscribers == {"/new_too": ["/node"]}
    assert services == {"/node/kept": ["/node"]}
    assert types["/new"] == types["/new_too"] == "std_msgs/String"
    assert "have ended are not registered again: /gone, /replaced" in caplog.text


def test_a_node_that_was_started_again_meanwhile_is_left_alone(graph, keeper):
    """The master ends a node when another address is registered under its name."""
    node, other = graph.node("/node"), graph.node("/other")
    node.publish("/words")
    node.offer("/node/ask", SmallManager().service)
    other.publish("/more")
    keeper.look()
    again = graph.node("/node")

    def listed(topics):  # it ends as soon as it has answered
        again.publish("/new")
        return SmallNode._listed(node, topics)

    node._listed = listed
    graph.core.renew()
    keeper.look()
    publishers, _, services, *_ = graph.core.state()
    assert publishers == {"/rosout": [ME], "/new": ["/node"], "/more": ["/other"]}
    assert services == {} and graph.core.api.node("/node") == again.uri


def test_what_the_manager_itself_has_just_offered_is_registered(graph, keeper, monkeypatch):
    """The last look was before, when the master ended while the manager was starting."""
    keeper.look()
    new = f"{ME}/spawn"
    offered = SimpleNamespace(get_services=lambda: [(new, SmallManager().service)])
    monkeypatch.setattr(keeper_module, "get_service_manager", lambda: offered)
    graph.core.renew()
    keeper.look()
    assert graph.core.state()[2] == {new: [ME]}


def test_a_node_with_a_fixed_port_that_was_killed_and_started_again_is_registered(graph, keeper):
    """The address of the node, and the registrations, are those of the process before."""
    node, before, after = graph.node("/node"), SmallManager(), SmallManager()
    node.publish("/words")
    for service in ("/ask", "/node/get_loggers"):
        node.offer(service, before.service)
    keeper.look()
    node.pid += 1
    before.error = "nonexistent service"
    node.offer("/ask", after.service)
    keeper.look()  # it is about to register the rest
    node.offer("/node/get_loggers", after.service)
    keeper.look()
    state = graph.core.state()
    graph.core.renew()
    keeper.look()
    assert graph.core.state() == state
    assert state[2].keys() == {"/ask", "/node/get_loggers"}


def test_services_of_all_nodes_are_looked_up_in_turn(graph, keeper, monkeypatch):
    monkeypatch.setattr(keeper_module, "_IN_TURN", 2)
    nodes, after = [graph.node(f"/node_{number}") for number in range(5)], SmallManager()
    for node in nodes:
        node.offer(f"{node.name}/get_loggers", SmallManager().service)
    keeper.look()
    for node in nodes:
        node.offer(f"{node.name}/get_loggers", after.service)
    for _ in range(3):
        keeper.look()
    state = graph.core.state()
    graph.core.renew()
    keeper.look()
    assert graph.core.state() == state


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


def test_a_node_with_a_wrong_address_keeps_no_other_from_a_new_master(graph, keeper):
    """Its ROS_IP is an address with a port."""
    graph.node("/node").publish("/words")
    uri, address = "http://192.0.2.1:11311:45123/", "rosrpc://192.0.2.1:11311:41234"
    wrong = patient("/wrong", graph.core.uri)
    wrong.ask("registerService", "/wrong/ask", address, uri)
    keeper.look()
    graph.core.renew()
    keeper.look()
    assert graph.core.state()[0] == {"/rosout": [ME], "/words": ["/node"]}


def test_what_the_new_master_has_is_newer(graph, keeper):
    elder, server = graph.node("/node"), SmallManager()
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


def test_a_subscriber_hears_of_new_publishers_and_always_of_all(graph, keeper):
    known, listener = graph.node("/known"), graph.node("/listener")
    known.publish("/words")
    listener.subscribe("/words")
    keeper.look()
    del listener.heard[:]
    graph.core.renew()
    new = graph.node("/new")
    new.publish("/words")  # it began while there was no master
    keeper.look()
    heard = [(topic, {*publishers}) for topic, publishers in listener.heard]
    assert heard == [("/words", {known.uri, new.uri})]


def test_the_manager_itself_comes_last(graph, keeper, monkeypatch):
    """Until then no part of it takes the lack of a registration for an end."""
    server = SmallManager()
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


@pytest.mark.parametrize("lives", [True, False])
def test_the_mirror_outlives_its_manager_unless_all_nodes_have_ended(graph, keeper, lives):
    node = graph.node("/node" if lives else ME)
    node.publish("/words")
    node.subscribe("/words")
    node.offer("/ask", SmallManager().service)
    graph.set(run_id="first", rate=5, raw=Binary(b"\0\1"), tree={"é": [1, 2.5, True, "x"]})
    keeper.look()
    assert stat.S_IMODE(os.stat(graph.path).st_mode) == 0o600
    before = graph.core.state()
    graph.manager.close()
    if not lives:
        node.close()
    graph.core.renew()
    graph.set(run_id="second")
    graph.node(ME).publish("/rosout", "rosgraph_msgs/Log")
    graph.keeper().look()
    found = graph.core.parameters()
    assert found.pop("run_id") == "second"
    if lives:
        assert graph.core.state() == before
        assert found.pop("raw").data == b"\0\1"
        assert found == {"rate": 5, "tree": {"é": [1, 2.5, True, "x"]}}
    else:
        assert (graph.core.state()[0], found) == ({"/rosout": [ME]}, {})


def test_a_silent_node_alone_brings_no_earlier_session_back(graph, keeper, monkeypatch):
    """The power has failed, and the network to its host with it."""
    ended, silent = graph.node("/ended"), graph.node("/silent")
    ended.publish("/words")
    silent.subscribe("/words")
    graph.set(run_id="first", rate=5)
    keeper.look()
    ended.close()
    graph.manager.close()
    silent.goes_on.clear()
    monkeypatch.setattr(keeper_module, "_PATIENCE", 0.05)
    graph.core.renew()
    graph.set(run_id="second")
    graph.node(ME).publish("/rosout", "rosgraph_msgs/Log")
    graph.keeper().look()
    assert graph.core.state()[:2] == [{"/rosout": [ME]}, {}]
    assert graph.core.parameters() == {"run_id": "second"}


def test_the_file_is_written_every_few_seconds_at_most_and_not_used_if_it_is_wrong(graph, caplog):
    clock = HandClock()
    file = Path(graph.path)
    keeper = MasterKeeper(patient(ME, graph.core.uri), graph.path, clock)
    for rate, pause, saved in ((1, 0.0, 1), (2, 0.0, 1), (2, 10.0, 2)):
        graph.set(rate=rate)
        clock.time += pause
        keeper.look()
        assert MasterMirror.from_text(file.read_text()).parameters == {"rate": saved}
    before = file.read_text()
    away = MasterKeeper(Master(ME, "http://localhost:9"), graph.path)
    assert 0.0 < away.look() < 1.0
    assert file.read_text() == before, "while there is no master it stays"
    file.write_text("<value>")
    graph.keeper().look()
    assert "is not used" in caplog.text
    for _ in range(2):
        keeper.close()
    assert not file.exists()


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


class Date(DateTime):
    """One of Python 3.8, which can be compared with other dates alone."""

    def __eq__(self, other: object) -> bool:
        assert isinstance(other, DateTime), f"Can't compare DateTime and {type(other)}"
        return super().__eq__(other)


def test_a_date_comes_back_and_a_namespace_without_parameters_does_not():
    date = Date("20210503T14:00:00")
    kept = {"camera": {"calibrated": date}, "empty": {}, "hollow": {"inner": {}}}
    assert [*lost_parameters(kept, {"camera": {}})] == [("/camera/calibrated", date)]


# Questions to a master


URI = "http://localhost:9/"


@pytest.fixture
def uri(monkeypatch):
    monkeypatch.setenv("ROS_HOSTNAME", "localhost")
    core = Core()
    yield core.uri
    core.stop()


def test_the_master_forgets_a_node_that_is_purged_and_no_successor(uri):
    """Else it would end a later process at that address, as soon as the name is back."""
    dead = patient("/dead", uri)
    dead.ask("registerPublisher", "/topic", "std_msgs/Empty", URI)
    dead.ask("registerSubscriber", "/topic", "std_msgs/Empty", URI)
    dead.ask("registerService", "/dead/service", "rosrpc://localhost:9", URI)
    dead.ask("subscribeParam", URI, "/rosout_disable_topics_generation")
    asking = patient("/asking", uri)
    assert asking.node("/dead") == URI
    asking.purge("/dead", URI)
    assert asking.node("/dead") == ""
    successor = "http://localhost:10/"
    for address in (URI, successor):
        dead.ask("registerPublisher", "/topic", "std_msgs/Empty", address)
    asking.purge("/dead", URI)
    assert asking.node("/dead") == successor
    assert asking.publishers("/topic") == {"/dead"}


def test_namespaces_without_parameters_go_with_their_last_one(uri):
    asking = patient("/asking", uri)
    names = ["rate", "in/rate", "in/raw/size", "out/raw/size"]
    for name in (*names, "out/rate"):
        asking.ask("setParam", f"/robot/node/{name}", 5)
    asking.delete_parameters("/robot/node", [*names, "unset"])
    assert asking.ask("getParam", "/robot") == {"node": {"out": {"rate": 5}}}
    asking.delete_parameters("/robot/node", ["out/rate"])
    assert asking.ask("getParam", "/robot") == {}, "it is not the node's"


def test_a_topic_has_a_type_while_somebody_publishes_it(uri):
    node = patient("/node", uri)
    node.ask("registerPublisher", "/space/topic", "std_msgs/Empty", URI)
    node.ask("registerPublisher", "/top", "std_msgs/Header", URI)
    topics = ("/space/topic", "/top", "/space/other")
    assert [*map(node.datatype, topics)] == ["std_msgs/Empty", "std_msgs/Header", ""]
    node.ask("unregisterPublisher", "/space/topic", URI)
    assert node.datatype("/space/topic") == ""


def test_registrations_are_listed_for_topics_alone_that_are_registered(uri, monkeypatch):
    """Where there are 600 nodelets a spawn took twice as long with it."""
    node, asked = patient("/node", uri), []
    monkeypatch.setattr(node, "subscribers", lambda topic: asked.append(topic) or ())
    for topic in ("/left", "/heard"):
        node.ask("registerSubscriber", topic, "std_msgs/Empty", URI)
    node.ask("unregisterSubscriber", "/left", URI)
    assert [*map(node.datatype, ("/new", "/left", "/heard", "/hea", "heard"))] == [""] * 5
    assert asked == ["/heard"]


def _slowly(frame, event, arg):
    """Let other threads go on between any two lines of the module."""
    if frame.f_code.co_filename != module.__file__:
        return None
    time.sleep(0.002)
    return _slowly


def test_many_questions_at_a_time_leave_two_connections(uri, monkeypatch):
    """Each would keep a descriptor here, and a thread of the master, for good."""
    count = 8
    together = threading.Barrier(count)
    made: List[socket.socket] = []

    class Together(module._Connection):
        def connect(self):
            together.wait(PATIENCE)
            super().connect()
            made.append(self.sock)

    monkeypatch.setattr(module, "_Connection", Together)
    node = Master("/node", uri, timeout=PATIENCE)
    with ThreadPoolExecutor(count, initializer=sys.settrace, initargs=(_slowly,)) as pool:
        assert [*pool.map(node.node, ["/none"] * count)] == [""] * count
    assert len(made) == count
    assert sum(each.fileno() >= 0 for each in made) == 2


def test_many_questions_are_one_request(uri):
    asking = patient("/asking", uri)
    asking.ask("setParam", "/a", 1)
    questions = [("getParam", "/asking", name) for name in ("/a", "/b", "")]
    assert asking.ask_all([*questions, ("nothing",)]) == [1, None, None, None]
    assert asking.ask_all([]) == []


def test_a_master_that_does_not_know_the_caller_is_new(uri):
    """It lacks registrations only for a moment."""
    patient("/node", uri).ask("registerPublisher", "/topic", "std_msgs/Empty", URI)
    asking = patient("/asking", uri)
    with pytest.raises(PeerTimeout, match="new"):
        asking.publications()
    with pytest.raises(PeerTimeout, match="new"):
        asking.bearer("/unknown")
    assert asking.bearer("/node") == URI
    asking.ask("registerPublisher", "/rosout", "rosgraph_msgs/Log", "http://localhost:10/")
    assert asking.publications() == {"/topic": ["/node"], "/rosout": ["/asking"]}
    assert asking.bearer("/unknown") == ""


class Page(http.server.BaseHTTPRequestHandler):
    """Answers every question with the text of its class."""

    text = ""

    def do_POST(self):  # noqa: N802
        self.rfile.read(int(self.headers["Content-Length"]))
        self.send_response(200)
        self.send_header("Content-Length", str(len(self.text)))
        self.end_headers()
        self.wfile.write(self.text.encode())

    def log_message(self, *unused):
        pass


@pytest.mark.parametrize("compares", [False, True])
@pytest.mark.parametrize(
    "text",
    ["", "<html>Hello<br></html>", dumps(([[]],), methodresponse=True), "<fault></fault>"],
)
def test_a_server_that_is_no_ros_node_answers_with_an_error(text, compares, monkeypatch):
    """It has the port of a node that has ended."""
    monkeypatch.setattr(Page, "text", text)
    with http.server.HTTPServer(("127.0.0.1", 0), Page) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        asking = Master("/asking", f"http://127.0.0.1:{server.server_port}/", PATIENCE, compares)
        assert asking.node("/node") == ""
        with pytest.raises(LookupError, match="the ROS master"):
            asking.ask_all([("getParam", "/asking", "/")])
        server.shutdown()


def test_an_address_that_is_none_does_not_answer(uri):
    for wrong in ("localhost:11311", "rosrpc://localhost:11311"):
        with pytest.raises(PeerTimeout):
            Master("/asking", wrong).node("/node")
        with pytest.raises(PeerTimeout):
            patient("/asking", uri).pid("/node", wrong, 1.0)


def test_an_answer_like_the_one_before_is_not_parsed(uri):
    asking = Master("/asking", uri, compares=True)
    question = [("getParam", "/asking", "/")]
    asking.ask("setParam", "/words", ["long " * 1000])
    asking.ask_all(question)
    first, second = (asking.ask_all(question)[0] for _ in range(2))
    assert first is second and first == {"words": ["long " * 1000]}
    patient("/other", uri).ask("setParam", "/words", ["short"])
    assert asking.ask_all(question) == [{"words": ["short"]}]


def test_a_node_that_is_gone_or_does_not_answer_has_no_transports(uri):
    patient("/dead", uri).ask("registerPublisher", "/topic", "std_msgs/Empty", URI)
    for node in ("/dead", "/gone"):
        assert patient("/asking", uri).transports(node, 1.0) == {}
