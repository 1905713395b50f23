# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Plans for claims, from what exists at the moment.

Claims whose clients listen on the same topic are planned together, since one publisher has to
satisfy them all.
"""

from __future__ import annotations

from typing import (
    AbstractSet,
    Dict,
    FrozenSet,
    Hashable,
    Iterable,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
)

from dyknow.backoff import Backoff
from dyknow.datatypes import ANY
from dyknow.errors import StreamTypeMismatch
from dyknow.manager.claim import Claim
from dyknow.manager.claims.context import ClaimContext
from dyknow.manager.claims.own_nodelets import Instance, OwnNodelet, assigned, instance_of
from dyknow.manager.claims.plan_context import STAMPED
from dyknow.manager.claims.supplies import Supplies, wishes_of
from dyknow.manager.claims.topology import demand_of, may_share
from dyknow.manager.planning.planner import BUDGET, Planner
from dyknow.manager.planning.problem import NO_LABELS, Answer, Live, NoPlan, Plan
from dyknow.manager.planning.supply import Demand, ways_to_meet
from dyknow.manager.planning.wishes import NO_WISHES, TaggedStream
from dyknow.manager.specifications.tags import Bindings, Subsumption
from dyknow.model.transformation import Transformation

#: Outdated terms that the planner may keep, if the library has fewer transformations.
_WASTE = 1_000
#: Seconds of the first pause of a transformation that failed: longer than a round of the
#: reconciler, so that another way is tried in between.
_FIRST_PAUSE = 1.0


class ClaimPlanner:
    """Plans with what exists; used under the lock of the claims."""

    def __init__(self, context: ClaimContext, ontology: Subsumption) -> None:
        """Begin without a look at the topics.

        Args:
            context: what the parts of the reconciler share.
            ontology: what is a kind of what.
        """
        self._manager = context.manager
        self._table = context.table
        self._monitor = context.monitor
        self._ontology = ontology
        self._planner = Planner(ontology)
        self._known: Mapping[str, Transformation] = {}
        #: What exists.
        self.supplies = Supplies(context, ontology)
        #: Failures of transformations, by label.
        self.failures = Backoff(context.clock, _FIRST_PAUSE)

    def signature(self) -> Hashable:
        """Return a value that differs when a plan may have become possible."""
        manager = self._manager
        return (
            manager.library.revision,
            manager.graph.revision,
            self.supplies.published,
            self.failures.paused,
            self._monitor.unhealthy,
            self._monitor.quality.signature,
        )

    def own(self, claim: Claim) -> List[OwnNodelet]:
        """Return the nodelets that can be connected elsewhere for a claim (``Supplies.own``)."""
        self._update()
        return self.supplies.own(claim, self._known)

    def assigned(self, plan: Plan, own: Sequence[OwnNodelet]) -> Dict[Instance, str]:
        """Choose nodelets for the steps of a plan; the other steps need new ones."""
        return assigned(plan, own, self._ontology)

    def price(self, claim: Claim) -> int:
        """Return what would be saved if a claim's stream did not exist."""
        own = self._saved(claim, self.own(claim))
        saved = sum(self._known[label].cost for label in own.values())
        if wishes_of(claim) == NO_WISHES:
            return saved
        exclude = frozenset(claim.request.exclude)
        streams = self.supplies.streams(exclude)
        demand = demand_of(self._table.together(claim))
        charges = self._planner.charges(demand, streams, exclude, wishes_of(claim))
        return saved + sum(
            charges.get(label, 0) for label in self.supplies.labels(claim.nodelets, claim.sources)
        )

    # Plans

    def common_topic(self, claim: Claim) -> str:
        """Return where another client listens whose stream will do for a claim; empty for none."""
        sharing = [each for each in self._table.living() if each.topic and may_share(claim, each)]
        return sharing[0].topic if sharing else ""

    def plan(
        self, claim: Claim, lenient: bool = False, avoid: FrozenSet[str] = NO_LABELS
    ) -> Answer:
        """Plan a claim's stream; its own nodelets cost nothing.

        Args:
            claim: whose stream it is.
            lenient: use transformations that failed lately too, if there is no other way.
            avoid: labels that turned out to be of no use.
        """
        self._update()
        together = self._table.together(claim)
        paused = self._paused(together)
        answer = self._plan(together, claim.topic, paused, avoid)
        if isinstance(answer, NoPlan) and lenient and paused:
            answer = self._plan(together, claim.topic, NO_LABELS, avoid)
        if isinstance(answer, Plan) and self._is_unstamped(claim, answer):
            stamped = self.plan(claim, lenient, avoid | {answer.goal.label})
            answer = stamped if isinstance(stamped, Plan) else answer
        return answer

    def check_stamped(self, claim: Claim, plan: Plan) -> None:
        """Check that messages of a plan bear a stamp if the claim needs one, as far as is known.

        Raises:
            StreamTypeMismatch: they do not.
        """
        if self._is_unstamped(claim, plan):
            found = self._goal_type(plan)
            raise StreamTypeMismatch(claim.request.tag, STAMPED, found, plan.goal.label)

    def is_waiting(self, claim: Claim) -> bool:
        """Whether there would be a plan if nothing had failed lately."""
        return bool(self._paused([claim])) and isinstance(
            self._plan([claim], claim.topic, NO_LABELS), Plan
        )

    def plan_from_scratch(self, claim: Claim) -> Answer:
        """Plan a claim's stream as if the nodelets that it alone needs did not exist."""
        own, together = self.own(claim), self._table.together(claim)
        saved = self._saved(claim, own)
        present = [each for each in own if self._known[each.label].node]
        exclude = frozenset(claim.request.exclude)
        without = frozenset(saved) | self._monitor.quality.unfit(together)
        streams = self.supplies.without_relays(self.supplies.streams(exclude, without))
        paused = self._paused(together) - frozenset(saved.values())
        demand = demand_of(together)
        return self._planner.plan(
            demand,
            streams,
            exclude,
            {each.label: each.kept for each in present},
            paused=paused | self.supplies.engaged(present),
            wishes=wishes_of(claim),
            feeders=self.supplies.feeders(claim, streams),
        )

    def bindings(self, demand: Demand) -> Tuple[List[Bindings], bool]:
        """Find what the variables of a demand can stand for now, and whether that is all."""
        self._update()
        return self._planner.bindings(
            demand, self.supplies.without_relays(self.supplies.streams(NO_LABELS))
        )

    def with_own(self, plan: Plan, own: Sequence[OwnNodelet]) -> Plan:
        """Return a plan in which nodelets that exist cost nothing, and the others their price."""
        used = self.assigned(plan, own)
        steps = tuple(
            step._replace(
                action=step.action._replace(
                    cost=0 if instance_of(step) in used else self._known[step.action.label].cost
                )
            )
            for step in plan.steps
        )
        plan = plan._replace(steps=steps)
        return plan._replace(cost=plan.total, least_cost=min(plan.total, plan.least_cost))

    # Inside

    def _is_unstamped(self, claim: Claim, plan: Plan) -> bool:
        """Whether a claim needs stamped messages, and a plan is known to make others."""
        known = self._goal_type(plan) if claim.request.max_age else ""
        return known not in ANY and self._manager.host.is_stamped(known) is False

    def _goal_type(self, plan: Plan) -> str:
        """ROS type of what a plan makes; empty while it is not known."""
        goal = plan.goal
        if isinstance(goal, Live):
            return goal.datatype
        ports = self._known[goal.label].ports
        return next((port.datatype for port in ports if port.name == goal.port), "")

    def _paused(self, claims: Iterable[Claim]) -> FrozenSet[str]:
        """Labels of which no nodelet is to be made for these claims now."""
        return self.failures.paused | self._monitor.quality.paused(claims)

    def _saved(self, claim: Claim, own: Iterable[OwnNodelet]) -> Dict[str, str]:
        """Those of its own that nothing would need if these clients needed no stream: labels."""
        together = {each.claim_id for each in self._table.together(claim)}
        kept = {
            name
            for each in self._table.living()
            if each.claim_id not in together
            for name in each.nodelets
        }
        kept.update(each.name for each in self._manager.graph.all() if each.is_protected)
        return {
            each.name: each.label
            for each in own
            if each.name in claim.wiring
            and each.name not in kept
            and not self._known[each.label].node
        }

    def _plan(
        self,
        claims: List[Claim],
        topic: str,
        paused: AbstractSet[str],
        avoid: FrozenSet[str] = NO_LABELS,
    ) -> Answer:
        demand = demand_of(claims)
        exclude = avoid | {label for claim in claims for label in claim.request.exclude}
        own = [each for each in self.own(claims[0]) if each.label not in exclude]
        streams = self.supplies.streams(exclude, self._monitor.quality.unfit(claims))
        present = self._present(demand, streams, topic)
        if present is not None:
            return present
        streams = self.supplies.without_relays(streams)
        free = {each.label: each.kept for each in reversed(own)}
        budget = max(claim.request.budget for claim in claims) or BUDGET
        feeders = self.supplies.feeders(claims[0], streams)
        paused |= self.supplies.engaged(own)
        while True:
            answer = self._planner.plan(
                demand,
                streams,
                exclude,
                free,
                paused - free.keys(),
                budget,
                wishes_of(claims[0]),
                feeders,
            )
            if isinstance(answer, NoPlan):
                return answer
            divided = self._divided(answer, own)
            if not divided:
                return self.with_own(answer, own)
            paused |= divided
            free = {label: free[label] for label in free.keys() - divided}

    def _divided(self, plan: Plan, own: Sequence[OwnNodelet]) -> FrozenSet[str]:
        """Labels of nodes of others that a plan needs more than once: no further one is made."""
        used = self.assigned(plan, own)
        steps = [step for step in plan.steps if instance_of(step) not in used]
        return frozenset(
            step.action.label for step in steps if self._known[step.action.label].node
        )

    def _present(
        self, demand: Demand, streams: Iterable[TaggedStream], topic: str
    ) -> Optional[Plan]:
        """Find a stream that will do and is where the client listens already."""
        for stream, terms in sorted(streams):
            is_good = demand.is_fast(stream.rate) and demand.is_soon(stream.latency)
            if topic and stream.topic == topic and is_good:
                ways = ways_to_meet(terms, stream.datatype, demand, self._ontology)
                for way in ways:
                    bindings = tuple(sorted(way.items()))
                    return Plan(demand, stream, (), 0, 0, bindings, latency=stream.latency)
        return None

    def _update(self) -> None:
        """Bring the planner up to date with what its plans may have steps of."""
        if self._planner.waste > max(_WASTE, len(self._planner)):
            self._planner = Planner(self._ontology)
            self._known = {}
        known, present = self._known, self.supplies.transformations()
        if known is present:
            return
        for label in [label for label in known if label not in present]:
            self._planner.remove(label)
        self._planner.add(each for each in present.values() if known.get(each.label) != each)
        self._known = present
