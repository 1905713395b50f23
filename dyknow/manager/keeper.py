"""Keeps requested streams alive: the reconciler of claims.

Desired are the claims, observed is the graph. Whatever happened, the keeper asks of each claim the
same question, whether every nodelet of its stream runs and is wired as it should, and if not makes
a new plan with what is there now. The client's topic stays.

One change of claims at a time (``_turn``); looking at them and renewing them waits for nobody.
"""

from __future__ import annotations

import logging
import threading
import time
import uuid
from dataclasses import dataclass, replace
from typing import Any, Callable, Dict, FrozenSet, List, Optional, Set, Tuple

from dyknow.errors import (
    DyKnowError,
    NoPlanFound,
    StreamTypeMismatch,
    UnknownClaim,
)
from dyknow.manager.claim import Claim, ClaimEvent, ClaimState, StreamRequest
from dyknow.manager.fulfilment import Fulfilled, Fulfilment
from dyknow.manager.manager import Manager
from dyknow.manager.model import Record, State
from dyknow.manager.planner import Planner
from dyknow.manager.planning import NoPlan, Plan
from dyknow.manager.quarantine import Quarantine
from dyknow.manager.streams import Stream, live_streams
from dyknow.manager.supply import Demand
from dyknow.manager.tags import NO_ONTOLOGY, Subsumption, parse_tag
from dyknow.manager.transformation import TOPIC

_log = logging.getLogger("rosout.dyknow")


@dataclass(frozen=True)
class KeeperSettings:
    """How the keeper behaves.

    Attributes:
        linger: seconds that a nodelet that no claim needs any more is kept.
        ended_kept: claims that ended and can still be asked about.
    """

    linger: float = 5.0
    ended_kept: int = 100


DEFAULT_KEEPER_SETTINGS = KeeperSettings()
"""Nodelets linger for five seconds."""


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


class Keeper:
    """All claims, and what is done for them."""

    def __init__(
        self,
        manager: Manager,
        ontology: Subsumption = NO_ONTOLOGY,
        settings: KeeperSettings = DEFAULT_KEEPER_SETTINGS,
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
        self._fulfilment = Fulfilment(manager)
        self._sleep = sleep
        self._ontology = ontology
        self._settings = settings
        self._clock = clock
        self._turn = threading.Lock()
        self._lock = threading.Lock()
        self._planner = Planner(ontology)
        self._planned_revision = -1
        self._quarantine = Quarantine(clock)
        self._idle_since: Dict[str, float] = {}
        #: Called with every change of a claim, outside the locks.
        self.on_event: Callable[[ClaimEvent], None] = lambda event: None
        now = clock()
        self._claims: Dict[str, Claim] = {
            claim_id: Claim.from_body(body, now)
            for claim_id, body in manager.store.claims().items()
        }

    # What clients ask

    def acquire(self, request: StreamRequest, dry_run: bool = False) -> Acquired:
        """Make a stream, and keep it until it is released or its lease ends.

        A request that cannot be met now stays pending: ``NoPlanFound`` names its claim.

        Raises:
            InvalidTag: the tag is no term.
            NoPlanFound: nothing supplies it; the tags that are missing are named.
            StreamTypeMismatch: the stream turned out to have another type.
            DyKnowError: it could not be made; nothing is left of it.
        """
        demand = _demand(request)
        with self._turn:
            known = self._same_request(request)
            if known is not None and not known.topic:
                raise NoPlanFound(known.detail, known.claim_id)
            if known is not None:
                return Acquired(known, None, (), known.nodelets)
            claim = Claim("" if dry_run else uuid.uuid4().hex[:12], request)
            answer = self._plan(claim, demand)
            if isinstance(answer, NoPlan):
                if not dry_run:
                    self._put(replace(self._leased(claim), detail=str(answer)), "requested")
                raise NoPlanFound(str(answer), claim.claim_id)
            if dry_run:
                labels = tuple(step.action.label for step in answer.steps)
                names = tuple(sorted({stream.nodelet or stream.topic for stream in answer.live}))
                return Acquired(claim, answer, labels, names)
            done = self._carry_out(claim, answer)
            claim = replace(self._leased(claim), **_outcome(done))
            self._put(claim, "requested")
        return Acquired(claim, answer, tuple(done.spawned), _reused(done))

    def release(self, claim_id: str) -> None:
        """End a claim; ending it again, or one that nobody knows any more, is no error."""
        self._end(claim_id, ClaimState.RELEASED, "released")

    def expire(self, claim_id: str, reason: str) -> None:
        """End a claim whose client is gone, such as one whose bond broke; no error if it ended."""
        self._end(claim_id, ClaimState.EXPIRED, reason)

    def renew(self, claim_id: str, lease: float) -> Claim:
        """Let the claim live for so many seconds from now (0: until it is released).

        Raises:
            UnknownClaim: there is no such claim, or it ended.
        """
        with self._lock:
            claim = self._claims.get(claim_id)
            if claim is None or claim.state.ended:
                raise UnknownClaim(claim_id, "" if claim is None else claim.state.name.lower())
            deadline = self._clock() + lease if lease > 0 else None
            claim = self._claims[claim_id] = replace(claim, deadline=deadline)
        self._manager.store.put_claim(claim_id, claim.body(self._clock()))
        return claim

    def replan(self, claim_id: str, dry_run: bool = False) -> Acquired:
        """Take the cheapest way of today, if it is another one.

        Raises:
            UnknownClaim: there is no such claim, or it ended.
            NoPlanFound: there is no way at all now.
        """
        with self._turn:
            claim = self._get(claim_id)
            answer = self._plan(claim, _demand(claim.request), anew=True)
            if isinstance(answer, NoPlan):
                raise NoPlanFound(str(answer), claim_id)
            if dry_run:
                labels = tuple(step.action.label for step in answer.steps)
                return Acquired(claim, answer, labels, ())
            done = self._carry_out(claim, answer)
            self._put(replace(claim, **_outcome(done)), "replanned on request")
        self.reconcile()
        return Acquired(self._claims[claim_id], answer, tuple(done.spawned), _reused(done))

    def claims(self) -> List[Claim]:
        """Return every claim, those that ended lately too, by id."""
        with self._lock:
            return [self._claims[claim_id] for claim_id in sorted(self._claims)]

    # What is done for them

    def reconcile(self) -> None:
        """Look at every claim once, and mend what is broken."""
        with self._turn:
            now = self._clock()
            for claim in self.claims():
                if claim.state.ended:
                    continue
                if claim.deadline is not None and now >= claim.deadline:
                    self._put(replace(claim, state=ClaimState.EXPIRED), "its lease ended")
                    continue
                self._mend(claim)
            self._collect(now)
            self._forget_ended()

    def blame(self, name: str, why: str) -> None:
        """Count a nodelet's failure against its transformation, and take it out of use."""
        record = self._manager.graph.find(name)
        if record is None or record.transformation is None:
            return
        self._quarantine.blame(record.label)
        _log.warning("%s: %s", name, why)
        if record.claimed:
            try:
                self._manager.lifecycle.destroy(name)
            except DyKnowError as error:
                _log.warning("%s: %s", name, error)
        else:
            self._quarantine.distrust(name)

    def _mend(self, claim: Claim) -> None:
        damage = self._damage(claim)
        if not damage:
            if claim.state is not ClaimState.ACTIVE:
                self._put(replace(claim, state=ClaimState.ACTIVE, detail=""), "it is whole again")
            return
        waiting = claim.state in (ClaimState.PENDING, ClaimState.FAILED) or not claim.topic
        if not waiting and claim.state is not ClaimState.RECOVERING:
            claim = replace(claim, state=ClaimState.RECOVERING, detail=damage)
            self._put(claim, damage)
        answer = self._plan(claim, _demand(claim.request))
        if isinstance(answer, NoPlan):
            state = ClaimState.PENDING
            if (claim.state, claim.detail) != (state, str(answer)):
                self._put(replace(claim, state=state, detail=str(answer)), damage)
            return
        if not self._quarantine.allows(claim.claim_id):
            return
        try:
            done = self._carry_out(claim, answer)
        except DyKnowError as error:
            self._quarantine.blame(claim.claim_id)
            if (claim.state, claim.detail) != (ClaimState.FAILED, str(error)):
                self._put(replace(claim, state=ClaimState.FAILED, detail=str(error)), damage)
            return
        self._put(replace(claim, **_outcome(done)), f"mended: {damage}")

    def _damage(self, claim: Claim) -> str:
        """Say what is wrong with a claim's stream; empty if it is whole."""
        if not claim.topic:
            return claim.detail or "it has no stream yet"
        for name in claim.nodelets:
            record = self._manager.graph.find(name)
            if record is None or record.transformation is None:
                return f"nodelet {name} is gone"
            if record.state is not State.RUNNING:
                return f"nodelet {name} is {record.state.name.lower()}"
            if self._quarantine.is_distrusted(name):
                return f"nodelet {name} is not to be relied on"
            if record.label in claim.request.exclude:
                return f"transformation {record.label} is excluded"
            if record.claimed and not self._is_in_library(record):
                return f"transformation {record.label} was removed"
            for port, topic in claim.wiring[name].items():
                if record.topics.get(port, "") != topic:
                    return f"port {port} of {name} was connected elsewhere"
        for topic in claim.sources:
            if not self._manager.host.is_published(topic):
                return f"topic {topic} is not published any more"
        return ""

    def _is_in_library(self, record: Record) -> bool:
        try:
            self._manager.library.get(record.label)
        except DyKnowError:
            return False
        return True

    # Planning

    def _plan(self, claim: Claim, demand: Demand, anew: bool = False) -> Plan | NoPlan:
        manager = self._manager
        if self._planned_revision != manager.library.revision:
            self._update_planner()
        exclude = frozenset(claim.request.exclude) | self._quarantine.labels()
        own = self._own(claim, exclude)
        past = frozenset(own.values()) if anew else frozenset()
        own = {} if anew else own
        streams = self._streams(exclude, past)
        answer = self._planner.plan(demand, streams, exclude, frozenset(own))
        if isinstance(answer, NoPlan) and self._quarantine.labels():
            exclude = frozenset(claim.request.exclude)  # better a doubtful part than none
            streams = self._streams(exclude, past)
            answer = self._planner.plan(demand, streams, exclude, frozenset(own))
        return answer

    def _update_planner(self) -> None:
        library = self._manager.library
        self._planned_revision = library.revision
        self._planner = Planner(self._ontology)
        self._planner.add(library.all())

    def _streams(self, exclude: FrozenSet[str], past: FrozenSet[str]) -> List[Stream]:
        manager = self._manager
        published = [
            each
            for each in manager.library.topics()
            if each.type == TOPIC
            and each.label not in exclude
            and manager.host.is_published(each.source)
        ]
        removed = {
            record.name
            for record in manager.graph.all()
            if record.claimed and not self._is_in_library(record)
        }
        unhealthy = self._quarantine.distrusted() | past | removed
        return live_streams(
            manager.graph.all(), published, self._planner.terms, self._ontology, unhealthy
        )

    def _own(self, claim: Claim, exclude: FrozenSet[str]) -> Dict[str, str]:
        """Healthy nodelets that only this claim uses: they can be re-wired."""
        others: Set[str] = set()
        for each in self.claims():
            if each.claim_id != claim.claim_id and not each.state.ended:
                others.update(each.nodelets)
        found: Dict[str, str] = {}
        for name in claim.nodelets:
            record = self._manager.graph.find(name)
            if (
                record is not None
                and record.claimed
                and record.state is State.RUNNING
                and name not in others
                and record.label not in exclude
                and not self._quarantine.is_distrusted(name)
                and self._is_in_library(record)
            ):
                found[record.label] = name
        return found

    def _carry_out(self, claim: Claim, plan: Plan) -> Fulfilled:
        own = self._own(claim, frozenset())
        done = self._fulfilment.carry_out(plan, claim.topic, own)
        wanted = claim.request.datatype
        if wanted and done.datatype and wanted != done.datatype and done.datatype != "*":
            for name in reversed(done.spawned):
                self._manager.lifecycle.destroy(name)
            raise StreamTypeMismatch(claim.request.tag, wanted, done.datatype)
        self._free_topic(done)
        return done

    def _free_topic(self, done: Fulfilled) -> None:
        """Leave one publisher on the client's topic: whoever was replaced goes off it."""
        for record in self._manager.graph.all():
            if record.name == done.goal[0] or not record.claimed:
                continue
            ports = {
                port.name: ""
                for port in record.ports
                if port.direction == "out" and port.topic == done.topic and done.goal[0]
            }
            if ports and record.state is State.RUNNING:
                try:
                    self._fulfilment.connect(record.name, ports)
                except DyKnowError as error:
                    _log.warning("%s: %s", record.name, error)

    # The table

    def _same_request(self, request: StreamRequest) -> Optional[Claim]:
        if not request.request_id:
            return None
        for claim in self.claims():
            same = claim.request.request_id == request.request_id
            if same and claim.request.client_id == request.client_id and not claim.state.ended:
                return claim
        return None

    def _leased(self, claim: Claim) -> Claim:
        lease = claim.request.lease
        return replace(claim, deadline=self._clock() + lease if lease > 0 else None)

    def _get(self, claim_id: str) -> Claim:
        with self._lock:
            claim = self._claims.get(claim_id)
        if claim is None or claim.state.ended:
            raise UnknownClaim(claim_id, "" if claim is None else claim.state.name.lower())
        return claim

    def _end(self, claim_id: str, state: ClaimState, reason: str) -> None:
        with self._lock:
            claim = self._claims.get(claim_id)
        if claim is not None and not claim.state.ended:
            self._put(replace(claim, state=state, detail=""), reason)

    def _put(self, claim: Claim, reason: str) -> None:
        if claim.state.ended:
            self._manager.store.remove_claim(claim.claim_id)
        else:
            self._manager.store.put_claim(claim.claim_id, claim.body(self._clock()))
        with self._lock:
            before = self._claims.get(claim.claim_id, replace(claim, state=ClaimState.PENDING))
            self._claims[claim.claim_id] = claim
        self.on_event(ClaimEvent(before, claim, reason))

    def _collect(self, now: float) -> None:
        """Destroy what was made for claims and no claim needs, after a while."""
        needed: Set[str] = set()
        for claim in self.claims():
            if not claim.state.ended:
                needed.update(claim.nodelets)
        for record in reversed(self._manager.graph.all()):
            if not record.claimed or record.is_protected or record.name in needed:
                self._idle_since.pop(record.name, None)
                continue
            since = self._idle_since.setdefault(record.name, now)
            if now - since >= self._settings.linger:
                try:
                    self._manager.lifecycle.destroy(record.name)
                    self._idle_since.pop(record.name, None)
                except DyKnowError as error:
                    _log.warning("%s: %s", record.name, error)

    def _forget_ended(self) -> None:
        with self._lock:
            ended = [each for each, claim in self._claims.items() if claim.state.ended]
            for claim_id in ended[: max(0, len(ended) - self._settings.ended_kept)]:
                del self._claims[claim_id]


def _demand(request: StreamRequest) -> Demand:
    return Demand(frozenset((parse_tag(request.tag),)), request.datatype)


def _outcome(done: Fulfilled) -> Dict[str, Any]:
    return {
        "topic": done.topic,
        "datatype": done.datatype,
        "goal": done.goal,
        "wiring": done.wiring,
        "sources": tuple(sorted(set(done.sources))),
        "state": ClaimState.ACTIVE,
        "detail": "",
    }


def _reused(done: Fulfilled) -> Tuple[str, ...]:
    return tuple(sorted(set(done.reused) - set(done.spawned)))
