# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What clients are told besides their streams: why there is none, and what would be cheaper."""

from __future__ import annotations

from typing import Dict, Hashable, Optional, Sequence, Set, Tuple

from dyknow.errors import UnknownTransformation
from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_planner import ClaimPlanner
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.relay import RELAY_COST
from dyknow.manager.manager import Manager
from dyknow.manager.planning.problem import Live, NoPlan, Plan
from dyknow.manager.specifications.findings import listed
from dyknow.manager.specifications.tags import Term, read_tags
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import OUT
from dyknow.similar import did_you_mean

#: Transformations beyond which nothing is suggested: the search would take too long.
_SEARCHED = 10_000
#: Missing tags, and unknown labels, for which something is suggested.
_EXPLAINED = 3


def refusal(manager: Manager, answer: NoPlan, exclude: Sequence[str]) -> str:
    """Explain to a client why there is no plan."""
    excluded = f" (excluded: {listed(exclude)})" if exclude else ""
    unknown = [f"; {each}" for each in unknown_labels(manager, exclude)] if exclude else []
    return "".join([str(answer), excluded, _similar_tags(manager, answer), *unknown])


def unknown_labels(manager: Manager, exclude: Sequence[str]) -> Tuple[str, ...]:
    """Say which of the labels that a client excludes belong to nothing."""
    known = {each.label for each in manager.library.all()}
    known |= {record.label for record in manager.graph.all()}
    unknown = [label for label in exclude if label not in known]
    among = known if len(known) < _SEARCHED else set()
    return tuple(
        str(UnknownTransformation(label, did_you_mean(label, among)))
        for label in unknown[:_EXPLAINED]
    )


def _similar_tags(manager: Manager, answer: NoPlan) -> str:
    transformations = manager.library.all()
    if len(transformations) > _SEARCHED:
        return ""
    supplied: Set[Term] = {
        term
        for each in transformations
        for port in each.ports
        if port.direction == OUT
        for term in read_tags(port.tags)
    }
    missing = {str(term): term for demand in answer.missing for term in demand.tags}
    advice = ""
    for tag in sorted(missing)[:_EXPLAINED]:
        known = {str(_as_asked(each, missing[tag])) for each in supplied}
        if tag not in known:
            advice += did_you_mean(tag, known, at_most=2)
    return advice


def _as_asked(supplied: Term, asked: Term) -> Term:
    """Put what was asked for in the places of the variables of a supplied tag."""
    if supplied.is_ground or len(supplied.args) != len(asked.args):
        return supplied
    pairs = zip(supplied.args, asked.args)
    return supplied.substitute({have: want for have, want in pairs if have[:1] == "?"})


class CheaperPlans:
    """Compares what streams cost with what they would cost today."""

    def __init__(self, table: ClaimTable, planner: ClaimPlanner) -> None:
        """Begin with no comparison.

        Args:
            table: the claims.
            planner: knows the prices.
        """
        self._table = table
        self._planner = planner
        #: For each claim what was on offer when it was compared last, and what was reported.
        self._compared: Dict[str, Tuple[Hashable, str]] = {}

    def find(self, claim: Claim) -> Optional[Plan]:
        """Return a plan by which all claims together cost less than now, or None."""
        answer = self._planner.plan_from_scratch(claim)
        if isinstance(answer, NoPlan):
            return None
        elsewhere = isinstance(answer.goal, Live) and answer.goal.topic not in ("", claim.topic)
        cost = answer.cost + (RELAY_COST if elsewhere else 0)
        if cost >= self._planner.price(claim):
            return None
        return self._planner.with_own(answer, self._planner.own(claim))

    def report(self) -> None:
        """Look for a cheaper plan for one claim, if anything new is on offer; report it once."""
        offers = self._planner.supplies.offers()
        claims = self._table.living()
        for claim in claims:
            before, reported = self._compared.get(claim.claim_id, (None, ""))
            if claim.state is not ClaimState.ACTIVE or before == offers:
                continue
            news = ""
            cheaper = self.find(claim)
            if cheaper is not None:
                labels = ", ".join(sorted(step.action.label for step in cheaper.steps))
                way = f"with {labels}" if labels else "with what others use"
                news = f"a cheaper way has appeared, {way}; replanning takes it"
                if news != reported:
                    self._table.report(claim.claim_id, news)
            self._compared[claim.claim_id] = (offers, news)
            break
        living = {claim.claim_id for claim in claims}
        self._compared = {key: each for key, each in self._compared.items() if key in living}
