"""Keeps requested streams alive: the reconciler of claims.

Desired are the claims, observed is the graph. Whatever happened, the reconciler asks of each
claim the same question, what is wrong with its stream, and if something is makes a new plan with
what is there now. The client's topic stays.

One change of claims at a time (``turn``); looking at them, renewing and ending them waits for
nobody.
"""

from __future__ import annotations

import logging
import time
import uuid
from dataclasses import dataclass, replace
from typing import Callable, List, Mapping, Optional, Tuple

from dyknow.backoff import Backoff
from dyknow.errors import DyKnowError, NoPlanFound
from dyknow.manager.claim import Claim, ClaimEvent
from dyknow.manager.claims.advice import refusal
from dyknow.manager.claims.cheaper_plans import CheaperPlans
from dyknow.manager.claims.claim_lock import ClaimLock
from dyknow.manager.claims.claim_planner import ClaimPlanner
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.connector import Connector
from dyknow.manager.claims.delivery import Delivery
from dyknow.manager.claims.demands import demand_of
from dyknow.manager.claims.first_message import FirstMessageMonitor
from dyknow.manager.claims.flows import FlowMeter
from dyknow.manager.claims.garbage_collector import GarbageCollector
from dyknow.manager.claims.repair import FIRST_PAUSE, Repair, outcome, with_remarks
from dyknow.manager.claims.silence_monitor import SilenceMonitor
from dyknow.manager.manager import Manager
from dyknow.manager.planning.problem import NoPlan, Plan
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption
from dyknow.model.streams import ClaimState, StreamRequest

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class ReconcilerSettings:
    """How the reconciler behaves.

    Attributes:
        linger: seconds that a nodelet that no claim needs any more is kept.
        handover: seconds that replacements may take to deliver before the old goes all the same.
        ended_kept: claims that ended and can still be asked about.
    """

    linger: float = 5.0
    handover: float = 2.0
    ended_kept: int = 100


DEFAULT_RECONCILER_SETTINGS = ReconcilerSettings()
"""Nodelets linger for five seconds; replacements have two to deliver."""


@dataclass(frozen=True)
class Acquired:
    """Answer to a request.

    Attributes:
        claim: the claim; without an id for a dry run.
        plan: how the stream is made; None for a claim that was there.
        spawned: nodelets that were made, or would be (labels, for a dry run).
        reused: nodelets that are used as they are.
    """

    claim: Claim
    plan: Optional[Plan]
    spawned: Tuple[str, ...] = ()
    reused: Tuple[str, ...] = ()

    @property
    def cost(self) -> int:
        """What was, or would be, paid for new nodelets."""
        return 0 if self.plan is None else self.plan.cost


class StreamReconciler:
    """All claims, and what is done for them."""

    def __init__(
        self,
        manager: Manager,
        ontology: Subsumption = NO_ONTOLOGY,
        settings: ReconcilerSettings = DEFAULT_RECONCILER_SETTINGS,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Take up the claims that the store has; nothing is done before ``reconcile``.

        Args:
            manager: makes and destroys nodelets.
            ontology: what is a kind of what.
            settings: how to behave.
            clock: seconds, steady.
            sleep: waits that long, while a replacement comes up.
        """
        self._manager = manager
        self._claim_lock = ClaimLock()
        self._ended = False
        self._table = ClaimTable(manager.store, clock, settings.ended_kept)
        self._counts = FlowMeter(manager.host, manager.graph, clock)
        self._silence = SilenceMonitor(self._counts, manager.graph)
        self._first_messages = FirstMessageMonitor(self._table, self._counts, manager.graph, clock)
        failures = Backoff(clock, FIRST_PAUSE)
        self._connector = Connector(manager, self._table, ontology, clock)
        self._planner = ClaimPlanner(
            manager,
            ontology,
            self._table,
            failures,
            self._silence,
            self._claim_lock,
            self._connector,
            clock,
        )
        self._cheaper_plans = CheaperPlans(self._table, self._planner)
        self._garbage_collector = GarbageCollector(
            manager,
            self._table,
            self._claim_lock,
            self._silence,
            self._connector,
            settings.linger,
            clock,
        )

        def wait(seconds: float) -> None:
            with self._claim_lock.pause():
                sleep(seconds)

        delivery = Delivery(manager.host, settings.handover, clock, wait)
        self._repair = Repair(
            manager,
            self._table,
            self._claim_lock,
            self._planner,
            delivery,
            self._garbage_collector,
            failures,
            self._silence,
            self._counts,
            self._first_messages,
            self._connector,
        )

    @property
    def on_event(self) -> Callable[[ClaimEvent], None]:
        """Called with every change of a claim, on the thread that made it."""
        return self._table.on_event

    @on_event.setter
    def on_event(self, callback: Callable[[ClaimEvent], None]) -> None:
        self._table.on_event = callback

    # What clients ask

    def acquire(self, request: StreamRequest, dry_run: bool = False) -> Acquired:
        """Make a stream, and keep it until it is released or its lease ends.

        A request that cannot be met now stays pending: ``NoPlanFound`` names its claim.

        Raises:
            InvalidTag: the tag is no term.
            NoPlanFound: nothing supplies it; the tags that are missing are named.
            StreamTypeMismatch: the stream turned out to have another type.
            Denied: the mode is read-only.
            DyKnowError: it could not be made; nothing is left of it.
        """
        claim = Claim("" if dry_run else uuid.uuid4().hex[:12], request)
        demand_of([claim])
        if not dry_run:
            self._manager.guards.check_writable(f"acquiring '{request.tag}'")
        with self._claim_lock.round() if dry_run else self._claim_lock.request():
            known = None if dry_run else self._table.same(request)
            if known is not None and not known.topic:
                raise NoPlanFound(known.detail, known.claim_id)
            if known is not None:
                return Acquired(known, None, (), known.nodelets)
            self._planner.look(at_once=True)
            claim = replace(claim, topic=self._planner.common_topic(claim))
            answer = self._planner.plan(claim, lenient=True)
            if isinstance(answer, NoPlan):
                if not dry_run:
                    self._table.add(replace(claim, topic="", detail=str(answer)), "requested")
                reason = refusal(self._manager, answer, request.exclude)
                raise NoPlanFound(reason, claim.claim_id)
            if dry_run:
                return Acquired(claim, answer, *_intended(answer, self._planner.own(claim)))
            plan, done = self._repair.carry_out(claim, answer, lenient=True)
            claim = self._table.add(replace(claim, **outcome(done)), "requested")
        return Acquired(claim, plan, tuple(done.spawned), tuple(sorted(done.reused)))

    def release(self, claim_id: str) -> None:
        """End a claim; ending it again, or one that nobody knows any more, is no error."""
        self._table.end(claim_id, ClaimState.RELEASED, "released")

    def expire(self, claim_id: str, reason: str) -> None:
        """End a claim whose client is gone, such as one whose bond broke; no error if it ended."""
        self._table.end(claim_id, ClaimState.EXPIRED, reason)

    def renew(self, claim_id: str, lease: float) -> Claim:
        """Let the claim live for so many seconds from now (0: until it is released).

        Raises:
            UnknownClaim: there is no such claim, or it ended.
        """
        return self._table.renew(claim_id, lease)

    def replan(self, claim_id: str, dry_run: bool = False) -> Acquired:
        """Take the cheapest way of today, if it is cheaper than the present one or that is broken.

        Raises:
            UnknownClaim: there is no such claim, or it ended.
            NoPlanFound: there is no way at all now.
            DyKnowError: it could not be made; the stream is as it was.
        """
        if not dry_run:
            self._manager.guards.check_writable(f"replanning claim '{claim_id}'")
        with self._claim_lock.round() if dry_run else self._claim_lock.request(claim_id):
            claim = self._table.get(claim_id)
            self._planner.look(at_once=True)
            fault = self._repair.diagnose(claim)
            own = self._planner.own(claim)
            cheaper = self._cheaper_plans.cheaper(claim) if fault is None else None
            answer = cheaper or self._planner.plan(claim, lenient=True)
            if isinstance(answer, NoPlan):
                reason = refusal(self._manager, answer, claim.request.exclude)
                raise NoPlanFound(reason, claim_id)
            if dry_run:
                return Acquired(claim, answer, *_intended(answer, own))
            plan, done = self._repair.carry_out(claim, answer, lenient=True)
            changed = self._table.change(
                claim_id, with_remarks("replanned on request", done), **outcome(done)
            )
            self._garbage_collector.clear_topics()
        return Acquired(changed or claim, plan, tuple(done.spawned), tuple(sorted(done.reused)))

    def claims(self) -> List[Claim]:
        """Return every claim, those that ended lately too, by id."""
        return self._table.all()

    # What is done for them

    def end(self) -> None:
        """End every claim, as the manager is stopped on purpose; nothing is mended any more."""
        with self._claim_lock.round():
            self._ended = True
        for claim in self._table.living():
            self._table.end(claim.claim_id, ClaimState.RELEASED, "the manager was stopped")

    def reconcile(self) -> None:
        """Look at every claim once, and mend what is broken."""
        with self._claim_lock.round():
            if self._ended:
                return
            self._table.end_late()
            self._planner.look()
            self._connector.ask()
            self._garbage_collector.disconnect()
            self._repair.forget_ended()
            claims = self._table.living()
            came = self._counts.read(
                self._first_messages.periods(claims), self._silence.periods(claims)
            )
            for name in self._silence.look(claims, came):
                self._repair.blame(name)
            for claim in sorted(claims, key=_upstream_first):
                if claim.claim_id == self._claim_lock.claim_id:
                    continue  # a request is about to make it anew
                try:
                    self._repair.mend(claim.claim_id)
                except DyKnowError as error:
                    _log.warning("claim %s: %s", claim.claim_id, error)
            self._garbage_collector.clear_topics()
            self._garbage_collector.collect()
            self._cheaper_plans.tell()
            self._first_messages.look()


def _upstream_first(claim: Claim) -> int:
    """Sort claims on parts of other claims' streams before these.

    A lost part that a client listens to is then replaced where that client listens, and its other
    users follow. The other way round the replacement would publish elsewhere, and it would take a
    relay to bring it to the client.
    """
    return len(claim.nodelets)


def _intended(plan: Plan, own: Mapping[str, str]) -> Tuple[Tuple[str, ...], Tuple[str, ...]]:
    """Labels of what would be made, and names of what would be used."""
    labels = [step.action.label for step in plan.steps]
    used = {stream.nodelet or stream.topic for stream in plan.live}
    used.update(own[label] for label in labels if label in own)
    return tuple(label for label in labels if label not in own), tuple(sorted(used))
