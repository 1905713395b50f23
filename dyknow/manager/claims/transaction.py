"""Changes of the graph that are undone together when one of them fails."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from typing import AbstractSet, Callable, Dict, List, Mapping, Tuple

from dyknow.errors import DyKnowError
from dyknow.manager.lifecycle import SpawnRequest
from dyknow.manager.manager import Manager
from dyknow.manager.model import Record, seen_ports
from dyknow.manager.specifications.transformation import Transformation

_log = logging.getLogger("rosout.dyknow")

#: Seconds to wait for a look to be done with a nodelet.
_PATIENCE = 1.0


class Transaction:
    """Spawns and connects; what it did can be taken back."""

    def __init__(self, manager: Manager) -> None:
        """Begin."""
        self._manager = manager
        self.spawned: List[str] = []
        self._before: List[Tuple[str, Dict[str, str]]] = []

    def spawn(self, transformation: Transformation, request: SpawnRequest) -> Record:
        """Make a nodelet.

        Raises:
            DyKnowError: it did not work.
        """
        record = self._manager.lifecycle.spawn(transformation, request)
        self.spawned.append(record.name)
        return record

    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Connect ports; nothing is done for those that are connected so already.

        Raises:
            DyKnowError: the nodelet refused.
        """
        record = self._manager.graph.get(name)
        before = {port: record.topics.get(port, "") for port in config}
        if before == dict(config):
            return
        connect(self._manager, name, config)
        self._before.append((name, before))

    def undo(self, needed: AbstractSet[str]) -> None:
        """Take everything back, the latest first, but nodelets that others need by now."""
        for name, before in reversed(self._before):
            if name not in self.spawned:
                _quietly(partial(connect, self._manager, name, before))
        for name in [name for name in reversed(self.spawned) if name not in needed]:
            _quietly(partial(self._manager.lifecycle.destroy, name))


def connect(manager: Manager, name: str, config: Mapping[str, str]) -> None:
    """Connect ports of a nodelet, and let the graph know at once.

    Raises:
        DyKnowError: the nodelet refused.
    """
    for topic in config.values():
        manager.guards.check_topic(topic)
    if manager.graph.get(name).rewired_by_reload:
        manager.lifecycle.reload(name, config)
        return
    manager.host.connect(name, config)
    with manager.graph.changing(name, patience=_PATIENCE) as record:
        if record is not None:
            topics = {**record.topics, **config}
            ports = tuple(
                replace(port, topic=config.get(port.name, port.topic)) for port in record.ports
            )
            manager.graph.put(replace(record, topics=topics, ports=seen_ports(record, ports)))


def _quietly(step: Callable[[], None]) -> None:
    try:
        step()
    except DyKnowError as error:
        _log.warning("undoing a plan: %s", error)
