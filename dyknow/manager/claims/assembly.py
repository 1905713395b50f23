# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Carries a plan out: all of it, or nothing.

Topics get the names of the out-ports that publish on them (``/NODELET/port``), except for the
goal, which publishes where the client listens. A healthy nodelet of the claim is connected
elsewhere instead of being made again. A replacement has to deliver first: a replacement
publishes on a topic of its own until it has sent its first message, then it takes over.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass, field
from typing import (
    AbstractSet,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from dyknow import names
from dyknow.datatypes import ANY, types_fit
from dyknow.errors import DyKnowError, HostTimeout, NameTaken, SpawnFailed, StreamTypeMismatch
from dyknow.manager.claims.connector import Transaction
from dyknow.manager.claims.context import ClaimContext
from dyknow.manager.claims.ends import relay
from dyknow.manager.claims.plan_inputs import Instance, add_upstream, instance_of
from dyknow.manager.claims.world import World
from dyknow.manager.host import Count, Host
from dyknow.manager.manager import Manager
from dyknow.manager.planning.problem import Live, New, Plan, PlanStep, Source
from dyknow.manager.record import Record, ports_on
from dyknow.manager.specifications.given import filling
from dyknow.manager.specifications.tags import Bindings, Term, read_tags
from dyknow.model.graph import SpawnRequest, State
from dyknow.model.transformation import IN, OUT, Parameter, Transformation

#: Names that are tried for one transformation.
_MOST_NAMES = 10_000
#: The demand for a header, beside or instead of a ROS type, for error messages.
STAMPED = "a type that begins with a header (for max_age)"

#: Seconds between two looks for the first message of a replacement.
_STEP = 0.02


@dataclass(frozen=True)
class AssemblyRequest:
    """A plan that has to be carried out, and its surroundings.

    Attributes:
        plan: the plan.
        tag: tag of the request, for error messages.
        topic: where the client listens; empty for wherever the stream is.
        datatype: ROS type of the request; empty for any.
        own: nodelets that are used for steps of the plan.
        movable: names of all healthy nodelets that can be connected elsewhere for the claim.
        unhealthy: nodelets that are not to be relied on.
        unresponsive: nodelets that do not answer.
        claim_id: whose stream it is.
        ordinary: topics that the library describes and ordinary nodes publish.
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
        remarks: deviations from the plan, in words.
        detail: what there is to say about the stream as it is now.
        bindings: names that the variables of the request stand for.
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
        world: Callable[[], World],
        request: AssemblyRequest,
        spawned: Sequence[str],
    ) -> None:
        self._manager = manager
        self._world = world
        self._request = request
        self.spawned = spawned
        #: Nodelets for the steps of the plan; grows.
        self.made: Dict[Instance, str] = {}
        #: Out-ports that the plan uses, by instance.
        self.outputs: Dict[Instance, Set[str]] = {}
        plan = request.plan
        for source in (*(source for step in plan.steps for _, source in step.inputs), plan.goal):
            if isinstance(source, New):
                self.outputs.setdefault(instance_of(source), set()).add(source.port)

    def name_of(self, source: Source) -> str:
        """Name of a supplier's nodelet; empty for a topic of ordinary nodes."""
        return source.nodelet if isinstance(source, Live) else self.made[instance_of(source)]

    def type_of(self, source: Source) -> str:
        """ROS type of a supplier's messages; empty while it is not known."""
        name = self.name_of(source)
        if not name:
            assert isinstance(source, Live)
            return source.datatype
        record = self._world().get(name)
        declared = record.transformation.ports if record.transformation is not None else ()
        known = [(port.name, port.datatype) for port in record.ports]
        known += [(port.name, port.datatype) for port in declared]
        return next((each for name, each in known if name == source.port and each not in ANY), "")

    def tags_of(self, source: Source) -> Tuple[Term, ...]:
        """Tags of a supplier's stream, without those whose variables are not bound."""
        name = self.name_of(source)
        if name:
            transformation = self._world().get(name).transformation
        else:
            transformation = self._manager.library.get(source.label)
        ports = transformation.ports if transformation is not None else ()
        tags = next((port.tags for port in ports if port.name == source.port or not name), ())
        possible = self._world().topology.dependent.supplies().get((name, source.port))
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
        return self._world().taken_topics(but=self._request.claim_id)

    def free_topic(self, name: str, port: str) -> str:
        """Name a topic after an out-port, but none that a successor has taken over."""
        taken = self.taken_topics() | {self._request.topic}
        taken |= {
            each.topic
            for record in self._world().records.values()
            for each in record.ports
            if each.direction == OUT and record.name != name
        }
        return names.free_topic(name, port, taken.__contains__)

    def flows(self, topic: str) -> bool:
        """Whether a healthy nodelet publishes on a topic."""
        return any(
            ports_on(record, OUT, topic)
            for record in self._world().records.values()
            if record.state is State.RUNNING and record.name not in self._request.unhealthy
        )

    def may_move(self, name: str, topic: str) -> bool:
        """Whether a nodelet may leave the topic that it publishes on: no other part needs it."""
        if name in self.spawned or not topic:
            return True
        records = self._world().records
        if not self._world().get(name).claimed or topic in self.taken_topics():
            return False
        own = {*self._request.movable, *self.spawned}
        return not any(
            ports_on(record, IN, topic)
            for record in records.values()
            if record.name not in own and record.state is State.RUNNING
        )

    def free_names(self, label: str) -> Iterator[str]:
        """Yield global names for a new nodelet of a transformation."""
        records = self._world().records.values()
        taken = {topic for record in records for topic in record.topics.values()}
        taken |= self.taken_topics() | {self._request.topic}
        for relative in _names(label):
            name = self._manager.resolve(relative)
            has_left_topics = any(topic.startswith(name + "/") for topic in taken)
            if not has_left_topics and not self._manager.graph.is_busy(name):
                yield name


def _names(label: str) -> Iterator[str]:
    """Name nodelets of a transformation: bottom_camera_1, _2 ... for ``bottom camera``."""
    stem = re.sub(r"[^A-Za-z0-9_]+", "_", label).strip("_")
    if not stem[:1].isalpha():
        stem = f"nodelet_{stem}".rstrip("_")
    for number in range(1, _MOST_NAMES):
        yield f"{stem}_{number}"


class Handover:
    """The waits of one plan for the first messages of its replacements."""

    def __init__(
        self,
        host: Host,
        seconds: float,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        """Prepare; the time runs from the first wait on.

        Args:
            host: counts messages.
            seconds: what all replacements of the plan together may take to deliver.
            clock: steady time, in seconds.
            sleep: waits that many seconds.
        """
        self._host = host
        self._seconds = seconds
        self._clock = clock
        self._sleep = sleep
        self._deadline: Optional[float] = None
        #: Deviations from the plan, in words.
        self.remarks: List[str] = []

    def wait(self, record: Record, port: str) -> None:
        """Wait until an out-port has sent a message, or until the time is over."""
        if self._deadline is None:
            self._deadline = self._clock() + self._seconds
        with contextlib.ExitStack() as closing:
            count = self._counter(record, port, closing)
            begin = self._clock()  # earlier answers are about earlier nodelets of the name
            while not _shows_messages(count(), begin):
                if self._clock() >= self._deadline:
                    late = f"though it sent nothing within {self._seconds:g} s"
                    self.remarks.append(f"{record.name} took over {late}")
                    return
                self._sleep(_STEP)

    def _counter(
        self, record: Record, port: str, closing: contextlib.ExitStack
    ) -> Callable[[], Optional[Count]]:
        """Return a function that counts the messages of an out-port.

        A C++ nodelet may be lazy, and send only to subscribers.
        """
        if not record.kind.is_written_for_dyknow:
            listening = self._host.listen(record.topics.get(port, ""))
            closing.callback(listening.close)
            return listening.count
        wanted = {record.manager: (record.name,)}
        return lambda: (self._host.counts(wanted).get(record.name) or {}).get(port)


def timed_out(error: Optional[BaseException]) -> bool:
    """Whether an error comes from a nodelet manager, or a nodelet, that did not answer."""
    while error is not None and not isinstance(error, HostTimeout):
        error = error.__cause__
    return error is not None


def _shows_messages(count: Optional[Count], since: float) -> bool:
    return count is not None and count.asked >= since and count.messages > 0


class Assembly:
    """One plan that is carried out."""

    def __init__(
        self, context: ClaimContext, request: AssemblyRequest, handover: Handover
    ) -> None:
        self._manager = context.manager
        self._world = context.connector.world
        self._lock = context.lock
        self._request = request
        self._handover = handover
        self._transaction = Transaction(context.manager, context.connector, request.unresponsive)
        self._plan = PlanContext(context.manager, self._world, request, self._transaction.spawned)
        self._result = AssemblyResult()
        #: Label of the transformation of which no nodelet could be made; empty if there is none.
        self.failed_label = ""

    def carry_out(self) -> AssemblyResult:
        """Carry the plan out; an exception undoes every change.

        Raises:
            StreamTypeMismatch: a new nodelet has a port of another type than is needed.
            DyKnowError: a step failed.
        """
        try:
            return self._carry_out()
        except BaseException:
            self._transaction.undo(self._world().needed)
            raise

    def _carry_out(self) -> AssemblyResult:
        result, request = self._result, self._request
        self._reserve()
        for step in request.plan.steps:
            self._take(step)
        self._publish(request.plan.goal)
        records = self._world().records
        add_upstream(records, request.ordinary, result.wiring, result.sources, result.reused)
        result.spawned = list(self._transaction.spawned)
        result.reused -= set(result.spawned)
        result.remarks = self._handover.remarks
        result.bindings = request.plan.bindings
        return result

    def _reserve(self) -> None:
        """Keep the nodelets that the plan counts on, and their feeders, from being destroyed."""
        used = {live.nodelet for live in self._request.plan.live if live.nodelet}
        fed: Dict[str, Dict[str, str]] = {name: {} for name in used}
        add_upstream(self._world().records, self._request.ordinary, fed, set(), used)
        self._lock.reserve([*self._request.movable, *fed])

    # Steps

    def _take(self, step: PlanStep) -> None:
        instance = instance_of(step)
        inputs = self._inputs(step)
        name = self._request.own.get(instance, "")
        if name:
            self._result.reused.add(name)
            self._plan.check_types(self._world().get(name), step)
            for port, source in step.inputs:
                self._await(source, self._world().get(name).topics.get(port, ""), inputs[port])
        else:
            transformation = self._manager.library.get(step.action.label)
            given = filling(transformation, dict(step.bindings))
            types = {port: self._plan.type_of(source) for port, source in step.inputs}
            typed = {port: (topic, types[port]) for port, topic in inputs.items()}
            name = self._spawn(transformation, typed, sorted(self._plan.outputs[instance]), given)
            self._plan.check_types(self._world().get(name), step)
        self._plan.made[instance] = name
        self._connect(name, self._inputs(step))

    def _inputs(self, step: PlanStep) -> Dict[str, str]:
        """Topics of a step's suppliers, as they are now."""
        return {port: self._topic_of(source) for port, source in step.inputs}

    def _publish(self, goal: Source) -> None:
        """Let the goal be published where the client listens."""
        result, place = self._result, self._request.topic
        present = self._topic_of(goal)
        datatype = self._plan.type_of(goal)
        wanted = self._request.datatype
        if not types_fit(wanted, datatype):
            raise StreamTypeMismatch(self._request.tag, wanted, datatype, goal.label)
        is_stamped = datatype in ANY or self._manager.host.is_stamped(datatype)
        if self._request.is_stamped and is_stamped is False:
            raise StreamTypeMismatch(self._request.tag, STAMPED, datatype, goal.label)
        result.topic, result.datatype = place or present, datatype or wanted
        name, port = self._plan.name_of(goal), goal.port
        if not place and present in self._plan.taken_topics() and datatype not in ANY:
            # The clients there want something else, and their stream may change.
            name, port = self._relay(goal, present), "out"
            result.topic = self._world().get(name).topics[port]
        elif present != result.topic:
            if not name or not self._plan.may_move(name, present):
                name, port = self._relay(goal, present, result.topic), "out"
            else:
                self._await(goal, result.topic, present)
                self._separate(goal, name, result.topic)
                self._connect(name, {port: result.topic})
            self._clear(result.topic, name)
        result.goal = (name, port) if name else ("", "")

    def _relay(self, goal: Source, present: str, topic: str = "") -> str:
        """Bring a stream that has to stay where it is to ``topic``, or to a new one.

        Returns:
            Name of the relay.
        """
        # The tags that hold for all messages there.
        tags = self._world().topology.common_tags(present, self._plan.tags_of(goal))
        datatype = self._plan.type_of(goal)
        made = relay(present, datatype, tuple(map(str, tags)))
        name = self._spawn(made, {"in": (present, datatype)}, () if topic else ("out",))
        out = {"out": topic} if topic else {}
        self._separate(goal, name, topic)
        self._connect(name, {"in": self._topic_of(goal), **out})
        return name

    def _separate(self, goal: Source, publisher: str, topic: str) -> None:
        """Disconnect the replaced publisher before the goal comes, if it is of another individual.

        Else it goes afterwards, so that no gap comes about.
        """
        tags, producers = set(self._plan.tags_of(goal)), self._world().topology.producers(topic)
        if any(set(each.tags) != tags for each in producers):
            self._clear(topic, publisher)

    def _clear(self, topic: str, publisher: str) -> None:
        """Disconnect every other publisher of the client's topic: it was replaced."""
        for record in self._world().records.values():
            if record.name == publisher or record.transformation is None:
                continue
            ports = dict.fromkeys(ports_on(record, OUT, topic), "")
            stays = record.is_fixed or record.name in self._request.unresponsive
            if ports and record.state is State.RUNNING and not stays:
                self._transaction.connect(record.name, ports)

    # Parts of a step

    def _await(self, source: Source, old: str, new: str) -> None:
        """Wait for a new supplier to deliver, if it replaces one that still delivers."""
        name = self._plan.name_of(source)
        is_new = name in self._transaction.spawned
        if is_new and old not in ("", new) and self._plan.flows(old):
            self._handover.wait(self._world().get(name), source.port)

    def _topic_of(self, source: Source) -> str:
        """Return the topic of a supplier; an out-port that has none is connected to one."""
        name = self._plan.name_of(source)
        if not name:
            assert isinstance(source, Live)
            self._result.sources.add(source.topic)
            return source.topic
        if isinstance(source, Live):
            self._result.reused.add(name)
        topic = self._world().get(name).topics.get(source.port, "")
        if topic in self._request.ordinary:
            self._result.sources.add(topic)
        if not topic or (isinstance(source, New) and self._is_mixed(source, topic)):
            topic = self._plan.free_topic(name, source.port)
        self._connect(name, {source.port: topic})
        return topic

    def _is_mixed(self, source: New, topic: str) -> bool:
        """Whether something else may be sent on a supplier's topic as well."""
        tags = self._plan.tags_of(source)
        return self._world().topology.common_tags(topic, tags) != tags

    def _connect(self, name: str, config: Mapping[str, str]) -> None:
        self._transaction.connect(name, config)
        self._result.wiring.setdefault(name, {}).update(config)

    def _spawn(
        self,
        transformation: Transformation,
        inputs: Mapping[str, Tuple[str, str]],
        outputs: Iterable[str],
        given: Tuple[Parameter, ...] = (),
    ) -> str:
        """Make a nodelet that is connected from its start, and return its name.

        An in-port is connected later if it is not certain yet that its type fits.

        Args:
            transformation: what to make.
            inputs: topics of its in-ports, and their types.
            outputs: out-ports that get topics of their own.
            given: parameters.
        """
        types = {port.name: port.datatype for port in transformation.ports}
        certain = {
            port: topic
            for port, (topic, datatype) in inputs.items()
            if types.get(port, "") not in ANY
            and datatype not in ANY
            and types_fit(types[port], datatype)
        }
        for name in self._plan.free_names(transformation.label):
            own = {port: names.topic_after(name, port) for port in outputs}
            self._lock.reserve([name])
            try:
                kind = self._manager.host.kind_of(transformation)
                topics = {port: topic for port, (topic, _) in inputs.items()}
                config = {**(certain if kind.is_written_for_dyknow else topics), **own}
            except DyKnowError:
                self.failed_label = transformation.label
                raise
            request = SpawnRequest(transformation.label, name, config, parameters=given)
            cut = self._transaction.make_way_for(transformation, request)
            try:
                with self._lock.pause():
                    self._transaction.spawn(transformation, request, topics.values())
            except NameTaken:
                self._transaction.connect_again(cut)
                continue
            except DyKnowError as error:
                if not timed_out(error):
                    self.failed_label = transformation.label
                raise
            self._transaction.connect_again(cut)
            self._connect(name, config)
            return name
        raise SpawnFailed(transformation.label, "all names for it are taken")
