"""Turns a plan into running nodelets: all of it, or nothing.

Topics get the names of the out-ports that publish on them (``/NODELET/port``), except for the
goal, which publishes where the client listens. A nodelet of the claim that is healthy is re-wired
instead of being made again. Who takes something over has to deliver first: a replacement publishes
on a topic of its own until its first message has been sent, then it takes the place of the old.
"""

from __future__ import annotations

from typing import Callable, Dict, Iterable, List, Mapping

from dyknow import names
from dyknow.errors import DyKnowError, NameTaken, SpawnFailed, StreamTypeMismatch
from dyknow.manager.delivery import Delivery, Handover
from dyknow.manager.host import Kind
from dyknow.manager.lifecycle import SpawnRequest
from dyknow.manager.manager import Manager
from dyknow.manager.model import Record, State
from dyknow.manager.naming import candidates
from dyknow.manager.order import Fulfilled, Order
from dyknow.manager.planning import Live, New, Source, Step
from dyknow.manager.relay import relay
from dyknow.manager.transaction import Transaction
from dyknow.manager.transformation import IN, OUT, Transformation
from dyknow.manager.upstream import upstream

_ANY = ("", "*")


class Fulfilment:
    """Carries plans out."""

    def __init__(
        self, manager: Manager, delivery: Delivery, on_failure: Callable[[str], None]
    ) -> None:
        """Make nodelets in the namespace of the manager.

        Args:
            manager: makes them.
            delivery: waits for first messages.
            on_failure: called with the label of which no nodelet could be made.
        """
        self._manager = manager
        self._delivery = delivery
        self._on_failure = on_failure

    def carry_out(self, order: Order) -> Fulfilled:
        """Make what a plan says.

        Raises:
            StreamTypeMismatch: what was made carries another type than was needed.
            DyKnowError: a step failed.

        Whatever it raises, what was made is undone.
        """
        work = _Work(self._manager, self._delivery.begin(), self._on_failure, order)
        try:
            return work.do()
        except BaseException:
            work.transaction.undo()
            raise


class _Work:
    """One plan being carried out."""

    def __init__(
        self,
        manager: Manager,
        handover: Handover,
        on_failure: Callable[[str], None],
        order: Order,
    ) -> None:
        self._manager = manager
        self._graph = manager.graph
        self._handover = handover
        self._on_failure = on_failure
        self._order = order
        self._made: Dict[str, str] = {}
        self._done = Fulfilled()
        self.transaction = Transaction(manager)

    def do(self) -> Fulfilled:
        done = self._done
        for step in self._order.plan.steps:
            self._take(step)
        self._publish(self._order.plan.goal)
        upstream(self._graph.all(), done.wiring, done.sources, done.reused)
        done.spawned = list(self.transaction.spawned)
        done.reused -= set(done.spawned)
        done.remarks = self._handover.remarks
        return done

    # Steps

    def _take(self, step: Step) -> None:
        label = step.action.label
        inputs = {port: self._topic_of(source) for port, source in step.inputs}
        name = self._order.own.get(label, "")
        if name:
            self._done.reused.add(name)
            self._check_types(self._graph.get(name), step)
            for port, source in step.inputs:
                self._await(source, self._graph.get(name).topics.get(port, ""), inputs[port])
        else:
            name = self._spawn(self._manager.library.get(label), inputs, self._outputs(label))
            self._check_types(self._graph.get(name), step)
        self._made[label] = name
        self._connect(name, inputs)

    def _outputs(self, label: str) -> List[str]:
        """Out-ports of a transformation that the plan uses."""
        plan = self._order.plan
        used = {source for step in plan.steps for _, source in step.inputs} | {plan.goal}
        return sorted(
            {each.port for each in used if isinstance(each, New) and each.label == label}
        )

    def _publish(self, goal: Source) -> None:
        """Let the goal be published where the client listens."""
        done, place = self._done, self._order.topic
        present = self._topic_of(goal)
        datatype = self._type_of(goal)
        wanted = self._order.datatype
        if wanted not in _ANY and datatype not in (*_ANY, wanted):
            raise StreamTypeMismatch(self._order.tag, wanted, datatype)
        done.topic, done.datatype = place or present, datatype or wanted
        name, port = self._name_of(goal), goal.port
        if present != done.topic:
            if not name or not self._may_move(name, present):
                name, port = self._relay(present, datatype, done.topic), "out"
            else:
                self._await(goal, done.topic, present)
                self._connect(name, {port: done.topic})
            self._clear(done.topic, name)
        done.goal = (name, port) if name else ("", "")

    def _relay(self, source: str, datatype: str, topic: str) -> str:
        """Bring a stream that must stay where it is to where the client listens."""
        name = self._spawn(relay(source, datatype), {"in": source}, ())
        self._connect(name, {"in": source, "out": topic})
        return name

    def _may_move(self, name: str, topic: str) -> bool:
        """Whether nobody else listens on the topic that an out-port publishes on now."""
        if name in self.transaction.spawned or not topic:
            return True
        if not self._graph.get(name).claimed or topic in self._order.taken:
            return False
        own = {*self._order.own.values(), *self.transaction.spawned}
        return not any(
            port.direction == IN and port.topic == topic
            for record in self._graph.all()
            if record.name not in own and record.state is State.RUNNING
            for port in record.ports
        )

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
        name = self._name_of(source)
        if old in ("", new) or name not in self.transaction.spawned or not self._flows(old):
            return
        self._handover.wait(self._graph.get(name), source.port)

    def _flows(self, topic: str) -> bool:
        return any(
            port.direction == OUT and port.topic == topic
            for record in self._graph.all()
            if record.state is State.RUNNING and record.name not in self._order.unhealthy
            for port in record.ports
        )

    def _name_of(self, source: Source) -> str:
        return source.nodelet if isinstance(source, Live) else self._made[source.label]

    def _topic_of(self, source: Source) -> str:
        """Name the topic of a supplier; an out-port that has none is given one."""
        name = self._name_of(source)
        if not name:
            assert isinstance(source, Live)
            self._done.sources.add(source.topic)
            return source.topic
        if isinstance(source, Live):
            self._done.reused.add(name)
        topic = self._graph.get(name).topics.get(source.port, "")
        if not topic:
            topic = self._free_topic(name, source.port)
        self._connect(name, {source.port: topic})
        return topic

    def _free_topic(self, name: str, port: str) -> str:
        """Name a topic after an out-port; one that has passed to a successor is passed over."""
        spoken_for = self._order.taken | {self._order.topic}
        spoken_for |= {
            each.topic
            for record in self._graph.all()
            for each in record.ports
            if each.direction == OUT and record.name != name
        }
        topic = default = _default(name, port)
        number = 1
        while topic in spoken_for:
            number += 1
            topic = f"{default}_{number}"
        return topic

    def _type_of(self, source: Source) -> str:
        name = self._name_of(source)
        if not name:
            assert isinstance(source, Live)
            return source.datatype
        types = {port.name: port.datatype for port in self._graph.get(name).ports}
        return types.get(source.port, "")

    def _check_types(self, record: Record, step: Step) -> None:
        types = {port.name: port.datatype for port in record.ports}
        for port, source in step.inputs:
            wanted, found = types.get(port, ""), self._type_of(source)
            if wanted not in _ANY and found not in (*_ANY, wanted):
                what = f"for port '{port}' of transformation '{step.action.label}'"
                raise StreamTypeMismatch(what, wanted, found)

    def _connect(self, name: str, config: Mapping[str, str]) -> None:
        self.transaction.connect(name, config)
        self._done.wiring.setdefault(name, {}).update(config)

    def _spawn(
        self, transformation: Transformation, inputs: Mapping[str, str], outputs: Iterable[str]
    ) -> str:
        records = self._graph.all()
        spoken_for = {topic for record in records for topic in record.topics.values()}
        spoken_for |= self._order.taken | {self._order.topic}
        for candidate in candidates(transformation.label):
            name = self._manager.resolve(candidate)
            if any(topic.startswith(name + "/") for topic in spoken_for):
                continue
            wiring = {**inputs, **{port: _default(name, port) for port in outputs}}
            try:
                is_plain = self._manager.host.kind_of(transformation.source) is Kind.CPP
                request = SpawnRequest(
                    transformation.label,
                    name,
                    config=wiring if is_plain else {},
                    claimed=True,
                    near=tuple(inputs.values()),
                )
                self.transaction.spawn(transformation, request)
            except NameTaken:
                continue
            except DyKnowError:
                self._on_failure(transformation.label)
                raise
            self._connect(name, {port: wiring[port] for port in outputs})
            return name
        raise SpawnFailed(transformation.label, "there are too many of its name")


def _default(name: str, port: str) -> str:
    return names.join(name, port.lstrip("~/"))
