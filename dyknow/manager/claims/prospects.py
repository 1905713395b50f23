"""What can be had now: plans for claims from what is there at the moment.

Claims whose clients listen on the same topic are planned together, since one publisher has to
satisfy them all.
"""

from __future__ import annotations

from typing import AbstractSet, Callable, Dict, FrozenSet, Hashable, Iterable, List, Optional

from dyknow.errors import HostError
from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.inspection import is_current
from dyknow.manager.claims.quarantine import Quarantine
from dyknow.manager.claims.silence import SilenceWatch
from dyknow.manager.claims.streams import Stream, live_streams
from dyknow.manager.manager import Manager
from dyknow.manager.model import State
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import NO_LABELS, Answer, Live, NoPlan, Plan
from dyknow.manager.planning.supply import Demand, Supply
from dyknow.manager.specifications.tags import Subsumption, parse_tag
from dyknow.manager.specifications.transformation import Transformation

#: Seconds for which the answer to "which topics are published?" is good enough.
_FRESH = 0.5


class Prospects:
    """Plans with what there is; one call at a time."""

    def __init__(
        self,
        manager: Manager,
        ontology: Subsumption,
        table: ClaimTable,
        quarantine: Quarantine,
        silence: SilenceWatch,
        clock: Callable[[], float],
    ) -> None:
        """Know nothing yet."""
        self._manager = manager
        self._ontology = ontology
        self._table = table
        self._quarantine = quarantine
        self._silence = silence
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

    def signature(self) -> Hashable:
        """Differs when a plan that could not be made may be possible now."""
        manager = self._manager
        return (
            manager.library.revision,
            manager.graph.revision,
            self.published,
            self._quarantine.names(),
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
        """Healthy nodelets of a claim, by label: they can be re-wired.

        Parts that other claims share are among them, unless these exclude what this one does not:
        whatever suits their in-ports, their out-ports supply the same.
        """
        sharing = [each for each in self._table.living() if each.claim_id != claim.claim_id]
        found: Dict[str, str] = {}
        for name in claim.nodelets:
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
        """What the nodelets cost that were made for a claim."""
        return sum(self._known[label].cost for label in self.own(claim))

    # Plans

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
        together = [claim]
        if claim.topic:
            sharing = [each for each in self._table.living() if each.topic == claim.topic]
            together += [each for each in sharing if each.claim_id != claim.claim_id]
        answer = self._plan(together, claim.topic, self._quarantine.names(), avoid)
        if isinstance(answer, NoPlan) and len(together) > 1:
            answer = self._plan([claim], claim.topic, self._quarantine.names(), avoid)
        if isinstance(answer, NoPlan) and lenient and self._quarantine.names():
            answer = self._plan([claim], claim.topic, NO_LABELS, avoid)
        return answer

    def is_waiting(self, claim: Claim) -> bool:
        """Whether there would be a plan if nothing had failed lately."""
        paused = self._quarantine.names()
        return bool(paused) and isinstance(self._plan([claim], claim.topic, NO_LABELS), Plan)

    def plan_anew(self, claim: Claim) -> Answer:
        """Plan a claim's stream as if its own nodelets were not there."""
        self._update()
        own = self.own(claim)
        exclude = frozenset(claim.request.exclude)
        streams = self._streams(exclude, frozenset(own.values()))
        paused = self._quarantine.names() - frozenset(own)
        return self._planner.plan(demand_of([claim]), streams, exclude, paused=paused)

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
        return self._planner.plan(demand, streams, exclude, own, paused=paused - own)

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
        return live_streams(records, published, self._planner.terms, self._ontology, unfit)

    def _current(self, label: str) -> Optional[Transformation]:
        self._update()
        return self._known.get(label)

    def _update(self) -> None:
        """Bring the planner up to date with the library."""
        library = self._manager.library
        if self._known_revision == library.revision:
            return
        self._known_revision = library.revision
        present = {each.label: each for each in library.all()}
        for label in [label for label in self._known if label not in present]:
            self._planner.remove(label)
        known = self._known
        self._planner.add(each for each in present.values() if known.get(each.label) is not each)
        self._known = present


def demand_of(claims: Iterable[Claim]) -> Demand:
    """What one stream has to be to satisfy all these claims."""
    claims = list(claims)
    types = [wanted_type(claim) for claim in claims]
    tags = frozenset(parse_tag(claim.request.tag) for claim in claims)
    return Demand(tags, types[0] or max(types))


def wanted_type(claim: Claim) -> str:
    """Type of messages that a claim's client expects: what it asked for, or got first."""
    return claim.request.datatype or claim.datatype.replace("*", "")
