"""A client of the DyKnow manager: typed, with a time limit for every call, answers as values.

It needs no node: scripts and command lines can use it without ``rospy.init_node``.
"""

from __future__ import annotations

import logging
import os
import threading
from dataclasses import dataclass
from typing import Any, Dict, Mapping, Optional, Tuple

import rosgraph.names
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import (
    AcquireStream,
    AddTransformation,
    Destroy,
    GetConfig,
    GetModel,
    GetStatistics,
    ListStreams,
    ReleaseStream,
    RemoveTransformation,
    RenewStream,
    ReplanStream,
    SetConfig,
    SetProtection,
    Spawn,
)
from genpy import Duration

from dyknow import names
from dyknow.errors import Refused
from dyknow.model.graph import PortState
from dyknow.model.streams import StreamRequest
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient
from dyknow.ros.stream_views import (
    AcquiredView,
    ReplannedView,
    StreamView,
    acquired_view,
    replanned_view,
    stream_view,
)
from dyknow.ros.views import ModelView, Statistics, model_view, port_view, statistics_view

#: Seconds for calls that only ask.
ASK_TIMEOUT = 5.0
#: Seconds for calls that change something; a spawn may start a nodelet manager first.
CHANGE_TIMEOUT = 60.0

#: Services whose answers say more than that it is done; their callers are given it.
_SPOKEN_OF = ("add_transformation", "replan_stream")

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class Added:
    """What ``add_transformation`` added.

    Attributes:
        labels: of what was added or replaced.
        warnings: what is probably not meant, one a line.
    """

    labels: Tuple[str, ...]
    warnings: str


class ManagerClient:
    """Speaks with one DyKnow manager, and with the proxies of nodelets.

    Every method raises ``Refused`` when the answer is no, ``HostError`` when nobody is there to
    answer, and ``PeerTimeout`` when no answer comes in time.
    """

    def __init__(self, manager: str = "dyknow_manager", caller: str = "") -> None:
        """Prepare calls; nothing is sent yet.

        Args:
            manager: node name of the manager; a relative one begins in the namespace of the
                environment.
            caller: in whose name to call; by default a name of this process.
        """
        self.manager: str = rosgraph.names.script_resolve_name("dyknow", manager)
        self._master = Master(caller or f"/dyknow_client_{os.getpid()}")
        self._lock = threading.Lock()
        self._kept: Dict[str, ServiceClient] = {}

    # Transformations

    def add_transformation(self, specification: str) -> Added:
        """Add what a specification (XML text) says."""
        answer = self._change("add_transformation", AddTransformation, specification=specification)
        return Added(tuple(answer.labels), answer.message)

    def remove_transformation(self, label: str) -> None:
        """Remove a transformation."""
        self._change("remove_transformation", RemoveTransformation, label=label)

    # Nodelets

    def spawn(
        self,
        label: str,
        name: str,
        config: Optional[Mapping[str, str]] = None,
        is_protected: bool = False,
        isolated: bool = False,
        manager: str = "",
    ) -> None:
        """Make a nodelet; it runs and is connected when this returns.

        Args:
            label: of the transformation.
            name: of the nodelet; a relative one begins in the manager's namespace.
            config: topics by port.
            is_protected: refuse to destroy it.
            isolated: give it a process of its own.
            manager: nodelet manager; empty for the manager's choice.
        """
        self._change(
            "spawn",
            Spawn,
            label=label,
            name=name,
            is_protected=is_protected,
            isolated=isolated,
            config=_pairs(config or {}),
            manager=manager,
        )

    def destroy(self, name: str) -> None:
        """Destroy a nodelet."""
        self._change("destroy", Destroy, name=name)

    def set_protection(self, name: str, is_protected: bool) -> None:
        """Protect a nodelet from being destroyed, or release it."""
        self._change("set_protection", SetProtection, name=name, is_protected=is_protected)

    def get_model(self, timeout: float = ASK_TIMEOUT) -> ModelView:
        """Ask what runs and what can run."""
        service = names.join(self.manager, "get_model")
        return model_view(self._call(service, GetModel, timeout).model)

    # Proxies

    def get_config(self, nodelet: str) -> Tuple[PortState, ...]:
        """Ask a nodelet for its ports."""
        answer = self._call(names.join(nodelet, "get_config"), GetConfig, ASK_TIMEOUT)
        return tuple(port_view(port) for port in answer.ports)

    def set_config(self, nodelet: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet, all or none; an empty topic disconnects."""
        service = names.join(nodelet, "set_config")
        answer = self._call(service, SetConfig, CHANGE_TIMEOUT, config=_pairs(config))
        if not answer.success:
            raise Refused(answer.message)

    def get_statistics(self, nodelet: str) -> Statistics:
        """Ask a nodelet what it has done."""
        answer = self._call(names.join(nodelet, "get_statistics"), GetStatistics, ASK_TIMEOUT)
        return statistics_view(answer)

    # Streams

    def acquire_stream(
        self, request: StreamRequest, dry_run: bool = False, timeout: float = CHANGE_TIMEOUT
    ) -> AcquiredView:
        """Ask for a stream, or with ``dry_run`` for how it would be made.

        Raises:
            StreamRefused: it cannot be made now; the claim it names is made when it can.
        """
        answer = self._call(
            names.join(self.manager, "acquire_stream"),
            AcquireStream,
            timeout,
            tag=request.tag,
            datatype=request.datatype,
            client_id=request.client_id,
            request_id=request.request_id,
            bond_id=request.bond_id,
            lease=Duration.from_sec(request.lease),
            max_silence=request.max_silence,
            exclude=list(request.exclude),
            dry_run=dry_run,
        )
        return acquired_view(answer)

    def release_stream(self, claim_id: str) -> None:
        """End a claim; ending it again is no error."""
        self._change("release_stream", ReleaseStream, claim_id=claim_id)

    def renew_stream(self, claim_id: str, lease: float) -> float:
        """Let a claim live for so many seconds from now, 0 for until it is released.

        The connection is kept, so that a later renewal needs no master.

        Returns:
            When it ends, in seconds of ROS time; 0 for until it is released.
        """
        answer = self._call(
            names.join(self.manager, "renew_stream"),
            RenewStream,
            ASK_TIMEOUT,
            kept=True,
            claim_id=claim_id,
            lease=Duration.from_sec(lease),
        )
        if not answer.success:
            raise Refused(answer.message)
        return float(answer.expires.to_sec())

    def replan_stream(self, claim_id: str, dry_run: bool = False) -> ReplannedView:
        """Take the way that is the cheapest now."""
        answer = self._change("replan_stream", ReplanStream, claim_id=claim_id, dry_run=dry_run)
        return replanned_view(answer)

    def list_streams(self, timeout: float = ASK_TIMEOUT) -> Tuple[StreamView, ...]:
        """Ask for all claims, those that ended lately too; the connection is kept."""
        service = names.join(self.manager, "list_streams")
        answer = self._call(service, ListStreams, timeout, kept=True)
        return tuple(stream_view(each) for each in answer.streams)

    # Inside

    def _change(self, service: str, service_class: Any, **fields: Any) -> Any:
        answer = self._call(
            names.join(self.manager, service), service_class, CHANGE_TIMEOUT, **fields
        )
        if not answer.success:
            raise Refused(answer.message)
        if answer.message and service not in _SPOKEN_OF:
            _log.warning("%s", answer.message)
        return answer

    def _call(
        self, service: str, service_class: Any, timeout: float, kept: bool = False, **fields: Any
    ) -> Any:
        client = self._service(self._master, service, service_class, kept)
        return client.call(timeout, **fields)

    def _service(
        self, master: Master, service: str, service_class: Any, kept: bool
    ) -> ServiceClient:
        """Return a client for one call, or one whose connection is kept for the next."""
        if not kept:
            return ServiceClient(master, service, service_class)
        with self._lock:
            if service not in self._kept:
                made = ServiceClient(master, service, service_class, persistent=True)
                self._kept[service] = made
            return self._kept[service]


def _pairs(config: Mapping[str, str]) -> list[PortConfig]:
    ordered: Dict[str, str] = dict(sorted(config.items()))
    return [PortConfig(port, topic) for port, topic in ordered.items()]
