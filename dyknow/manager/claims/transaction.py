# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes of the graph that are undone together when one of them fails."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from typing import AbstractSet, Callable, Dict, Iterable, List, Mapping, Optional, Set, Tuple

from dyknow.errors import DyKnowError, HostError
from dyknow.manager.claims.connector import Connector
from dyknow.manager.manager import Manager
from dyknow.manager.record import Record
from dyknow.model.graph import SpawnRequest, State
from dyknow.model.transformation import Transformation

_log = logging.getLogger("rosout.dyknow")


class Transaction:
    """Spawns and connects nodelets; everything that it did can be undone."""

    def __init__(
        self, manager: Manager, connector: Connector, unresponsive: AbstractSet[str]
    ) -> None:
        """Begin.

        Args:
            manager: makes nodelets.
            connector: connects them.
            unresponsive: nodelets that do not answer.
        """
        self._manager = manager
        self._connector = connector
        self._unresponsive = unresponsive
        #: Names of the nodelets that were made.
        self.spawned: List[str] = []
        #: Nodelets and how they were connected before; None for those that did not exist.
        self._before: List[Tuple[str, Optional[Dict[str, str]]]] = []

    def spawn(
        self, transformation: Transformation, request: SpawnRequest, near: Iterable[str]
    ) -> None:
        """Make a nodelet.

        Args:
            transformation: what to make.
            request: how.
            near: topics whose publishers it is to run close to.

        Raises:
            DyKnowError: it did not work.
        """
        planned = Record(
            request.name,
            transformation,
            "",
            topics=request.config,
            parameters=request.parameters,
        )
        self._make_way(planned, request.config)
        record = self._manager.lifecycle.spawn(transformation, request, True, near)
        self.spawned.append(record.name)
        self._before.append((record.name, None))

    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet that are not connected so already.

        Consumers that would receive what they do not demand are disconnected first.

        Raises:
            DyKnowError: the nodelet refused, or did not answer.
        """
        record = self._manager.graph.get(name)
        before = {port: record.topics.get(port, "") for port in config}
        if before == dict(config) and self._connector.is_known(name):
            return
        self._make_way(record, config)
        self._before.append((name, before))  # what was not answered may have been done, too
        self._connector.connect(name, config)

    def undo(self, needed: AbstractSet[str]) -> None:
        """Undo everything, the latest change first; nodelets that are ``needed`` by now stay."""
        for name, before in reversed(self._before):
            if before is None:
                if name not in needed:
                    _attempt(partial(self._manager.lifecycle.destroy, name))
            elif name not in self.spawned or name not in needed:
                _attempt(partial(self._reconnect, name, before))

    def _make_way(self, record: Record, config: Mapping[str, str]) -> None:
        cut: Dict[str, Set[str]] = {}
        while True:
            found = self._connector.in_the_way(record, config)
            more = {
                name: ports for name, ports in found.items() if ports.keys() - cut.get(name, ())
            }
            if not more:
                return
            for name, ports in sorted(more.items()):
                other = self._manager.graph.get(name)
                if other.state is not State.RUNNING or name in self._unresponsive:
                    raise HostError(f"{name} has to be disconnected first, and does not answer")
                self.connect(name, ports)
                cut.setdefault(name, set()).update(ports)

    def _reconnect(self, name: str, before: Dict[str, str]) -> None:
        record = self._manager.graph.find(name)
        if record is None or not self._connector.is_known(name):
            return  # it is asked how it is connected, and connected as it should be then
        fits = self._connector.fitting(replace(record, topics=before))
        self._connector.connect(name, fits)


def _attempt(step: Callable[[], None]) -> None:
    try:
        step()
    except DyKnowError as error:
        _log.warning("undoing a plan: %s", error)
