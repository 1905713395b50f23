# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Values that are sent as messages arrive unchanged."""

from __future__ import annotations

from io import BytesIO
from typing import Any, TypeVar

import pytest
from dyknow_msgs import srv
from dyknow_msgs.msg import Model as Message
from hypothesis import given
from hypothesis import strategies as st
from specification_strategies import transformations

from dyknow.errors import Result, StreamRefused
from dyknow.model.graph import NodeletStatus, PortState, SpawnRequest, State
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.model.streams import Acquisition, Replanned, StreamEvent, StreamRequest, StreamStatus
from dyknow.model.transformation import IN, OUT, Parameter
from dyknow.ros import messages

M = TypeVar("M")

words = st.text(st.characters(blacklist_categories=["Cs"]), max_size=10)
numbers = st.integers(0, 2**32 - 1)
#: Seconds that a message of ROS holds exactly.
seconds = st.integers(0, 2**31 - 1).map(lambda number: number / 8)
directions = st.sampled_from([IN, OUT])
ports = st.builds(PortState, words, directions, words, words, st.tuples(words))
streams = st.builds(
    StreamStatus, expires=seconds, nodelets=st.tuples(words, words), bindings=st.tuples(words)
)
lines = st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=1, max_size=10)


def sent(message: M) -> M:
    """Serialise and deserialise a message."""
    buffer = BytesIO()
    sending: Any = message
    sending.serialize(buffer)
    arrived: M = type(sending)().deserialize(buffer.getvalue())
    return arrived


@given(ports)
def test_ports(port: PortState) -> None:
    assert messages.port_from(sent(messages.port_message(port))) == port


@given(transformations)
def test_transformations(transformation: Any) -> None:
    message = sent(messages.transformation_message(transformation))
    assert messages.transformation_from(message) == transformation
    assert message.specification == transformation.to_xml()


@given(st.dictionaries(words, words))
def test_configurations(config: Any) -> None:
    request = sent(messages.spawn_message(SpawnRequest("label", "name", config)))
    assert dict(messages.config_pairs(request.config)) == config
    assert [each.port for each in request.config] == sorted(config)


parameters = st.lists(st.builds(Parameter, words, words, words), max_size=2).map(tuple)


@given(parameters, ports)
def test_what_is_given_at_the_spawn(given: Any, port: PortState) -> None:
    request = sent(messages.spawn_message(SpawnRequest("label", "name", parameters=given)))
    assert messages.parameters_from(request.parameters) == given
    nodelet = NodeletStatus(
        "/n", "label", "/m", False, True, False, State.RUNNING, "", (port,), given
    )
    model = Message(nodelets=[messages.nodelet_message(nodelet)])
    assert messages.model_from(sent(model)).nodelets == (nodelet,)


counted = st.builds(
    PortStatistics,
    words,
    directions,
    words,
    messages=numbers,
    dropped=numbers,
    rate=seconds,
    mean_callback=st.just(0.5),
    max_callback=st.just(2.5),
    latched=st.just(False),
)


@given(st.builds(NodeletStatistics, seconds, numbers, numbers, st.tuples(counted)))
def test_statistics(statistics: NodeletStatistics) -> None:
    assert messages.statistics_from(sent(messages.statistics_message(statistics))) == statistics


def test_what_nobody_counts_is_not_zero() -> None:
    unknown = PortStatistics("in", IN, "/t", None, None, None, None, None)
    statistics = NodeletStatistics(1.0, 2, None, (unknown,))
    assert messages.statistics_from(sent(messages.statistics_message(statistics))) == statistics


@given(streams)
def test_claims(stream: StreamStatus) -> None:
    assert messages.stream_from(sent(messages.stream_message(stream))) == stream


@given(seconds, streams, words, st.booleans())
def test_events(stamp: float, stream: StreamStatus, reason: str, is_new: bool) -> None:
    before = None if is_new or not stream.claim_id else stream
    event = StreamEvent(stamp, before, stream, reason)
    assert messages.event_from(sent(messages.event_message(event))) == event


name_sets = st.sets(words).map(lambda labels: tuple(sorted(labels)))


@given(
    st.builds(
        StreamRequest,
        lease=seconds,
        max_silence=seconds,
        exclude=name_sets,
        min_rate=seconds,
        max_age=seconds,
        prefer=name_sets,
        avoid=name_sets,
        budget=seconds,
    ),
    st.booleans(),
)
def test_requests_for_streams(request: StreamRequest, dry_run: bool) -> None:
    message = sent(messages.acquire_message(request, dry_run))
    assert message.dry_run == dry_run
    assert messages.acquire_from(message) == request


@given(
    st.builds(
        Acquisition,
        spawned=st.tuples(words),
        reused=st.tuples(words, words),
        cost=seconds,
        expires=seconds,
        message=st.just("") | lines.filter(lambda line: not line.startswith("warning: ")),
        warnings=st.lists(lines, max_size=2).map(tuple),
        bindings=st.tuples(words),
        least_cost=seconds,
    )
)
def test_answers_that_are_yes(got: Acquisition) -> None:
    assert messages.acquisition_from(sent(messages.acquisition_message(got))) == got


@given(st.builds(Replanned, st.tuples(words), st.tuples(words, words), seconds, words, words))
def test_answers_to_replan(replanned: Replanned) -> None:
    assert messages.replanned_from(sent(messages.replanned_message(replanned))) == replanned


@given(words, st.sampled_from([each for each in Result if each is not Result.OK]), words)
def test_refusals(text: str, result: Result, claim_id: str) -> None:
    refusal = StreamRefused(text, result, claim_id)
    with pytest.raises(StreamRefused) as caught:
        messages.acquisition_from(sent(messages.refusal_message(refusal)))
    arrived = caught.value
    assert (str(arrived), arrived.result, arrived.claim_id) == (text, result, claim_id)


def test_numbers_are_those_of_the_messages() -> None:
    for result in Result:
        assert getattr(srv.AcquireStreamResponse, result.name) == result
