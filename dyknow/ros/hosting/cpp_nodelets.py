# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The proxy's three services for nodelets of stock C++ managers, offered in their place.

Such a nodelet has no ports that can be moved: what connects it elsewhere is a reload with other
remappings, which the manager does. What goes through it is not counted.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Dict, List, Sequence, Tuple

from dyknow.errors import DuplicatePort, UnknownNodelet
from dyknow.locks import turn_lock
from dyknow.manager.manager import Manager
from dyknow.manager.record import Record
from dyknow.model.graph import PortState, State
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.ros.nodelets.proxy_services import ProxyServices


class CppProxy:
    """Stands in for the proxy of one nodelet."""

    def __init__(self, manager: Manager, name: str) -> None:
        self.name = name
        self._manager = manager
        self._since = time.monotonic()
        self._reconfigurations = 0

    def get_config(self) -> List[PortState]:
        """Return the ports; the tags are for the manager to tell."""
        return [replace(port, tags=()) for port in self._record().ports]

    def set_config(self, config: Sequence[Tuple[str, str]]) -> None:
        """Load the nodelet again with other connections.

        Raises:
            DyKnowError: it did not work; the nodelet is wired as before.
        """
        texts = (text for pair in config for text in pair)
        self._manager.guards.check_sizes(texts, len(config))
        topics: Dict[str, str] = {}
        for port, topic in config:
            if port in topics:
                raise DuplicatePort(port)
            topics[port] = topic
        self._manager.reconfigure(self.name, topics)
        self._reconfigurations += 1

    def get_statistics(self) -> NodeletStatistics:
        """Return what is known: only the manager's own changes."""
        unknown = (None,) * 5
        ports = tuple(
            PortStatistics(port.name, port.direction, port.topic, *unknown)
            for port in self._record().ports
        )
        uptime = time.monotonic() - self._since
        return NodeletStatistics(uptime, self._reconfigurations, None, ports)

    def _record(self) -> Record:
        found = self._manager.graph.find(self.name)
        if found is None:
            raise UnknownNodelet(self.name, ())
        return found


class CppNodelets:
    """All nodelets that the manager made in stock C++ nodelet managers."""

    def __init__(self, manager: Manager) -> None:
        """Begin without services."""
        self._manager = manager
        self._turn = turn_lock("services of C++ nodelets")
        self._offered: Dict[str, ProxyServices] = {}

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
                    self._offered[name] = ProxyServices(CppProxy(self._manager, name))

    def close(self) -> None:
        """Withdraw all services."""
        with self._turn:
            while self._offered:
                self._offered.popitem()[1].close()
