# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Carries a plan out: all of it, or nothing.

Topics get the names of the out-ports that publish on them (``/NODELET/port``), except for the
goal, which publishes where the client listens. A healthy nodelet of the claim is connected
elsewhere instead of being made again. A replacement has to deliver first: a replacement
publishes on a topic of its own until it has sent its first message, then it takes over.
"""

from __future__ import annotations

import re
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import AbstractSet, Any, Iterable, Iterator, Mapping, NamedTuple

from dyknow import names
from dyknow.datatypes import ANY, types_fit
from dyknow.errors import (
    DyKnowError,
    NameTaken,
    SpawnFailed,
    StreamTypeMismatch,
    UnknownTransformation,
)
from dyknow.manager.claim import STREAM, Claim
from dyknow.manager.claims.claim_planner import STAMPED
from dyknow.manager.claims.connector import ClaimContext, Transaction
from dyknow.manager.claims.ends import VERDICTS, monitor, monitored, relay
from dyknow.manager.host import Count
from dyknow.manager.planning.problem import Instance, Live, New, Plan, PlanStep, Source
from dyknow.manager.record import Record, ports_on
from dyknow.manager.specifications.given import filling
from dyknow.manager.specifications.tags import Term, read_tags
from dyknow.model.graph import SpawnRequest, State
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import IN, OUT, Parameter, Transformation

#: Names that are tried for one transformation.
_MOST_NAMES = 10_000
#: The label of a relay of a topic that was made for a relay: the name of that one is long enough.
_RELAY_OF_RELAY = re.compile(r"relay of /(?:\w+/)*(relay_of_\w+)_[0-9]+/out\Z")
#: Seconds that all replacements of a plan together have to deliver, before they take over anyway.
_HANDOVER = 2.0
#: Seconds between two looks for the first message of a replacement.
_STEP = 0.02


@dataclass(frozen=True)
class Acquired:
    """A stream, and the way in which it was made."""

    claim: Claim  # the claim; without an id for a dry run
    plan: Plan | None  # how the stream is made; None for a claim that existed before
    #: Nodelets that were made; for a dry run, labels of those that would be.
    spawned: tuple[str, ...] = ()
    reused: tuple[str, ...] = ()  # nodelets that are used as they are
    remarks: tuple[str, ...] = ()  # deviations from the plan, in words

    @property
    def cost(self) -> int:
        """Cost of the nodelets that were, or would be, made."""
        return 0 if self.plan is None else self.plan.cost

    @property
    def changes(self) -> dict[str, Any]:
        """The fields of the claim that say how its stream is made."""
        names_ = ("topic", "datatype", "goal", "wiring", "sources", "bindings", "monitor")
        return {name: getattr(self.claim, name) for name in (*names_, "state", "detail")}


class _Supply(NamedTuple):
    """A supplier of the plan as it is now, be it live or new."""

    source: Source  # its entry in the plan
    nodelet: str  # its name; empty for a topic of ordinary nodes
    topic: str  # where it sends
    tags: tuple[Term, ...]  # the tags of its messages, as far as they are certain
    datatype: str  # ROS type of its messages


class Assembly(Transaction):
    """One plan that is carried out for a claim."""

    def __init__(
        self,
        context: ClaimContext,
        claim: Claim,
        plan: Plan,
        own: Mapping[Instance, str],
        movable: AbstractSet[str],
        ordinary: AbstractSet[str],
    ) -> None:
        """Prepare; nothing is changed yet.

        Nodelets of ``own`` are used for steps of the plan, ``movable`` are all healthy ones that
        can be connected elsewhere for the claim. Ordinary nodes publish on ``ordinary`` topics.
        """
        super().__init__(context)
        self._manager = context.manager
        self._claim = claim
        self._plan = plan
        self._own = own
        self._movable = movable
        self._ordinary = ordinary
        #: Out-ports that the plan uses of its new nodelets.
        self._used: dict[Instance, set[str]] = {}
        for source in plan.sources:
            if isinstance(source, New):
                self._used.setdefault(source.instance, set()).add(source.port)
        #: Nodelets for the steps of the plan; grows, as do the remarks.
        self._made: dict[Instance, str] = {}
        self._remarks: list[str] = []
        #: When the replacements of the plan have to have delivered.
        self._deadline: float | None = None

    def carry_out(self) -> Acquired:
        """Carry the plan out; an exception undoes every change.

        Raises StreamTypeMismatch if a new nodelet has a port of another type than is needed.
        """
        try:
            # Nothing that the plan counts on is to be destroyed meanwhile.
            self._context.lock.reserve([*self._movable, *self._upstream()[0]])
            for step in self._plan.steps:
                self._take(step)
            goal = self._supply(self._plan.goal)
            claim = self._publish(goal)
            if claim.request.require:
                claim = replace(claim, monitor=self._spawn_monitor(claim, goal))
        except BaseException:
            self.undo()
            self._context.lock.free()  # another plan may use the same nodelets
            raise
        name = claim.goal[0]
        wiring, sources = self._upstream(name, *self._made.values())
        if goal.nodelet:
            wiring[goal.nodelet][goal.source.port] = goal.topic
        if name != goal.nodelet:
            wiring[name]["in"] = goal.topic  # of the relay
        if name:
            wiring[name][claim.goal[1]] = claim.topic
        if not name or goal.topic in self._ordinary:
            sources.add(goal.topic)
        if claim.monitor:
            wiring[claim.monitor] = dict(self.world.records[claim.monitor].topics)
        claim = replace(
            claim,
            wiring=wiring,
            sources=tuple(sorted(sources)),
            bindings=self._plan.bindings,
            state=ClaimState.ACTIVE,
        )
        spawned, reused = tuple(self.spawned), sorted(wiring.keys() - {*self.spawned})
        return Acquired(claim, self._plan, spawned, tuple(reused), tuple(self._remarks))

    def _upstream(self, *made: str) -> tuple[dict[str, dict[str, str]], set[str]]:
        """Find the nodelets and topics of the plan."""
        used = {*made, *[live.nodelet for live in self._plan.live]}
        return self.world.upstream(used - {""}, self._ordinary)

    def _supply(self, source: Source) -> _Supply:
        """Return a supplier as it is now; an out-port that has no topic is connected to one."""
        name = source.nodelet if isinstance(source, Live) else self._made[source.instance]
        if isinstance(source, Live) and not name:
            for each in self.world.described.get(source.topic, ()):
                if each.label == source.label:
                    tags = read_tags(each.ports[0].tags)
                    return _Supply(source, name, source.topic, tags, source.datatype)
            raise UnknownTransformation(source.label)
        sent = self.world.sent(name, source.port)
        topic = self.world.records[name].topics.get(source.port, "")
        is_new = isinstance(source, New)
        if not topic or (is_new and self.world.common_tags(topic, sent.tags) != sent.tags):
            topic = self._free_topic(name, source.port)
        self.connect(name, {source.port: topic})
        return _Supply(source, name, topic, sent.tags, sent.datatype)

    # Steps

    def _take(self, step: PlanStep) -> None:
        supplies = {port: self._supply(source) for port, source in step.inputs}
        name = self._own.get(step.instance, "")
        if name:
            topics = self.world.records[name].topics
            self._check_types(name, step, supplies)
            for port, supply in supplies.items():
                self._await(supply, topics.get(port, ""), supply.topic)
        else:
            transformation = self._manager.library.get(step.instance.label)
            given = filling(transformation, step.instance.bindings)
            name = self._spawn(transformation, supplies, self._used[step.instance], given)
            self._check_types(name, step, supplies)
        self._made[step.instance] = name
        # A round may have passed, and a supplier may be on another topic.
        self.connect(name, {port: self._supply(source).topic for port, source in step.inputs})

    def _check_types(self, name: str, step: PlanStep, supplies: Mapping[str, _Supply]) -> None:
        """Compare the types of a nodelet's in-ports with those of their suppliers."""
        types = {port.name: port.datatype for port in self.world.records[name].ports}
        label = step.instance.label
        for port, supply in supplies.items():
            wanted, found = types.get(port, ""), supply.datatype
            if not types_fit(wanted, found):
                what = f"for port '{port}' of transformation '{label}'"
                raise StreamTypeMismatch(what, wanted, found, supply.source.label, label)

    def _publish(self, goal: _Supply) -> Claim:
        """Let the goal be published where the client listens."""
        claim, datatype = self._claim, goal.datatype
        if not types_fit(claim.wanted_type, datatype):
            label = goal.source.label
            raise StreamTypeMismatch(claim.request.tag, claim.wanted_type, datatype, label)
        is_stamped = datatype in ANY or self._manager.host.is_stamped(datatype)
        if claim.request.max_age > 0 and is_stamped is False:
            raise StreamTypeMismatch(claim.request.tag, STAMPED, datatype, goal.source.label)
        topic = claim.topic or goal.topic
        name, port = goal.nodelet, goal.source.port
        if not claim.topic and goal.topic in self._taken_topics() and datatype not in ANY:
            # The clients there want something else, and their stream may change.
            name, port = self._relay(goal), "out"
            topic = self.world.records[name].topics[port]
        elif goal.topic != topic:
            if not name or not self._may_move(name, goal.topic):
                name, port = self._relay(goal, topic), "out"
            else:
                self._await(goal, topic, goal.topic)
                self._separate(goal, name, topic)
                self.connect(name, {port: topic})
            self._clear(topic, name)
        place = (name, port) if name else ("", "")
        datatype = claim.wanted_type if datatype in ANY else datatype
        return replace(claim, topic=topic, datatype=datatype, goal=place)

    def _relay(self, goal: _Supply, topic: str = "") -> str:
        """Relay a stream that stays on its topic to ``topic``, or a new one; name the relay."""
        # The tags that hold for all messages there.
        tags = self.world.common_tags(goal.topic, goal.tags)
        made = relay(goal.topic, goal.datatype, tuple(map(str, tags)))
        name = self._spawn(made, {"in": goal}, () if topic else ("out",))
        out = {"out": topic} if topic else {}
        self._separate(goal, name, topic)
        self.connect(name, {"in": self._supply(goal.source).topic, **out})
        return name

    def _spawn_monitor(self, claim: Claim, goal: _Supply) -> str:
        """Let a new nodelet evaluate the formula of the request: it knows no earlier stream."""
        delivered = goal._replace(topic=claim.topic, datatype=claim.datatype)
        made = monitor(claim.topic, claim.datatype)
        given = monitored(claim.request.require, claim.datatype)
        return self._spawn(made, {STREAM: delivered}, (VERDICTS,), given)

    def _separate(self, goal: _Supply, publisher: str, topic: str) -> None:
        """Disconnect the replaced publisher before the goal comes if it is of another individual.

        Else it goes afterwards, without a gap.
        """
        if any({*each.tags} != {*goal.tags} for each in self.world.producers(topic)):
            self._clear(topic, publisher)

    def _clear(self, topic: str, publisher: str) -> None:
        """Disconnect every other publisher of the client's topic: it was replaced."""
        for record, ports in self.world.publishers(topic):
            is_other = record.name != publisher and record.transformation is not None
            if is_other and self._context.monitor.is_reachable(record):
                self.connect(record.name, dict.fromkeys(ports, ""))

    # Parts of a step

    def _spawn(
        self,
        transformation: Transformation,
        supplies: Mapping[str, _Supply],
        outputs: Iterable[str],
        given: tuple[Parameter, ...] = (),
    ) -> str:
        """Make a nodelet that is connected from its start, and return its name.

        An in-port whose type may not fit that of its supplier is connected later. The out-ports of
        ``outputs`` get topics of their own.
        """
        try:
            kind = self._manager.host.kind_of(transformation)
        except DyKnowError:
            self.failed_label = transformation.label
            raise
        types = {port.name: port.datatype for port in transformation.ports}
        inputs = {}
        for port, supply in supplies.items():
            wanted, found = types.get(port, ""), supply.datatype
            is_certain = wanted not in ANY and found not in ANY and types_fit(wanted, found)
            if is_certain or not kind.is_written_for_dyknow:
                inputs[port] = supply.topic
        near = [supply.topic for supply in supplies.values()]
        for name in self._free_names(transformation.label):
            self._context.lock.reserve([name])
            own = {port: names.topic_after(name, port) for port in sorted(outputs)}
            config = {**inputs, **own}
            request = SpawnRequest(transformation.label, name, config, parameters=given)
            try:
                self.spawn(transformation, request, near)
            except NameTaken:
                continue
            return name
        raise SpawnFailed(transformation.label, "all names for it are taken")

    def _await(self, supply: _Supply, old: str, new: str) -> None:
        """Wait for a new supplier to deliver, if it replaces one that still delivers."""
        name = supply.nodelet
        if name not in self.spawned or old in ("", new) or not self._flows(old):
            return
        record, clock = self.world.records[name], self._context.clock
        if self._deadline is None:
            self._deadline = clock() + _HANDOVER
        with ExitStack() as closing:
            counter = self._counter(record, supply.source.port, closing)
            begin = clock()  # earlier answers are about earlier nodelets of the name
            while not _shows_messages(next(counter), begin):
                if clock() >= self._deadline:
                    late = f"though it sent nothing within {_HANDOVER:g} s"
                    self._remarks.append(f"{name} took over {late}")
                    return
                with self._context.lock.pause():
                    self._context.sleep(_STEP)
                self.world = self._connector.world()

    def _counter(self, record: Record, port: str, closing: ExitStack) -> Iterator[Count | None]:
        """Count the messages of an out-port; a lazy C++ nodelet sends only to subscribers."""
        host = self._manager.host
        if not record.kind.is_written_for_dyknow:
            listening = host.listen(record.topics.get(port, ""))
            closing.callback(listening.close)
            while True:
                yield listening.count()
        while True:
            counts = host.counts({record.manager: (record.name,)}).get(record.name)
            yield (counts or {}).get(port)

    def _flows(self, topic: str) -> bool:
        """Whether a healthy nodelet publishes on a topic."""
        unfit = self._context.monitor.unfit()
        return any(record.name not in unfit for record, _ in self.world.publishers(topic))

    def _may_move(self, name: str, topic: str) -> bool:
        """Whether a nodelet may leave the topic that it publishes on: no other part needs it."""
        if name in self.spawned or not topic:
            return True
        record = self.world.records[name]
        is_a_users = not record.claimed or (record.is_protected and name not in self._movable)
        if is_a_users or topic in self._taken_topics():
            return False
        own = {*self._movable, *self.spawned}
        return not any(
            ports_on(record, IN, topic)
            for record in self.world.records.values()
            if record.name not in own and record.state is State.RUNNING
        )

    # Free names

    def _taken_topics(self) -> set[str]:
        """Topics on which the clients of other claims listen."""
        claims, mine = self.world.claims, self._claim.claim_id
        return {each.topic for each in claims if each.topic and each.claim_id != mine}

    def _free_topic(self, name: str, port: str) -> str:
        """Name a topic after an out-port, but none that a successor has taken over."""
        taken = self._taken_topics() | {self._claim.topic, *self.world.described}
        taken |= {
            each.topic
            for record in self.world.records.values()
            for each in record.ports
            if each.direction == OUT and record.name != name
        }
        return names.free_topic(name, port, taken.__contains__)

    def _free_names(self, label: str) -> Iterator[str]:
        """Yield global names for nodelets of a transformation: /bottom_camera_1, _2 ..."""
        records = self.world.records
        taken = {topic for record in records.values() for topic in record.topics.values()}
        taken |= self._taken_topics() | {self._claim.topic, *self.world.described}
        label = _RELAY_OF_RELAY.sub(r"\1", label)
        stem = re.sub(r"[^A-Za-z0-9_]+", "_", label).strip("_")
        if not stem[:1].isalpha():
            stem = f"nodelet_{stem}".rstrip("_")
        for number in range(1, _MOST_NAMES):
            name = names.join(self._manager.namespace, f"{stem}_{number}")
            left = [topic for topic in taken if topic.startswith(name + "/")]
            if not left and name not in records and not self._manager.graph.is_busy(name):
                yield name


def _shows_messages(count: Count | None, since: float) -> bool:
    return count is not None and count.asked >= since and count.messages > 0
