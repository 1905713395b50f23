"""What is known of the parts of a plan while it is carried out."""

from __future__ import annotations

from typing import Dict, List, Sequence, Set, Tuple

from dyknow import names
from dyknow.errors import StreamTypeMismatch
from dyknow.manager.claims.assembly_request import AssemblyRequest
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.manager import Manager
from dyknow.manager.planning.problem import Live, New, PlanStep, Source
from dyknow.manager.record import Record
from dyknow.model.graph import State
from dyknow.model.transformation import IN, OUT

#: Types that go with every other.
ANY = ("", "*")


class PlanContext:
    """Names, topics and types of suppliers, live and new ones alike."""

    def __init__(
        self, manager: Manager, table: ClaimTable, request: AssemblyRequest, spawned: Sequence[str]
    ) -> None:
        """Look at the parts of an order.

        Args:
            manager: knows the nodelets.
            table: knows where clients listen.
            request: what is being made.
            spawned: names of the nodelets that were made for it so far; grows.
        """
        self._manager = manager
        self._graph = manager.graph
        self._table = table
        self._request = request
        self.spawned = spawned
        #: Nodelets of the plan's transformations, by label.
        self.made: Dict[str, str] = {}

    def outputs(self, label: str) -> List[str]:
        """Out-ports of a transformation that the plan uses."""
        plan = self._request.plan
        used = {source for step in plan.steps for _, source in step.inputs} | {plan.goal}
        return sorted(
            {each.port for each in used if isinstance(each, New) and each.label == label}
        )

    def name_of(self, source: Source) -> str:
        """Name the nodelet of a supplier; empty for a topic of ordinary nodes."""
        return source.nodelet if isinstance(source, Live) else self.made[source.label]

    def type_of(self, source: Source) -> str:
        """Tell the type of a supplier's messages; empty while nobody knows."""
        name = self.name_of(source)
        if not name:
            assert isinstance(source, Live)
            return source.datatype
        record = self._graph.get(name)
        declared = record.transformation.ports if record.transformation is not None else ()
        known = [(port.name, port.datatype) for port in record.ports]
        known += [(port.name, port.datatype) for port in declared]
        return next((each for name, each in known if name == source.port and each not in ANY), "")

    def tags_of(self, source: Source) -> Tuple[str, ...]:
        """Tell what a supplier says of its stream."""
        name = self.name_of(source)
        if name:
            transformation = self._graph.get(name).transformation
        else:
            transformation = self._manager.library.get(source.label)
        ports = transformation.ports if transformation is not None else ()
        return next((port.tags for port in ports if port.name == source.port or not name), ())

    def check_types(self, record: Record, step: PlanStep) -> None:
        """Compare the types of a nodelet's in-ports with those of their suppliers.

        Raises:
            StreamTypeMismatch: two differ.
        """
        types = {port.name: port.datatype for port in record.ports}
        for port, source in step.inputs:
            wanted, found = types.get(port, ""), self.type_of(source)
            if wanted not in ANY and found not in (*ANY, wanted):
                what = f"for port '{port}' of transformation '{step.action.label}'"
                raise StreamTypeMismatch(what, wanted, found, source.label)

    def taken(self) -> Set[str]:
        """Topics that are spoken for: clients of other claims listen there."""
        return self._table.taken(but=self._request.claim_id)

    def free_topic(self, name: str, port: str) -> str:
        """Name a topic after an out-port; one that has passed to a successor is passed over."""
        spoken_for = self.taken() | {self._request.topic}
        spoken_for |= {
            each.topic
            for record in self._graph.all()
            for each in record.ports
            if each.direction == OUT and record.name != name
        }
        topic = default = default_topic(name, port)
        number = 1
        while topic in spoken_for:
            number += 1
            topic = f"{default}_{number}"
        return topic

    def flows(self, topic: str) -> bool:
        """Whether a healthy nodelet publishes on a topic."""
        return any(
            port.direction == OUT and port.topic == topic
            for record in self._graph.all()
            if record.state is State.RUNNING and record.name not in self._request.unhealthy
            for port in record.ports
        )

    def may_move(self, name: str, topic: str) -> bool:
        """Whether nobody else listens on the topic that an out-port publishes on now."""
        if name in self.spawned or not topic:
            return True
        if not self._graph.get(name).claimed or topic in self.taken():
            return False
        own = {*self._request.own.values(), *self.spawned}
        return not any(
            port.direction == IN and port.topic == topic
            for record in self._graph.all()
            if record.name not in own and record.state is State.RUNNING
            for port in record.ports
        )


def default_topic(name: str, port: str) -> str:
    """Name a topic after an out-port."""
    return names.join(name, port.lstrip("~/"))
