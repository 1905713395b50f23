# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Repairs streams: finds the fault of one, and makes it from the present world."""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any, Hashable, Sequence

from dyknow.backoff import Backoff
from dyknow.errors import DyKnowError, StreamTypeMismatch
from dyknow.manager.claim import Claim
from dyknow.manager.claims.assembly import Acquired, Assembly
from dyknow.manager.claims.claim_planner import ClaimPlanner, OwnNodelet, is_current
from dyknow.manager.claims.connector import ClaimContext, timed_out
from dyknow.manager.claims.garbage_collector import GarbageCollector
from dyknow.manager.planning.problem import Answer, NoPlan, Obstacle, Plan, ways_to_meet
from dyknow.manager.record import ports_on
from dyknow.manager.specifications.tags import Bindings, written_bindings
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import OUT

#: Times that a stream is planned because parts of it went while it was being made.
_ATTEMPTS = 3
#: Seconds of the first pause after a claim's stream could not be made.
_FIRST_PAUSE = 1.0


@dataclass(frozen=True)
class Fault:
    """Why a stream has to be repaired; unless ``severed``, messages may flow unreliably."""

    what: str
    severed: bool = True


class Repair:
    """Repairs one claim's stream at a time; used under the lock of the claims."""

    def __init__(
        self, context: ClaimContext, planner: ClaimPlanner, collector: GarbageCollector
    ) -> None:
        self._context = context
        self._graph = context.manager.graph
        self._table = context.table
        self._monitor = context.monitor
        self._planner = planner
        self._collector = collector
        self._failures = Backoff(context.clock, _FIRST_PAUSE)
        #: Transformation of which no nodelet could be made since the present repair began.
        self._failed_label = ""
        #: Claims without a plan: the planner's signature at the time, the fault, and the requests
        #: that the plan had to satisfy.
        self._unplannable: dict[str, Hashable] = {}
        self._held: frozenset[str] = frozenset()  # claims with nodelets that are being restarted

    # Faults

    def diagnose(self, claim: Claim) -> Fault | None:
        """Return the fault of a claim's stream; None if it is whole."""
        if not claim.topic:
            return Fault("it has no stream yet")
        if not claim.is_made:
            return Fault("it has no stream")
        for topic in claim.sources:
            if topic not in self._planner.published:
                return Fault(f"topic {topic} is not published any more")
            if not self._is_described(topic, claim):
                return Fault(f"topic {topic} is not described any more as what is needed")
        weaknesses = []
        for name in claim.nodelets:
            record = self._graph.find(name)
            if record is None or record.transformation is None:
                return Fault(f"nodelet {name} is gone")
            if record.state is not State.RUNNING:
                return Fault(record.detail or f"nodelet {name} is {record.state.name.lower()}")
            for port, topic in claim.wiring[name].items():
                if record.topics.get(port, "") != topic:
                    return Fault(f"port {port} of {name} was connected elsewhere")
            if record.claimed and not is_current(self._context.manager.library, record):
                weaknesses.append(f"transformation {record.label} was removed")
        weaknesses = self._monitor.faults(claim) + weaknesses
        return Fault(weaknesses[0], severed=False) if weaknesses else None

    def _is_described(self, topic: str, claim: Claim) -> bool:
        """Whether the library still describes a topic as the claim needs it."""
        world = self._context.connector.world()
        consumers = [
            consumer
            for consumer in world.consumers(topic)
            if claim.wiring.get(consumer.nodelet, {}).get(consumer.port) == topic
            or consumer.port == claim.claim_id
        ]
        return topic in world.described and all(
            world.fits(producer, consumer, topic)
            for producer in world.producers(topic)
            for consumer in consumers
        )

    # Making a stream

    def make(self, claim: Claim, plan: Plan, lenient: bool = False) -> Acquired:
        """Make a claim's stream by a plan.

        Another plan is made where types turn out wrong, parts went while others came up, or a
        nodelet manager does not answer. Where two types differ it is the supplier that has no
        part in it, or the consumer if nothing else supplies that. An error that is raised has
        undone every change.
        """
        wrong: dict[str, StreamTypeMismatch] = {}
        late: frozenset[str] = frozenset()
        attempts = 0
        while True:
            consumer = ""
            own = self._planner.own(claim, late)
            try:
                return self._assemble(claim, plan, own)
            except StreamTypeMismatch as error:
                if error.label in wrong:
                    raise
                wrong[error.label] = error
                consumer = error.consumer
                failure: DyKnowError = next(iter(wrong.values()))
            except DyKnowError as error:
                attempts += 1
                is_late = timed_out(error)
                if attempts == _ATTEMPTS or (not is_late and self._are_running(plan, own)):
                    raise
                if is_late:  # the nodelets of managers that do not answer are lost from now on
                    with self._context.lock.pause():
                        self._context.manager.look()
                    late |= self._context.connector.unknown.keys()
                failure = error
            answer = self._planner.propose(claim, lenient, frozenset(wrong), late).answer
            if isinstance(answer, NoPlan) and consumer:
                wrong[consumer] = wrong.popitem()[1]
                answer = self._planner.propose(claim, lenient, frozenset(wrong), late).answer
            if isinstance(answer, NoPlan):
                raise failure
            plan = answer

    def _are_running(self, plan: Plan, own: Sequence[OwnNodelet]) -> bool:
        """Whether the nodelets that a plan counted on still run."""
        names = {live.nodelet for live in plan.live if live.nodelet}
        names.update(self._planner.assigned(plan, own).values())
        found = map(self._graph.find, names)
        return all(record is not None and record.state is State.RUNNING for record in found)

    def _assemble(self, claim: Claim, plan: Plan, own: Sequence[OwnNodelet]) -> Acquired:
        assigned = self._planner.assigned(plan, own)
        movable = {each.name for each in own}
        assembly = Assembly(self._context, claim, plan, assigned, movable, self._planner.ordinary)
        try:
            made = assembly.carry_out()
        except DyKnowError:
            if assembly.failed_label:
                self._failed_label = assembly.failed_label
                self._monitor.failed(assembly.failed_label)
            raise
        detail = self._monitor.restart(made.claim, assembly.changed)
        return replace(made, claim=replace(made.claim, detail=detail))

    # Restarts

    def hold(self) -> frozenset[str]:
        """Return the claims with nodelets that are being restarted, which wait for these.

        Afterwards all parts are judged by their messages from then on.
        """
        held = frozenset(each.claim_id for each in self._table.living if self._waits(each))
        for claim_id in sorted(self._held - held):
            claim = self._table.find(claim_id)
            if claim is not None and claim.state is ClaimState.ACTIVE:
                detail = self._monitor.restart(claim, claim.wiring.keys())
                self._table.change(claim_id, "a part of it was restarted", detail=detail)
        self._held = held
        return held

    def _waits(self, claim: Claim) -> bool:
        return not self._graph.restarting.isdisjoint(claim.nodelets)

    # Repairing

    def repair(self, claim_id: str) -> None:
        """Repair a claim's stream, if something is wrong with it and there is a way."""
        claim = self._table.find(claim_id)
        if claim is None or claim_id in self._held or self._waits(claim):
            return
        fault = self.diagnose(claim)
        if fault is None:
            if claim.state is not ClaimState.ACTIVE:
                whole = {"state": ClaimState.ACTIVE, "detail": self._monitor.restart(claim)}
                self._table.change(claim_id, "it is whole again", **whole)
            return
        waiting = claim
        if not claim.topic:
            claim = replace(claim, topic=self._planner.common_topic(claim))
        requests = tuple([each.request for each in self._table.together(claim)])
        situation = (self._planner.signature(), fault.what, requests)
        if self._unplannable.get(claim_id) == situation:
            return
        answer = self._checked(claim, self._proposed(claim))
        if isinstance(answer, NoPlan):
            self._unplannable[claim_id] = situation
            self._give_up(waiting, fault, answer)
        elif self._failures.allows(claim_id):
            self._mend(claim, fault, answer)

    def _proposed(self, claim: Claim) -> Answer:
        """Plan a stream again: without one of its parts if its formula is FALSE."""
        is_violated = bool(self._monitor.violation(claim))
        parts = {*claim.nodelets, *claim.sources}
        if not is_violated or not parts.isdisjoint(self._monitor.unfit([claim])):
            return self._planner.propose(claim).answer
        found: list[tuple[int, str, str, Plan]] = []
        for part, label in sorted(self._planner.replaceable(claim).items()):
            answer = self._planner.propose(claim, False, frozenset([label]), {part}).answer
            if isinstance(answer, Plan):
                found.append((answer.cost, part, label, answer))
        if not found:
            demand = claim.demand
            nothing = Obstacle(demand, ("no part of it can be replaced",))
            return NoPlan(demand, (), False, obstacles=(nothing,))
        _, part, label, plan = min(found, key=itemgetter(0, 1))
        self._monitor.blame(claim, part, label)
        return plan

    def _checked(self, claim: Claim, answer: Answer) -> Answer:
        """Refuse a plan whose stream is known to have another type than the claim needs."""
        if isinstance(answer, Plan):
            try:
                self._planner.check_goal(claim, answer)
            except DyKnowError as error:
                obstacle = Obstacle(claim.demand, (str(error),))
                return NoPlan(claim.demand, (), False, obstacles=(obstacle,))
        return answer

    def _mend(self, claim: Claim, fault: Fault, plan: Plan) -> None:
        claim_id = claim.claim_id
        if claim.state is ClaimState.ACTIVE and plan.steps:
            changes = {"state": ClaimState.RECOVERING, "detail": fault.what}
            claim = self._table.change(claim_id, fault.what, **changes) or claim
        self._failed_label = ""
        try:
            made = self.make(claim, plan)
        except DyKnowError as error:
            if not self._failed_label:  # else its transformation has a pause
                self._failures.failed(claim_id)
            failed = {"state": ClaimState.FAILED, "detail": str(error)}
            self._table.change(claim_id, fault.what, **failed)
            return
        self._failures.forgive(claim_id)
        reasons = [f"mended: {fault.what}" if claim.is_made else "it can be made now"]
        if claim.bindings not in ((), made.claim.bindings):
            reasons.append(_changed_bindings(made.claim.bindings))
        new = sorted(set(made.claim.wiring) - set(claim.wiring))
        if claim.is_made and new:
            reasons.append(f"{', '.join(new)} {'is' if len(new) == 1 else 'are'} used now")
        self._table.change(claim_id, "; ".join([*reasons, *made.remarks]), **made.changes)

    def follow_bindings(self) -> None:
        """Report the bindings of claims, if they were changed from elsewhere."""
        for claim in self._table.living:
            is_made_now = claim.claim_id == self._context.lock.claim_id
            if not claim.bindings or claim.state is not ClaimState.ACTIVE or is_made_now:
                continue
            world = self._context.connector.world()
            ontology = self._context.manager.library.ontology
            for producer in world.producers(claim.topic):
                found = ways_to_meet(producer.tags, producer.datatype, claim.demand, ontology)
                ways = [tuple(sorted(way.items())) for way in found]
                if ways and claim.bindings not in ways:
                    reason = _changed_bindings(ways[0])
                    self._table.change(claim.claim_id, reason, bindings=ways[0])
                    break

    def _give_up(self, claim: Claim, fault: Fault, answer: NoPlan) -> None:
        """Report that no plan exists now, and whether one is to be expected without a change."""
        if self._planner.is_waiting(claim):
            if claim.state is ClaimState.FAILED:
                return  # its detail says why
            state = ClaimState.RECOVERING
            detail = f"{fault.what}; what could supply it failed lately and is left for a while"
        else:
            state = ClaimState.PENDING
            detail = str(answer) if fault.severed else f"{fault.what}; {answer}"
        if not claim.topic:
            state = ClaimState.PENDING
        elif not fault.severed:
            state = ClaimState.DEGRADED
        changes: dict[str, Any] = {"state": state, "detail": detail}
        if state is ClaimState.PENDING and claim.is_made:
            if self._collector.take_apart(claim):
                wiring: dict[str, dict[str, str]] = {name: {} for name in self._kept(claim)}
                changes.update(wiring=wiring, goal=("", ""), sources=(), bindings=(), monitor="")
            else:
                still = "but a part of it cannot be disconnected yet"
                changes.update(state=ClaimState.FAILED, detail=f"{detail}; {still}")
                self._unplannable.pop(claim.claim_id, None)  # it is tried again
        self._table.change(claim.claim_id, fault.what, **changes)

    def _kept(self, claim: Claim) -> set[str]:
        """Nodelets that a claim without a stream keeps for itself.

        An external node is left to other claims, unless the clients listen where it publishes.
        """
        records = [self._graph.find(each.name) for each in self._planner.own(claim)]
        return {
            record.name
            for record in records
            if record is not None
            and record.name in claim.wiring
            and (record.claimed or ports_on(record, OUT, claim.topic))
        }

    @property
    def pause_ends(self) -> float:
        """Seconds until the next attempt that has to wait may be made; infinite if none has to."""
        return min(self._failures.soonest, self._monitor.pause_ends)

    def forget_ended(self) -> None:
        """Forget the claims that have ended."""
        ids = {claim.claim_id for claim in self._table.living}
        self._unplannable = {key: each for key, each in self._unplannable.items() if key in ids}


def _changed_bindings(bindings: Bindings) -> str:
    return f"{written_bindings(bindings)} from now on"
