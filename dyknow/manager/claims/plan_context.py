# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A plan that is carried out: the request, its result, and what is known meanwhile."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import AbstractSet, Dict, Iterator, List, Mapping, Sequence, Set, Tuple

from dyknow import names
from dyknow.datatypes import ANY, types_fit
from dyknow.errors import StreamTypeMismatch
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.own_nodelets import Instance, instance_of
from dyknow.manager.claims.topology import Topology
from dyknow.manager.manager import Manager
from dyknow.manager.planning.problem import Live, New, Plan, PlanStep, Source
from dyknow.manager.record import Record, ports_on
from dyknow.manager.specifications.tags import Bindings, Term, read_tags
from dyknow.model.graph import State
from dyknow.model.transformation import IN, OUT

#: Names that are tried for one transformation.
_MOST_NAMES = 10_000
#: What is asked for besides, or instead of, a ROS type, for error messages.
STAMPED = "a type that begins with a header (for max_age)"


@dataclass(frozen=True)
class AssemblyRequest:
    """What has to be made, and around what.

    Attributes:
        plan: how.
        tag: what was asked for, for error messages.
        topic: where the client listens; empty for wherever the stream is.
        datatype: ROS type that was asked for; empty for any.
        own: nodelets that are used for steps of the plan.
        movable: names of all healthy nodelets that can be connected elsewhere for the claim.
        unhealthy: nodelets that are not to be relied on.
        unresponsive: nodelets that do not answer.
        claim_id: whose stream it is.
        ordinary: topics on which ordinary nodes publish what the library describes.
        is_stamped: whether its messages have to begin with a header.
    """

    plan: Plan
    tag: str = ""
    topic: str = ""
    datatype: str = ""
    own: Mapping[Instance, str] = field(default_factory=dict)
    movable: AbstractSet[str] = frozenset()
    unhealthy: AbstractSet[str] = frozenset()
    unresponsive: AbstractSet[str] = frozenset()
    claim_id: str = ""
    ordinary: AbstractSet[str] = frozenset()
    is_stamped: bool = False


@dataclass
class AssemblyResult:
    """What became of a plan.

    Attributes:
        topic: where the stream is published.
        datatype: its type.
        goal: nodelet and out-port; empty for a topic of ordinary nodes.
        wiring: for each nodelet of the stream the topics that its ports need.
        sources: topics of ordinary nodes.
        spawned: names of new nodelets.
        reused: names of nodelets that existed before.
        remarks: what did not go as it should, in words.
        detail: what there is to say about the stream as it is now.
        bindings: what the variables of the request stand for.
    """

    topic: str = ""
    datatype: str = ""
    goal: Tuple[str, str] = ("", "")
    wiring: Dict[str, Dict[str, str]] = field(default_factory=dict)
    sources: Set[str] = field(default_factory=set)
    spawned: List[str] = field(default_factory=list)
    reused: Set[str] = field(default_factory=set)
    remarks: List[str] = field(default_factory=list)
    detail: str = ""
    bindings: Bindings = ()


class PlanContext:
    """Names, topics and types of the suppliers of a plan, live and new ones alike."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        request: AssemblyRequest,
        spawned: Sequence[str],
    ) -> None:
        """Begin before the first step of the plan.

        Args:
            manager: knows the nodelets.
            table: knows where clients listen.
            request: what has to be made.
            spawned: names of the nodelets that were made for it; grows.
        """
        self._manager = manager
        self._graph = manager.graph
        self._table = table
        self._request = request
        self.spawned = spawned
        #: Nodelets for the steps of the plan; grows.
        self.made: Dict[Instance, str] = {}

    def outputs(self, instance: Instance) -> List[str]:
        """Out-ports of a nodelet that the plan uses."""
        plan = self._request.plan
        used = {source for step in plan.steps for _, source in step.inputs} | {plan.goal}
        new = [each for each in used if isinstance(each, New)]
        return sorted({each.port for each in new if instance_of(each) == instance})

    def name_of(self, source: Source) -> str:
        """Name of a supplier's nodelet; empty for a topic of ordinary nodes."""
        return source.nodelet if isinstance(source, Live) else self.made[instance_of(source)]

    def type_of(self, source: Source) -> str:
        """ROS type of a supplier's messages; empty while it is not known."""
        name = self.name_of(source)
        if not name:
            assert isinstance(source, Live)
            return source.datatype
        record = self._graph.get(name)
        declared = record.transformation.ports if record.transformation is not None else ()
        known = [(port.name, port.datatype) for port in record.ports]
        known += [(port.name, port.datatype) for port in declared]
        return next((each for name, each in known if name == source.port and each not in ANY), "")

    def tags_of(self, source: Source, topology: Topology) -> Tuple[Term, ...]:
        """Tags of a supplier's stream, without those whose variables are not bound."""
        name = self.name_of(source)
        if name:
            transformation = self._graph.get(name).transformation
        else:
            transformation = self._manager.library.get(source.label)
        ports = transformation.ports if transformation is not None else ()
        tags = next((port.tags for port in ports if port.name == source.port or not name), ())
        possible = topology.dependent.supplies().get((name, source.port))
        if possible is None:
            return tuple(term for term in read_tags(tags) if term.is_ground)
        return next(iter(possible)).tags if len(possible) == 1 else ()

    def check_types(self, record: Record, step: PlanStep) -> None:
        """Compare the types of a nodelet's in-ports with those of their suppliers.

        Raises:
            StreamTypeMismatch: two differ.
        """
        types = {port.name: port.datatype for port in record.ports}
        for port, source in step.inputs:
            wanted, found = types.get(port, ""), self.type_of(source)
            if not types_fit(wanted, found):
                what = f"for port '{port}' of transformation '{step.action.label}'"
                raise StreamTypeMismatch(what, wanted, found, source.label)

    def taken_topics(self) -> Set[str]:
        """Topics on which the clients of other claims listen."""
        return self._table.taken_topics(but=self._request.claim_id)

    def free_topic(self, name: str, port: str) -> str:
        """Name a topic after an out-port, but none that a successor has taken over."""
        taken = self.taken_topics() | {self._request.topic}
        taken |= {
            each.topic
            for record in self._graph.all()
            for each in record.ports
            if each.direction == OUT and record.name != name
        }
        topic = default = default_topic(name, port)
        number = 1
        while topic in taken:
            number += 1
            topic = f"{default}_{number}"
        return topic

    def flows(self, topic: str) -> bool:
        """Whether a healthy nodelet publishes on a topic."""
        return any(
            ports_on(record, OUT, topic)
            for record in self._graph.all()
            if record.state is State.RUNNING and record.name not in self._request.unhealthy
        )

    def may_move(self, name: str, topic: str) -> bool:
        """Whether a nodelet may leave the topic that it publishes on: no other part needs it."""
        if name in self.spawned or not topic:
            return True
        if not self._graph.get(name).claimed or topic in self.taken_topics():
            return False
        own = {*self._request.movable, *self.spawned}
        return not any(
            ports_on(record, IN, topic)
            for record in self._graph.all()
            if record.name not in own and record.state is State.RUNNING
        )

    def free_names(self, label: str) -> Iterator[str]:
        """Yield global names for a new nodelet of a transformation."""
        records = self._graph.all()
        taken = {topic for record in records for topic in record.topics.values()}
        taken |= self.taken_topics() | {self._request.topic}
        for relative in _names(label):
            name = self._manager.resolve(relative)
            has_left_topics = any(topic.startswith(name + "/") for topic in taken)
            if not has_left_topics and not self._graph.is_busy(name):
                yield name


def default_topic(name: str, port: str) -> str:
    """Name a topic after an out-port."""
    return names.join(name, port.lstrip("~/"))


def _names(label: str) -> Iterator[str]:
    """Name nodelets of a transformation: bottom_camera_1, _2 ... for ``bottom camera``."""
    stem = re.sub(r"[^A-Za-z0-9_]+", "_", label).strip("_")
    if not stem[:1].isalpha():
        stem = f"nodelet_{stem}".rstrip("_")
    for number in range(1, _MOST_NAMES):
        yield f"{stem}_{number}"
