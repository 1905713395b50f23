# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Values and texts that are sent as messages."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from io import BytesIO
from types import SimpleNamespace
from typing import Any

import pytest
import rospy
from dyknow_msgs import srv
from dyknow_msgs.msg import Counts
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.srv import GetModelResponse
from hypothesis import given
from specification_strategies import transformations
from unit.proxy.bench import Bench

from dyknow.errors import BadParameter, LoadFailed, Result, StreamRefused
from dyknow.model.graph import Model, NodeletKind, NodeletStatus, PortState, SpawnRequest, State
from dyknow.model.statistics import (
    NodeletCount,
    NodeletLoad,
    NodeletStatistics,
    PortCount,
    PortStatistics,
)
from dyknow.model.streams import (
    Acquisition,
    ClaimState,
    Replanned,
    StreamEvent,
    StreamRequest,
    StreamStatus,
)
from dyknow.model.transformation import IN, NODE, OUT, Parameter, Port, Transformation
from dyknow.nodelet.texts import LONGEST, sendable
from dyknow.ros.nodelets import nodelet_manager
from dyknow.ros.nodelets.nodelet_log import NodeletLog
from dyknow.ros.transport.middleware import RospyServices
from dyknow.ros.transport.node import own_logs
from dyknow.ros.wire import messages
from dyknow.ros.wire.model_messages import ModelMessages

PARAMETERS = (Parameter("größe", "double", "0.5"), Parameter("~x", "yaml", "[1, '']"))
PORT = PortState("in", IN, "std_msgs/Header", "/t", ("A(b)", "C"))
RELAY = Transformation(
    "relay",
    "dyknow/Relay",
    cost=2**32 - 1,
    parameters=PARAMETERS,
    ports=(Port("in", IN, "std_msgs/Header", ("A(b)",)), Port("out", OUT, "*", (), 2.5, 0.25)),
    isolated=True,
)
THEIRS = Transformation("theirs", "camera/driver --fast", NODE, node="/driver")
NODELET = NodeletStatus(
    "/relay",
    "relay",
    "/manager",
    True,
    True,
    True,
    State.LOST,
    "gone",
    (PORT, PortState("out", OUT)),
    PARAMETERS,
    NodeletKind.CPP,
    "robot",
)
OTHER = replace(NODELET, name="/other", state=State.RUNNING, ports=(), parameters=())
STREAM = StreamStatus(
    "7", "/me", "A(?b)", "/a", "a/B", ClaimState.EXPIRED, "out", ("/n",), 2.5, ("?b=c",)
)
COUNTED = PortStatistics("out", OUT, "/t", 2**32, 3, 12.5, 0.5, 2.5)
UNKNOWN = PortStatistics("in", IN, "/t", None, None, None, None, None)
LABELS = (("a", "b"), ("c",), ("d", "e"))
REQUEST = StreamRequest(
    "A(b)", "a/B", "/me", "1", "bond", 30.0, 0.5, LABELS[0], 5.0, 0.125, LABELS[1], LABELS[2], 2.0
)
ACQUIRED = Acquisition(
    *("7", "/a", "a/B", ("/n", "/o"), ("/p",), 1.5, 99.5, "a plan", "no message yet"),
    *(("one", "two"), ("?b=c",), 1.25),
)


def sent(message, message_class=None):
    """Serialise and deserialise a message."""
    buffer = BytesIO()
    message.serialize(buffer)
    return (message_class or type(message))().deserialize(buffer.getvalue())


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        ("port", PORT),
        ("transformation", RELAY),
        ("transformation", THEIRS),
        ("statistics", NodeletStatistics(1.5, 2, 3, (COUNTED,))),
        ("statistics", NodeletStatistics(1.5, 2, None, (UNKNOWN,))),
        ("stream", STREAM),
        ("event", StreamEvent(1.5, None, STREAM, "new")),
        ("event", StreamEvent(1.5, replace(STREAM, topic=""), STREAM, "moved")),
        ("acquire", REQUEST),
        ("acquisition", ACQUIRED),
        ("acquisition", replace(ACQUIRED, message="", warnings=())),
        ("replanned", Replanned(("/n",), ("/o", "/p"), 1.5, "a plan", "as before")),
    ],
)
def test_a_value_arrives_unchanged(kind, value):
    further = [True] if kind == "acquire" else []
    message = getattr(messages, f"{kind}_message")(value, *further)
    assert getattr(messages, f"{kind}_from")(sent(message)) == value


@pytest.mark.parametrize("seconds", [2.0**31, 1e300, math.inf, math.nan])
def test_a_time_that_no_message_can_hold(seconds):
    with pytest.raises(BadParameter, match="'lease' is .*: expected seconds below 2147483648"):
        messages.acquire_message(replace(REQUEST, lease=seconds), dry_run=False)


def test_fields_that_the_values_do_not_have():
    assert messages.transformation_message(RELAY).specification == RELAY.to_xml()
    for dry_run in (False, True):
        assert messages.acquire_message(REQUEST, dry_run).dry_run is dry_run
    assert messages.acquisition_message(ACQUIRED).success
    assert messages.replanned_message(Replanned((), (), 0.0, "", "")).success
    for result in Result:
        assert getattr(srv.AcquireStreamResponse, result.name) == result
    message = messages.acquire_message(replace(REQUEST, exclude=("b", "a", "b")), False)
    assert messages.acquire_from(message).exclude == ("a", "b")


def test_a_request_to_spawn():
    config = {"b": "/t", "a": ""}
    request = SpawnRequest("relay", "/n", config, True, True, "/m", PARAMETERS)
    arrived = sent(messages.spawn_message(request))
    assert (arrived.label, arrived.name, arrived.manager) == ("relay", "/n", "/m")
    assert (arrived.is_protected, arrived.isolated) == (True, True)
    assert messages.config_pairs(arrived.config) == sorted(config.items())
    assert messages.parameters_from(arrived.parameters) == PARAMETERS


def test_statistics_are_sorted_by_port():
    arrived = sent(messages.statistics_message(NodeletStatistics(1.5, 2, 3, (COUNTED, UNKNOWN))))
    assert [each.port for each in arrived.ports] == ["in", "out"]


def test_the_counts_of_a_nodelet():
    latched = replace(COUNTED, latched=True, age=0.25, size=100)
    statistics = NodeletStatistics(1.5, 2, 3, (latched, UNKNOWN), "late")
    arrived = sent(messages.counts_message("/n", statistics, 0.75))
    assert (arrived.nodelet, arrived.uptime.to_sec()) == ("/n", 1.5)
    unknown, counted = arrived.ports
    assert (counted.port, counted.direction, counted.messages) == ("out", 1, 2**32)
    assert (counted.latched, counted.age, counted.size) == (True, 0.25, 100)
    assert (unknown.port, unknown.direction, unknown.messages) == ("in", 0, 0)
    assert unknown.age != unknown.age
    (count,) = messages.counts_from(sent(Counts([arrived])))
    ports = {"in": PortCount(0, 0), "out": PortCount(2**32, 3, 0.25, 100)}
    assert count == NodeletCount("/n", 1.5, 2, ports, 3, "late", 0.75)
    arrived.cpu, arrived.memory = 2.5, 2**33
    (count,) = messages.counts_from(sent(Counts([arrived])))
    assert (count.cpu, count.memory) == (2.5, 2**33)


def test_the_load_of_a_nodelet_between_two_counts():
    before = NodeletCount("/n", 10.0, 0, {}, busy=3.0, cpu=5.0, memory=100)
    after = NodeletCount("/n", 12.0, 0, {}, busy=4.0, cpu=7.5, memory=200)
    assert after.load_since(before) == NodeletLoad(0.5, 1.25, 200)
    assert replace(after, cpu=None, memory=None).load_since(before) == NodeletLoad(0.5, None, None)
    assert after.load_since(replace(before, cpu=None)) == NodeletLoad(0.5, None, 200)
    assert replace(after, busy=2.0).load_since(before) == NodeletLoad(0.0, 1.25, 200)
    assert before.load_since(after) is None


@pytest.mark.parametrize("result", [each for each in Result if each is not Result.OK])
def test_refusals(result):
    with pytest.raises(StreamRefused, match="no way") as caught:
        messages.acquisition_from(
            sent(messages.refusal_message(StreamRefused("no way", result, "7")))
        )
    assert (caught.value.result, caught.value.claim_id) == (result, "7")


def test_a_model_on_its_topic_in_the_answer_and_changed():
    rospy.rostime.set_rostime_initialized(True)
    kept = ModelMessages()
    model = Model(7, 3, (NODELET, OTHER), (RELAY, THEIRS))
    on_topic = sent(kept.topic(model), ModelMessage)
    assert messages.model_from(on_topic) == replace(model, transformations=())
    answer = sent(kept.response(model), GetModelResponse).model
    assert messages.model_from(answer) == model
    assert answer.nodelets == list(map(messages.nodelet_message, model.nodelets))
    assert answer.transformations == list(map(messages.transformation_message, (RELAY, THEIRS)))
    changed = Model(8, 4, (replace(NODELET, is_protected=False),), (RELAY._replace(cost=0),))
    answer = sent(kept.response(changed), GetModelResponse).model
    assert messages.model_from(answer) == changed


@given(transformations)
def test_a_transformation_arrives_as_it_is(transformation):
    arrived = sent(messages.transformation_message(transformation))
    assert messages.transformation_from(arrived) == transformation


@pytest.mark.parametrize(
    "detail",
    [
        "PermissionError: /dev/video0, owner: root",
        "it has died; owner: nobody",
        "RuntimeError: firmware outdated: 1.2, expected 1.3; no firmware",
        "firmware outdated: its version is 1.2",
    ],
)
def test_words_of_an_error_are_neither_an_owner_nor_a_cause(detail):
    status = replace(NODELET, detail=detail, owner="")
    for owned in (status, replace(status, owner="/m")):
        (arrived,) = messages.model_from(
            ModelMessage(nodelets=[sent(messages.nodelet_message(owned))])
        ).nodelets
        assert (arrived, arrived.outdated) == (owned, "")
    outdated = replace(status, detail=f"{detail}; outdated: its code changed")
    assert outdated.outdated == "its code changed"


# Texts of errors, with characters or lengths that no message can have


HALF = "unknown command \ud83d"


def encoded(error: BaseException) -> str:
    """The text of an error, by way of rospy's encoding of it."""
    return bytes(str(error), "utf-8").decode()


def test_a_text_is_sendable() -> None:
    assert sendable(ValueError("5 °C")) == "5 °C"
    assert sendable(HALF) == "unknown command ?"
    assert sendable("x" * LONGEST) == "x" * LONGEST
    assert sendable("x" * 5_000_000) == "x" * (LONGEST - 1) + "…"


@pytest.mark.parametrize("text", [HALF, "x" * 5_000_000], ids=["half", "long"])
def test_an_error_of_a_callback_can_be_polled(text: str) -> None:
    bench = Bench()
    bench.context.failed("'in'", ValueError(text))
    buffer = BytesIO()
    messages.counts_message("/n", bench.proxy.get_statistics(), 0.0).serialize(buffer)
    assert buffer.tell() < 3 * LONGEST


def test_a_load_that_fails_answers() -> None:
    error = LoadFailed("/n", "pack/Nodelet", ValueError(HALF))
    assert "unknown command ?" in encoded(nodelet_manager._failed("Failed to load", "/n", error))


@pytest.mark.parametrize(
    "raised, expected",
    [
        (ValueError(HALF), "ValueError: unknown command ?"),
        (rospy.ServiceException(HALF), "unknown command ?"),
        (ValueError("5 °C"), "5 °C"),
    ],
)
def test_a_handler_that_raises_answers(monkeypatch: Any, raised: Exception, expected: str) -> None:
    offered: list[Any] = []
    monkeypatch.setattr(rospy, "Service", lambda *args, **options: offered.append(args[2]))

    def handler(request: Any) -> Any:
        raise raised

    RospyServices().offer("/n/act", object, handler, {}, "/n")
    with pytest.raises(Exception, match="") as caught:
        offered[0](None)
    assert encoded(caught.value) == expected
    is_service_error = isinstance(raised, rospy.ServiceException)
    assert isinstance(caught.value, rospy.ServiceException) is is_service_error
    assert raised in (caught.value, caught.value.__cause__)


def test_an_error_of_a_service_is_logged_in_the_name_of_its_nodelet(monkeypatch, caplog):
    offered: dict[str, Any] = {}
    monkeypatch.setattr(rospy, "Service", lambda *args, **options: offered.update(options))
    RospyServices().offer("/n/act", object, print, {}, "/n")
    error = ValueError(HALF)
    offered["error_handler"](error, ValueError, error, None)
    assert [line.nodelet for line in caplog.records] == ["/n"]
    assert "the handler of service /n/act raised: unknown command ?" in caplog.text


def test_a_line_of_the_log() -> None:
    line = logging.makeLogRecord({"msg": "raised %s", "args": (HALF,)})
    assert NodeletLog(lambda name: None).format(line) == "raised unknown command ?"


def test_an_error_of_a_callback_is_logged_in_the_name_of_its_nodelet(caplog, monkeypatch):
    lines = []
    publisher = SimpleNamespace(publish=lines.append)
    monkeypatch.setattr(rospy.impl.rosout, "_rosout_pub", publisher)
    monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
    context = Bench().context
    context.failed("'in'", ValueError(HALF))
    assert "unknown command ?" in caplog.text
    topics = {context.name: ["/in"]}
    NodeletLog(topics.get).emit(caplog.records[-1])
    assert [(line.name, line.topics) for line in lines] == [(context.name, ["/in"])]


def test_a_line_with_a_logger_of_its_own_is_in_the_name_of_its_nodelet(caplog):
    caplog.set_level(logging.INFO, "rosout")
    logs = own_logs("/robot/n")
    logs["logwarn"]("plain")
    logs["logout"]("under its old name")
    logs["logwarn"]("in %s", "detail", logger_name="detail", extra={"more": 1})
    assert [(line.name, line.nodelet, line.getMessage()) for line in caplog.records] == [
        ("rosout.robot.n", "/robot/n", "plain"),
        ("rosout.robot.n", "/robot/n", "under its old name"),
        ("rosout.robot.n.detail", "/robot/n", "in detail"),
    ]
    assert caplog.records[-1].more == 1
