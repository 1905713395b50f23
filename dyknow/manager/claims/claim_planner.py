# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Plans for claims, from the world of the moment.

Claims whose clients listen on the same topic are planned together, since one publisher has to
satisfy them all.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
from functools import lru_cache
from typing import AbstractSet, Hashable, Iterable, Iterator, Mapping, NamedTuple, Sequence

from dyknow.datatypes import ANY
from dyknow.errors import DyKnowError, HostError, StreamTypeMismatch
from dyknow.formulas import parse
from dyknow.manager.claim import STREAM, Claim, demand_of
from dyknow.manager.claims.connector import ClaimContext
from dyknow.manager.claims.ends import RELAY_COST, is_monitor, is_relay
from dyknow.manager.library import Library
from dyknow.manager.planning.planner import BUDGET, Planner
from dyknow.manager.planning.problem import (
    NO_LABELS,
    NO_WISHES,
    Answer,
    Demand,
    Instance,
    Live,
    NoPlan,
    Obstacle,
    Plan,
    TaggedStream,
    Verdicts,
    Wishes,
    meets,
    required_tags,
    ways_to_meet,
)
from dyknow.manager.planning.request import matched
from dyknow.manager.record import Record
from dyknow.manager.specifications.given import exposed_variables
from dyknow.manager.specifications.tags import Bindings, Subsumption, Term, read_tags
from dyknow.model.graph import State
from dyknow.model.transformation import OUT, VERDICT, Transformation, Transformations

#: The demand for a header, beside or instead of a ROS type, for error messages.
STAMPED = "a type that begins with a header (for max_age)"
#: Seconds for which the answer to "which topics are published?" is good enough.
_FRESH = 0.5


class OwnNodelet(NamedTuple):
    """A healthy nodelet that can be connected elsewhere for a claim."""

    name: str  # its name
    label: str  # its transformation
    kept: Bindings = ()  # names that its variables have to stand for wherever it is connected
    present: Bindings = ()  # names that they stand for now, as far as known


class Situation(NamedTuple):
    """All that a plan follows from, as it was at one moment."""

    demand: Demand
    topic: str  # where the clients listen; empty for wherever the stream is
    streams: tuple[TaggedStream, ...]  # those that can be relied on
    usable: tuple[TaggedStream, ...]  # those of the streams that steps may receive
    own: tuple[OwnNodelet, ...]  # nodelets that can be connected elsewhere
    exclude: frozenset[str]  # labels that must have no part in it
    paused: frozenset[str]  # labels of which nothing is to be made since they failed lately
    external: frozenset[str]  # labels of external nodes, of which none is made
    wishes: Wishes
    #: Labels upstream of each nodelet of the streams, where there are wishes.
    upstream: Mapping[str, Sequence[str]]
    budget: float  # seconds that the improvement of the plan may take
    known: Transformations
    verdicts: Verdicts | None  # those that transformations require; None to disregard them
    refused: frozenset[str] = NO_LABELS  # ROS types that the stream must not have

    def tags(self, live: Live) -> frozenset[Term] | None:
        """Return the tags of a stream; None if it is not there."""
        found = [tags for each, tags in self.streams if each[:4] == live[:4]]
        return frozenset(found[0]) if found else None


class Proposal(NamedTuple):
    """An answer, the situation that it was found for, and the moment of that, if known."""

    situation: Situation
    answer: Answer
    moment: Hashable = None


class ClaimPlanner:
    """Plans in the present world; used under the lock of the claims."""

    def __init__(self, context: ClaimContext) -> None:
        self._manager = context.manager
        self._table = context.table
        self._lock = context.lock
        self._world = context.connector.world
        self._monitor = context.monitor
        self._clock = context.clock
        self._ontology = context.manager.library.ontology
        self._planner = Planner(self._ontology)
        self._planned_with: Transformations = {}
        self._transformations: Transformations = {}
        self._transformations_at: tuple[int, frozenset[str]] = (-1, NO_LABELS)
        self._looked = float("-inf")
        #: Topics of ordinary nodes that had a publisher at the last look; before the first one
        #: these are the topics that streams are made of.
        self.published = frozenset().union(*(claim.sources for claim in self._table.living))

    def look(self, at_once: bool = False) -> None:
        """Ask which topics of ordinary nodes are published: now and then, or ``at_once``."""
        now = self._clock()
        if now - self._looked < _FRESH and not at_once:
            return
        self._looked = now
        wanted = set(self._world().described)
        wanted.update(topic for claim in self._table.living for topic in claim.sources)
        with contextlib.suppress(HostError):  # the ROS master is away: no stream is interrupted
            self.published = self._manager.host.published(sorted(wanted))

    @property
    def ordinary(self) -> frozenset[str]:
        """Topics of ordinary nodes that the library describes."""
        return self.published & self._world().described.keys()

    def signature(self) -> Hashable:
        """Return a value that differs when a plan may have become possible."""
        return (
            self._manager.library.revision,
            self._manager.graph.revision,
            self._world().users,
            self.published,
            self._monitor.signature,
        )

    def offers(self) -> Hashable:
        """Return a value that differs when a plan may have become cheaper."""
        records = self._world().records.values()
        by_hand = (each for each in records if not each.claimed and each.state is State.RUNNING)
        names = frozenset(each.name for each in by_hand)
        verdicts = self._monitor.requirements.verdicts
        return self._manager.library.revision, self.published, names, verdicts

    def common_topic(self, claim: Claim) -> str:
        """Return where another client listens whose stream will do for a claim; empty for none."""
        sharing = [each for each in self._table.living if each.topic and claim.may_share(each)]
        return sharing[0].topic if sharing else ""

    # Plans

    def propose(
        self,
        claim: Claim,
        lenient: bool = False,
        avoid: frozenset[str] = NO_LABELS,
        without: AbstractSet[str] = NO_LABELS,
    ) -> Proposal:
        """Plan a claim's stream; its own nodelets cost nothing.

        A request lets rounds pass meanwhile: ``still_fits`` says whether the plan can be used
        then. ``lenient`` allows transformations that failed lately if nothing else will do; labels
        of ``avoid`` and nodelets of ``without`` have no part in it.
        """
        moment = self.signature(), self._table.living
        situation = self.situation(claim, avoid, without)
        answer = fitting = self._found(situation, lenient)
        if isinstance(answer, NoPlan):
            answer = self._unavailable(claim, situation, without) or answer
        refused = NO_LABELS
        while isinstance(fitting, Plan):
            try:
                self.check_goal(claim, fitting)
            except DyKnowError:
                refused |= {self._type_of_goal(fitting)}
                fitting = self._found(situation._replace(refused=refused), lenient)
            else:
                return Proposal(situation, fitting, moment)
        return Proposal(situation, answer, moment)

    def _found(self, situation: Situation, lenient: bool) -> Answer:
        """Plan; ``lenient`` as for `propose`."""
        answer = self._solved(situation)
        if isinstance(answer, NoPlan) and lenient and situation.paused:
            answer = self._solved(situation._replace(paused=NO_LABELS))
        return self._with_absent(situation, answer) if isinstance(answer, NoPlan) else answer

    def _with_absent(self, situation: Situation, answer: NoPlan) -> NoPlan:
        """Name the described topics and nodes that supply a missing demand once they are there."""
        if not answer.missing:
            return answer
        library, running = self._manager.library, self._world().described_nodes
        absent = {
            f"topic {each.source} is not published": each
            for each in self._world().descriptions
            if each.source not in self.published
        }
        for name, node in library.nodes().items():
            if node.label not in running:
                absent[f"node {name} does not run"] = node
        found = {
            demand: tuple(
                why
                for why, each in absent.items()
                if each.label not in situation.exclude
                and any(
                    port.direction == OUT
                    and meets(read_tags(port.tags), port.datatype, demand, self._ontology)
                    for port in each.ports
                )
            )
            for demand in answer.missing
        }
        return answer._replace(
            missing=tuple([demand for demand, causes in found.items() if not causes]),
            obstacles=(
                *answer.obstacles,
                *(Obstacle(demand, causes) for demand, causes in found.items() if causes),
            ),
        )

    def _unavailable(
        self, claim: Claim, situation: Situation, without: AbstractSet[str]
    ) -> NoPlan | None:
        """Say which verdicts and faults of parts forbid every plan, if there is one with them."""
        unfit = self._monitor.unfit(self._table.together(claim))
        if not unfit and not self._manager.library.guarded:
            return None
        streams = tuple(self._streams(situation.exclude, without))
        plan = self._solved(
            situation._replace(
                streams=streams,
                usable=self._without_relays(streams),
                paused=NO_LABELS,
                verdicts=None,
            )
        )
        if not isinstance(plan, Plan):
            return None
        why_not = self._monitor.requirements.why_not
        steps = {each.instance: situation.known.get(each.instance.label) for each in plan.steps}
        found = {
            f"{label} is not available: {why}": None
            for (label, bindings), known in steps.items()
            for why in [known and why_not(known, dict(bindings))]
            if why
        }
        nodelets = {each.nodelet for each in plan.live if each.nodelet}
        wiring, topics = self._world().upstream(nodelets, self.ordinary)
        parts = {*wiring, *topics, *[each.topic for each in plan.live if not each.nodelet]}
        found.update((unfit[part], None) for part in sorted(parts & unfit.keys()))
        causes = Obstacle(situation.demand, tuple(found))
        return NoPlan(situation.demand, (), False, obstacles=(causes,)) if found else None

    def required(self, claims: Iterable[Claim]) -> dict[Term, set[str]]:
        """Return the ids of the claims that may depend on verdicts, by the tags of these.

        The verdicts may depend on verdicts in turn.
        """
        found: dict[Term, set[str]] = {}
        if not self._manager.library.guarded:
            return found
        known = self.transformations()
        waiting = [
            (claim.demand, frozenset(claim.request.exclude), claim.claim_id) for claim in claims
        ]
        claimed = {name for name, each in self._world().records.items() if each.claimed}
        streams = [e for e in self._streams(NO_LABELS, NO_LABELS) if e[0].nodelet not in claimed]
        with self._planning(known) as (planner, _):
            parts = lru_cache(None)(lambda *of: planner.parts(of[0], streams, of[1]))
            for demand, exclude, claim_id in waiting:  # grows meanwhile
                tags = {
                    tag
                    for label, bindings in parts(demand, exclude)
                    if label in known
                    for tag in required_tags(known[label], dict(bindings), str)
                    if tag.is_ground and claim_id not in found.setdefault(tag, set())
                }
                for tag in tags:
                    found[tag].add(claim_id)
                    waiting.append((Demand(frozenset([tag]), VERDICT), NO_LABELS, claim_id))
        return found

    def replaceable(self, claim: Claim) -> dict[str, str]:
        """Return the parts of a claim's stream that come from the library, with their labels."""
        world, library = self._world(), self._manager.library
        found = {
            name: world.records[name].label for name in claim.nodelets if name in world.records
        }
        found.update((e.source, e.label) for e in world.descriptions if e.source in claim.sources)
        return {part: label for part, label in found.items() if label in library}

    def still_fits(self, claim: Claim, proposal: Proposal) -> bool:
        """Whether every part that a plan uses is still there, unchanged."""
        if proposal.moment == (self.signature(), self._table.living):
            return True
        before, now = proposal.situation, self.situation(claim)
        if isinstance(proposal.answer, NoPlan):
            return before == now
        steps = {step.instance.label for step in proposal.answer.steps}
        return (
            before.demand == now.demand
            and not steps & now.exclude
            and steps <= before.known.keys()
            and all(now.known.get(label) == before.known[label] for label in steps)
            and all(before.tags(live) == now.tags(live) for live in proposal.answer.live)
        )

    def check_goal(self, claim: Claim, plan: Plan) -> None:
        """Compare the type of a plan's stream, as far as it is known, with a claim's limits.

        Raises:
            StreamTypeMismatch: it lacks the stamp that the claim needs.
            FormulaError: it lacks fields that the formula of the claim reads.
        """
        found = self._unstamped_type(claim, plan)
        if found:
            raise StreamTypeMismatch(claim.request.tag, STAMPED, found, plan.goal.label)
        lookup = self._manager.library.types
        stream = lookup(self._type_of_goal(plan)) if claim.request.require else None
        if stream is not None:
            parse(claim.request.require).check({STREAM: stream}, lookup)

    def is_waiting(self, claim: Claim) -> bool:
        """Whether there would be a plan if nothing had failed lately."""
        situation = self.situation(claim)
        is_paused = bool(situation.paused)
        return is_paused and isinstance(self._solved(situation._replace(paused=NO_LABELS)), Plan)

    def cheaper(self, claim: Claim) -> Plan | None:
        """Return a plan by which all claims together cost less than now, or None."""
        known = self.transformations()
        own = self.own(claim, known=known)
        saved = self._saved(claim, own, known)
        lingering = self._world().idle(self._lock.reserved)
        situation = self.situation(claim, without=lingering.union(saved))
        answer = self._searched(
            situation._replace(
                own=tuple(each for each in situation.own if situation.known[each.label].node),
                paused=situation.paused - {each.label for each in saved.values()},
                budget=BUDGET,
            )
        )
        if isinstance(answer, NoPlan):
            return None
        is_elsewhere = isinstance(answer.goal, Live) and answer.goal.topic not in ("", claim.topic)
        cost = answer.cost + (RELAY_COST if is_elsewhere else 0)
        is_cheaper = cost < self._price(claim, saved.values(), situation.known)
        return self._priced(answer, own, situation.known) if is_cheaper else None

    def bindings(self, demand: Demand) -> tuple[list[Bindings], bool]:
        """Find the names that a demand's variables can stand for, and whether these are all.

        Verdicts are disregarded: they are heard while there are claims that depend on them.
        """
        unfit = self._monitor.unfit(by_verdicts=False).keys()
        streams = self._without_relays(self._streams(NO_LABELS, unfit))
        with self._planning(self.transformations()) as (planner, _):
            return planner.bindings(demand, streams, verdicts=None)

    def assigned(self, plan: Plan, own: Sequence[OwnNodelet]) -> dict[Instance, str]:
        """Choose nodelets for the steps of a plan; the other steps need new ones."""
        if not own:
            return {}
        used = self._used_as_they_are(plan)
        return assigned(plan, [each for each in own if each.name not in used], self._ontology)

    def _used_as_they_are(self, plan: Plan) -> AbstractSet[str]:
        """Name the nodelets whose streams a plan uses, and those that feed them."""
        names = {each.nodelet for each in plan.live if each.nodelet}
        return self._world().upstream(names, self.ordinary)[0].keys()

    # The situation

    def situation(
        self,
        claim: Claim,
        avoid: frozenset[str] = NO_LABELS,
        without: AbstractSet[str] = NO_LABELS,
    ) -> Situation:
        """Read all that a plan for a claim follows from."""
        claims, known = self._table.together(claim), self.transformations()
        exclude = avoid.union(*(each.request.exclude for each in claims))
        streams = tuple(self._streams(exclude, self._monitor.unfit(claims).keys() | without))
        return Situation(
            demand_of(claims),
            claim.topic,
            streams,
            self._without_relays(streams),
            tuple(self.own(claim, without, known)),
            exclude,
            self._monitor.paused(claims),
            self._world().described_nodes,
            claim.wishes,
            self._upstream(claim, streams),
            max(each.request.budget for each in claims) or BUDGET,
            known,
            self._monitor.requirements.verdicts,
        )

    def transformations(self) -> Transformations:
        """Return the transformations for steps of plans by label; another mapping after changes.

        An external node is among them while it runs. The library may change at any time: what
        belongs together is read once.
        """
        library, nodes = self._manager.library, self._world().described_nodes
        if self._transformations_at != (library.revision, nodes):
            at = library.revision, nodes
            self._transformations = {
                each.label: each for each in library.all() if not each.node or each.label in nodes
            }
            self._transformations_at = at
        return self._transformations

    def own(
        self,
        claim: Claim,
        without: AbstractSet[str] = NO_LABELS,
        known: Transformations | None = None,
    ) -> list[OwnNodelet]:
        """Return healthy nodelets to connect elsewhere for a claim, the preferred ones first.

        These are its own, those that no claim needs and no user protects, and described external
        nodes. Parts that claims with clients elsewhere share are among them, and have to go on
        supplying the same, unless these claims exclude other labels or parts, have other wishes,
        or demand more. They are of the ``known`` transformations; by default these are those of
        now.
        """
        known, world = self.transformations() if known is None else known, self._world()
        sharing = [
            each
            for each in self._table.living
            if each.claim_id != claim.claim_id
            and not (claim.topic and each.topic == claim.topic)
            and not each.wiring.keys().isdisjoint(claim.wiring)
        ]
        needed = world.needed | self._lock.reserved
        idle = [
            name
            for name, record in world.records.items()
            if name not in needed and not record.is_protected
        ]
        unfit = self._monitor.unfit(self._table.together(claim)).keys() | without
        left_out = unfit | {
            name
            for each in sharing
            if not (_may_lend(each, claim) and self._monitor.unfit([each]).keys() <= unfit)
            for name in each.wiring
        }
        found: list[OwnNodelet] = []
        for name in reversed((*idle, *claim.nodelets)):
            record = world.records.get(name)
            users = [each for each in sharing if name in each.wiring]
            if record is None or name in left_out or not _is_connectable(record, known):
                continue
            exposed = exposed_variables(known[record.label])
            ways = world.ways(name) if exposed else None
            present = {
                tuple(sorted((each, way[each]) for each in exposed if each in way))
                for way in ways or ()
            }
            bound = min(present) if len(present) == 1 else ()
            if not users:
                kept = tuple(sorted(record.given.items()))
                found.append(OwnNodelet(name, record.label, kept, bound))
            elif {variable for variable, _ in bound} == exposed:
                found.append(OwnNodelet(name, record.label, bound, bound))
        return found

    def _streams(self, exclude: AbstractSet[str], without: AbstractSet[str]) -> list[TaggedStream]:
        """List the streams that can be relied on.

        Labels of ``exclude`` have no part in them, directly or further up, nor have nodelets and
        topics of ``without``.
        """
        world, library = self._world(), self._manager.library
        published = [
            each
            for each in world.descriptions
            if each.label not in exclude
            and each.source in self.published
            and each.source not in without
            and not (exclude and self._have_a_part(exclude, each.source))
        ]
        records = [
            record
            for record in world.records.values()
            if record.name not in without
            and record.label not in exclude
            and (not record.claimed or is_current(library, record))
        ]
        return world.live(records, published)

    def _have_a_part(self, labels: AbstractSet[str], topic: str) -> bool:
        """Whether nodelets of these labels publish on a topic, or feed those that do."""
        world = self._world()
        names = [record.name for record, _ in world.publishers(topic)]
        return not labels.isdisjoint(self._labels(*world.upstream(names, self.ordinary)))

    def _without_relays(self, streams: Iterable[TaggedStream]) -> tuple[TaggedStream, ...]:
        """Leave out the streams of relays: a plan uses the stream that they forward."""
        relays = self._world().relays
        return tuple([each for each in streams if each[0].nodelet not in relays])

    def _upstream(
        self, claim: Claim, streams: Iterable[TaggedStream]
    ) -> Mapping[str, Sequence[str]]:
        """Labels upstream of each nodelet of streams, where the claim has wishes about them."""
        if claim.wishes == NO_WISHES:
            return {}
        world, found = self._world(), {}
        for name in {stream.nodelet for stream, _ in streams if stream.nodelet}:
            wiring, topics = world.upstream([name], self.ordinary)
            found[name] = sorted(self._labels(wiring.keys() - {name}, topics))
        return found

    def _labels(self, nodelets: Iterable[str], topics: Iterable[str]) -> list[str]:
        """Labels of nodelets that run, and of ordinary topics."""
        world, wanted = self._world(), set(topics)
        found = [world.records.get(name) for name in nodelets]
        described = [each.label for each in world.descriptions if each.source in wanted]
        return [record.label for record in found if record is not None] + described

    # Solving

    def _solved(self, situation: Situation) -> Answer:
        """Plan; nodelets that exist cost nothing, and new ones their price."""
        present = self._present(situation)
        answer = self._searched(situation) if present is None else present
        if present is not None or isinstance(answer, NoPlan):
            return answer
        return self._priced(answer, situation.own, situation.known)

    def _present(self, situation: Situation) -> Plan | None:
        """Find a stream that will do and is where the client listens already."""
        demand, topic = situation.demand, situation.topic
        for stream, terms in sorted(situation.streams) if topic else ():
            is_good = demand.is_fast(stream.rate) and demand.is_soon(stream.latency)
            if stream.topic == topic and is_good and stream.datatype not in situation.refused:
                ways = ways_to_meet(terms, stream.datatype, demand, self._ontology)
                for way in ways:
                    bindings = tuple(sorted(way.items()))
                    return Plan(demand, stream, (), 0, bindings, latency=stream.latency)
        return None

    def _searched(self, situation: Situation) -> Answer:
        """Plan; in a round within the default budget, even if clients allow more."""
        free: dict[str, list[Bindings]] = {}
        for each in situation.own:
            free.setdefault(each.label, []).append(each.kept)
        with self._planning(situation.known) as (planner, is_aside):
            answer = planner.plan(
                situation.demand,
                situation.usable,
                situation.exclude,
                free,
                situation.paused | situation.external,
                situation.budget if is_aside else min(situation.budget, BUDGET),
                situation.wishes,
                situation.upstream,
                situation.verdicts,
                situation.refused,
            )
        if isinstance(answer, NoPlan) or not situation.own:
            return answer
        used = self._used_as_they_are(answer)
        moved = used & {*assigned(answer, situation.own, self._ontology).values()}
        if not moved:
            return answer
        # The planner has connected a nodelet elsewhere whose stream it uses as well.
        own = tuple(each for each in situation.own if each.name not in used)
        others = [self._searched(situation._replace(own=own))]
        if isinstance(others[0], NoPlan) or others[0].cost > answer.cost:
            usable = tuple(each for each in situation.usable if not self._has(moved, each[0]))
            others.append(self._searched(situation._replace(usable=usable)))
        plans = [each for each in others if isinstance(each, Plan)]
        if not plans:
            return others[-1]
        best = min(plans, key=lambda plan: plan.cost)
        return replace(best, least_cost=min(best.least_cost, answer.least_cost))

    def _has(self, nodelets: AbstractSet[str], stream: Live) -> bool:
        """Whether one of these nodelets publishes a stream, or feeds the one that does."""
        names = [stream.nodelet] if stream.nodelet else []
        return not nodelets.isdisjoint(self._world().upstream(names, self.ordinary)[0])

    @contextlib.contextmanager
    def _planning(self, known: Transformations) -> Iterator[tuple[Planner, bool]]:
        """Let rounds pass while a request plans with transformations, and say whether they may."""
        ontology = self._manager.library.ontology
        if ontology is not self._ontology:
            self._ontology, self._planner, self._planned_with = ontology, Planner(ontology), {}
        if self._planned_with is not known:
            self._planner.know(known.values())
            self._planned_with = known
        with self._lock.pause() as is_aside:
            yield self._planner, is_aside

    # Costs

    def _priced(self, plan: Plan, own: Sequence[OwnNodelet], known: Transformations) -> Plan:
        """Return a plan in which nodelets that exist cost nothing, and new ones their price."""
        used = self.assigned(plan, own)
        steps = []
        for step in plan.steps:
            found = known.get(step.instance.label)  # None if the library has changed meanwhile
            price = step.cost if found is None else found.cost
            steps.append(step._replace(cost=0 if step.instance in used else price))
        plan = replace(plan, steps=tuple(steps))
        return replace(plan, least_cost=min(plan.cost, plan.least_cost))

    def _price(self, claim: Claim, saved: Iterable[Transformation], known: Transformations) -> int:
        """Return the cost that ends with a claim's stream; ``saved`` parts serve nothing else."""
        price = sum(each.cost for each in saved)
        wishes = claim.wishes
        if wishes == NO_WISHES:
            return price
        exclude = frozenset(claim.request.exclude)
        demand = demand_of(self._table.together(claim))
        streams = self._without_relays(self._streams(exclude, self._monitor.unfit().keys()))
        with self._planning(known) as (planner, _):
            charges = planner.charges(demand, streams, exclude, wishes)
        labels = self._labels(claim.nodelets, claim.sources)
        return price + sum(charges.get(label, 0) for label in labels)

    def _saved(
        self, claim: Claim, own: Iterable[OwnNodelet], known: Transformations
    ) -> dict[str, Transformation]:
        """Those of its own that nothing would need if these clients needed no stream."""
        together = {each.claim_id for each in self._table.together(claim)}
        claims = [each for each in self._table.living if each.claim_id not in together]
        kept = {name for each in claims for name in each.nodelets}
        records = self._world().records.values()
        kept.update(each.name for each in records if each.is_protected)
        return {
            each.name: known[each.label]
            for each in own
            if each.name in claim.wiring and each.name not in kept and not known[each.label].node
        }

    def _unstamped_type(self, claim: Claim, plan: Plan) -> str:
        """The type of a plan's stream if it is known to lack the stamp that a claim needs."""
        datatype = self._type_of_goal(plan) if claim.request.max_age else ""
        lacks = datatype not in ANY and self._manager.host.is_stamped(datatype) is False
        return datatype if lacks else ""

    def _type_of_goal(self, plan: Plan) -> str:
        goal = plan.goal
        if isinstance(goal, Live):
            return goal.datatype
        found = self.transformations().get(goal.label)  # None if the library has changed
        ports = found.ports if found is not None else ()
        return next((port.datatype for port in ports if port.name == goal.port), "")


def _is_connectable(record: Record, transformations: Transformations) -> bool:
    """Whether a nodelet runs, is one that plans may connect, and is as today's library says."""
    return (
        record.transformation is not None
        and record.transformation == transformations.get(record.label)
        and (record.claimed or (record.is_described and record.is_complete))
        and record.state is State.RUNNING
    )


def _may_lend(user: Claim, claim: Claim) -> bool:
    """Whether a claim may connect elsewhere what another one uses."""
    has, needs = user.request, claim.request
    return (
        set(has.exclude) <= set(needs.exclude)
        and user.wishes == claim.wishes
        and has.min_rate <= needs.min_rate
        and (not has.max_age or 0 < needs.max_age <= has.max_age)
    )


def assigned(plan: Plan, own: Sequence[OwnNodelet], ontology: Subsumption) -> dict[Instance, str]:
    """Choose nodelets for the steps of a plan, by instance; the other instances need new ones.

    As few as possible do. The preferred nodelets come first in ``own``. Those that stay as they
    are take precedence, since nothing that they supply changes.
    """
    begun: dict[Instance, str] = {}
    fitting: dict[Instance, list[str]] = {}
    for instance in [step.instance for step in plan.steps]:
        label, names = instance
        of_label = [each for each in own if each.label == label]
        fit = fitting[instance] = [e.name for e in of_label if _agree(e.kept, names, ontology)]
        for each in of_label:
            is_left = each.name in fit and each.name not in begun.values()
            if is_left and each.present and _agree(each.present, names, ontology):
                begun[instance] = each.name
                break
    return matched(fitting, begun)


def _agree(some: Bindings, all_: Bindings, ontology: Subsumption) -> bool:
    """Whether all that is bound in ``some`` stands for the same individual in ``all_``."""
    known = {variable: ontology.canonical(name) for variable, name in all_}
    return all(known.get(variable) == ontology.canonical(name) for variable, name in some)


def is_current(library: Library, record: Record) -> bool:
    """Whether the library still has a nodelet's transformation, perhaps in a newer version."""
    made = record.transformation
    return is_relay(made) or is_monitor(made) or record.label in library
