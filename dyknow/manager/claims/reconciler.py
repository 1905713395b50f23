# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps requested streams alive: the reconciler of claims.

The claims are the desired state, the graph is the observed one. Each round asks the same
question of each claim, after any event: is its stream whole? If not, it is planned and made from
the present world. The client's topic stays.

One change of claims at a time (``ClaimLock``). Listing, renewing and ending claims waits for none,
and a plan for a client holds up none.
"""

from __future__ import annotations

import itertools
import logging
import time
import uuid
from dataclasses import replace
from functools import partial
from typing import Callable, Collection, Hashable

from dyknow.errors import NoPlanFound, StreamTypeMismatch
from dyknow.manager.claim import Claim, ClaimEvent, check_request
from dyknow.manager.claims.answers import CheaperPlans, refusal
from dyknow.manager.claims.assembly import Acquired
from dyknow.manager.claims.claim_planner import STAMPED, ClaimPlanner, Proposal
from dyknow.manager.claims.claim_table import ClaimLock, ClaimTable
from dyknow.manager.claims.connector import ClaimContext, Connector
from dyknow.manager.claims.garbage_collector import GarbageCollector
from dyknow.manager.claims.judgements import StreamMonitor
from dyknow.manager.claims.repair import Repair
from dyknow.manager.claims.requirements import is_own
from dyknow.manager.manager import Manager
from dyknow.manager.planning.problem import Demand, Live, NoPlan, Plan
from dyknow.manager.specifications.tags import Bindings, parse_tag
from dyknow.manager.supervision.lifecycle import ManagerContext, StreamKeeper
from dyknow.manager.supervision.observer import PERIOD
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.periodic import PAUSE, attempt

#: Rounds in the ``max_silence`` of a claim.
_ROUNDS = 4
#: Times that a request is planned because a part of its plan went meanwhile.
_ATTEMPTS = 3

_log = logging.getLogger("rosout.dyknow")


class StreamReconciler:
    """All claims, and their requests and rounds; safe from any thread."""

    def __init__(self, context: ClaimContext) -> None:
        """Take over the claims in the table; ``reconcile`` works on them."""
        self.manager = context.manager  # makes and destroys nodelets
        self._ended = self._had_work = False
        self._required_at: Hashable = None
        self._context = context
        self._table = context.table
        self._lock = context.lock
        self._monitor = context.monitor
        self._planner = ClaimPlanner(context)
        self._cheaper_plans = CheaperPlans(context, self._planner)
        self._collector = GarbageCollector(context)
        self._repair = Repair(context, self._planner, self._collector)

    # Requests of clients. Other work goes on while they plan: plans are checked before their use

    def acquire(self, request: StreamRequest, dry_run: bool = False) -> Acquired:
        """Make a stream, or only plan it, and keep it until it is released or its lease ends.

        A request that cannot be met now stays pending: ``NoPlanFound`` has the id of its claim.

        Raises:
            BadParameter: a value of the request is of no use.
            InvalidTag: the tag is not a term.
            NoPlanFound: nothing supplies it; the missing tags are named.
            StreamTypeMismatch: the stream has another type, or none with a header for ``max_age``.
            Denied: the mode is read-only.
            DyKnowError: it could not be made; nothing is left of it.
        """
        check_request(request)
        claim = Claim("" if dry_run else uuid.uuid4().hex[:12], request)
        parse_tag(request.tag)
        if request.max_age and self.manager.host.is_stamped(request.datatype) is False:
            raise StreamTypeMismatch(request.tag, STAMPED, request.datatype)
        if not dry_run:
            self.manager.guards.check_writable(f"acquiring '{request.tag}'")
        self._planner.look(at_once=True)
        if dry_run:
            return self._explained(*self._drafted(claim))
        for number in itertools.count(1):
            known = self._table.same(request)
            proposal = None
            if known is None:
                claim, proposal = self._drafted(claim)
            with self._lock.request():
                known = self._table.same(request)
                if known is not None and not known.topic:
                    raise NoPlanFound(known.detail, known.claim_id)
                if known is not None:
                    return Acquired(known, None, (), known.nodelets)
                if proposal is None or (
                    number < _ATTEMPTS and not self._is_current(claim, proposal)
                ):
                    continue
                answer = proposal.answer
                if isinstance(answer, NoPlan):
                    self._table.add(replace(claim, topic="", detail=str(answer)), "requested")
                    missing = answer
                    break
                self._planner.check_goal(claim, answer)
                made = self._repair.make(claim, answer, lenient=True)
                return replace(made, claim=self._table.add(made.claim, "requested"))
        raise self._refusal(claim, missing)

    def replan(self, claim_id: str, dry_run: bool = False) -> Acquired:
        """Use the cheapest plan of today, if it is cheaper than the stream or that is broken.

        Raises:
            UnknownClaim: the claim is unknown, or has ended.
            NoPlanFound: nothing supplies it now.
            DyKnowError: it could not be made; the stream is as it was.
        """
        if not dry_run:
            self.manager.guards.check_writable(f"replanning claim '{claim_id}'")
        for number in itertools.count(1):
            self._planner.look(at_once=True)
            claim, proposal = self._redrafted(claim_id)
            if dry_run:
                return self._explained(claim, proposal)
            with self._lock.request(claim_id):
                claim = self._table.get(claim_id)
                if number < _ATTEMPTS and not self._planner.still_fits(claim, proposal):
                    continue
                answer = proposal.answer
                if isinstance(answer, NoPlan):
                    missing = answer
                    break
                if self._is_as_planned(claim, answer):
                    kept = replace(claim, detail=self._monitor.restart(claim))
                    made = Acquired(kept, answer, (), claim.nodelets)
                else:
                    made = self._repair.make(claim, answer, lenient=True)
                reason = "; ".join(["replanned on request", *made.remarks])
                changed = self._table.change(claim_id, reason, **made.changes)
                self._lock.free()  # it is made
                self._collector.clear_topics()
                return replace(made, claim=changed or claim)
        raise self._refusal(claim, missing)

    def plan(self, claim_id: str, exclude: Collection[str]) -> Acquired:
        """Plan a claim's stream again without some transformations (labels), and change nothing.

        Raises:
            UnknownClaim: the claim is unknown, or has ended.
            NoPlanFound: nothing else supplies it now.
        """
        self._planner.look(at_once=True)
        with self._lock.reading():
            claim = self._table.get(claim_id)
            proposal = self._planner.propose(claim, lenient=True, avoid=frozenset(exclude))
        if isinstance(proposal.answer, NoPlan):
            excluded = (*claim.request.exclude, *exclude)
            raise NoPlanFound(refusal(self.manager, proposal.answer, excluded))
        return self._explained(claim, proposal)

    def release(self, claim_id: str) -> None:
        """End a claim; one that has ended, or is unknown, is not an error."""
        self._table.end(claim_id, ClaimState.RELEASED, "released")

    def expire(self, claim_id: str, reason: str) -> None:
        """End a claim whose client is gone; one that has ended is not an error."""
        self._table.end(claim_id, ClaimState.EXPIRED, reason)

    def renew(self, claim_id: str, lease: float) -> Claim:
        """Let a claim live for ``lease`` seconds from now; 0 for until it is released."""
        return self._table.renew(claim_id, lease)

    def claims(self) -> list[Claim]:
        """Return every claim, those that ended lately included, by id."""
        return self._table.all()

    def report(self, news: str) -> None:
        """Send an event about each claim that has not ended, which changes none."""
        for claim in self._table.living:
            self._table.report(claim.claim_id, news)

    def find_bindings(self, tag: str, datatype: str = "") -> tuple[list[Bindings], bool]:
        """Find the names for which a stream of a tag is there or, verdicts aside, can be made.

        Returns the names that its variables stand for in each way, sorted, and whether these are
        all.
        """
        demand = Demand(frozenset([parse_tag(tag)]), datatype)
        self._planner.look()
        with self._lock.reading():
            return self._planner.bindings(demand)

    def _drafted(self, claim: Claim) -> tuple[Claim, Proposal]:
        """Plan a new claim's stream; returns the claim with the topic that it may share."""
        with self._lock.reading():
            claim = replace(claim, topic=self._planner.common_topic(claim))
            return claim, self._planner.propose(claim, lenient=True)

    def _is_current(self, claim: Claim, proposal: Proposal) -> bool:
        """Whether a new claim would be planned alike now."""
        is_there = claim.topic == self._planner.common_topic(claim)
        return is_there and self._planner.still_fits(claim, proposal)

    def _redrafted(self, claim_id: str) -> tuple[Claim, Proposal]:
        """Plan a claim's stream again: a cheaper way if there is one."""
        with self._lock.reading():
            claim = self._table.get(claim_id)
            situation = self._planner.situation(claim)
            is_whole = self._repair.diagnose(claim) is None
            cheaper = self._planner.cheaper(claim) if is_whole else None
            if cheaper is not None:
                return claim, Proposal(situation, cheaper)
            return claim, self._planner.propose(claim, lenient=True)

    def _is_as_planned(self, claim: Claim, plan: Plan) -> bool:
        """Whether a claim's stream is whole and what a plan would make of it."""
        is_there = isinstance(plan.goal, Live) and plan.goal.topic == claim.topic
        return is_there and not plan.steps and self._repair.diagnose(claim) is None

    def _explained(self, claim: Claim, proposal: Proposal) -> Acquired:
        """Answer a dry run: labels of new nodelets, and names of those that would be used."""
        plan = proposal.answer
        if isinstance(plan, NoPlan):
            raise self._refusal(claim, plan)
        with self._lock.reading():
            self._planner.check_goal(claim, plan)
            own = self._planner.assigned(plan, self._planner.own(claim))
        used = {stream.nodelet or stream.topic for stream in plan.live}
        new = [each.instance.label for each in plan.steps if each.instance not in own]
        claim = replace(claim, bindings=plan.bindings)
        return Acquired(claim, plan, tuple(new), tuple(sorted({*used, *own.values()})))

    def _refusal(self, claim: Claim, answer: NoPlan) -> NoPlanFound:
        return NoPlanFound(refusal(self.manager, answer, claim.request.exclude), claim.claim_id)

    # Reconciling

    def work(self) -> float | None:
        """Reconcile while there are claims, nodelets of claims, or ports to give back.

        One more round follows the end of the last claim, and releases its nodelets. Returns the
        seconds until the next round; None for the next change.
        """
        had_work, self._had_work = self._had_work, self._has_work()
        if had_work or self._had_work:
            self.reconcile()
        if not self._has_work():
            return None
        silences = (claim.request.max_silence for claim in self._table.living)
        waits = [PERIOD, self._repair.pause_ends, *(each / _ROUNDS for each in silences if each)]
        return max(PAUSE, min(waits))

    def _has_work(self) -> bool:
        return bool(self._table.living) or any(
            record.claimed or record.owed for record in self.manager.graph.all()
        )

    def reconcile(self) -> None:
        """Check every claim once, and repair broken streams."""
        with self._lock.round():
            if self._ended:
                return
            self._table.expire_late()
            self._planner.look()
            self._hold_requirements()
            self._context.connector.ask()
            self._context.connector.remember()
            self._collector.disconnect()
            attempt("judging streams", partial(self._monitor.read, self._repair.hold()), _log)
            self._repair.forget_ended()
            # Claims that use another claim's stream come behind that one: a lost part that its
            # client listens to is replaced where that listens, and they follow, without a relay.
            # Those that have no stream come last: their plans take time.
            claims = self._table.living
            for claim in sorted(claims, key=lambda each: (not each.is_made, len(each.nodelets))):
                if claim.claim_id == self._lock.claim_id:
                    continue  # a request is about to make its stream
                # No fault of one stream is to keep another one from its repair.
                repair = partial(self._repair.repair, claim.claim_id)
                attempt(f"claim {claim.claim_id}", repair, _log)
            self._repair.follow_bindings()
            self._collector.clear_topics()
            self._collector.give_back()
            self._collector.collect()
            self._cheaper_plans.report()
            self._monitor.report()

    def _hold_requirements(self) -> None:
        """Hold claims on the verdicts that the streams of clients may depend on."""
        claims = [claim for claim in self._table.living if not is_own(claim)]
        demands = frozenset((claim.claim_id, claim.demand) for claim in claims)
        at = (self._planner.signature(), demands)
        if at != self._required_at:
            self._required_at = at
            self._monitor.requirements.hold(self._planner.required(claims))

    def end(self) -> None:
        """End every claim and give ports back, since the manager is stopped on purpose."""
        with self._lock.round():
            self._ended = True
        for claim in self._table.living:
            self._table.end(claim.claim_id, ClaimState.RELEASED, "the manager was stopped")
        with self._lock.round():
            if any(record.owed for record in self.manager.graph.all()):
                self._collector.disconnect()  # some may be in the way
                self._collector.give_back()


def open_reconciler(
    context: ManagerContext,
    sleep: Callable[[float], None] = time.sleep,
    running: Callable[[], float] | None = None,
    on_event: Callable[[ClaimEvent], object] = lambda event: None,
    recover: float = 2.0,
) -> StreamReconciler:
    """Make a manager, and the reconciler of its streams; ``manager.start`` comes first.

    ``sleep`` waits so many seconds, while a replacement comes up; ``running`` returns those for
    which this process has run, by default those of the clock. ``on_event`` is called with every
    change of a claim, on the thread that made it. A verdict has to be TRUE for ``recover`` seconds
    after it was FALSE, until parts that require it are used.
    """
    now = context.clock.now
    running = running or now
    keeper = StreamKeeper(
        lambda record: connector.world().fitting(record),
        lambda record: monitor.fell(record, record.incarnation),
        lambda label: monitor.failed(label),
        lambda label: monitor.forgive(label),
    )
    context = replace(context, keeper=keeper)
    table = ClaimTable(context.store, now, running, on_event)
    connector = Connector(context, table)
    monitor = StreamMonitor(context, table, lambda: connector.world(), running, recover)
    lock, manager = ClaimLock(), Manager(context)
    return StreamReconciler(ClaimContext(manager, table, lock, connector, monitor, now, sleep))
