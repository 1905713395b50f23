# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelets of the demonstration, seen from another process: through services alone."""

from __future__ import annotations

import json
import time
from typing import Any, Dict, List, Mapping, Tuple

from nodelet.srv import NodeletLoad
from std_srvs.srv import Trigger

from dyknow import names
from dyknow.errors import PeerTimeout
from dyknow.model.statistics import PortStatistics
from dyknow.ros.client import ProxyClient
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient

_TIMEOUT = 10.0


class HandWiredGraph:
    """Nodelets of one manager, all in the manager's namespace."""

    def __init__(self, manager: str) -> None:
        """Address the manager of that global name."""
        self._manager = manager
        self._namespace = names.parent(manager)
        self._master = Master(names.join(self._namespace, "dyknow_demo"))
        self._proxies = ProxyClient(self._master)
        self._loaded: List[str] = []

    def is_up(self) -> bool:
        """Whether the manager's services are there."""
        try:
            return bool(self._master.ask("lookupService", f"{self._manager}/load_nodelet"))
        except (LookupError, PeerTimeout):
            return False

    def load(
        self,
        name: str,
        type_name: str,
        ports: Mapping[str, str],
        parameters: Mapping[str, Any],
    ) -> None:
        """Load a nodelet with its ports connected.

        Args:
            name: relative name.
            type_name: ``package/Class``.
            ports: topics by port.
            parameters: values by name, set before the load.
        """
        self._loaded.append(name)
        for key, value in parameters.items():
            self._master.ask("setParam", names.join(self._full(name), key), value)
        sources = [self._full(port) for port in ports]
        targets = [self._full(topic) for topic in ports.values()]
        self._call(
            f"{self._manager}/load_nodelet",
            NodeletLoad,
            name=self._full(name),
            type=type_name,
            remap_source_args=sources,
            remap_target_args=targets,
        )

    def forget(self) -> None:
        """Delete the parameters of what was loaded; the nodelets end with their manager."""
        while self._loaded:
            name = self._full(self._loaded.pop())
            try:
                self._master.ask("deleteParam", name)
            except (LookupError, PeerTimeout):
                continue  # it had none, or the master has ended

    def connect(self, name: str, port: str, topic: str) -> Tuple[float, float]:
        """Connect a port to a topic (empty: to none) while everything runs.

        Returns:
            When it was called and when it returned, in s of ROS time.

        Raises:
            Refused: the nodelet refused it.
            HostError: it is not there.
        """
        called = time.time()
        self._proxies.set_config(self._full(name), {port: topic}, _TIMEOUT)
        return called, time.time()

    def statistics(self, name: str) -> Tuple[Dict[str, PortStatistics], int]:
        """Return statistics by port, and the number of callbacks that failed."""
        found = self._proxies.get_statistics(self._full(name), _TIMEOUT)
        return {each.port: each for each in found.ports}, found.callback_errors or 0

    def arrivals(self, reporter: str) -> List[Any]:
        """Return the records of a reporter; see ``dyknow_demo.nodelets.reporter``."""
        answer = self._call(names.join(self._full(reporter), "arrivals"), Trigger)
        records = json.loads(answer.message)
        assert isinstance(records, list)
        return records

    def _full(self, name: str) -> str:
        return names.join(self._namespace, name)

    def _call(self, service: str, service_class: Any, **fields: Any) -> Any:
        return ServiceClient(self._master, service, service_class).call(_TIMEOUT, **fields)
