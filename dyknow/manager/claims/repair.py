"""Mends streams: finds out what is wrong with one, and makes it anew from what is there."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any, Dict, Hashable, Mapping, Optional, Tuple

from dyknow.backoff import Backoff
from dyknow.errors import DyKnowError, StreamTypeMismatch
from dyknow.manager.claim import Claim
from dyknow.manager.claims.assembly import Assembly
from dyknow.manager.claims.assembly_request import AssemblyRequest, AssemblyResult
from dyknow.manager.claims.claim_lock import ClaimLock
from dyknow.manager.claims.claim_planner import ClaimPlanner
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.connector import Connector
from dyknow.manager.claims.delivery import Delivery
from dyknow.manager.claims.demands import wanted_type
from dyknow.manager.claims.diagnosis import Fault, diagnose
from dyknow.manager.claims.first_message import FirstMessageMonitor
from dyknow.manager.claims.flows import FlowMeter
from dyknow.manager.claims.garbage_collector import GarbageCollector
from dyknow.manager.claims.silence_monitor import SilenceMonitor
from dyknow.manager.manager import Manager
from dyknow.manager.planning.problem import NoPlan, Plan
from dyknow.manager.record import Record
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState

#: Seconds of the first pause after a failure: longer than a round of the reconciler, so that
#: another way is tried in between.
FIRST_PAUSE = 1.0
#: Times that a stream is planned anew because parts went while it was being made.
_ATTEMPTS = 3

_log = logging.getLogger("rosout.dyknow")


class Repair:
    """Mends one claim after the other; one call at a time."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        claim_lock: ClaimLock,
        claim_planner: ClaimPlanner,
        delivery: Delivery,
        garbage_collector: GarbageCollector,
        failures: Backoff,
        silence: SilenceMonitor,
        counts: FlowMeter,
        first_messages: FirstMessageMonitor,
        connector: Connector,
    ) -> None:
        """Mend nothing yet; hear of nodelets that die from now on."""
        self._manager = manager
        self._table = table
        self._planner = claim_planner
        self._assembly = Assembly(
            manager, table, claim_lock, connector, delivery, self._note_failure
        )
        self._garbage_collector = garbage_collector
        self._failures = failures
        self._silence = silence
        self._counts = counts
        self._first_messages = first_messages
        self._connector = connector
        self._culprit = ""
        #: Claims of which nothing came when they were planned last, and what there was then.
        self._hopeless: Dict[str, Tuple[Hashable, str]] = {}
        manager.observer.on_death = self._note_death
        manager.observer.on_crash = failures.failed

    def diagnose(self, claim: Claim) -> Optional[Fault]:
        """Say what is wrong with a claim's stream; None if it is whole."""
        silence, published = self._silence, self._planner.published
        look = self._connector.topology
        return diagnose(
            self._manager, claim, silence.silent, silence.unresponsive, published, look
        )

    def carry_out(
        self, claim: Claim, plan: Plan, lenient: bool = False
    ) -> Tuple[Plan, AssemblyResult]:
        """Make a claim's stream as a plan says.

        It is made another way where types turn out wrong, or parts went while new ones came up.

        Args:
            claim: whose stream it is.
            plan: what to try first.
            lenient: use what failed lately too, if there is no other way.

        Raises:
            StreamTypeMismatch: every way carries another type than is needed.
            DyKnowError: a step failed; what was made is undone.
        """
        wrong: Dict[str, StreamTypeMismatch] = {}
        attempts = 0
        while True:
            own = self._planner.own(claim)
            try:
                return plan, self._carry_out(claim, plan, own)
            except StreamTypeMismatch as error:
                if error.label in wrong:
                    raise
                wrong[error.label] = error
                failure: DyKnowError = next(iter(wrong.values()))
            except DyKnowError as error:
                attempts += 1
                if attempts == _ATTEMPTS or self._are_there(plan, own):
                    raise
                failure = error
            answer = self._planner.plan(claim, lenient, frozenset(wrong))
            if isinstance(answer, NoPlan):
                raise failure
            plan = answer

    def _are_there(self, plan: Plan, own: Mapping[str, str]) -> bool:
        """Whether the nodelets that a plan counted on are still there."""
        counted_on = {live.nodelet for live in plan.live if live.nodelet}
        counted_on.update(
            own[step.action.label] for step in plan.steps if step.action.label in own
        )
        found = map(self._manager.graph.find, counted_on)
        return all(record is not None and record.state is State.RUNNING for record in found)

    def _carry_out(self, claim: Claim, plan: Plan, own: Mapping[str, str]) -> AssemblyResult:
        request = AssemblyRequest(
            plan,
            claim.request.tag,
            claim.topic,
            wanted_type(claim),
            own,
            self._silence.unhealthy,
            self._silence.unresponsive,
            claim.claim_id,
            self._planner.ordinary(),
        )
        done = self._assembly.carry_out(request)
        self._counts.excuse(done.wiring)
        done.detail = self._first_messages.expect(claim, done.goal, done.topic)
        self._garbage_collector.replaced(replace(claim, **outcome(done)))
        return done

    def mend(self, claim_id: str) -> None:
        """Mend a claim's stream if something is wrong with it and there is a way.

        Raises:
            DyKnowError: nobody can tell what is wrong.
        """
        claim = self._table.find(claim_id)
        if claim is None:
            return
        fault = self.diagnose(claim)
        if fault is None:
            if claim.state is not ClaimState.ACTIVE:
                detail = self._first_messages.expect(claim, claim.goal, claim.topic)
                whole = {"state": ClaimState.ACTIVE, "detail": detail}
                self._table.change(claim_id, "it is whole again", **whole)
            return
        despair = (self._planner.signature(), fault.what)
        if self._hopeless.get(claim_id) == despair:
            return
        answer = self._planner.plan(claim)
        if isinstance(answer, NoPlan):
            self._hopeless[claim_id] = despair
            self._despair(claim, fault, answer)
            return
        if not self._failures.allows(claim_id):
            return
        if claim.state is ClaimState.ACTIVE and answer.steps:
            changes = {"state": ClaimState.RECOVERING, "detail": fault.what}
            claim = self._table.change(claim_id, fault.what, **changes) or claim
        self._culprit = ""
        try:
            _, done = self.carry_out(claim, answer)
        except DyKnowError as error:
            if not self._culprit:
                self._failures.failed(claim_id)
            failed = {"state": ClaimState.FAILED, "detail": str(error)}
            self._table.change(claim_id, fault.what, **failed)
            return
        self._failures.forgive(claim_id)
        reason = f"mended: {fault.what}" if claim.is_made else "it can be made now"
        reason = with_remarks(reason, done)
        self._table.change(claim_id, reason, **outcome(done))

    def _despair(self, claim: Claim, fault: Fault, answer: NoPlan) -> None:
        """There is no way now: say why, and whether one is to be expected by itself."""
        if self._planner.is_waiting(claim):
            if claim.state is ClaimState.FAILED:
                return  # it says why already
            state = ClaimState.RECOVERING
            detail = f"{fault.what}; what could supply it failed lately and is left for a while"
        else:
            state = ClaimState.PENDING
            detail = str(answer) if fault.severed else f"{fault.what}; {answer}"
        if not claim.topic:
            state = ClaimState.PENDING
        elif not fault.severed:
            state = ClaimState.DEGRADED
        changes: Dict[str, Any] = {"state": state, "detail": detail}
        if state is ClaimState.PENDING and claim.is_made:
            if self._garbage_collector.take_apart(claim):
                kept = set(self._planner.own(claim).values()) & set(claim.wiring)
                wiring: Dict[str, Dict[str, str]] = {name: {} for name in kept}
                changes.update(wiring=wiring, goal=("", ""), sources=())
            else:
                still = "but a part of it cannot be disconnected yet"
                changes.update(state=ClaimState.FAILED, detail=f"{detail}; {still}")
                self._hopeless.pop(claim.claim_id, None)  # it is tried again
        self._table.change(claim.claim_id, fault.what, **changes)

    # Failures

    def forget_ended(self) -> None:
        """Forget claims that ended."""
        for claim_id in [each for each in self._hopeless if self._table.find(each) is None]:
            del self._hopeless[claim_id]

    def _note_failure(self, label: str) -> None:
        """Count against a transformation that no nodelet could be made of it."""
        self._culprit = label
        self._failures.failed(label)

    def _note_death(self, record: Record) -> None:
        """Count the death of a nodelet's process against its transformation."""
        self._failures.served(record.label, self._manager.graph.lifetime(record.name))
        self._failures.failed(record.label)

    def blame(self, name: str) -> None:
        """Count the silence of a nodelet or topic against its transformation."""
        _log.warning("%s", self._silence.silent[name])
        record = self._manager.graph.find(name)
        if record is not None:
            self._note_death(record)


def outcome(done: AssemblyResult) -> Dict[str, Any]:
    """Write what became of a plan as changes of its claim."""
    return {
        "topic": done.topic,
        "datatype": done.datatype,
        "goal": done.goal,
        "wiring": done.wiring,
        "sources": tuple(sorted(done.sources)),
        "state": ClaimState.ACTIVE,
        "detail": done.detail,
    }


def with_remarks(reason: str, done: AssemblyResult) -> str:
    """Add to a reason what did not go as it should."""
    return "; ".join([reason, *done.remarks])
