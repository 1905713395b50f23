# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The state of the manager, its nodelets and claims on ``/diagnostics``.

Diagnostic tools of ROS group by the names of statuses. They are ``NODE: manager``, ``NODE: nodelet
NAME``, ``NODE: claim ID TAG`` and ``NODE: host NAME``, with the manager's node first.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Callable, Iterable, Mapping, NamedTuple, Sequence

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from dyknow_msgs.msg import NodeletCounts, Port

import dyknow
from dyknow.model.graph import Model, NodeletStatus, State
from dyknow.model.hosts import HostStatus
from dyknow.model.streams import ClaimState, StreamStatus

TOPIC = "/diagnostics"
_PERIOD = 1.0
_OK, _WARN, _ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
_OF_NODELETS = {
    State.STARTING: _WARN,
    State.RUNNING: _OK,
    State.LOST: _ERROR,
    State.FAILED: _ERROR,
}
_OF_CLAIMS = {ClaimState.ACTIVE: _OK, ClaimState.FAILED: _ERROR}


class Counted(NamedTuple):
    """Counts of a nodelet.

    Attributes:
        dropped: messages that its in-ports have dropped.
        errors: callbacks that have raised.
        recent_error: the last of these errors, if that was lately.
        lately: messages that were dropped since the last diagnostics.
    """

    dropped: int
    errors: int = 0
    recent_error: str = ""
    lately: int = 0

    @classmethod
    def of(cls, counts: NodeletCounts, before: Mapping[str, int]) -> Counted:
        """Read counts; ``before`` has the dropped messages of each nodelet before."""
        dropped = sum(each.dropped for each in counts.ports if each.direction == Port.IN)
        lately = dropped - before.get(counts.nodelet, dropped)
        return cls(dropped, counts.callback_errors, counts.recent_error, lately)


class DiagnosticsTopic:
    """Publishes the diagnostics once a second, while there are subscribers."""

    def __init__(
        self,
        model: Callable[[], Model],
        claims: Callable[[], Iterable[StreamStatus]],
        trouble: Callable[[], str],
        count: Callable[[], Iterable[NodeletCounts]],
        hosts: Callable[[], tuple[Sequence[HostStatus], float]],
    ) -> None:
        """Advertise the topic.

        ``trouble`` returns why changes are not on disk, empty if they are, and ``hosts`` the hosts
        and the seconds by which their clocks may differ.
        """
        self._model = model
        self._claims = claims
        self._trouble = trouble
        self._count = count
        self._hosts = hosts
        self._dropped: Mapping[str, int] = {}
        self._publisher = rospy.Publisher(TOPIC, DiagnosticArray, queue_size=1)
        self.close = self._publisher.unregister

    def publish(self) -> float:
        """Publish the present diagnostics; returns the seconds until the next."""
        if self._publisher.get_num_connections():
            node = rospy.get_name().lstrip("/")
            counted = {each.nodelet: Counted.of(each, self._dropped) for each in self._count()}
            self._dropped = {name: each.dropped for name, each in counted.items()}
            claims, trouble = list(self._claims()), self._trouble()
            found = statuses(node, self._model(), claims, trouble, counted, *self._hosts())
            array = DiagnosticArray(status=found)
            array.header.stamp = rospy.Time.now()
            self._publisher.publish(array)
        return _PERIOD


def statuses(
    node: str,
    model: Model,
    claims: Sequence[StreamStatus],
    trouble: str,
    counted: Mapping[str, Counted] = MappingProxyType({}),
    hosts: Sequence[HostStatus] = (),
    max_offset: float = 0.0,
) -> list[DiagnosticStatus]:
    """Describe the manager, each nodelet, each claim that has not ended, and each host.

    ``max_offset`` is the number of seconds by which the clocks of the hosts may differ.
    """
    claims = [each for each in claims if not each.state.ended]
    running = sum(each.state is State.RUNNING for each in model.nodelets)
    values = {
        "version": dyknow.__version__,
        "nodelets": str(len(model.nodelets)),
        "running": str(running),
        "claims": str(len(claims)),
    }
    return [
        _status(f"{node}: manager", _WARN if trouble else _OK, trouble or "answers", node, values),
        *(_of_nodelet(node, each, counted.get(each.name)) for each in model.nodelets),
        *(_of_claim(node, each) for each in claims),
        *(_of_host(node, each, max_offset) for each in hosts),
    ]


def _of_nodelet(node: str, nodelet: NodeletStatus, counted: Counted | None) -> DiagnosticStatus:
    level = _OF_NODELETS[nodelet.state]
    values = {
        "state": nodelet.state.name,
        "kind": nodelet.kind.value,
        "transformation": nodelet.transformation,
        "node": nodelet.node,
        "host": nodelet.host,
        "owner": nodelet.owner,
        **{f"port {name}": topic for name, topic in nodelet.connections.items()},
    }
    details = [nodelet.detail] if nodelet.detail else []
    if counted is not None:
        values["dropped"] = str(counted.dropped)
        values["callback errors"] = str(counted.errors)
        details += [f"dropped {counted.lately} messages"] if counted.lately > 0 else []
        details += [counted.recent_error] if counted.recent_error else []
    level = max(level, _WARN) if details else level
    message = "; ".join(details) or nodelet.state.name.lower()
    return _status(f"{node}: nodelet {nodelet.name}", level, message, nodelet.host, values)


def _of_claim(node: str, claim: StreamStatus) -> DiagnosticStatus:
    level = _OF_CLAIMS.get(claim.state, _WARN)
    values = {
        "state": claim.state.name,
        "client": claim.client_id,
        "topic": claim.topic,
        "type": claim.datatype,
        "nodelets": ", ".join(claim.nodelets),
        "bindings": " ".join(claim.bindings),
    }
    message = claim.detail or claim.state.name.lower()
    return _status(f"{node}: claim {claim.claim_id} {claim.tag}", level, message, node, values)


def _of_host(node: str, host: HostStatus, limit: float) -> DiagnosticStatus:
    problems = ["none of its processes answers"] if host.is_away else []
    if host.clock.exceeds(limit):
        problems.append(f"its clock differs by {host.offset:+.3f} s")
    values = {
        "address": host.address,
        "nodelet managers": ", ".join(host.managers),
        "nodelets": str(len(host.nodelets)),
        "load": f"{host.load:.2f}",
        "memory": f"{host.memory:.2f}",
        "clock offset": f"{host.offset:.6f}",
        "clock offset error": f"{host.error:.6f}",
    }
    level, message = _WARN if problems else _OK, "; ".join(problems) or "answers"
    return _status(f"{node}: host {host.name}", level, message, host.name, values)


def _status(
    name: str, level: int, message: str, hardware: str, values: Mapping[str, str]
) -> DiagnosticStatus:
    pairs = [KeyValue(key, value) for key, value in values.items()]
    return DiagnosticStatus(level, name, message, hardware, pairs)
