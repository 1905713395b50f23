# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Conversion between the values of ``dyknow.model`` and the messages of ``dyknow_msgs``.

``x_message`` makes the message of a value, ``x_from`` the value of a message. Fields that have the
same name on both sides are converted by their type; the functions state only the rest.
``model_messages`` puts the message of a model together.
"""

from __future__ import annotations

import dataclasses
import enum
import math
import re
from functools import lru_cache, partial
from operator import attrgetter
from typing import Any, Callable, Mapping, Sequence, TypeVar

from dyknow_msgs import msg, srv
from genpy import Duration, Time, TVal

from dyknow.errors import BadParameter, Result, StreamRefused
from dyknow.guards import Guards
from dyknow.model.graph import OWNER, Model, NodeletKind, NodeletStatus, PortState, State
from dyknow.model.hosts import UNKNOWN_MACHINE, HostStatus, Machine
from dyknow.model.statistics import NodeletCount, NodeletStatistics, PortCount, PortStatistics
from dyknow.model.streams import (
    Acquisition,
    ClaimState,
    Replanned,
    StreamEvent,
    StreamRequest,
    StreamStatus,
)
from dyknow.model.transformation import (
    IN,
    OUT,
    Parameter,
    Port,
    Transformation,
    read_requirements,
)

T = TypeVar("T")

_ABSENT = object()
#: Begins the types of messages that are in others.
_OURS = "dyknow_msgs/"
#: Prefix of the lines of an answer to ``acquire_stream`` that are warnings.
_WARNING = "warning: "
#: The end of a nodelet's detail that names its owner.
_OWNER = re.compile(rf"(?:\A|; ){OWNER}(/\S+)\Z")
#: Types of times, and the number of seconds that they cannot hold any more.
_SECONDS = {"duration": (Duration, 2**31), "time": (Time, 2**32)}


def _message(message_class: Any, value: object, /, **fields: object) -> Any:
    """Make a message from ``fields``, and the rest from the attributes of a value.

    An unknown one, of None, is a NaN in a message, or else 0 or empty.
    """
    for name, unknown, convert in _converters(message_class):
        if name not in fields:
            attribute = getattr(value, name, _ABSENT)
            if attribute is None:
                fields.update(unknown)
            elif attribute is not _ABSENT:
                fields[name] = convert(attribute)
    return message_class(**fields)


@lru_cache(maxsize=None)
def _converters(
    message_class: Any,
) -> list[tuple[str, Mapping[str, float], Callable[[Any], object]]]:
    """List the names of the fields, each with the field if it is unknown, and its conversion."""
    return [
        (name, {name: math.nan} if kind.startswith("float") else {}, _converter(name, kind))
        for name, kind in zip(message_class.__slots__, message_class._slot_types)
    ]


def _converter(name: str, kind: str) -> Callable[[Any], object]:
    """Return the conversion of attributes to a field of a type."""
    if name == "direction":
        return direction_message
    if kind == f"{_OURS}Parameter[]":
        return lambda value: [msg.Parameter(*each) for each in value]
    if kind == f"{_OURS}PortConfig[]":
        return config_message
    if kind.startswith(_OURS):
        class_name, is_list, _ = kind[len(_OURS) :].partition("[")
        make = partial(_message, getattr(msg, class_name))
        return (lambda value: list(map(make, value))) if is_list else make
    return partial(_time, name, *_SECONDS[kind]) if kind in _SECONDS else _plain


def _time(name: str, time_class: type[TVal], end: int, seconds: float) -> TVal:
    if not abs(seconds) < end:
        raise BadParameter(name, seconds, f"seconds below {end}")
    return time_class.from_sec(seconds)


def _plain(value: object) -> object:
    if isinstance(value, enum.Enum):
        return value.value
    return list(value) if isinstance(value, tuple) else value


def _value(value_class: Callable[..., T], message: Any, /, **attributes: object) -> T:
    """Make a value from ``attributes``, and the rest from the fields of a message."""
    for name in _names(value_class):
        if name not in attributes:
            field = getattr(message, name, _ABSENT)
            if name == "direction":
                attributes[name] = direction_from(message)
            elif isinstance(field, TVal):
                attributes[name] = field.to_sec()
            elif field is not _ABSENT:
                attributes[name] = tuple(field) if isinstance(field, list) else field
    return value_class(**attributes)


@lru_cache(maxsize=None)
def _names(value_class: Any) -> Sequence[str]:
    """List the names of the attributes that make a value."""
    named = getattr(value_class, "_fields", None)
    return named or [each.name for each in dataclasses.fields(value_class)]


# Ports and where they are connected


def direction_message(direction: str) -> int:
    return int(msg.Port.OUT if direction == OUT else msg.Port.IN)


def direction_from(message: Any) -> str:
    return OUT if message.direction == msg.Port.OUT else IN


port_message = partial(_message, msg.Port)


def port_from(message: msg.Port) -> PortState:
    return _value(PortState, message)


def config_message(config: Mapping[str, str]) -> list[msg.PortConfig]:
    return [msg.PortConfig(port, topic) for port, topic in sorted(config.items())]


def config_pairs(config: Sequence[msg.PortConfig]) -> list[tuple[str, str]]:
    """Read pairs of port and topic; a port may be named twice."""
    return [(entry.port, entry.topic) for entry in config]


# Transformations and nodelets


def parameters_from(messages: Sequence[msg.Parameter]) -> tuple[Parameter, ...]:
    return tuple(Parameter(each.name, each.type, each.value) for each in messages)


def transformation_message(transformation: Transformation) -> msg.Transformation:
    return _message(msg.Transformation, transformation, specification=transformation.to_xml())


def transformation_from(message: msg.Transformation) -> Transformation:
    ports = (_value(Port, each) for each in message.ports)
    parameters = parameters_from(message.parameters)
    requires = read_requirements(message.specification)
    return _value(
        Transformation, message, parameters=parameters, ports=tuple(ports), requires=requires
    )


def nodelet_message(nodelet: NodeletStatus) -> msg.Nodelet:
    owner = f"{OWNER}{nodelet.owner}" if nodelet.owner else ""
    detail = "; ".join(filter(None, (nodelet.detail, owner)))
    return _message(msg.Nodelet, nodelet, detail=detail)


def _nodelet_from(message: msg.Nodelet) -> NodeletStatus:
    found = _OWNER.search(message.detail)
    return _value(
        NodeletStatus,
        message,
        detail=message.detail[: found.start()] if found else message.detail,
        owner=found[1] if found else "",
        state=State(message.state),
        ports=tuple(map(port_from, message.ports)),
        parameters=parameters_from(message.parameters),
        kind=NodeletKind(message.kind),
    )


def model_from(message: msg.Model) -> Model:
    return Model(
        message.revision,
        message.library_revision,
        tuple(map(_nodelet_from, message.nodelets)),
        tuple(map(transformation_from, message.transformations)),
    )


spawn_message = partial(_message, srv.SpawnRequest)


# Hosts


def machine_from(message: msg.Machine) -> Machine:
    """Read the machine of a process; a stock nodelet manager does not describe it."""
    return _value(Machine, message) if message.cores else UNKNOWN_MACHINE


host_message = partial(_message, msg.HostStatus)


def host_from(message: msg.HostStatus) -> HostStatus:
    return _value(HostStatus, message)


# Statistics: a rate or an age of NaN is unknown


def statistics_message(statistics: NodeletStatistics) -> srv.GetStatisticsResponse:
    ports = sorted(statistics.ports, key=attrgetter("port"))
    return _message(
        srv.GetStatisticsResponse,
        statistics,
        ports=[_message(msg.PortStatistics, each) for each in ports],
    )


def statistics_from(answer: srv.GetStatisticsResponse) -> NodeletStatistics:
    ports = tuple(map(_port_statistics_from, answer.ports))
    is_counted = all(each.rate is not None for each in ports)
    errors = answer.callback_errors if is_counted else None
    return _value(NodeletStatistics, answer, callback_errors=errors, ports=ports)


def _port_statistics_from(message: msg.PortStatistics) -> PortStatistics:
    if math.isnan(message.rate):
        return PortStatistics(message.port, direction_from(message), message.topic, *(None,) * 5)
    return _value(PortStatistics, message)


def counts_message(nodelet: str, statistics: NodeletStatistics, busy: float) -> msg.NodeletCounts:
    """Make the counts of a nodelet whose callbacks have taken so many seconds."""
    ports = sorted(statistics.ports, key=attrgetter("port"))
    fields = {"nodelet": nodelet, "ports": [_message(msg.PortCount, each) for each in ports]}
    return _message(msg.NodeletCounts, statistics, busy=busy, **fields)


def counts_from(message: msg.Counts) -> tuple[NodeletCount, ...]:
    return tuple(map(_count_from, message.nodelets))


def _count_from(message: msg.NodeletCounts) -> NodeletCount:
    ports = {each.port: _port_count_from(each) for each in message.ports}
    cpu, memory = message.cpu or None, message.memory or None
    return _value(NodeletCount, message, ports=ports, cpu=cpu, memory=memory)


def _port_count_from(message: msg.PortCount) -> PortCount:
    age = None if math.isnan(message.age) else message.age
    return _value(PortCount, message, age=age)


# Guards of one manager, which has one allow list at most


def guards_message(guards: Guards, protected: Sequence[str] = ()) -> msg.Guards:
    return _message(
        msg.Guards,
        guards,
        are_topics_limited=bool(guards.allowed_topics),
        allowed_topics=[each for patterns in guards.allowed_topics for each in patterns],
        are_programs_limited=bool(guards.allowed_programs),
        allowed_programs=[each for patterns in guards.allowed_programs for each in patterns],
        protected_nodelets=list(protected),
    )


def guards_from(message: msg.Guards) -> Guards:
    topics, programs = tuple(message.allowed_topics), tuple(message.allowed_programs)
    return _value(
        Guards,
        message,
        allowed_topics=(topics,) if message.are_topics_limited else (),
        allowed_programs=(programs,) if message.are_programs_limited else (),
    )


# Streams

stream_message = partial(_message, msg.StreamStatus)


def stream_from(message: msg.StreamStatus) -> StreamStatus:
    return _value(StreamStatus, message, state=ClaimState(message.state))


event_message = partial(_message, msg.StreamEvent)


def event_from(message: msg.StreamEvent) -> StreamEvent:
    before = stream_from(message.before) if message.before.claim_id else None
    return _value(StreamEvent, message, before=before, after=stream_from(message.after))


def acquire_message(request: StreamRequest, dry_run: bool) -> srv.AcquireStreamRequest:
    return _message(srv.AcquireStreamRequest, request, dry_run=dry_run)


def acquire_from(message: srv.AcquireStreamRequest) -> StreamRequest:
    """Read the request for a stream; its lists are sorted."""
    labels = {
        name: tuple(sorted(set(getattr(message, name)))) for name in ("exclude", "prefer", "avoid")
    }
    return _value(StreamRequest, message, **labels)


def acquisition_message(got: Acquisition) -> srv.AcquireStreamResponse:
    lines = [*filter(None, [got.message]), *(_WARNING + each for each in got.warnings)]
    return _message(srv.AcquireStreamResponse, got, success=True, message="\n".join(lines))


def acquisition_from(answer: srv.AcquireStreamResponse) -> Acquisition:
    """Read the answer to the request for a stream; raises `StreamRefused` if it was refused."""
    if not answer.success:
        raise StreamRefused(answer.message, Result(answer.result), answer.claim_id)
    lines = answer.message.splitlines()
    return _value(
        Acquisition,
        answer,
        message="\n".join(line for line in lines if not line.startswith(_WARNING)),
        warnings=tuple(line[len(_WARNING) :] for line in lines if line.startswith(_WARNING)),
    )


def refusal_message(refusal: StreamRefused) -> srv.AcquireStreamResponse:
    return _message(srv.AcquireStreamResponse, refusal, success=False, message=str(refusal))


replanned_message = partial(_message, srv.ReplanStreamResponse, success=True)
planned_message = partial(_message, srv.PlanStreamResponse, success=True)


def replanned_from(answer: srv.ReplanStreamResponse | srv.PlanStreamResponse) -> Replanned:
    return _value(Replanned, answer)
