"""Turns a plan into running nodelets: all of it, or nothing.

Topics get the names of the out-ports that publish on them (``/NODELET/port``), except for the
goal, which publishes where the client listens. A nodelet of the claim that is healthy is re-wired
instead of being made again. Who takes something over has to deliver first: a replacement publishes
on a topic of its own until its first message has been sent, then it takes the place of the old.
"""

from __future__ import annotations

from typing import Callable, Dict, Iterable, Mapping

from dyknow.errors import DyKnowError, NameTaken, SpawnFailed, StreamTypeMismatch
from dyknow.manager.claims.assembly_request import AssemblyRequest, AssemblyResult
from dyknow.manager.claims.claim_lock import ClaimLock
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.connector import Connector
from dyknow.manager.claims.delivery import Delivery, Handover
from dyknow.manager.claims.feeders import with_feeders
from dyknow.manager.claims.free_names import free_names
from dyknow.manager.claims.plan_context import ANY, PlanContext, default_topic
from dyknow.manager.claims.relay import relay
from dyknow.manager.claims.transaction import Transaction
from dyknow.manager.host import NodeletKind
from dyknow.manager.manager import Manager
from dyknow.manager.planning.problem import Live, New, PlanStep, Source
from dyknow.manager.specifications.tags import read_tags
from dyknow.model.graph import SpawnRequest, State
from dyknow.model.transformation import OUT, Transformation


class Assembly:
    """Carries plans out."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        claim_lock: ClaimLock,
        connector: Connector,
        delivery: Delivery,
        on_failure: Callable[[str], None],
    ) -> None:
        """Make nodelets in the namespace of the manager.

        Args:
            manager: makes them.
            table: knows what other claims have.
            claim_lock: is passed on while a nodelet comes up, if it may be.
            connector: connects what they are made of.
            delivery: waits for first messages.
            on_failure: called with the label of which no nodelet could be made.
        """
        self._manager = manager
        self._table = table
        self._claim_lock = claim_lock
        self._connector = connector
        self._delivery = delivery
        self._on_failure = on_failure

    def carry_out(self, request: AssemblyRequest) -> AssemblyResult:
        """Make what a plan says.

        Raises:
            StreamTypeMismatch: what was made carries another type than was needed.
            DyKnowError: a step failed.

        Whatever it raises, what was made is undone.
        """
        parts = (
            self._manager,
            self._table,
            self._claim_lock,
            self._connector,
            self._delivery.begin(),
        )
        work = _Work(*parts, self._on_failure, request)
        try:
            return work.do()
        except BaseException:
            work.transaction.undo(self._table.needed())
            raise


class _Work:
    """One plan being carried out."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        claim_lock: ClaimLock,
        connector: Connector,
        handover: Handover,
        on_failure: Callable[[str], None],
        request: AssemblyRequest,
    ) -> None:
        self._manager = manager
        self._graph = manager.graph
        self._claim_lock = claim_lock
        self._connector = connector
        self._handover = handover
        self._on_failure = on_failure
        self._request = request
        self._done = AssemblyResult()
        self.transaction = Transaction(manager, connector, request.unresponsive)
        self._context = PlanContext(manager, table, request, self.transaction.spawned)

    def do(self) -> AssemblyResult:
        done = self._done
        self._claim_lock.reserve(self._request.own.values())
        used = {live.nodelet for live in self._request.plan.live if live.nodelet}
        fed_by: Dict[str, Dict[str, str]] = {name: {} for name in used}
        with_feeders(self._graph.all(), self._request.ordinary, fed_by, set(), used)
        self._claim_lock.reserve(fed_by)
        for step in self._request.plan.steps:
            self._take(step)
        self._publish(self._request.plan.goal)
        ordinary = self._request.ordinary
        with_feeders(self._graph.all(), ordinary, done.wiring, done.sources, done.reused)
        done.spawned = list(self.transaction.spawned)
        done.reused -= set(done.spawned)
        done.remarks = self._handover.remarks
        return done

    # Steps

    def _take(self, step: PlanStep) -> None:
        label = step.action.label
        inputs = self._inputs(step)
        name = self._request.own.get(label, "")
        if name:
            self._done.reused.add(name)
            self._context.check_types(self._graph.get(name), step)
            for port, source in step.inputs:
                self._await(source, self._graph.get(name).topics.get(port, ""), inputs[port])
        else:
            name = self._spawn(
                self._manager.library.get(label), inputs, self._context.outputs(label)
            )
            self._context.check_types(self._graph.get(name), step)
        self._context.made[label] = name
        self._connect(name, self._inputs(step))

    def _inputs(self, step: PlanStep) -> Dict[str, str]:
        """Topics of a step's suppliers, as they are now."""
        return {port: self._topic_of(source) for port, source in step.inputs}

    def _publish(self, goal: Source) -> None:
        """Let the goal be published where the client listens."""
        done, place = self._done, self._request.topic
        present = self._topic_of(goal)
        datatype = self._context.type_of(goal)
        wanted = self._request.datatype
        if wanted not in ANY and datatype not in (*ANY, wanted):
            raise StreamTypeMismatch(self._request.tag, wanted, datatype, goal.label)
        done.topic, done.datatype = place or present, datatype or wanted
        name, port = self._context.name_of(goal), goal.port
        if not place and present in self._context.taken() and datatype not in ANY:
            # Clients listen there who want something else: what they get may change.
            name, port = self._relay(goal, present), "out"
            done.topic = self._graph.get(name).topics[port]
        elif present != done.topic:
            if not name or not self._context.may_move(name, present):
                name, port = self._relay(goal, present, done.topic), "out"
            else:
                self._await(goal, done.topic, present)
                self._connect(name, {port: done.topic})
            self._clear(done.topic, name)
        done.goal = (name, port) if name else ("", "")

    def _relay(self, goal: Source, present: str, topic: str = "") -> str:
        """Bring a stream that must stay where it is to where the client listens.

        Without a topic it is brought to a new one, the relay's own.
        """
        topology = self._connector.topology()
        tags = tuple(
            tag
            for tag in self._context.tags_of(goal)
            if topology.common_tags(present, read_tags((tag,)))  # and not only of this sender
        )
        made = relay(present, self._context.type_of(goal), tags)
        name = self._spawn(made, {"in": present}, () if topic else ("out",))
        out = {"out": topic} if topic else {}
        self._connect(name, {"in": self._topic_of(goal), **out})
        return name

    def _clear(self, topic: str, publisher: str) -> None:
        """Take everybody else off the client's topic: whoever was replaced goes."""
        for record in self._graph.all():
            if record.name == publisher or record.transformation is None:
                continue
            ports = {
                port.name: ""
                for port in record.ports
                if port.direction == OUT and port.topic == topic
            }
            reachable = (
                record.state is State.RUNNING and record.name not in self._request.unresponsive
            )
            if ports and reachable:
                self.transaction.connect(record.name, ports)

    # Parts of a step

    def _await(self, source: Source, old: str, new: str) -> None:
        """Wait for a new supplier to deliver, if something flows that it is to replace."""
        name = self._context.name_of(source)
        if (
            old in ("", new)
            or name not in self.transaction.spawned
            or not self._context.flows(old)
        ):
            return
        self._handover.wait(self._graph.get(name), source.port)

    def _topic_of(self, source: Source) -> str:
        """Name the topic of a supplier; an out-port that has none is given one."""
        name = self._context.name_of(source)
        if not name:
            assert isinstance(source, Live)
            self._done.sources.add(source.topic)
            return source.topic
        if isinstance(source, Live):
            self._done.reused.add(name)
        topic = self._graph.get(name).topics.get(source.port, "")
        if topic in self._request.ordinary:
            self._done.sources.add(topic)
        if not topic or (isinstance(source, New) and self._is_mixed(source, topic)):
            topic = self._context.free_topic(name, source.port)
        self._connect(name, {source.port: topic})
        return topic

    def _is_mixed(self, source: New, topic: str) -> bool:
        """Whether something else is sent there as well, such as by somebody who was re-wired."""
        tags = tuple(tag for tag in read_tags(self._context.tags_of(source)) if tag.is_ground)
        return self._connector.topology().common_tags(topic, tags) != tags

    def _connect(self, name: str, config: Mapping[str, str]) -> None:
        self.transaction.connect(name, config)
        self._done.wiring.setdefault(name, {}).update(config)

    def _spawn(
        self, transformation: Transformation, inputs: Mapping[str, str], outputs: Iterable[str]
    ) -> str:
        records = self._graph.all()
        spoken_for = {topic for record in records for topic in record.topics.values()}
        spoken_for |= self._context.taken() | {self._request.topic}
        for candidate in free_names(transformation.label):
            name = self._manager.resolve(candidate)
            if self._graph.is_busy(name) or any(
                topic.startswith(name + "/") for topic in spoken_for
            ):
                continue
            wiring = {**inputs, **{port: default_topic(name, port) for port in outputs}}
            self._claim_lock.reserve([name])  # nobody takes it for one that is not needed
            try:
                is_plain = self._manager.host.kind_of(transformation.source) is NodeletKind.CPP
                request = SpawnRequest(transformation.label, name, wiring if is_plain else {})
                with self._claim_lock.pause():
                    self.transaction.spawn(transformation, request, inputs.values())
            except NameTaken:
                continue
            except DyKnowError:
                self._on_failure(transformation.label)
                raise
            self._connect(name, {port: wiring[port] for port in outputs})
            return name
        raise SpawnFailed(transformation.label, "there are too many of its name")
