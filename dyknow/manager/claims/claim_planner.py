"""What can be had now: plans for claims from what is there at the moment.

Claims whose clients listen on the same topic are planned together, since one publisher has to
satisfy them all.
"""

from __future__ import annotations

from typing import AbstractSet, Callable, Dict, FrozenSet, Hashable, Iterable, List, Optional

from dyknow.backoff import Backoff
from dyknow.errors import HostError
from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_lock import ClaimLock
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.connector import Connector
from dyknow.manager.claims.demands import demand_of, may_share
from dyknow.manager.claims.diagnosis import is_current
from dyknow.manager.claims.relay import is_relay
from dyknow.manager.claims.silence_monitor import SilenceMonitor
from dyknow.manager.claims.streams import Stream, live_streams
from dyknow.manager.manager import Manager
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import NO_LABELS, Answer, Live, NoPlan, Plan
from dyknow.manager.planning.supply import Demand, Supply
from dyknow.manager.specifications.tags import Subsumption
from dyknow.model.graph import State
from dyknow.model.transformation import Transformation

#: Seconds for which the answer to "which topics are published?" is good enough.
_FRESH = 0.5
#: How much the planner may remember in vain, if that is more than the library has.
_WASTE = 1_000


class ClaimPlanner:
    """Plans with what there is; one call at a time."""

    def __init__(
        self,
        manager: Manager,
        ontology: Subsumption,
        table: ClaimTable,
        failures: Backoff,
        silence: SilenceMonitor,
        claim_lock: ClaimLock,
        connector: Connector,
        clock: Callable[[], float],
    ) -> None:
        """Know nothing yet."""
        self._manager = manager
        self._ontology = ontology
        self._table = table
        self._failures = failures
        self._silence = silence
        self._claim_lock = claim_lock
        self._connector = connector
        self._clock = clock
        self._planner = Planner(ontology)
        self._known: Dict[str, Transformation] = {}
        self._known_revision = -1
        self._asked = float("-inf")
        #: Topics of ordinary nodes that had a publisher at the last look.
        self.published: FrozenSet[str] = frozenset()

    # What is there

    def look(self, at_once: bool = False) -> None:
        """Ask which topics of ordinary nodes are published, now and then or at once.

        While nobody can tell, the last answer holds.
        """
        now = self._clock()
        if now - self._asked < _FRESH and not at_once:
            return
        self._asked = now
        wanted = {each.source for each in self._manager.existing_topics()}
        wanted.update(topic for claim in self._table.living() for topic in claim.sources)
        try:
            self.published = self._manager.host.published(sorted(wanted))
        except HostError:
            return  # the master is away; what flows flows on

    def ordinary(self) -> FrozenSet[str]:
        """Topics on which ordinary nodes send what the library says."""
        return self.published & {each.source for each in self._manager.existing_topics()}

    def signature(self) -> Hashable:
        """Differs when a plan that could not be made may be possible now."""
        manager = self._manager
        return (
            manager.library.revision,
            manager.graph.revision,
            self.published,
            self._failures.paused,
            self._silence.unhealthy,
        )

    def offers(self) -> Hashable:
        """Differs when something new is offered: a reason to look for cheaper ways."""
        others = frozenset(
            record.name
            for record in self._manager.graph.all()
            if not record.claimed and record.state is State.RUNNING
        )
        return self._manager.library.revision, self.published, others

    def own(self, claim: Claim) -> Dict[str, str]:
        """Healthy nodelets of a claim, and such as no claim needs, by label: they can be re-wired.

        Parts that other claims share are among them, unless these exclude what this one does not:
        whatever suits their in-ports, their out-ports supply the same.
        """
        sharing = [each for each in self._table.living() if each.claim_id != claim.claim_id]
        needed = self._table.needed() | self._claim_lock.reserved
        idle = [record.name for record in self._manager.graph.all() if record.name not in needed]
        found: Dict[str, str] = {}
        for name in (*idle, *claim.nodelets):
            record = self._manager.graph.find(name)
            if (
                record is not None
                and record.claimed
                and record.state is State.RUNNING
                and name not in self._silence.unhealthy
                and record.transformation == self._current(record.label)
                and all(
                    set(each.request.exclude) <= set(claim.request.exclude)
                    for each in sharing
                    if name in each.wiring
                )
            ):
                found[record.label] = name
        return found

    def price(self, claim: Claim) -> int:
        """What would be saved if a claim's stream were not there."""
        return sum(self._known[label].cost for label in self._saved(claim))

    # Plans

    def common_topic(self, claim: Claim) -> str:
        """Where another client listens that wants the same; empty if there is none."""
        sharing = [each for each in self._table.living() if each.topic and may_share(claim, each)]
        return sharing[0].topic if sharing else ""

    def plan(
        self, claim: Claim, lenient: bool = False, avoid: FrozenSet[str] = NO_LABELS
    ) -> Answer:
        """Plan a claim's stream, with its own nodelets re-wired at no cost.

        Args:
            claim: whose stream it is.
            lenient: use what failed lately too, if there is no other way.
            avoid: labels that will not do, as has turned out.
        """
        self._update()
        together = self._together(claim)
        answer = self._plan(together, claim.topic, self._failures.paused, avoid)
        if isinstance(answer, NoPlan) and lenient and self._failures.paused:
            answer = self._plan(together, claim.topic, NO_LABELS, avoid)
        return answer

    def is_waiting(self, claim: Claim) -> bool:
        """Whether there would be a plan if nothing had failed lately."""
        paused = self._failures.paused
        return bool(paused) and isinstance(self._plan([claim], claim.topic, NO_LABELS), Plan)

    def plan_anew(self, claim: Claim) -> Answer:
        """Plan a claim's stream as if the nodelets were not there that only it needs."""
        self._update()
        own = self._saved(claim)
        exclude = frozenset(claim.request.exclude)
        streams = self._origins(self._streams(exclude, frozenset(own.values())))
        paused = self._failures.paused - frozenset(own)
        demand = demand_of(self._together(claim))
        return self._planner.plan(demand, streams, exclude, paused=paused)

    def with_own(self, plan: Plan, own: Dict[str, str]) -> Plan:
        """Take the nodelets that are there out of a plan's price."""
        steps = tuple(
            step._replace(action=step.action._replace(cost=0))
            if step.action.label in own
            else step
            for step in plan.steps
        )
        return plan._replace(steps=steps, cost=sum(step.action.cost for step in steps))

    # Inside

    def _together(self, claim: Claim) -> List[Claim]:
        """List the claims whose clients listen where this one's does; this one first."""
        others = [each for each in self._table.living() if each.claim_id != claim.claim_id]
        return [claim, *(each for each in others if each.topic and each.topic == claim.topic)]

    def _saved(self, claim: Claim) -> Dict[str, str]:
        """Nodelets, by label, that would go if the stream of these clients were not needed."""
        together = {each.claim_id for each in self._together(claim)}
        kept = {
            name
            for each in self._table.living()
            if each.claim_id not in together
            for name in each.nodelets
        }
        kept.update(each.name for each in self._manager.graph.all() if each.is_protected)
        own = self.own(claim).items()
        return {label: name for label, name in own if name in claim.wiring and name not in kept}

    def _plan(
        self,
        claims: List[Claim],
        topic: str,
        paused: AbstractSet[str],
        avoid: FrozenSet[str] = NO_LABELS,
    ) -> Answer:
        demand = demand_of(claims)
        exclude = avoid | {label for claim in claims for label in claim.request.exclude}
        own = self.own(claims[0]).keys() - exclude
        streams = self._streams(exclude)
        present = self._present(demand, streams, topic)
        if present is not None:
            return Plan(demand, present, (), 0)
        return self._planner.plan(
            demand, self._origins(streams), exclude, own, paused=paused - own
        )

    def _origins(self, streams: Iterable[Stream]) -> List[Stream]:
        """Leave relays out: who needs what they bring takes it where they have it from."""
        relays = {
            record.name for record in self._manager.graph.all() if is_relay(record.transformation)
        }
        return [each for each in streams if each[0].nodelet not in relays]

    def _present(self, demand: Demand, streams: Iterable[Stream], topic: str) -> Optional[Live]:
        """Find a stream that will do and is where the client listens already."""
        there: Supply[Live] = Supply(self._ontology)
        for stream, terms in streams:
            if topic and stream.topic == topic:
                there.add(stream, terms, stream.datatype)
        return min(there.suppliers(demand), default=None)

    def _streams(
        self, exclude: AbstractSet[str], without: AbstractSet[str] = frozenset()
    ) -> List[Stream]:
        """List the streams that can be relied on.

        Args:
            exclude: labels that must not have a part in them, directly or further up.
            without: nodelets that must not have a part in them.
        """
        manager = self._manager
        published = [
            each
            for each in manager.existing_topics()
            if each.label not in exclude
            and each.source in self.published
            and each.source not in self._silence.silent
        ]
        records = manager.graph.all()
        excluded = {
            record.name
            for record in records
            if record.label in exclude
            or (record.claimed and not is_current(manager.library, record))
        }
        unfit = without | excluded | self._silence.unhealthy
        return live_streams(records, published, self._connector.topology(), self._ontology, unfit)

    def _current(self, label: str) -> Optional[Transformation]:
        self._update()
        return self._known.get(label)

    def _update(self) -> None:
        """Bring the planner up to date with the library."""
        library = self._manager.library
        if self._planner.waste > max(_WASTE, len(self._planner)):
            self._planner = Planner(self._ontology)
            self._known, self._known_revision = {}, -1
        if self._known_revision == library.revision:
            return
        self._known_revision = library.revision
        present = {each.label: each for each in library.all()}
        for label in [label for label in self._known if label not in present]:
            self._planner.remove(label)
        known = self._known
        self._planner.add(each for each in present.values() if known.get(each.label) != each)
        self._known = present
