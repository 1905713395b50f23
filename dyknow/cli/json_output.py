# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What `--json` prints. Programs rely on it: keys may be added, never changed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Dict, List, Sequence

from dyknow.cli.views import state_of
from dyknow.model.graph import PortState
from dyknow.model.transformation import Parameter, Transformation
from dyknow.wiring.ports import by_name

if TYPE_CHECKING:
    from dyknow.model.graph import NodeletStatus
    from dyknow.model.statistics import NodeletStatistics
    from dyknow.model.streams import StreamEvent, StreamStatus

Json = Dict[str, Any]


def port_json(port: PortState) -> Json:
    """A port of a running nodelet."""
    return {
        "name": port.name,
        "direction": port.direction,
        "datatype": port.datatype,
        "topic": port.topic,
        "tags": list(port.tags),
    }


def nodelet_json(nodelet: NodeletStatus) -> Json:
    """A running nodelet."""
    return {
        "name": nodelet.name,
        "transformation": nodelet.transformation,
        "manager": nodelet.manager,
        "protected": nodelet.is_protected,
        "isolated": nodelet.isolated,
        "fixed": nodelet.is_fixed,
        "kind": nodelet.kind.value,
        "host": nodelet.host,
        "state": state_of(nodelet),
        "detail": nodelet.detail,
        "ports": [port_json(port) for port in by_name(nodelet.ports)],
        "parameters": _parameters_json(nodelet.parameters),
    }


def _parameters_json(parameters: Sequence[Parameter]) -> List[Json]:
    return [{"name": each.name, "type": each.type, "value": each.text} for each in parameters]


def transformation_json(transformation: Transformation) -> Json:
    """A transformation of the library."""
    return {
        "label": transformation.label,
        "type": transformation.type,
        "source": transformation.source,
        "node": transformation.node,
        "isolated": transformation.isolated,
        "cost": transformation.cost,
        "parameters": _parameters_json(transformation.parameters),
        "ports": [
            {
                "name": port.name,
                "direction": port.direction,
                "datatype": port.datatype,
                "tags": list(port.tags),
            }
            for port in transformation.ports
        ],
        "specification": transformation.to_xml(),
    }


def statistics_json(name: str, statistics: NodeletStatistics) -> Json:
    """The statistics of a nodelet; times in s, rates in Hz, null where nothing is counted."""
    return {
        "nodelet": name,
        "uptime": statistics.uptime,
        "reconfigurations": statistics.reconfigurations,
        "callback_errors": statistics.callback_errors,
        "ports": [
            {
                "name": port.port,
                "direction": port.direction,
                "topic": port.topic,
                "messages": port.messages,
                "dropped": port.dropped,
                "rate": port.rate,
                "mean_callback": port.mean_callback,
                "max_callback": port.max_callback,
            }
            for port in sorted(statistics.ports, key=lambda port: port.port)
        ],
    }


def stream_json(stream: StreamStatus) -> Json:
    """A claim; its lease ends at `expires`, in seconds of ROS time, or never if that is null."""
    return {
        "claim": stream.claim_id,
        "client": stream.client_id,
        "tag": stream.tag,
        "topic": stream.topic,
        "datatype": stream.datatype,
        "state": stream.state.name.lower(),
        "detail": stream.detail,
        "nodelets": list(stream.nodelets),
        "expires": stream.expires or None,
        "bindings": list(stream.bindings),
    }


def event_json(event: StreamEvent) -> Json:
    """A change of a claim; ``before`` is null for a new one."""
    return {
        "stamp": event.stamp,
        "before": stream_json(event.before) if event.before is not None else None,
        "after": stream_json(event.after),
        "reason": event.reason,
    }
