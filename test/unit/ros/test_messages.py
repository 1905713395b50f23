# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Values that are sent as messages arrive unchanged.

No field of the values here has its default, so each of them has to be converted.
"""

from __future__ import annotations

import math
from dataclasses import replace
from io import BytesIO

import pytest
import rospy
from dyknow_msgs import srv
from dyknow_msgs.msg import Counts
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.srv import GetModelResponse

from dyknow.errors import BadParameter, Result, StreamRefused
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
