"""Mends streams: finds out what is wrong with one, and makes it anew from what is there."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any, Callable, Dict, Hashable, Mapping, Optional, Tuple

from dyknow.errors import DyKnowError, StreamTypeMismatch
from dyknow.manager.claim import Claim, ClaimState
from dyknow.manager.claims.assembly import Assembly
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.delivery import Delivery
from dyknow.manager.claims.demands import wanted_type
from dyknow.manager.claims.first_message import FirstMessages
from dyknow.manager.claims.housekeeping import Housekeeping
from dyknow.manager.claims.inspection import Damage, inspect
from dyknow.manager.claims.message_counts import MessageCounts
from dyknow.manager.claims.order import Assembled, Order
from dyknow.manager.claims.prospects import Prospects
from dyknow.manager.claims.quarantine import Quarantine
from dyknow.manager.claims.silence import SilenceWatch
from dyknow.manager.claims.turn import Turn
from dyknow.manager.claims.wires import Wires
from dyknow.manager.manager import Manager
from dyknow.manager.model import Record, State
from dyknow.manager.planning.problem import NoPlan, Plan

#: Times that a stream is planned anew because parts went while it was being made.
_ATTEMPTS = 3

_log = logging.getLogger("rosout.dyknow")


class Repair:
    """Mends one claim after the other; one call at a time."""

    def __init__(
        self,
        manager: Manager,
        table: ClaimTable,
        turn: Turn,
        prospects: Prospects,
        delivery: Delivery,
        housekeeping: Housekeeping,
        quarantine: Quarantine,
        silence: SilenceWatch,
        counts: MessageCounts,
        first_messages: FirstMessages,
        wires: Wires,
        clock: Callable[[], float],
    ) -> None:
        """Mend nothing yet; hear of nodelets that die from now on."""
        self._manager = manager
        self._table = table
        self._prospects = prospects
        self._assembly = Assembly(manager, table, turn, wires, delivery, self._note_failure)
        self._housekeeping = housekeeping
        self._quarantine = quarantine
        self._silence = silence
        self._counts = counts
        self._first_messages = first_messages
        self._wires = wires
        self._clock = clock
        self._born: Dict[str, float] = {}
        self._culprit = ""
        #: Claims of which nothing came when they were planned last, and what there was then.
        self._hopeless: Dict[str, Tuple[Hashable, str]] = {}
        manager.observer.on_death = self._note_death
        manager.observer.on_crash = quarantine.blame

    def inspect(self, claim: Claim) -> Optional[Damage]:
        """Say what is wrong with a claim's stream; None if it is whole."""
        silence, published = self._silence, self._prospects.published
        look = self._wires.audience
        return inspect(self._manager, claim, silence.silent, silence.mute, published, look)

    def carry_out(self, claim: Claim, plan: Plan, lenient: bool = False) -> Tuple[Plan, Assembled]:
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
            own = self._prospects.own(claim)
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
            answer = self._prospects.plan(claim, lenient, frozenset(wrong))
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

    def _carry_out(self, claim: Claim, plan: Plan, own: Mapping[str, str]) -> Assembled:
        order = Order(
            plan,
            claim.request.tag,
            claim.topic,
            wanted_type(claim),
            own,
            self._silence.unhealthy,
            self._silence.mute,
            claim.claim_id,
            self._prospects.ordinary(),
        )
        done = self._assembly.carry_out(order)
        self._counts.excuse(done.wiring)
        done.detail = self._first_messages.expect(claim, done.goal, done.topic)
        self._housekeeping.replaced(replace(claim, **outcome(done)))
        return done

    def mend(self, claim_id: str) -> None:
        """Mend a claim's stream if something is wrong with it and there is a way.

        Raises:
            DyKnowError: nobody can tell what is wrong.
        """
        claim = self._table.find(claim_id)
        if claim is None:
            return
        damage = self.inspect(claim)
        if damage is None:
            if claim.state is not ClaimState.ACTIVE:
                detail = self._first_messages.expect(claim, claim.goal, claim.topic)
                whole = {"state": ClaimState.ACTIVE, "detail": detail}
                self._table.change(claim_id, "it is whole again", **whole)
            return
        despair = (self._prospects.signature(), damage.what)
        if self._hopeless.get(claim_id) == despair:
            return
        answer = self._prospects.plan(claim)
        if isinstance(answer, NoPlan):
            self._hopeless[claim_id] = despair
            self._despair(claim, damage, answer)
            return
        if not self._quarantine.allows(claim_id):
            return
        if claim.state is ClaimState.ACTIVE and answer.steps:
            changes = {"state": ClaimState.RECOVERING, "detail": damage.what}
            claim = self._table.change(claim_id, damage.what, **changes) or claim
        self._culprit = ""
        try:
            _, done = self.carry_out(claim, answer)
        except DyKnowError as error:
            if not self._culprit:
                self._quarantine.blame(claim_id)
            failed = {"state": ClaimState.FAILED, "detail": str(error)}
            self._table.change(claim_id, damage.what, **failed)
            return
        self._quarantine.forgive(claim_id)
        reason = f"mended: {damage.what}" if claim.is_made else "it can be made now"
        reason = with_remarks(reason, done)
        self._table.change(claim_id, reason, **outcome(done))

    def _despair(self, claim: Claim, damage: Damage, answer: NoPlan) -> None:
        """There is no way now: say why, and whether one is to be expected by itself."""
        if self._prospects.is_waiting(claim):
            if claim.state is ClaimState.FAILED:
                return  # it says why already
            state = ClaimState.RECOVERING
            detail = f"{damage.what}; what could supply it failed lately and is left for a while"
        else:
            state = ClaimState.PENDING
            detail = str(answer) if damage.severed else f"{damage.what}; {answer}"
        if not claim.topic:
            state = ClaimState.PENDING
        elif not damage.severed:
            state = ClaimState.DEGRADED
        changes: Dict[str, Any] = {"state": state, "detail": detail}
        if state is ClaimState.PENDING and claim.is_made:
            if self._housekeeping.take_apart(claim):
                kept = set(self._prospects.own(claim).values()) & set(claim.wiring)
                wiring: Dict[str, Dict[str, str]] = {name: {} for name in kept}
                changes.update(wiring=wiring, goal=("", ""), sources=())
            else:
                still = "but a part of it cannot be disconnected yet"
                changes.update(state=ClaimState.FAILED, detail=f"{detail}; {still}")
                self._hopeless.pop(claim.claim_id, None)  # it is tried again
        self._table.change(claim.claim_id, damage.what, **changes)

    # Failures

    def keep_books(self) -> None:
        """Remember since when nodelets serve, and forget claims that ended."""
        now = self._clock()
        present = set()
        for record in self._manager.graph.all():
            if record.state is State.RUNNING:
                present.add(record.name)
                self._born.setdefault(record.name, now)
        for name in [name for name in self._born if name not in present]:
            del self._born[name]
        for claim_id in [each for each in self._hopeless if self._table.find(each) is None]:
            del self._hopeless[claim_id]

    def _note_failure(self, label: str) -> None:
        """Count against a transformation that no nodelet could be made of it."""
        self._culprit = label
        self._quarantine.blame(label)

    def _note_death(self, record: Record) -> None:
        """Count the death of a nodelet's process against its transformation."""
        now = self._clock()
        self._quarantine.blame(record.label, now - self._born.get(record.name, now))

    def blame(self, name: str) -> None:
        """Count the silence of a nodelet or topic against its transformation."""
        _log.warning("%s", self._silence.silent[name])
        record = self._manager.graph.find(name)
        if record is not None:
            self._note_death(record)


def outcome(done: Assembled) -> Dict[str, Any]:
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


def with_remarks(reason: str, done: Assembled) -> str:
    """Add to a reason what did not go as it should."""
    return "; ".join([reason, *done.remarks])
