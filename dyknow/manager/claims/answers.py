# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Answers to clients, refusals, and reports of cheaper plans."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, replace
from typing import Callable, Hashable, Iterable, Sequence

from dyknow.errors import (
    Denied,
    DyKnowError,
    InvalidTag,
    LimitExceeded,
    NoPlanFound,
    PeerTimeout,
    Result,
    StreamRefused,
    StreamTypeMismatch,
    UnknownTransformation,
)
from dyknow.manager.claim import Claim, ClaimEvent
from dyknow.manager.claims.assembly import Acquired
from dyknow.manager.claims.claim_planner import ClaimPlanner
from dyknow.manager.claims.connector import ClaimContext
from dyknow.manager.manager import Manager
from dyknow.manager.planning.explanation import as_tree
from dyknow.manager.planning.problem import NoPlan
from dyknow.manager.specifications.findings import listed
from dyknow.manager.specifications.tags import Term, read_tags, written_bindings
from dyknow.model.streams import (
    Acquisition,
    ClaimState,
    Replanned,
    StreamEvent,
    StreamRequest,
    StreamStatus,
)
from dyknow.model.transformation import OUT, Transformation
from dyknow.similar import did_you_mean

#: Transformations beyond which nothing is suggested: the search would take too long.
_SEARCHED = 10_000
#: Missing tags, and unknown labels, for which something is suggested.
_EXPLAINED = 3
#: Seconds that a cheaper way has to be there before it is reported.
_SETTLED = 3.0


def refusal(manager: Manager, answer: NoPlan, exclude: Sequence[str]) -> str:
    """Explain to a client why there is no plan."""
    excluded = f" (excluded: {listed(exclude)})" if exclude and not answer.obstacles else ""
    unknown = [f"; {each}" for each in unknown_labels(manager, exclude)]
    return "".join([str(answer), excluded, _similar_tags(manager, answer), *unknown])


def unknown_labels(manager: Manager, exclude: Sequence[str]) -> tuple[str, ...]:
    """Say which of the labels that a client excludes belong to nothing."""
    if not exclude:
        return ()
    known = _labels(manager, manager.library.all())
    unknown = [label for label in exclude if label not in known]
    among = known if len(known) < _SEARCHED else set()
    return tuple(
        str(UnknownTransformation(label, did_you_mean(label, among)))
        for label in unknown[:_EXPLAINED]
    )


def unknown_names(manager: Manager, request: StreamRequest) -> tuple[str, ...]:
    """Say which labels that a client excludes, and which names of its wishes, mean nothing."""
    found = unknown_labels(manager, request.exclude)
    wishes = (*request.prefer, *request.avoid)
    transformations = manager.library.all() if wishes else ()
    if not transformations or len(transformations) > _SEARCHED:
        return found
    ontology = manager.library.ontology
    named = _labels(manager, transformations)
    said = {name for term in _supplied(transformations) for name in (term.functor, *term.args)}
    concepts = {above for each in said for above in ontology.names_above(ontology.canonical(each))}
    unknown = [e for e in wishes if e not in named and ontology.canonical(e) not in concepts]
    known = named | said
    return found + tuple(
        f"no transformation, and no name in its tags, is '{each}'{did_you_mean(each, known)}"
        for each in unknown[:_EXPLAINED]
    )


def _labels(manager: Manager, transformations: Iterable[Transformation]) -> set[str]:
    """Labels of the library, and those of which it has no transformation any more."""
    known = {each.label for each in transformations}
    return known | {record.label for record in manager.graph.all()}


def _supplied(transformations: Iterable[Transformation]) -> set[Term]:
    """The tags of all out-ports."""
    return {
        term
        for each in transformations
        for port in each.ports
        if port.direction == OUT
        for term in read_tags(port.tags)
    }


def _similar_tags(manager: Manager, answer: NoPlan) -> str:
    transformations = manager.library.all()
    if len(transformations) > _SEARCHED:
        return ""
    supplied = _supplied(transformations)
    missing = {str(term): term for demand in answer.missing for term in demand.tags}
    advice = ""
    for tag in sorted(missing)[:_EXPLAINED]:
        known = {str(_as_asked(each, missing[tag])) for each in supplied}
        if tag not in known:
            functor = missing[tag].functor
            others = [str(each) for each in supplied if each.functor == functor]
            near = did_you_mean(tag, known, at_most=2)
            advice += near or (f"; supplied: {listed(others)}" if others else "")
    return advice


def _as_asked(supplied: Term, asked: Term) -> Term:
    """Put the arguments of a request in the places of the variables of a supplied tag."""
    if supplied.is_ground or len(supplied.args) != len(asked.args):
        return supplied
    pairs = zip(supplied.args, asked.args)
    return supplied.substitute({have: want for have, want in pairs if have[:1] == "?"})


@dataclass(frozen=True)
class _Comparison:
    """The cheaper plans that were found for a claim's stream."""

    nodelets: tuple[str, ...]  # of the stream as it is
    offers: Hashable = None  # the offers at the last comparison
    way: str = ""  # the cheaper way, in words; empty if there is none
    since: float = 0.0  # when that was found first
    reported: frozenset[str] = frozenset()  # ways that the client was informed of


class CheaperPlans:
    """Compares the costs of streams with those of plans of today."""

    def __init__(self, context: ClaimContext, planner: ClaimPlanner) -> None:
        self._table = context.table
        self._planner = planner
        self._clock = context.clock
        self._compared: dict[str, _Comparison] = {}

    def report(self) -> None:
        """Report a cheaper plan of a claim once it has been on offer for some time.

        Each call compares one claim again, if there is a new offer.
        """
        offers, now = self._offers(), self._clock()
        claims = [each for each in self._table.living if each.state is ClaimState.ACTIVE]
        for claim in claims:
            known = self._compared.get(claim.claim_id)
            if known is None or known.nodelets != claim.nodelets:
                known = _Comparison(claim.nodelets)
            elif known.offers == offers[claim.claim_id]:
                continue
            way = self._way(claim)
            since = known.since if way == known.way else now
            known = replace(known, offers=offers[claim.claim_id], way=way, since=since)
            self._compared[claim.claim_id] = known
            break
        for claim_id, known in list(self._compared.items()):
            is_settled = known.offers == offers.get(claim_id) and now - known.since >= _SETTLED
            if known.way and known.way not in known.reported and is_settled:
                self._table.report(claim_id, known.way)
                self._compared[claim_id] = replace(known, reported=known.reported | {known.way})
        living = {claim.claim_id for claim in self._table.living}
        self._compared = {key: each for key, each in self._compared.items() if key in living}

    def _offers(self) -> dict[str, Hashable]:
        """Return a value for each claim that differs when a plan may have become cheaper."""
        common, living = self._planner.offers(), self._table.living
        users = Counter([name for claim in living for name in claim.wiring])
        return {
            claim.claim_id: (common, tuple([users[name] for name in claim.nodelets]))
            for claim in living
        }

    def _way(self, claim: Claim) -> str:
        """Say how a claim's stream would cost less; empty if there is no such way."""
        cheaper = self._planner.cheaper(claim)
        if cheaper is None:
            return ""
        labels = ", ".join(sorted(step.instance.label for step in cheaper.steps))
        way = f"with {labels}" if labels else "with what others use"
        return f"a cheaper way has appeared, {way}; replanning takes it"


_RESULTS: tuple[tuple[type[DyKnowError], Result], ...] = (
    (NoPlanFound, Result.NO_PLAN),
    (InvalidTag, Result.INVALID_TAG),
    (StreamTypeMismatch, Result.TYPE_MISMATCH),
    (PeerTimeout, Result.TIMEOUT),
    (Denied, Result.DENIED),
    (LimitExceeded, Result.DENIED),
)


class StreamAnswers:
    """Makes the values that clients get; converts lease times from steady time to their clock."""

    def __init__(
        self, now: Callable[[], float], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Convert times of ``clock``, the reconciler's, to ``now``, the clients' (ROS time)."""
        self._now = now
        self._clock = clock

    def status(self, claim: Claim) -> StreamStatus:
        return StreamStatus(
            claim.claim_id,
            claim.request.client_id,
            claim.request.tag,
            claim.topic,
            claim.datatype,
            claim.state,
            claim.detail,
            claim.nodelets,
            self.expires(claim),
            _written(claim),
        )

    def expires(self, claim: Claim) -> float:
        """Return when the lease ends, in seconds on the clients' clock; 0 for never."""
        if claim.deadline is None:
            return 0.0
        return self._now() + max(0.0, claim.deadline - self._clock())

    def event(self, event: ClaimEvent) -> StreamEvent:
        before = None if event.before is None else self.status(event.before)
        return StreamEvent(self._now(), before, self.status(event.after), event.reason)

    def acquisition(self, acquired: Acquired, warnings: Sequence[str]) -> Acquisition:
        claim, plan = acquired.claim, self.replanned(acquired)
        return Acquisition(
            claim.claim_id,
            claim.topic,
            claim.datatype,
            plan.spawned,
            plan.reused,
            plan.cost,
            self.expires(claim),
            plan.plan,
            plan.message,
            tuple(warnings),
            _written(claim),
            0.0 if acquired.plan is None else float(acquired.plan.least_cost),
        )

    def replanned(self, acquired: Acquired) -> Replanned:
        """Return the answer to a request to plan a stream again."""
        return Replanned(
            tuple(sorted(acquired.spawned)),
            tuple(sorted(acquired.reused)),
            float(acquired.cost),
            "" if acquired.plan is None else as_tree(acquired.plan),
            acquired.claim.detail,
        )


def _written(claim: Claim) -> tuple[str, ...]:
    return tuple(written_bindings((each,)) for each in claim.bindings)


def refusal_of(error: BaseException) -> StreamRefused:
    """Return the refusal for an error, or for the error that caused it."""
    cause: BaseException | None = error
    while cause is not None:
        for kind, result in _RESULTS:
            if isinstance(cause, kind):
                return StreamRefused(str(error), result, getattr(error, "claim_id", ""))
        cause = cause.__cause__
    return StreamRefused(str(error), Result.SPAWN_FAILED, getattr(error, "claim_id", ""))
