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
    Set,
    Tuple,
)

from dyknow.backoff import Backoff
from dyknow.errors import HostError, StreamTypeMismatch, UnknownTransformation
from dyknow.manager.claim import Claim
from dyknow.manager.claims.context import ClaimContext
from dyknow.manager.claims.own_nodelets import Instance, OwnNodelet, assigned, instance_of
from dyknow.manager.claims.plan_context import STAMPED
from dyknow.manager.claims.relay import is_relay
from dyknow.manager.claims.streams import live_streams, with_feeders
from dyknow.manager.claims.topology import demand_of, may_share
from dyknow.manager.library import Library
from dyknow.manager.planning.planner import BUDGET, Planner
from dyknow.manager.planning.problem import NO_LABELS, Answer, Live, NoPlan, Plan
from dyknow.manager.planning.supply import ANY, Demand, ways_to_meet
from dyknow.manager.planning.wishes import NO_WISHES, TaggedStream, Wishes
from dyknow.manager.record import Record
from dyknow.manager.specifications.given import exposed_variables
from dyknow.manager.specifications.tags import Bindings, Subsumption
from dyknow.model.graph import State
from dyknow.model.transformation import Transformation

#: Seconds for which the answer to "which topics are published?" is good enough.
_FRESH = 0.5
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
        self._lock = context.lock
        self._connector = context.connector
        self._monitor = context.monitor
        self._clock = context.clock
        self._ontology = ontology
        self._planner = Planner(ontology)
        self._known: Dict[str, Transformation] = {}
        self._known_at: Tuple[int, FrozenSet[str]] = (-1, NO_LABELS)
        self._nodes_at: Tuple[int, FrozenSet[str]] = (-1, NO_LABELS)
        self._looked = float("-inf")
        #: Failures of transformations, by label.
        self.failures = Backoff(context.clock, _FIRST_PAUSE)
        #: Topics of ordinary nodes that had a publisher at the last look.
        self.published: FrozenSet[str] = frozenset()

    # What exists

    def look(self, at_once: bool = False) -> None:
        """Ask which topics of ordinary nodes are published: now and then, or ``at_once``.

        The last answer holds until there is another one.
        """
        now = self._clock()
        if now - self._looked < _FRESH and not at_once:
            return
        self._looked = now
        wanted = {each.source for each in self._manager.existing_topics()}
        wanted.update(topic for claim in self._table.living() for topic in claim.sources)
        try:
            self.published = self._manager.host.published(sorted(wanted))
        except HostError:
            return  # the ROS master is away, which interrupts no stream

    def ordinary(self) -> FrozenSet[str]:
        """Topics on which ordinary nodes publish what the library describes."""
        return self.published & {each.source for each in self._manager.existing_topics()}

    def signature(self) -> Hashable:
        """Return a value that differs when a plan may have become possible."""
        manager = self._manager
        return (
            manager.library.revision,
            manager.graph.revision,
            self.published,
            self.failures.paused,
            self._monitor.unhealthy,
            self._monitor.quality.signature,
        )

    def offers(self) -> Hashable:
        """Return a value that differs when a plan may have become cheaper."""
        others = frozenset(
            record.name
            for record in self._manager.graph.all()
            if not record.claimed and record.state is State.RUNNING
        )
        return self._manager.library.revision, self.published, others

    def own(self, claim: Claim) -> List[OwnNodelet]:
        """Healthy nodelets that can be connected elsewhere for a claim, the preferred ones first.

        These are the claim's own nodelets and those that no claim needs, and nodes of others that
        the library describes. Parts that other claims
        share are among them, unless these claims exclude what this one does not, or have other
        wishes; they have to go on supplying the same.
        """
        self._update()
        sharing = [each for each in self._table.living() if each.claim_id != claim.claim_id]
        needed = self._table.needed() | self._lock.reserved
        idle = [record.name for record in self._manager.graph.all() if record.name not in needed]
        unfit = self._monitor.unhealthy | self._monitor.quality.unfit(self._together(claim))
        found: List[OwnNodelet] = []
        topology = self._connector.topology()
        for name in reversed((*idle, *claim.nodelets)):
            record = self._manager.graph.find(name)
            users = [each for each in sharing if name in each.wiring]
            if (
                record is not None
                and (record.claimed or (record.is_described and record.is_complete))
                and record.state is State.RUNNING
                and name not in unfit
                and record.transformation == self._known.get(record.label)
                and record.transformation is not None
                and all(
                    set(each.request.exclude) <= set(claim.request.exclude)
                    and wishes_of(each) == wishes_of(claim)
                    for each in users
                )
            ):
                exposed = exposed_variables(record.transformation)
                ways = topology.dependent.ways(name) if exposed else None
                present = {_restricted(way, exposed) for way in ways or ()}
                bound = min(present) if len(present) == 1 else ()
                is_certain = {variable for variable, _ in bound} == exposed
                if is_certain or not users:
                    kept = bound if users else tuple(sorted(record.given.items()))
                    found.append(OwnNodelet(name, record.label, kept, bound))
        return found

    def assigned(self, plan: Plan, own: Sequence[OwnNodelet]) -> Dict[Instance, str]:
        """Choose nodelets for the steps of a plan; the other steps need new ones."""
        return assigned(plan, own, self._ontology)

    def price(self, claim: Claim) -> int:
        """Return what would be saved if a claim's stream did not exist."""
        saved = sum(self._known[label].cost for label in self._saved(claim).values())
        if wishes_of(claim) == NO_WISHES:
            return saved
        exclude = frozenset(claim.request.exclude)
        streams = self._streams(exclude)
        demand = demand_of(self._together(claim))
        charges = self._planner.charges(demand, streams, exclude, wishes_of(claim))
        return saved + sum(
            charges.get(label, 0) for label in self._labels(claim.nodelets, claim.sources)
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
        together = self._together(claim)
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
        self._update()
        own, together = self._saved(claim), self._together(claim)
        present = [each for each in self.own(claim) if self._known[each.label].node]
        exclude = frozenset(claim.request.exclude)
        without = frozenset(own) | self._monitor.quality.unfit(together)
        streams = self._without_relays(self._streams(exclude, without))
        paused = self._paused(together) - frozenset(own.values()) | self._engaged(present)
        demand = demand_of(together)
        return self._planner.plan(
            demand,
            streams,
            exclude,
            {each.label: each.kept for each in present},
            paused=paused,
            wishes=wishes_of(claim),
            feeders=self._feeders(claim, streams),
        )

    def bindings(self, demand: Demand) -> Tuple[List[Bindings], bool]:
        """Find what the variables of a demand can stand for now, and whether that is all."""
        self._update()
        return self._planner.bindings(demand, self._without_relays(self._streams(NO_LABELS)))

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

    def _together(self, claim: Claim) -> List[Claim]:
        """List the claims whose clients listen where this one's does; this one first."""
        others = [each for each in self._table.living() if each.claim_id != claim.claim_id]
        return [claim, *(each for each in others if each.topic and each.topic == claim.topic)]

    def _saved(self, claim: Claim) -> Dict[str, str]:
        """Nodelets that nothing would need if these clients needed no stream, with labels."""
        together = {each.claim_id for each in self._together(claim)}
        kept = {
            name
            for each in self._table.living()
            if each.claim_id not in together
            for name in each.nodelets
        }
        kept.update(each.name for each in self._manager.graph.all() if each.is_protected)
        return {
            each.name: each.label
            for each in self.own(claim)
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
        streams = self._streams(exclude, self._monitor.quality.unfit(claims))
        present = self._present(demand, streams, topic)
        if present is not None:
            return present
        streams = self._without_relays(streams)
        free = {each.label: each.kept for each in reversed(own)}
        budget = max(claim.request.budget for claim in claims) or BUDGET
        feeders = self._feeders(claims[0], streams)
        paused |= self._engaged(own)
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

    def _engaged(self, own: Iterable[OwnNodelet]) -> FrozenSet[str]:
        """Labels of the nodes of others that run, but can be connected as they are alone."""
        _, described = self._known_at
        return described - {each.label for each in own}

    def _divided(self, plan: Plan, own: Sequence[OwnNodelet]) -> FrozenSet[str]:
        """Labels of nodes of others that a plan needs more than once: no further one is made."""
        used = self.assigned(plan, own)
        steps = [step for step in plan.steps if instance_of(step) not in used]
        return frozenset(
            step.action.label for step in steps if self._known[step.action.label].node
        )

    def _feeders(self, claim: Claim, streams: Iterable[TaggedStream]) -> Dict[str, FrozenSet[str]]:
        """Labels of what feeds each nodelet of streams, where the claim has wishes about it."""
        if wishes_of(claim) == NO_WISHES:
            return {}
        records, ordinary = self._manager.graph.all(), self.ordinary()
        found = {}
        for name in {stream.nodelet for stream, _ in streams if stream.nodelet}:
            fed: Dict[str, Dict[str, str]] = {name: {}}
            topics: Set[str] = set()
            with_feeders(records, ordinary, fed, topics, {name})
            found[name] = frozenset(self._labels(fed.keys() - {name}, topics))
        return found

    def _labels(self, nodelets: Iterable[str], topics: Iterable[str]) -> List[str]:
        """Labels of nodelets that run, and of ordinary topics."""
        found = [self._manager.graph.find(name) for name in nodelets]
        wanted = set(topics)
        described = [
            each.label for each in self._manager.existing_topics() if each.source in wanted
        ]
        return [record.label for record in found if record is not None] + described

    def _without_relays(self, streams: Iterable[TaggedStream]) -> List[TaggedStream]:
        """Leave out what relays publish: a plan takes it from where they receive it."""
        relays = {
            record.name for record in self._manager.graph.all() if is_relay(record.transformation)
        }
        return [each for each in streams if each[0].nodelet not in relays]

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

    def _streams(
        self, exclude: AbstractSet[str], without: AbstractSet[str] = frozenset()
    ) -> List[TaggedStream]:
        """List the streams that can be relied on.

        Args:
            exclude: labels that must have no part in them, directly or further up.
            without: nodelets and topics that must have no part in them.
        """
        manager = self._manager
        published = [
            each
            for each in manager.existing_topics()
            if each.label not in exclude
            and each.source in self.published
            and each.source not in self._monitor.silent
            and each.source not in without
        ]
        records = manager.graph.all()
        excluded = {
            record.name
            for record in records
            if record.label in exclude
            or (record.claimed and not is_current(manager.library, record))
        }
        unfit = without | excluded | self._monitor.unhealthy
        topology = self._connector.topology()
        return live_streams(records, published, topology, self._ontology, unfit)

    def _update(self) -> None:
        """Bring the planner up to date with the library."""
        library = self._manager.library
        if self._planner.waste > max(_WASTE, len(self._planner)):
            self._planner = Planner(self._ontology)
            self._known, self._known_at = {}, (-1, NO_LABELS)
        nodes = self._described_nodes()
        if self._known_at == (library.revision, nodes):
            return
        self._known_at = library.revision, nodes
        present = {
            each.label: each for each in library.all() if not each.node or each.label in nodes
        }
        for label in [label for label in self._known if label not in present]:
            self._planner.remove(label)
        known = self._known
        self._planner.add(each for each in present.values() if known.get(each.label) != each)
        self._known = present

    def _described_nodes(self) -> FrozenSet[str]:
        """Labels of the nodes of others that run, found once for each revision of the graph."""
        graph = self._manager.graph
        revision, nodes = self._nodes_at
        if revision != graph.revision:
            revision = graph.revision  # first: what comes meanwhile is found the next time
            nodes = frozenset(
                each.label
                for each in graph.all()
                if each.is_described and each.state is State.RUNNING
            )
            self._nodes_at = revision, nodes
        return nodes


def wishes_of(claim: Claim) -> Wishes:
    """Return what a claim's client would rather have."""
    request = claim.request
    return Wishes(tuple(sorted(set(request.prefer))), tuple(sorted(set(request.avoid))))


def _restricted(way: Mapping[str, str], variables: AbstractSet[str]) -> Bindings:
    return tuple(sorted((each, way[each]) for each in variables if each in way))


def is_current(library: Library, record: Record) -> bool:
    """Whether the library still has what a nodelet was made from, perhaps in a newer version."""
    if is_relay(record.transformation):
        return True
    try:
        library.get(record.label)
    except UnknownTransformation:
        return False
    return True
