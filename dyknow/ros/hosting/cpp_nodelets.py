"""The proxy's three services for plain C++ nodelets, offered by the manager in their place.

Such a nodelet has no ports that can be moved: what connects it elsewhere is a reload with other
remappings, which the manager does. What goes through it nobody counts.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, Dict, List

import rospy
from dyknow_msgs.srv import (
    GetConfig,
    GetConfigResponse,
    GetStatistics,
    GetStatisticsResponse,
    SetConfig,
    SetConfigResponse,
)

from dyknow import names
from dyknow.errors import DuplicatePort, DyKnowError, UnknownNodelet
from dyknow.locks import turn_lock
from dyknow.manager.manager import Manager
from dyknow.manager.record import Record
from dyknow.model.graph import State
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.ros.log_text import for_log
from dyknow.ros.messages import config_pairs, port_message, statistics_message
from dyknow.ros.nodelets.guard_parameters import caller_of


class CppNodelet:
    """Stands in for the proxy of one C++ nodelet."""

    def __init__(self, manager: Manager, name: str) -> None:
        """Offer its services."""
        self._manager = manager
        self._name = name
        self._since = time.monotonic()
        self._reconfigurations = 0
        self._services: List[Any] = []
        for service, service_class, handler in (
            ("get_config", GetConfig, self._get_config),
            ("set_config", SetConfig, self._set_config),
            ("get_statistics", GetStatistics, self._get_statistics),
        ):
            offered = rospy.Service(names.join(name, service), service_class, handler)
            self._services.append(offered)

    def close(self) -> None:
        """Withdraw the services."""
        while self._services:
            self._services.pop().shutdown("the nodelet is unloaded")

    def _record(self) -> Record:
        found = self._manager.graph.find(self._name)
        if found is None:
            raise UnknownNodelet(self._name, ())
        return found

    def _get_config(self, request: Any) -> GetConfigResponse:
        return GetConfigResponse(
            [port_message(replace(port, tags=())) for port in self._record().ports]
        )

    def _set_config(self, request: Any) -> SetConfigResponse:
        caller = caller_of(request)
        pairs = config_pairs(request.config)
        try:
            self._manager.guards.check_sizes((text for pair in pairs for text in pair), len(pairs))
            config: Dict[str, str] = {}
            for port, topic in pairs:
                if port in config:
                    raise DuplicatePort(port)
                config[port] = topic
            self._manager.reconfigure(self._name, config)
        except DyKnowError as error:
            rospy.logerr("%s: set_config of %s: %s", self._name, for_log(caller), for_log(error))
            return SetConfigResponse(False, str(error))
        self._reconfigurations += 1
        rospy.loginfo(
            "%s: loaded anew with the connections that %s wants", self._name, for_log(caller)
        )
        return SetConfigResponse(True, "")

    def _get_statistics(self, request: Any) -> GetStatisticsResponse:
        unknown = (None,) * 5
        return statistics_message(
            NodeletStatistics(
                time.monotonic() - self._since,
                self._reconfigurations,
                None,
                tuple(
                    PortStatistics(port.name, port.direction, port.topic, *unknown)
                    for port in self._record().ports
                ),
            )
        )


class CppNodelets:
    """All C++ nodelets that the manager made."""

    def __init__(self, manager: Manager) -> None:
        """Offer nothing yet."""
        self._manager = manager
        self._turn = turn_lock("services of C++ nodelets")
        self._offered: Dict[str, CppNodelet] = {}

    def follow(self) -> None:
        """Offer the services of those that are there now, and of no others."""
        with self._turn:
            wanted = [
                record.name
                for record in self._manager.graph.all()
                if record.rewired_by_reload
                and (record.state is State.RUNNING or record.name in self._offered)
            ]
            for name in [name for name in self._offered if name not in wanted]:
                self._offered.pop(name).close()
            for name in wanted:
                if name not in self._offered:
                    self._offered[name] = CppNodelet(self._manager, name)

    def close(self) -> None:
        """Withdraw all services."""
        with self._turn:
            while self._offered:
                self._offered.popitem()[1].close()
