"""Turns a plan into running nodelets: all of it, or nothing.

Topics get the names of the out-ports that publish on them (``/NODELET/port``), except for the
goal, which publishes where the client listens. A nodelet of the claim that is healthy is re-wired
instead of being made again. Who takes something over has to deliver first: a replacement publishes
on a topic of its own until its first message has been sent, then it takes the place of the old.
"""

from __future__ import annotations

from typing import Callable, Dict, Iterable, Mapping

from dyknow.errors import DyKnowError, NameTaken, SpawnFailed, StreamTypeMismatch
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.delivery import Delivery, Handover
from dyknow.manager.claims.naming import candidates
from dyknow.manager.claims.order import Assembled, Order
from dyknow.manager.claims.parts import ANY, Parts, default_topic
from dyknow.manager.claims.relay import relay
from dyknow.manager.claims.transaction import Transaction
from dyknow.manager.claims.turn import Turn
from dyknow.manager.claims.upstream import upstream
from dyknow.manager.claims.wires import Wires
from dyknow.manager.host import Kind
from dyknow.manager.lifecycle import SpawnRequest
from dyknow.manager.manager import Manager
from dyknow.manager.model import State
from dyknow.manager.planning.problem import Live, New, Source, Step
from dyknow.manager.specifications.tags import read_tags
from dyknow.manager.specifications.transformation import OUT, Transformation


class Assembly:
    """Carries plans out."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        turn: Turn,
        wires: Wires,
        delivery: Delivery,
        on_failure: Callable[[str], None],
    ) -> None:
        """Make nodelets in the namespace of the manager.

        Args:
            manager: makes them.
            table: knows what other claims have.
            turn: is passed on while a nodelet comes up, if it may be.
            wires: connects what they are made of.
            delivery: waits for first messages.
            on_failure: called with the label of which no nodelet could be made.
        """
        self._manager = manager
        self._table = table
        self._turn = turn
        self._wires = wires
        self._delivery = delivery
        self._on_failure = on_failure

    def carry_out(self, order: Order) -> Assembled:
        """Make what a plan says.

        Raises:
            StreamTypeMismatch: what was made carries another type than was needed.
            DyKnowError: a step failed.

        Whatever it raises, what was made is undone.
        """
        parts = (self._manager, self._table, self._turn, self._wires, self._delivery.begin())
        work = _Work(*parts, self._on_failure, order)
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
        turn: Turn,
        wires: Wires,
        handover: Handover,
        on_failure: Callable[[str], None],
        order: Order,
    ) -> None:
        self._manager = manager
        self._graph = manager.graph
        self._turn = turn
        self._wires = wires
        self._handover = handover
        self._on_failure = on_failure
        self._order = order
        self._done = Assembled()
        self.transaction = Transaction(manager, wires, order.mute)
        self._parts = Parts(manager, table, order, self.transaction.spawned)

    def do(self) -> Assembled:
        done = self._done
        self._turn.reserve(self._order.own.values())
        used = {live.nodelet for live in self._order.plan.live if live.nodelet}
        fed_by: Dict[str, Dict[str, str]] = {name: {} for name in used}
        upstream(self._graph.all(), self._order.ordinary, fed_by, set(), used)
        self._turn.reserve(fed_by)
        for step in self._order.plan.steps:
            self._take(step)
        self._publish(self._order.plan.goal)
        ordinary = self._order.ordinary
        upstream(self._graph.all(), ordinary, done.wiring, done.sources, done.reused)
        done.spawned = list(self.transaction.spawned)
        done.reused -= set(done.spawned)
        done.remarks = self._handover.remarks
        return done

    # Steps

    def _take(self, step: Step) -> None:
        label = step.action.label
        inputs = self._inputs(step)
        name = self._order.own.get(label, "")
        if name:
            self._done.reused.add(name)
            self._parts.check_types(self._graph.get(name), step)
            for port, source in step.inputs:
                self._await(source, self._graph.get(name).topics.get(port, ""), inputs[port])
        else:
            name = self._spawn(
                self._manager.library.get(label), inputs, self._parts.outputs(label)
            )
            self._parts.check_types(self._graph.get(name), step)
        self._parts.made[label] = name
        self._connect(name, self._inputs(step))

    def _inputs(self, step: Step) -> Dict[str, str]:
        """Topics of a step's suppliers, as they are now."""
        return {port: self._topic_of(source) for port, source in step.inputs}

    def _publish(self, goal: Source) -> None:
        """Let the goal be published where the client listens."""
        done, place = self._done, self._order.topic
        present = self._topic_of(goal)
        datatype = self._parts.type_of(goal)
        wanted = self._order.datatype
        if wanted not in ANY and datatype not in (*ANY, wanted):
            raise StreamTypeMismatch(self._order.tag, wanted, datatype, goal.label)
        done.topic, done.datatype = place or present, datatype or wanted
        name, port = self._parts.name_of(goal), goal.port
        if not place and present in self._parts.taken() and datatype not in ANY:
            # Clients listen there who want something else: what they get may change.
            name, port = self._relay(goal, present), "out"
            done.topic = self._graph.get(name).topics[port]
        elif present != done.topic:
            if not name or not self._parts.may_move(name, present):
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
        audience = self._wires.audience()
        tags = tuple(
            tag
            for tag in self._parts.tags_of(goal)
            if audience.common_tags(present, read_tags((tag,)))  # and not only of this sender
        )
        made = relay(present, self._parts.type_of(goal), tags)
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
            reachable = record.state is State.RUNNING and record.name not in self._order.mute
            if ports and reachable:
                self.transaction.connect(record.name, ports)

    # Parts of a step

    def _await(self, source: Source, old: str, new: str) -> None:
        """Wait for a new supplier to deliver, if something flows that it is to replace."""
        name = self._parts.name_of(source)
        if old in ("", new) or name not in self.transaction.spawned or not self._parts.flows(old):
            return
        self._handover.wait(self._graph.get(name), source.port)

    def _topic_of(self, source: Source) -> str:
        """Name the topic of a supplier; an out-port that has none is given one."""
        name = self._parts.name_of(source)
        if not name:
            assert isinstance(source, Live)
            self._done.sources.add(source.topic)
            return source.topic
        if isinstance(source, Live):
            self._done.reused.add(name)
        topic = self._graph.get(name).topics.get(source.port, "")
        if topic in self._order.ordinary:
            self._done.sources.add(topic)
        if not topic or (isinstance(source, New) and self._is_mixed(source, topic)):
            topic = self._parts.free_topic(name, source.port)
        self._connect(name, {source.port: topic})
        return topic

    def _is_mixed(self, source: New, topic: str) -> bool:
        """Whether something else is sent there as well, such as by somebody who was re-wired."""
        tags = tuple(tag for tag in read_tags(self._parts.tags_of(source)) if tag.is_ground)
        return self._wires.audience().common_tags(topic, tags) != tags

    def _connect(self, name: str, config: Mapping[str, str]) -> None:
        self.transaction.connect(name, config)
        self._done.wiring.setdefault(name, {}).update(config)

    def _spawn(
        self, transformation: Transformation, inputs: Mapping[str, str], outputs: Iterable[str]
    ) -> str:
        records = self._graph.all()
        spoken_for = {topic for record in records for topic in record.topics.values()}
        spoken_for |= self._parts.taken() | {self._order.topic}
        for candidate in candidates(transformation.label):
            name = self._manager.resolve(candidate)
            if self._graph.is_busy(name) or any(
                topic.startswith(name + "/") for topic in spoken_for
            ):
                continue
            wiring = {**inputs, **{port: default_topic(name, port) for port in outputs}}
            self._turn.reserve([name])  # nobody takes it for one that is not needed
            try:
                is_plain = self._manager.host.kind_of(transformation.source) is Kind.CPP
                request = SpawnRequest(
                    transformation.label,
                    name,
                    config=wiring if is_plain else {},
                    claimed=True,
                    near=tuple(inputs.values()),
                )
                with self._turn.pause():
                    self.transaction.spawn(transformation, request)
            except NameTaken:
                continue
            except DyKnowError:
                self._on_failure(transformation.label)
                raise
            self._connect(name, {port: wiring[port] for port in outputs})
            return name
        raise SpawnFailed(transformation.label, "there are too many of its name")
