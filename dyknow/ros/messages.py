# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Conversion between DyKnow's values and the messages of ``dyknow_msgs``: all of it is here.

``x_message`` makes the message of a value, ``x_from`` the value of a message.
"""

from __future__ import annotations

import math
from typing import Any, List, Mapping, Sequence, Tuple

from dyknow_msgs import msg, srv
from genpy import Duration, Time

from dyknow.errors import Result, StreamRefused
from dyknow.model.graph import (
    Model,
    NodeletKind,
    NodeletStatus,
    PortState,
    SpawnRequest,
    State,
)
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.model.streams import (
    Acquisition,
    ClaimState,
    Replanned,
    StreamEvent,
    StreamRequest,
    StreamStatus,
)
from dyknow.model.transformation import IN, OUT, Parameter, Port, Transformation

#: Begins the lines of an answer to ``acquire_stream`` that are no detail of the claim.
_WARNING = "warning: "


# Ports and where they are connected


def direction_message(direction: str) -> int:
    """Write ``in`` or ``out`` as the number that messages use."""
    return int(msg.Port.OUT if direction == OUT else msg.Port.IN)


def _direction_from(message: Any) -> str:
    return OUT if message.direction == msg.Port.OUT else IN


def port_message(port: PortState) -> msg.Port:
    """Convert a port of a running nodelet."""
    return msg.Port(
        name=port.name,
        direction=direction_message(port.direction),
        datatype=port.datatype,
        topic=port.topic,
        tags=list(port.tags),
    )


def port_from(message: msg.Port) -> PortState:
    """Read a port of a running nodelet."""
    return PortState(
        message.name,
        _direction_from(message),
        message.datatype,
        message.topic,
        tuple(message.tags),
    )


def config_message(config: Mapping[str, str]) -> List[msg.PortConfig]:
    """Convert topics by port, sorted."""
    return [msg.PortConfig(port, topic) for port, topic in sorted(config.items())]


def config_pairs(config: Sequence[msg.PortConfig]) -> List[Tuple[str, str]]:
    """Read pairs of port and topic; a port may be named twice."""
    return [(entry.port, entry.topic) for entry in config]


# What can run


def _parameter_messages(parameters: Sequence[Parameter]) -> List[msg.Parameter]:
    return [msg.Parameter(*each) for each in parameters]


def parameters_from(messages: Sequence[msg.Parameter]) -> Tuple[Parameter, ...]:
    """Read parameters."""
    return tuple(Parameter(each.name, each.type, each.value) for each in messages)


def transformation_message(transformation: Transformation) -> msg.Transformation:
    """Convert a transformation."""
    return msg.Transformation(
        label=transformation.label,
        type=transformation.type,
        source=transformation.source,
        cost=transformation.cost,
        parameters=_parameter_messages(transformation.parameters),
        ports=[
            msg.Port(
                port.name,
                direction_message(port.direction),
                port.datatype,
                "",
                list(port.tags),
                port.rate,
                port.latency,
            )
            for port in transformation.ports
        ],
        specification=transformation.to_xml(),
        isolated=transformation.isolated,
        node=transformation.node,
    )


def transformation_from(message: msg.Transformation) -> Transformation:
    """Read a transformation."""
    return Transformation(
        message.label,
        message.source,
        message.type,
        message.cost,
        parameters_from(message.parameters),
        tuple(
            Port(
                each.name,
                _direction_from(each),
                each.datatype,
                tuple(each.tags),
                each.rate,
                each.latency,
            )
            for each in message.ports
        ),
        message.isolated,
        message.node,
    )


# What runs


def nodelet_message(nodelet: NodeletStatus) -> msg.Nodelet:
    """Convert a nodelet."""
    return msg.Nodelet(
        name=nodelet.name,
        transformation=nodelet.transformation,
        manager=nodelet.manager,
        is_protected=nodelet.is_protected,
        isolated=nodelet.isolated,
        rewired_by_reload=nodelet.rewired_by_reload,
        state=int(nodelet.state),
        detail=nodelet.detail,
        ports=[port_message(port) for port in nodelet.ports],
        kind=nodelet.kind.value,
        host=nodelet.host,
        parameters=_parameter_messages(nodelet.parameters),
    )


def _nodelet_from(message: msg.Nodelet) -> NodeletStatus:
    return NodeletStatus(
        message.name,
        message.transformation,
        message.manager,
        message.is_protected,
        message.isolated,
        message.rewired_by_reload,
        State(message.state),
        message.detail,
        tuple(port_from(port) for port in message.ports),
        parameters_from(message.parameters),
        NodeletKind(message.kind),
        message.host,
    )


def model_from(message: msg.Model) -> Model:
    """Read a model, as ``get_model`` answers or the topic ``~model`` carries it.

    Its message is put together in ``dyknow.ros.model_messages``.
    """
    return Model(
        message.revision,
        message.library_revision,
        tuple(_nodelet_from(each) for each in message.nodelets),
        tuple(transformation_from(each) for each in message.transformations),
    )


def spawn_message(request: SpawnRequest) -> srv.SpawnRequest:
    """Convert the request for a nodelet."""
    return srv.SpawnRequest(
        label=request.label,
        name=request.name,
        is_protected=request.is_protected,
        isolated=request.isolated,
        config=config_message(request.config),
        manager=request.manager,
        parameters=_parameter_messages(request.parameters),
    )


# What it has done


def statistics_message(statistics: NodeletStatistics) -> srv.GetStatisticsResponse:
    """Convert what a nodelet has done."""
    return srv.GetStatisticsResponse(
        uptime=Duration.from_sec(statistics.uptime),
        reconfigurations=statistics.reconfigurations,
        callback_errors=statistics.callback_errors or 0,
        ports=[
            msg.PortStatistics(
                port=each.port,
                direction=direction_message(each.direction),
                topic=each.topic,
                messages=each.messages or 0,
                dropped=each.dropped or 0,
                rate=math.nan if each.rate is None else each.rate,
                mean_callback=Duration.from_sec(each.mean_callback or 0.0),
                max_callback=Duration.from_sec(each.max_callback or 0.0),
            )
            for each in statistics.ports
        ],
    )


def statistics_from(answer: srv.GetStatisticsResponse) -> NodeletStatistics:
    """Read what a nodelet has done; a rate of NaN says that nobody counts."""
    ports = tuple(map(_port_statistics_from, answer.ports))
    is_counted = all(each.rate is not None for each in ports)
    return NodeletStatistics(
        answer.uptime.to_sec(),
        answer.reconfigurations,
        answer.callback_errors if is_counted else None,
        ports,
    )


def _port_statistics_from(message: msg.PortStatistics) -> PortStatistics:
    port = (message.port, _direction_from(message), message.topic)
    if math.isnan(message.rate):
        return PortStatistics(*port, None, None, None, None, None)
    return PortStatistics(
        *port,
        message.messages,
        message.dropped,
        message.rate,
        message.mean_callback.to_sec(),
        message.max_callback.to_sec(),
    )


def counts_message(nodelet: str, statistics: NodeletStatistics) -> msg.NodeletCounts:
    """Convert a nodelet's part of the answer of ``get_counts``."""
    return msg.NodeletCounts(
        nodelet=nodelet,
        uptime=Duration.from_sec(statistics.uptime),
        ports=[
            msg.PortCount(
                port=each.port,
                direction=direction_message(each.direction),
                messages=each.messages or 0,
                latched=each.latched,
                age=math.nan if each.age is None else each.age,
            )
            for each in sorted(statistics.ports, key=lambda each: each.port)
        ],
    )


# Streams


def stream_message(stream: StreamStatus) -> msg.StreamStatus:
    """Convert a claim."""
    return msg.StreamStatus(
        claim_id=stream.claim_id,
        client_id=stream.client_id,
        tag=stream.tag,
        topic=stream.topic,
        datatype=stream.datatype,
        state=int(stream.state),
        detail=stream.detail,
        nodelets=list(stream.nodelets),
        expires=Time.from_sec(stream.expires),
        bindings=list(stream.bindings),
    )


def stream_from(message: msg.StreamStatus) -> StreamStatus:
    """Read a claim."""
    return StreamStatus(
        message.claim_id,
        message.client_id,
        message.tag,
        message.topic,
        message.datatype,
        ClaimState(message.state),
        message.detail,
        tuple(message.nodelets),
        message.expires.to_sec(),
        tuple(message.bindings),
    )


def event_message(event: StreamEvent) -> msg.StreamEvent:
    """Convert a change of a claim."""
    return msg.StreamEvent(
        stamp=Time.from_sec(event.stamp),
        before=msg.StreamStatus() if event.before is None else stream_message(event.before),
        after=stream_message(event.after),
        reason=event.reason,
    )


def event_from(message: msg.StreamEvent) -> StreamEvent:
    """Read a change of a claim."""
    return StreamEvent(
        message.stamp.to_sec(),
        stream_from(message.before) if message.before.claim_id else None,
        stream_from(message.after),
        message.reason,
    )


def acquire_message(request: StreamRequest, dry_run: bool) -> srv.AcquireStreamRequest:
    """Convert the request for a stream."""
    return srv.AcquireStreamRequest(
        tag=request.tag,
        datatype=request.datatype,
        client_id=request.client_id,
        request_id=request.request_id,
        bond_id=request.bond_id,
        lease=Duration.from_sec(request.lease),
        max_silence=request.max_silence,
        exclude=list(request.exclude),
        dry_run=dry_run,
        min_rate=request.min_rate,
        max_age=request.max_age,
        prefer=list(request.prefer),
        avoid=list(request.avoid),
        budget=request.budget,
    )


def acquire_from(message: srv.AcquireStreamRequest) -> StreamRequest:
    """Read the request for a stream; its lists are sorted."""
    return StreamRequest(
        tag=message.tag,
        datatype=message.datatype,
        client_id=message.client_id,
        request_id=message.request_id,
        bond_id=message.bond_id,
        lease=message.lease.to_sec(),
        max_silence=message.max_silence,
        exclude=tuple(sorted(set(message.exclude))),
        min_rate=message.min_rate,
        max_age=message.max_age,
        prefer=tuple(sorted(set(message.prefer))),
        avoid=tuple(sorted(set(message.avoid))),
        budget=message.budget,
    )


def acquisition_message(got: Acquisition) -> srv.AcquireStreamResponse:
    """Convert what became of the request for a stream."""
    lines = [*filter(None, [got.message]), *(_WARNING + each for each in got.warnings)]
    return srv.AcquireStreamResponse(
        success=True,
        message="\n".join(lines),
        claim_id=got.claim_id,
        topic=got.topic,
        datatype=got.datatype,
        spawned=list(got.spawned),
        reused=list(got.reused),
        cost=got.cost,
        expires=Time.from_sec(got.expires),
        plan=got.plan,
        bindings=list(got.bindings),
        least_cost=got.least_cost,
    )


def acquisition_from(answer: srv.AcquireStreamResponse) -> Acquisition:
    """Read what became of the request for a stream.

    Raises:
        StreamRefused: it was refused.
    """
    if not answer.success:
        raise StreamRefused(answer.message, Result(answer.result), answer.claim_id)
    lines = answer.message.splitlines()
    return Acquisition(
        answer.claim_id,
        answer.topic,
        answer.datatype,
        tuple(answer.spawned),
        tuple(answer.reused),
        answer.cost,
        answer.expires.to_sec(),
        answer.plan,
        "\n".join(line for line in lines if not line.startswith(_WARNING)),
        tuple(line[len(_WARNING) :] for line in lines if line.startswith(_WARNING)),
        tuple(answer.bindings),
        answer.least_cost,
    )


def refusal_message(refusal: StreamRefused) -> srv.AcquireStreamResponse:
    """Convert the refusal of a stream."""
    return srv.AcquireStreamResponse(
        success=False,
        result=int(refusal.result),
        message=str(refusal),
        claim_id=refusal.claim_id,
    )


def replanned_message(replanned: Replanned) -> srv.ReplanStreamResponse:
    """Convert what became of a claim that was planned again."""
    return srv.ReplanStreamResponse(
        success=True,
        message=replanned.message,
        spawned=list(replanned.spawned),
        reused=list(replanned.reused),
        cost=replanned.cost,
        plan=replanned.plan,
    )


def replanned_from(answer: srv.ReplanStreamResponse) -> Replanned:
    """Read what became of a claim that was planned again."""
    return Replanned(
        tuple(answer.spawned), tuple(answer.reused), answer.cost, answer.plan, answer.message
    )
