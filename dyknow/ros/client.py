# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Clients of nodelets' proxies and of the DyKnow manager: every call has a time limit.

Answers are values of ``dyknow.model``. No client needs a node, so scripts and command lines can
use them without ``rospy.init_node``.
"""

from __future__ import annotations

import logging
import os
import re
import time
from functools import partial
from typing import Any, Callable, Mapping, Sequence, TypeVar

import rosgraph.names
from dyknow_msgs import msg, srv
from genpy import Duration

from dyknow import names
from dyknow.errors import ManagerUnreachable, PeerTimeout, Refused
from dyknow.locks import state_lock
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import Model, ParameterSet, PortState, Restarted, SpawnRequest
from dyknow.model.hosts import HostStatus
from dyknow.model.statistics import NodeletStatistics
from dyknow.model.streams import Acquisition, Replanned, StreamRequest, StreamStatus
from dyknow.model.transformation import Added, Parameter
from dyknow.ros.parameters import PrivateParameters
from dyknow.ros.process.os_process import has_begun
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.messages import (
    acquire_message,
    acquisition_from,
    config_message,
    host_from,
    model_from,
    port_from,
    replanned_from,
    spawn_message,
    statistics_from,
    stream_from,
)
from dyknow.ros.wire.service_client import ServiceClient, ServiceLost

T = TypeVar("T")

#: Seconds for calls that only ask.
ASK_TIMEOUT = 5.0
#: Seconds for calls that change something; a spawn may start a nodelet manager first.
CHANGE_TIMEOUT = 60.0
#: Seconds for the restart of a nodelet manager with all its nodelets.
RESTART_TIMEOUT = 300.0

#: Seconds to wait for the services of a manager that starts, between two looks, for its answer
#: that it is there, and from its start to its registration at most.
_STARTING, _AGAIN, _LOOK, _BEGINNING = 10.0, 0.1, 1.0, 60.0
#: Command lines of a manager that is being started, by rosrun and roslaunch too.
_MANAGER = re.compile(rb"(^|[\0/])dyknow[\0/]manager(\.launch)?(\0|$)")

_OWN_MANAGER = re.compile(r".*/dyknow_(cpp_)?nodelet_manager(_[0-9]+)?\Z")
#: The manager's parameter with the names of further nodelet managers.
_NAMED = "nodelet_managers"

#: Services whose answers say more than that it is done; their callers are given it.
_SPOKEN_OF = ("add_transformation", "replan_stream", "plan_stream", "set_parameter")

_log = logging.getLogger("rosout.dyknow")


class ProxyClient:
    """Calls the three services that the proxy of each nodelet offers.

    Every method raises ``Refused`` when the nodelet says no, ``HostError`` when the call fails,
    and ``PeerTimeout`` when no answer comes in time.
    """

    def __init__(self, master: Master) -> None:
        """Prepare calls in the name of the master's caller; nothing is sent yet."""
        self._master = master

    def get_config(self, nodelet: str, timeout: float = ASK_TIMEOUT) -> tuple[PortState, ...]:
        """Return the ports of a nodelet."""
        answer = self._call(names.join(nodelet, "get_config"), srv.GetConfig, timeout)
        return tuple(map(port_from, answer.ports))

    def set_config(
        self, nodelet: str, config: Mapping[str, str], timeout: float = CHANGE_TIMEOUT
    ) -> None:
        """Connect ports to topics, all or none; an empty topic disconnects."""
        service, request = names.join(nodelet, "set_config"), config_message(config)
        _accepted(self._call(service, srv.SetConfig, timeout, config=request))

    def get_statistics(self, nodelet: str, timeout: float = ASK_TIMEOUT) -> NodeletStatistics:
        """Return the counts of a nodelet and of its ports."""
        service = names.join(nodelet, "get_statistics")
        return statistics_from(self._call(service, srv.GetStatistics, timeout))

    def _call(self, service: str, kind: Any, timeout: float, *request: Any, **fields: Any) -> Any:
        return ServiceClient(self._master, service, kind).call(timeout, *request, **fields)


class ManagerClient(ProxyClient, BaseManagerClient):
    """Speaks with one DyKnow manager of the ROS graph, and with the proxies of nodelets."""

    def __init__(self, manager: str = "dyknow_manager", caller: str = "") -> None:
        """Prepare calls; nothing is sent yet.

        Args:
            manager: node name of the manager; a relative one begins in the namespace of the
                environment.
            caller: in whose name to call; by default a name of this process.
        """
        self.manager: str = rosgraph.names.script_resolve_name("dyknow", manager)
        super().__init__(Master(caller or f"/dyknow_client_{os.getpid()}"))
        self._kept_lock = state_lock("kept services")
        self._kept: dict[str, ServiceClient] = {}

    def close(self) -> None:
        """Close the connections that are kept; later calls look up their services again."""
        with self._kept_lock:
            kept = list(self._kept.values())
        for each in kept:
            each.close()

    # Transformations

    def add_transformation(self, specification: str) -> Added:
        answer = self._change(
            "add_transformation", srv.AddTransformation, specification=specification
        )
        return Added(tuple(answer.labels), answer.message)

    def remove_transformation(self, label: str) -> None:
        self._change("remove_transformation", srv.RemoveTransformation, label=label)

    # Nodelets

    def spawn_nodelet(self, request: SpawnRequest) -> None:
        self._change("spawn", srv.Spawn, spawn_message(request))

    def destroy(self, name: str) -> None:
        self._change("destroy", srv.Destroy, name=name)

    def restart(self, name: str) -> Restarted:
        answer = _accepted(self._ask("restart", srv.Restart, RESTART_TIMEOUT, name=name))
        return Restarted(tuple(answer.restarted), answer.message)

    def set_parameter(self, name: str, parameter: Parameter) -> ParameterSet:
        given = msg.Parameter(*parameter)
        answer = self._change("set_parameter", srv.SetParameter, name=name, parameter=given)
        return ParameterSet(answer.is_read, answer.message)

    def set_protection(self, name: str, is_protected: bool) -> None:
        self._change("set_protection", srv.SetProtection, name=name, is_protected=is_protected)

    def connect(self, moves: Sequence[tuple[str, Mapping[str, str]]]) -> None:
        nodelets = [msg.NodeletConfig(name, config_message(config)) for name, config in moves]
        self._change("connect", srv.Connect, nodelets=nodelets)

    def get_model(self, timeout: float = ASK_TIMEOUT) -> Model:
        return model_from(self._ask("get_model", srv.GetModel, timeout).model)

    def nodelet_managers(self) -> list[str]:
        try:
            given = self._master.ask("getParam", names.join(self.manager, _NAMED))
        except LookupError:
            given = []
        named = PrivateParameters({_NAMED: given}).nodes(_NAMED, self.manager)
        running = self._nodes_with("/load_nodelet")
        return [each for each in running if each in named or self.is_own_manager(each)]

    def is_own_manager(self, name: str) -> bool:
        """Whether a nodelet manager is one that the DyKnow manager starts when it is needed."""
        is_beside = names.parent(name) == names.parent(self.manager)
        return is_beside and bool(_OWN_MANAGER.match(name))

    def list_hosts(self) -> tuple[HostStatus, ...]:
        answer = self._ask("list_hosts", srv.ListHosts, ASK_TIMEOUT)
        return tuple(map(host_from, answer.hosts))

    # Streams; connections for frequent calls are kept, so that a later renewal of a lease
    # needs no master

    def acquire_stream(
        self, request: StreamRequest, dry_run: bool = False, timeout: float = CHANGE_TIMEOUT
    ) -> Acquisition:
        message = acquire_message(request, dry_run)
        return acquisition_from(self._ask("acquire_stream", srv.AcquireStream, timeout, message))

    def release_stream(self, claim_id: str) -> None:
        self._change("release_stream", srv.ReleaseStream, claim_id=claim_id)

    def renew_stream(self, claim_id: str, lease: float) -> float:
        fields = {"claim_id": claim_id, "lease": Duration.from_sec(lease)}
        answer = self._ask("renew_stream", srv.RenewStream, ASK_TIMEOUT, kept=True, **fields)
        return float(_accepted(answer).expires.to_sec())

    def replan_stream(self, claim_id: str, dry_run: bool = False) -> Replanned:
        return replanned_from(
            self._change("replan_stream", srv.ReplanStream, claim_id=claim_id, dry_run=dry_run)
        )

    def plan_stream(self, claim_id: str, exclude: Sequence[str]) -> Replanned:
        return replanned_from(
            self._change("plan_stream", srv.PlanStream, claim_id=claim_id, exclude=exclude)
        )

    def list_streams(self, timeout: float = ASK_TIMEOUT) -> tuple[StreamStatus, ...]:
        answer = self._ask("list_streams", srv.ListStreams, timeout, kept=True)
        return tuple(map(stream_from, answer.streams))

    def find_bindings(self, tag: str, datatype: str = "") -> tuple[str, ...]:
        answer = self._ask(
            "find_bindings", srv.FindBindings, ASK_TIMEOUT, tag, datatype, kept=True
        )
        if _accepted(answer).message:
            _log.warning("%s: %s", tag, answer.message)
        return tuple(answer.bindings)

    # Inside

    def _ask(self, service: str, kind: Any, timeout: float, *request: Any, **fields: Any) -> Any:
        """Call a service of the manager."""
        return self._call(names.join(self.manager, service), kind, timeout, *request, **fields)

    def _change(self, service: str, kind: Any, *request: Any, **fields: Any) -> Any:
        """Call a service of the manager whose answer may be no."""
        answer = _accepted(self._ask(service, kind, CHANGE_TIMEOUT, *request, **fields))
        if answer.message and service not in _SPOKEN_OF:
            _log.warning("%s", answer.message)
        return answer

    def _call(
        self,
        service: str,
        kind: Any,
        timeout: float,
        *request: Any,
        kept: bool = False,
        **fields: Any,
    ) -> Any:
        """Call a service, over a new connection, or over one that is kept for later calls."""
        call = partial(super()._call, service, kind, timeout, *request, **fields)
        if kept:
            with self._kept_lock:
                if service not in self._kept:
                    client = ServiceClient(self._master, service, kind, persistent=True)
                    self._kept[service] = client
                call = partial(self._kept[service].call, timeout, *request, **fields)
        return self._once_up(call, timeout) if names.parent(service) == self.manager else call()

    def _once_up(self, ask: Callable[[], T], seconds: float) -> T:
        """Query the manager, and repeat the query while it is starting and offers no answer."""
        deadline = time.monotonic() + min(seconds, _STARTING)
        while True:
            try:
                return ask()
            except (ServiceLost, PeerTimeout, LookupError, ConnectionRefusedError) as error:
                is_late = not is_unoffered(error) or time.monotonic() > deadline
                if is_late or not (self._is_there() or self._is_beginning()):
                    raise
            time.sleep(_AGAIN)

    def _is_there(self) -> bool:
        """Whether a node of the manager's name answers."""
        return self._master.pid_of(self.manager, _LOOK) > 0

    def _is_beginning(self) -> bool:
        """Whether a manager was started on this host that has not registered yet."""
        if not has_begun(_MANAGER, rosgraph.ROS_MASTER_URI, _BEGINNING):
            return False
        try:
            return {*self._nodes_with("/add_transformation")} <= {self.manager}  # else another
        except (ManagerUnreachable, PeerTimeout):
            return True  # roslaunch starts a master, too

    def _nodes_with(self, service: str) -> list[str]:
        """Return the nodes that offer a service of such a name, sorted."""
        _, _, services = self._master.ask("getSystemState")
        return sorted(name[: -len(service)] for name, _ in services if name.endswith(service))


def is_unoffered(error: BaseException) -> bool:
    """Whether a query reached no process, since its service or topic is missing."""
    return isinstance(error.__cause__ or error, (LookupError, ConnectionRefusedError))


def _accepted(answer: Any) -> Any:
    if not answer.success:
        raise Refused(answer.message)
    return answer
