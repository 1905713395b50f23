"""Turns a plan into running nodelets: all of it, or nothing.

Topics get the names of the out-ports that publish on them (``/NODELET/port``), except for the
goal, which publishes where the client listens. A nodelet of the claim that is healthy is re-wired
instead of being made again.
"""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Callable, Dict, List, Mapping, Set, Tuple

from dyknow import names
from dyknow.errors import DyKnowError, NameTaken, SpawnFailed
from dyknow.manager.lifecycle import SpawnRequest
from dyknow.manager.manager import Manager
from dyknow.manager.model import Record, seen_ports
from dyknow.manager.planning import Live, Plan, Source
from dyknow.manager.transformation import IN, OUT

_log = logging.getLogger("rosout.dyknow")


@dataclass
class Fulfilled:
    """What became of a plan.

    Attributes:
        topic: where the stream is published.
        datatype: its type.
        goal: nodelet and out-port; empty for a topic of ordinary nodes.
        wiring: for each nodelet of the stream the topics that its ports need.
        sources: topics of ordinary nodes.
        spawned: names of new nodelets.
        reused: names of nodelets that were there.
    """

    topic: str = ""
    datatype: str = ""
    goal: Tuple[str, str] = ("", "")
    wiring: Dict[str, Dict[str, str]] = field(default_factory=dict)
    sources: List[str] = field(default_factory=list)
    spawned: List[str] = field(default_factory=list)
    reused: List[str] = field(default_factory=list)


class Fulfilment:
    """Carries plans out."""

    def __init__(self, manager: Manager) -> None:
        """Make nodelets in the namespace of the manager."""
        self._manager = manager
        self._host = manager.host
        self._graph = manager.graph
        self._library = manager.library
        self._lifecycle = manager.lifecycle

    def carry_out(self, plan: Plan, topic: str, own: Mapping[str, str]) -> Fulfilled:
        """Make what a plan says.

        Args:
            plan: the plan.
            topic: where the client listens; empty for where the stream is.
            own: healthy nodelets of the claim that can be re-wired, by label.

        Raises:
            DyKnowError: a step failed; what was made is undone.
        """
        done = Fulfilled()
        undo: List[Tuple[str, Dict[str, str]]] = []
        made: Dict[str, str] = {}
        try:
            for step in plan.steps:
                config = {
                    port: self._topic_of(source, made, done, undo) for port, source in step.inputs
                }
                label = step.action.label
                name = own.get(label, "")
                if name:
                    self._connect(name, config, done, undo)
                    done.reused.append(name)
                else:
                    name = self._spawn(label, config)
                    done.spawned.append(name)
                made[label] = name
                done.wiring.setdefault(name, {}).update(config)
            self._publish(plan.goal, topic, made, done, undo)
            self._add_upstream(done)
        except BaseException:
            self._undo(done, undo)
            raise
        return done

    # Inside

    def _publish(
        self,
        goal: Source,
        topic: str,
        made: Mapping[str, str],
        done: Fulfilled,
        undo: List[Tuple[str, Dict[str, str]]],
    ) -> None:
        if isinstance(goal, Live) and not goal.nodelet:
            if topic and topic != goal.topic:
                raise SpawnFailed(topic, f"its stream is the existing topic '{goal.topic}'")
            done.topic, done.datatype = goal.topic, goal.datatype
            done.sources.append(goal.topic)
            return
        name = goal.nodelet if isinstance(goal, Live) else made[goal.label]
        record = self._graph.get(name)
        place = topic or record.topics.get(goal.port) or names.join(name, goal.port.lstrip("~/"))
        self._connect(name, {goal.port: place}, done, undo)
        if isinstance(goal, Live):
            done.reused.append(name)
        done.topic, done.goal = place, (name, goal.port)
        types = {port.name: port.datatype for port in self._graph.get(name).ports}
        done.datatype = types.get(goal.port, "")

    def _add_upstream(self, done: Fulfilled) -> None:
        """Add what feeds the nodelets that are used as they are: the stream needs that too."""
        records = self._graph.all()
        waiting = [name for name in done.reused if name in done.wiring]
        while waiting:
            name = waiting.pop()
            record = self._graph.find(name)
            if record is None or record.transformation is None:
                continue
            for port in record.transformation.ports:
                topic = record.topics.get(port.name, "")
                if port.direction != IN or not port.tags or not topic:
                    continue
                done.wiring[name][port.name] = topic
                publishers = [
                    (each.name, out.name)
                    for each in records
                    for out in each.ports
                    if out.direction == OUT and out.topic == topic
                ]
                for publisher, out_port in publishers:
                    known = publisher in done.wiring
                    done.wiring.setdefault(publisher, {})[out_port] = topic
                    if not known:
                        waiting.append(publisher)
                        done.reused.append(publisher)
                if not publishers:
                    done.sources.append(topic)

    def _topic_of(
        self,
        source: Source,
        made: Mapping[str, str],
        done: Fulfilled,
        undo: List[Tuple[str, Dict[str, str]]],
    ) -> str:
        if isinstance(source, Live):
            if not source.nodelet:
                done.sources.append(source.topic)
                return source.topic
            name = source.nodelet
            done.reused.append(name)
        else:
            name = made[source.label]
        topic = self._graph.get(name).topics.get(source.port, "")
        if not topic:
            topic = names.join(name, source.port.lstrip("~/"))
            self._connect(name, {source.port: topic}, done, undo)
        done.wiring.setdefault(name, {})[source.port] = topic
        return topic

    def _connect(
        self,
        name: str,
        config: Dict[str, str],
        done: Fulfilled,
        undo: List[Tuple[str, Dict[str, str]]],
    ) -> None:
        record = self._graph.get(name)
        done.wiring.setdefault(name, {}).update(config)
        before = {port: record.topics.get(port, "") for port in config}
        if before == config:
            return
        self.connect(name, config)
        undo.append((name, before))

    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Connect ports of a nodelet, and let the graph know at once.

        Raises:
            DyKnowError: the nodelet refused.
        """
        record = self._graph.get(name)
        if record.rewired_by_reload:
            self._lifecycle.reload(name, config)
            return
        self._host.connect(name, config)
        with self._graph.changing(name, patience=1.0) as current:
            if current is not None:
                self._graph.put(_wired(current, config))

    def _spawn(self, label: str, config: Mapping[str, str]) -> str:
        transformation = self._library.get(label)
        stem = re.sub(r"[^A-Za-z0-9_]+", "_", label).strip("_")
        stem = stem if stem[:1].isalpha() else "nodelet_" + stem
        taken: Set[str] = {record.name for record in self._graph.all()}
        for number in range(1, 10_000):
            name = self._manager.resolve(f"{stem}_{number}")
            if name in taken:
                continue
            request = SpawnRequest(label, name, config=config, claimed=True)
            try:
                return self._lifecycle.spawn(transformation, request).name
            except NameTaken:
                continue
        raise SpawnFailed(stem, "there are too many of its name")

    def _undo(self, done: Fulfilled, undo: List[Tuple[str, Dict[str, str]]]) -> None:
        for name, before in reversed(undo):
            if name not in done.spawned:
                self._quietly(partial(self.connect, name, before))
        for name in reversed(done.spawned):
            self._quietly(partial(self._lifecycle.destroy, name))

    @staticmethod
    def _quietly(step: Callable[[], None]) -> None:
        try:
            step()
        except DyKnowError as error:
            _log.warning("undoing a plan: %s", error)


def _wired(record: Record, config: Mapping[str, str]) -> Record:
    topics = {**record.topics, **config}
    ports = tuple(replace(port, topic=config.get(port.name, port.topic)) for port in record.ports)
    return replace(record, topics=topics, ports=seen_ports(record, ports))
