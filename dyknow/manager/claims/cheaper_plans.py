"""Cheaper ways: told about once, taken on request only."""

from __future__ import annotations

from typing import Dict, Hashable, Optional, Tuple

from dyknow.manager.claim import Claim
from dyknow.manager.claims.claim_planner import ClaimPlanner
from dyknow.manager.claims.claim_table import ClaimTable
from dyknow.manager.claims.relay import RELAY_COST
from dyknow.manager.planning.problem import Live, NoPlan, Plan
from dyknow.model.streams import ClaimState


class CheaperPlans:
    """Compares what streams cost with what they would cost today."""

    def __init__(self, table: ClaimTable, claim_planner: ClaimPlanner) -> None:
        """Compare nothing yet."""
        self._table = table
        self._planner = claim_planner
        self._compared: Dict[str, Tuple[Hashable, str]] = {}

    def cheaper(self, claim: Claim) -> Optional[Plan]:
        """Plan a way by which all claims together cost less than now, if there is any."""
        answer = self._planner.plan_anew(claim)
        if isinstance(answer, NoPlan):
            return None
        elsewhere = isinstance(answer.goal, Live) and answer.goal.topic not in ("", claim.topic)
        cost = answer.cost + (RELAY_COST if elsewhere else 0)
        if cost >= self._planner.price(claim):
            return None
        return self._planner.with_own(answer, self._planner.own(claim))

    def tell(self) -> None:
        """Look for a cheaper way for one claim, if anything new is offered, and report it."""
        offers = self._planner.offers()
        claims = self._table.living()
        for claim in claims:
            before, told = self._compared.get(claim.claim_id, (None, ""))
            if claim.state is not ClaimState.ACTIVE or before == offers:
                continue
            news = ""
            cheaper = self.cheaper(claim)
            if cheaper is not None:
                labels = ", ".join(sorted(step.action.label for step in cheaper.steps))
                way = f"with {labels}" if labels else "with what others use"
                news = f"a cheaper way has appeared, {way}; replanning takes it"
                if news != told:
                    self._table.report(claim.claim_id, news)
            self._compared[claim.claim_id] = (offers, news)
            break
        living = {claim.claim_id for claim in claims}
        self._compared = {key: each for key, each in self._compared.items() if key in living}
