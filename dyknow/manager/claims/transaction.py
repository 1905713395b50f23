# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes of the graph that are undone together when one of them fails."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from typing import AbstractSet, Callable, Dict, Iterable, List, Mapping, Optional, Tuple

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
        cut = self._make_way(planned, request.config)
        record = self._manager.lifecycle.spawn(transformation, request, True, near)
        self.spawned.append(record.name)
        self._before.append((record.name, None))
        self._connector.remember()
        self._connect_again(cut)

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
        cut = self._make_way(record, config)
        self._before.append((name, before))  # what was not answered may have been done, too
        self._connector.connect(name, config)
        self._connect_again(cut)

    def reconfigure(self, name: str, ports: Mapping[str, str]) -> None:
        """Disconnect ports of a nodelet and connect them again: it forgets what it received.

        They stay disconnected if they do not fit together by then.

        Args:
            name: of the nodelet.
            ports: those that share variables, with their topics.

        Raises:
            DyKnowError: the nodelet refused, or did not answer.
        """
        self.connect(name, dict.fromkeys(ports, ""))
        self._connect_if_fitting(self._manager.graph.get(name), ports)

    def undo(self, needed: AbstractSet[str]) -> None:
        """Undo everything, the latest change first; nodelets that are ``needed`` by now stay."""
        for name, before in reversed(self._before):
            if before is None:
                if name not in needed:
                    _attempt(partial(self._manager.lifecycle.destroy, name))
            elif name not in self.spawned or name not in needed:
                _attempt(partial(self._reconnect, name, before))

    def _make_way(self, record: Record, config: Mapping[str, str]) -> Dict[str, Mapping[str, str]]:
        """Disconnect what is in the way of a connection.

        Returns:
            By nodelet the ports that were disconnected, with the topics that they had.
        """
        cut: Dict[str, Dict[str, str]] = {}
        is_forgetful = False
        while True:
            found = self._connector.in_the_way(record, config, is_forgetful)
            more = {
                name: ports
                for name, ports in found.items()
                if ports.keys() - cut.get(name, {}).keys()
            }
            if not more:
                return dict(sorted(cut.items()))
            reached = {name: ports for name, ports in more.items() if self._is_reachable(name)}
            if not reached:
                if is_forgetful or self._connector.in_the_way(record, config, True):
                    first = self._manager.graph.get(min(more))
                    why = "has fixed topics" if first.is_fixed else "does not answer"
                    raise HostError(f"{first.name} has to be disconnected first, and {why}")
                is_forgetful = True  # they are reconfigured as soon as they answer
            for name, ports in sorted(reached.items()):
                topics = self._manager.graph.get(name).topics
                self.connect(name, ports)
                before = {port: topics.get(port, "") for port in ports}
                cut.setdefault(name, {}).update(before)

    def _is_reachable(self, name: str) -> bool:
        record = self._manager.graph.get(name)
        is_movable = record.state is State.RUNNING and not record.is_fixed
        return is_movable and name not in self._unresponsive

    def _connect_again(self, cut: Mapping[str, Mapping[str, str]]) -> None:
        """Connect those that people connected, and that fit together again, as one.

        What claims need is connected by their repair, with all that changes there.
        """
        for name, ports in cut.items():
            record = self._manager.graph.find(name)
            if record is not None and not record.claimed:
                self._connect_if_fitting(record, ports)

    def _connect_if_fitting(self, record: Record, ports: Mapping[str, str]) -> None:
        fits = self._connector.fitting(replace(record, topics={**record.topics, **ports}))
        if all(fits.get(port) == topic for port, topic in ports.items()):
            self.connect(record.name, ports)

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
