# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Plans for claims, from the world of the moment.

Claims whose clients listen on the same topic are planned together, since one publisher has to
satisfy them all.
"""

from __future__ import annotations

import contextlib
from typing import (
    AbstractSet,
    Dict,
    FrozenSet,
    Hashable,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from dyknow.datatypes import ANY
from dyknow.errors import StreamTypeMismatch
from dyknow.manager.claim import Claim
from dyknow.manager.claims.assembly import STAMPED
from dyknow.manager.claims.context import ClaimContext
from dyknow.manager.claims.plan_inputs import (
    Instance,
    OwnNodelet,
    PlanInputs,
    assigned,
    instance_of,
    wishes_of,
)
from dyknow.manager.claims.topology import demand_of, may_share
from dyknow.manager.planning.planner import BUDGET, Planner
from dyknow.manager.planning.problem import (
    NO_LABELS,
    NO_WISHES,
    Answer,
    Demand,
    Live,
    NoPlan,
    Plan,
    PlanStep,
    TaggedStream,
    Wishes,
    ways_to_meet,
)
from dyknow.manager.specifications.tags import Bindings, Subsumption, Term
from dyknow.model.transformation import Transformation


class Situation(NamedTuple):
    """All that a plan follows from, as it was at one moment.

    Attributes:
        demand: the demand on the stream.
        topic: where the clients listen; empty for wherever the stream is.
        streams: those that can be relied on.
        usable: those of the streams that steps may receive.
        own: nodelets that can be connected elsewhere.
        exclude: labels that must have no part in it.
        paused: labels of which nothing is to be made since they failed lately.
        engaged: labels of external nodes that can only be used as they are connected.
        wishes: preferences of the client.
        upstream: labels upstream of each nodelet of the streams, where there are wishes.
        budget: seconds that the improvement of the plan may take.
        known: transformations by label.
    """

    demand: Demand
    topic: str
    streams: Tuple[TaggedStream, ...]
    usable: Tuple[TaggedStream, ...]
    own: Tuple[OwnNodelet, ...]
    exclude: FrozenSet[str]
    paused: FrozenSet[str]
    engaged: FrozenSet[str]
    wishes: Wishes
    upstream: Mapping[str, FrozenSet[str]]
    budget: float
    known: Mapping[str, Transformation]

    def tags(self, live: Live) -> Optional[FrozenSet[Term]]:
        """Return the tags of a stream; None if it is not there."""
        found = [tags for each, tags in self.streams if each[:4] == live[:4]]
        return frozenset(found[0]) if found else None


class Proposal(NamedTuple):
    """An answer, and the situation that it was found for."""

    situation: Situation
    answer: Answer


class ClaimPlanner:
    """Plans in the present world; used under the lock of the claims."""

    def __init__(self, context: ClaimContext, ontology: Subsumption) -> None:
        self._manager = context.manager
        self._table = context.table
        self._lock = context.lock
        self._world = context.connector.world
        self._monitor = context.monitor
        self._ontology = ontology
        self._planner = Planner(ontology)
        self._planned_with: Mapping[str, Transformation] = {}
        self._known: Mapping[str, Transformation] = {}
        #: Transformations, streams and nodelets that exist.
        self.inputs = PlanInputs(context, ontology)
        self._failures = context.failures

    def signature(self) -> Hashable:
        """Return a value that differs when a plan may have become possible."""
        manager = self._manager
        return (
            manager.library.revision,
            manager.graph.revision,
            self.inputs.published,
            self._failures.paused,
            self._monitor.unhealthy,
            self._monitor.quality.signature,
        )

    def own(self, claim: Claim, without: AbstractSet[str] = frozenset()) -> List[OwnNodelet]:
        """Return the nodelets that can be connected elsewhere for a claim (``PlanInputs.own``)."""
        self._update()
        own = self.inputs.own(claim, self._known)
        return [each for each in own if each.name not in without]

    def assigned(self, plan: Plan, own: Sequence[OwnNodelet]) -> Dict[Instance, str]:
        """Choose nodelets for the steps of a plan; the other steps need new ones."""
        return assigned(plan, own, self._ontology)

    def price(self, claim: Claim) -> int:
        """Return the cost that would be saved without a claim's stream."""
        own = self._saved(claim, self.own(claim))
        saved = sum(self._known[label].cost for label in own.values())
        if wishes_of(claim) == NO_WISHES:
            return saved
        exclude = frozenset(claim.request.exclude)
        streams = self.inputs.streams(exclude)
        demand = demand_of(self._table.together(claim))
        charges = self._planner_for(self._known).charges(
            demand, streams, exclude, wishes_of(claim)
        )
        return saved + sum(
            charges.get(label, 0) for label in self.inputs.labels(claim.nodelets, claim.sources)
        )

    # Plans

    def common_topic(self, claim: Claim) -> str:
        """Return where another client listens whose stream will do for a claim; empty for none."""
        sharing = [each for each in self._table.living() if each.topic and may_share(claim, each)]
        return sharing[0].topic if sharing else ""

    def plan(
        self,
        claim: Claim,
        lenient: bool = False,
        avoid: FrozenSet[str] = NO_LABELS,
        without: AbstractSet[str] = frozenset(),
    ) -> Answer:
        """Plan a claim's stream; its own nodelets cost nothing.

        A request lets rounds pass meanwhile: ``still_fits`` says whether it can be used then.

        Args:
            claim: whose stream it is.
            lenient: use transformations that failed lately too, if nothing else will do.
            avoid: labels that turned out to be of no use.
            without: nodelets that must have no part in it.
        """
        return self.propose(claim, lenient, avoid, without).answer

    def propose(
        self,
        claim: Claim,
        lenient: bool = False,
        avoid: FrozenSet[str] = NO_LABELS,
        without: AbstractSet[str] = frozenset(),
    ) -> Proposal:
        """Plan a claim's stream as ``plan`` does; returns the situation, too."""
        situation = self.situation(claim, avoid, without)
        answer = self._solved(situation, situation.paused)
        if isinstance(answer, NoPlan) and lenient and situation.paused:
            answer = self._solved(situation, NO_LABELS)
        if isinstance(answer, Plan) and self._is_unstamped(claim, answer):
            stamped = self.propose(claim, lenient, avoid | {answer.goal.label}, without)
            if isinstance(stamped.answer, Plan):
                return stamped
        return Proposal(situation, answer)

    def situation(
        self,
        claim: Claim,
        avoid: FrozenSet[str] = NO_LABELS,
        without: AbstractSet[str] = frozenset(),
    ) -> Situation:
        """Read all that a plan for a claim follows from."""
        return self._situation(self._table.together(claim), claim.topic, avoid, without)

    def still_fits(self, claim: Claim, proposal: Proposal) -> bool:
        """Whether every part that a plan uses is still there, unchanged."""
        before, now = proposal.situation, self.situation(claim)
        if isinstance(proposal.answer, NoPlan):
            return before == now
        steps = {step.action.label for step in proposal.answer.steps}
        return (
            before.demand == now.demand
            and not steps & now.exclude
            and steps <= before.known.keys()
            and all(now.known.get(label) == before.known[label] for label in steps)
            and all(before.tags(live) == now.tags(live) for live in proposal.answer.live)
        )

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
        situation = self._situation([claim], claim.topic)
        return bool(situation.paused) and isinstance(self._solved(situation, NO_LABELS), Plan)

    def plan_from_scratch(self, claim: Claim) -> Answer:
        """Plan a claim's stream as if the nodelets that it alone needs did not exist."""
        own, together = self.own(claim), self._table.together(claim)
        saved = self._saved(claim, own)
        present = [each for each in own if self._known[each.label].node]
        exclude = frozenset(claim.request.exclude)
        without = frozenset(saved) | self._monitor.quality.unfit(together)
        streams = self.inputs.without_relays(self.inputs.streams(exclude, without))
        paused = self._paused(together) - frozenset(saved.values())
        demand = demand_of(together)
        paused |= self.inputs.engaged(present)
        feeders = self.inputs.upstream(claim, streams)
        with self._planning(self._known) as (planner, _):
            return planner.plan(
                demand,
                streams,
                exclude,
                {each.label: each.kept for each in present},
                paused=paused,
                wishes=wishes_of(claim),
                feeders=feeders,
            )

    def bindings(self, demand: Demand) -> Tuple[List[Bindings], bool]:
        """Find the names that a demand's variables can stand for, and whether these are all."""
        self._update()
        streams = self.inputs.without_relays(self.inputs.streams(NO_LABELS))
        with self._planning(self._known) as (planner, _):
            return planner.bindings(demand, streams)

    # Inside

    def with_own(
        self,
        plan: Plan,
        own: Sequence[OwnNodelet],
        known: Optional[Mapping[str, Transformation]] = None,
    ) -> Plan:
        """Return a plan in which nodelets that exist cost nothing, and new ones their price."""
        known = self._known if known is None else known
        used = self.assigned(plan, own)
        steps = tuple(
            step._replace(
                action=step.action._replace(
                    cost=0 if instance_of(step) in used else _cost(step, known)
                )
            )
            for step in plan.steps
        )
        plan = plan._replace(steps=steps)
        return plan._replace(cost=plan.total, least_cost=min(plan.total, plan.least_cost))

    def _is_unstamped(self, claim: Claim, plan: Plan) -> bool:
        """Whether a claim needs stamped messages, and a plan is known to make unstamped ones."""
        known = self._goal_type(plan) if claim.request.max_age else ""
        return known not in ANY and self._manager.host.is_stamped(known) is False

    def _goal_type(self, plan: Plan) -> str:
        """ROS type of a plan's stream; empty while it is not known."""
        goal = plan.goal
        if isinstance(goal, Live):
            return goal.datatype
        found = self._known.get(goal.label)  # None if the library has changed meanwhile
        ports = found.ports if found is not None else ()
        return next((port.datatype for port in ports if port.name == goal.port), "")

    def _paused(self, claims: Iterable[Claim]) -> FrozenSet[str]:
        """Labels of which no nodelet is to be made for these claims now."""
        return self._failures.paused | self._monitor.quality.paused(claims)

    def _saved(self, claim: Claim, own: Iterable[OwnNodelet]) -> Dict[str, str]:
        """Those of its own that nothing would need if these clients needed no stream: labels."""
        together = {each.claim_id for each in self._table.together(claim)}
        kept = {
            name
            for each in self._table.living()
            if each.claim_id not in together
            for name in each.nodelets
        }
        kept.update(each.name for each in self._world().records.values() if each.is_protected)
        return {
            each.name: each.label
            for each in own
            if each.name in claim.wiring
            and each.name not in kept
            and not self._known[each.label].node
        }

    def _situation(
        self,
        claims: List[Claim],
        topic: str,
        avoid: FrozenSet[str] = NO_LABELS,
        without: AbstractSet[str] = frozenset(),
    ) -> Situation:
        """Read all that a plan for claims follows from."""
        first = claims[0]
        exclude = avoid | {label for claim in claims for label in claim.request.exclude}
        own = tuple(each for each in self.own(first, without) if each.label not in exclude)
        unfit = self._monitor.quality.unfit(claims) | without
        streams = tuple(self.inputs.streams(exclude, unfit))
        return Situation(
            demand_of(claims),
            topic,
            streams,
            tuple(self.inputs.without_relays(streams)),
            own,
            exclude,
            self._paused(claims),
            self.inputs.engaged(own),
            wishes_of(first),
            self.inputs.upstream(first, streams),
            max(claim.request.budget for claim in claims) or BUDGET,
            self._known,
        )

    @contextlib.contextmanager
    def _planning(self, known: Mapping[str, Transformation]) -> Iterator[Tuple[Planner, bool]]:
        """Let rounds pass while a request plans with transformations.

        Returns:
            What to plan with, and whether rounds may pass.
        """
        planner = self._planner_for(known)
        with self._lock.pause() as is_aside:
            yield planner, is_aside

    def _solved(self, situation: Situation, paused: FrozenSet[str]) -> Answer:
        """Plan; in a round within the default budget, even if clients allow more."""
        present = self._present(situation)
        if present is not None:
            return present
        free = {each.label: each.kept for each in reversed(situation.own)}
        paused |= situation.engaged
        with self._planning(situation.known) as (planner, is_aside):
            while True:
                answer = planner.plan(
                    situation.demand,
                    situation.usable,
                    situation.exclude,
                    free,
                    paused - free.keys(),
                    situation.budget if is_aside else min(situation.budget, BUDGET),
                    situation.wishes,
                    situation.upstream,
                )
                if isinstance(answer, NoPlan):
                    return answer
                divided = self._divided(answer, situation)
                if not divided:
                    return self.with_own(answer, situation.own, situation.known)
                paused |= divided
                free = {label: free[label] for label in free.keys() - divided}

    def _divided(self, plan: Plan, situation: Situation) -> FrozenSet[str]:
        """Labels of external nodes that a plan needs more than once: no further one is made."""
        used = self.assigned(plan, situation.own)
        steps = [step for step in plan.steps if instance_of(step) not in used]
        return frozenset(
            step.action.label
            for step in steps
            if step.action.label in situation.known and situation.known[step.action.label].node
        )

    def _present(self, situation: Situation) -> Optional[Plan]:
        """Find a stream that will do and is where the client listens already."""
        demand, topic = situation.demand, situation.topic
        for stream, terms in sorted(situation.streams):
            is_good = demand.is_fast(stream.rate) and demand.is_soon(stream.latency)
            if topic and stream.topic == topic and is_good:
                ways = ways_to_meet(terms, stream.datatype, demand, self._ontology)
                for way in ways:
                    bindings = tuple(sorted(way.items()))
                    return Plan(demand, stream, (), 0, 0, bindings, latency=stream.latency)
        return None

    def _planner_for(self, present: Mapping[str, Transformation]) -> Planner:
        """Return a planner for these transformations, by label; any thread may use it.

        Each of its plans is made with the library of its time.
        """
        known = self._planned_with
        if known is not present:
            gone = [label for label in known if label not in present]
            if gone:
                self._planner.remove(*gone)
            self._planner.add(each for each in present.values() if known.get(each.label) != each)
            self._planned_with = present
        return self._planner

    def _update(self) -> None:
        """Read the transformations that plans may have steps of."""
        self._known = self.inputs.transformations()


def _cost(step: PlanStep, known: Mapping[str, Transformation]) -> int:
    """Return the price of a new nodelet; the library may have changed since it was planned."""
    found = known.get(step.action.label)
    return step.action.cost if found is None else found.cost
