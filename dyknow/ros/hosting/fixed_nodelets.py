# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The proxy's services for spawned nodelets with fixed topics, which have no proxy."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Sequence

from dyknow.errors import FixedTopics
from dyknow.locks import turn_lock
from dyknow.manager.manager import Manager
from dyknow.manager.record import Record
from dyknow.model.graph import PortState, State
from dyknow.model.statistics import NodeletStatistics, PortStatistics
from dyknow.ros.nodelets.proxy_services import ProxyServices


class FixedProxy:
    """Answers for one nodelet from the manager's records; refuses to connect it elsewhere."""

    def __init__(self, manager: Manager, name: str) -> None:
        self.name = name
        self._manager = manager
        self._since = time.monotonic()

    def get_config(self) -> list[PortState]:
        """Return the ports, without tags."""
        return [replace(port, tags=()) for port in self._record().ports]

    def set_config(self, config: Sequence[tuple[str, str]]) -> None:
        """Raise `FixedTopics`, whose text says how to get live ports."""
        raise FixedTopics(self.name, self._record().manager)

    def get_statistics(self) -> NodeletStatistics:
        """Return the ports; nothing is counted."""
        ports = tuple(
            PortStatistics(port.name, port.direction, port.topic, *(None,) * 5)
            for port in self._record().ports
        )
        return NodeletStatistics(time.monotonic() - self._since, 0, None, ports)

    def _record(self) -> Record:
        return self._manager.graph.get(self.name)


class FixedNodelets:
    """Offers the services of all spawned nodelets with fixed topics."""

    def __init__(self, manager: Manager) -> None:
        self._manager = manager
        self._turn = turn_lock("services of fixed nodelets")
        self._offered: dict[str, ProxyServices] = {}
        self._closed = False

    def follow(self) -> None:
        """Offer the services of the present nodelets alone, until it is closed."""
        with self._turn:
            wanted = [
                record.name
                for record in (() if self._closed else self._manager.graph.all())
                if record.is_fixed
                and record.is_spawned
                and (record.state is State.RUNNING or record.name in self._offered)
            ]
            for name in [name for name in self._offered if name not in wanted]:
                self._offered.pop(name).close()
            for name in wanted:
                if name not in self._offered:
                    self._offered[name] = ProxyServices(FixedProxy(self._manager, name))

    def close(self) -> None:
        """Withdraw all services."""
        self._closed = True
        self.follow()
