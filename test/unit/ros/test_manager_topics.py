# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What the manager publishes, answers and hears: changes, counts, verdicts; its reports."""

from __future__ import annotations

import struct
import threading
import time
from dataclasses import replace
from io import BytesIO
from types import SimpleNamespace
from typing import Any, Dict
from unittest import mock

import pytest
import rospy
from clocks import eventually, in_thread, join, wait_for
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_msgs import srv
from dyknow_msgs.msg import Counts, NodeletCounts, NodeletPorts, Verdict
from rospy.msg import deserialize_messages
from unit.cli.fake_client import FakeClient
from unit.manager.world import World

from dyknow.model.graph import Model, NodeletStatus, PortState, State
from dyknow.model.hosts import HostStatus
from dyknow.model.streams import ClaimState, StreamStatus
from dyknow.ros.hosting.listening import TopicCounter, VerdictTopics
from dyknow.ros.manager import services
from dyknow.ros.manager.diagnostics import Counted, statuses
from dyknow.ros.manager.services import CountsTopic, ManagerServices
from dyknow.ros.nodelets.announcements import Announcer


def test_a_change_is_published_before_it_is_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    offered: dict[str, Any] = {}
    monkeypatch.setattr(rospy, "Service", lambda name, _, answer: offered.update({name: answer}))
    client, published = FakeClient(World()), []
    unused: Any = None

    def publish() -> None:
        published.append(client.core.graph_model().nodelets)

    ManagerServices(client.reconciler, unused, unused, lambda: None, publish)
    for name, request, states in (
        ("spawn", srv.SpawnRequest(label="camera", name="/cam"), [("/cam", False)]),
        ("set_protection", srv.SetProtectionRequest("/cam", True), [("/cam", True)]),
        ("destroy", srv.DestroyRequest("/cam"), [("/cam", True)]),  # refused
        ("set_protection", srv.SetProtectionRequest("/cam", False), [("/cam", False)]),
        ("destroy", srv.DestroyRequest("/cam"), []),
    ):
        offered[f"~{name}"](request)
        assert [(each.name, each.is_protected) for each in published.pop()] == states


class Turn:
    """A lock that says when a second thread comes."""

    def __init__(self, comes: threading.Event) -> None:
        self._comes = comes
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        if self._lock.locked():
            self._comes.set()
        self._lock.acquire()

    def __exit__(self, *unused: object) -> None:
        self._lock.release()


def test_diagnostics_take_the_counts_that_are_under_way(monkeypatch):
    """Of two requests at once, a process answered one, and the other lacked its nodelets."""
    comes = threading.Event()
    counted, diagnosed, published, threads = [], [], [], []
    heard = mock.Mock(publish=published.append, get_num_connections=lambda: 1)
    monkeypatch.setattr(rospy, "Publisher", lambda *unused, **options: heard)
    monkeypatch.setattr(services, "turn_lock", lambda name: Turn(comes))

    def diagnose():
        diagnosed.append(topic.latest())
        comes.set()

    def count():
        counted.append([NodeletCounts(nodelet=f"/{len(counted)}")])
        if not threads:
            threads.append(in_thread(diagnose))
            wait_for(comes)
        return counted[-1]

    topic = CountsTopic(count)
    topic.publish()
    join(*threads)
    assert counted == diagnosed == [[NodeletCounts(nodelet="/0")]]
    assert published == [Counts(counted[0])]


def test_messages_that_arrive_together_are_all_counted(monkeypatch):
    """In one packet: rospy hands on as many of them as its subscriber says."""

    def subscribe(topic, datatype, hear, queue_size=None, **options):
        arrived = BytesIO()
        arrived.write(3 * struct.pack("<Ic", 1, b"x"))
        messages = []
        deserialize_messages(arrived, messages, datatype, queue_size)
        for each in messages:
            each._connection_header = {}
            hear(each)
        return mock.Mock()

    monkeypatch.setattr(rospy, "Subscriber", subscribe)
    registrar, at_once = mock.Mock(), mock.Mock(run=lambda register: register())
    counted = TopicCounter("/beats", registrar, at_once).count()
    assert counted is not None and counted.messages == 3


# Verdicts that the manager hears


def received(md5sum=Verdict._md5sum, stamp=0.0):
    body = BytesIO()
    verdict = Verdict(value=Verdict.TRUE, why="it is charged")
    verdict.header.stamp = rospy.Time.from_sec(stamp)
    verdict.serialize(body)
    message = rospy.AnyMsg().deserialize(body.getvalue())
    message._connection_header = {"md5sum": md5sum}
    return message


@pytest.fixture
def holds(monkeypatch):
    """Hears messages on the topic `/holds`, and returns the verdict there after each."""
    callbacks, changes = {}, []
    monkeypatch.setattr(rospy, "Subscriber", lambda *words: callbacks.update([words[1:]]))
    monkeypatch.setattr(rospy, "get_time", lambda: 100.0)
    verdicts = VerdictTopics(lambda: changes.append("change"))

    def hear(message):
        callbacks[rospy.AnyMsg](message)
        return verdicts.follow(["/holds"]).get("/holds")

    verdicts.follow(["/holds"])
    eventually(lambda: callbacks)
    yield SimpleNamespace(hear=hear, changes=changes)
    verdicts.close()


def test_a_topic_whose_messages_are_counted_too_is_heard(holds):
    """Rospy gives all subscribers of a topic the message class of the first."""
    assert holds.hear(received("of another type")) is None
    assert holds.hear(received()).is_true


def test_verdicts_tell_the_time_of_the_last_state(holds):
    """In steady time, which the clocks of messages and of the master do not share."""
    heard = [holds.hear(received(stamp=stamp)) for stamp in (0.0, 60.0, 1000.0)]
    begin, one_minute, future = (each.state for each in heard)
    assert one_minute - begin >= 60.0
    assert future - one_minute >= 40.0, "no state is in the future"
    assert future <= time.monotonic()
    assert len(holds.changes) == 1


# Reports on /diagnostics


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
PORTS = (PortState("out", "out", "std_msgs/Header", "/s"),)
NODELET = NodeletStatus(
    "/camera", "camera", "/nodelet_manager", False, False, False, State.RUNNING, "", PORTS
)
CLAIM = StreamStatus(
    "ab12",
    "/client",
    "Ball(?c)",
    "/s",
    "std_msgs/Header",
    ClaimState.ACTIVE,
    "",
    ("/camera",),
    0.0,
)


def reported(nodelet=NODELET, claim=CLAIM, trouble=""):
    return statuses("robot/dyknow_manager", Model(1, 1, (nodelet,)), [claim], trouble)


def values(status: Any) -> Dict[str, str]:
    return {each.key: each.value for each in status.values}


def test_all_is_well_but_for_the_disk():
    manager = reported(trouble="the disk is full")[0]
    assert (manager.level, manager.message) == (WARN, "the disk is full")
    manager, nodelet, claim = reported()
    assert {manager.level, nodelet.level, claim.level} == {OK}
    assert manager.name == "robot/dyknow_manager: manager"
    assert values(manager).items() >= {"nodelets": "1", "running": "1", "claims": "1"}.items()
    assert (nodelet.name, nodelet.message) == ("robot/dyknow_manager: nodelet /camera", "running")
    assert values(nodelet).items() >= {"node": "/nodelet_manager", "port out": "/s"}.items()
    assert claim.name == "robot/dyknow_manager: claim ab12 Ball(?c)"
    assert values(claim).items() >= {"topic": "/s", "nodelets": "/camera"}.items()


@pytest.mark.parametrize(
    ("state", "detail", "level"),
    [
        (State.STARTING, "", WARN),
        (State.RUNNING, "a callback has been running for 9 s", WARN),
        (State.LOST, "its process has died", ERROR),
        (State.FAILED, "not loaded", ERROR),
    ],
)
def test_nodelets(state, detail, level):
    manager, nodelet, _ = reported(replace(NODELET, state=state, detail=detail))
    assert (nodelet.level, nodelet.message) == (level, detail or "starting")
    assert values(manager)["running"] == str(int(state is State.RUNNING))


@pytest.mark.parametrize(
    ("counted", "level", "message"),
    [
        (Counted(7), OK, "running"),
        (Counted(7, lately=2), WARN, "dropped 2 messages"),
        (Counted(7, 3), OK, "running"),
        (Counted(7, 3, "in-port 'in': KeyError: 'x'"), WARN, "in-port 'in': KeyError: 'x'"),
    ],
)
def test_drops_warn_while_they_grow_and_errors_for_a_while(counted, level, message):
    found = statuses("manager", Model(1, 1, (NODELET,)), [], "", {"/camera": counted})[1]
    assert (found.level, found.message, values(found)["dropped"]) == (level, message, "7")
    assert values(found)["callback errors"] == str(counted.errors)


@pytest.mark.parametrize("state", list(ClaimState))
def test_claims(state):
    found = reported(claim=replace(CLAIM, state=state, detail="why"))[2:]
    levels = {ClaimState.ACTIVE: OK, ClaimState.FAILED: ERROR}
    expected = [] if state.ended else [(levels.get(state, WARN), "why")]
    assert [(each.level, each.message) for each in found] == expected


@pytest.mark.parametrize(
    ("host", "level", "message"),
    [
        (HostStatus("rover"), OK, "answers"),
        (HostStatus("rover", offset=0.15, error=0.06), OK, "answers"),
        (HostStatus("rover", offset=-0.15, error=0.04), WARN, "its clock differs by -0.150 s"),
        (HostStatus("rover", is_away=True), WARN, "none of its processes answers"),
    ],
)
def test_hosts(host, level, message):
    *_, found = statuses("manager", Model(1, 1, ()), [], "", hosts=[host], max_offset=0.1)
    assert (found.name, found.level, found.message) == ("manager: host rover", level, message)


# Announcements of changes in nodelet managers, and their numbers


MANY = [f"/n{number:03}" for number in range(500)]


@pytest.fixture
def announced(monkeypatch):
    """An announcer, and the nodelets of each of its messages."""
    published = []
    topic = mock.Mock(publish=published.append)
    monkeypatch.setattr(rospy, "Publisher", lambda *arguments, **options: topic)
    announcer = Announcer(lambda name: NodeletPorts(name, name != "/gone", [], "", ""))
    yield announcer, published
    announcer.close()


def names(changes):
    return [each.nodelet for each in changes.nodelets]


def test_a_change_among_many_nodelets_is_announced_alone(announced):
    announcer, published = announced
    for name in MANY:
        announcer.announce(name)
    announcer.start()
    eventually(lambda: published)
    assert (published[0].sequence, names(published[0])) == (500, MANY)
    announcer.announce("/n007")
    eventually(lambda: len(published) == 2)
    assert (published[1].sequence, names(published[1])) == (501, ["/n007"])
    assert published[1].process == published[0].process


def test_each_poll_and_each_newcomer_gets_what_it_has_not_seen(announced):
    announcer, published = announced
    for name in ("/b", "/gone", "/a", "/b"):
        announcer.announce(name)
    found = {seen: names(announcer.since(seen)) for seen in (0, 2, 3, 4)}
    assert found == {0: ["/a", "/b", "/gone"], 2: ["/a", "/b"], 3: ["/b"], 4: []}
    announcer.start()
    eventually(lambda: published)
    eventually(lambda: names(announcer.since(0)) == ["/a", "/b"])
    newcomer = []
    announcer.peer_subscribe("", None, newcomer.append)
    assert names(newcomer[0]) == ["/a", "/b"]
