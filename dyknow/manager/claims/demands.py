"""What the clients of claims are to receive."""

from __future__ import annotations

from typing import Iterable

from dyknow.manager.claim import Claim
from dyknow.manager.planning.supply import Demand
from dyknow.manager.specifications.tags import parse_tag


def demand_of(claims: Iterable[Claim]) -> Demand:
    """What one stream has to be to satisfy all these claims."""
    claims = list(claims)
    types = [wanted_type(claim) for claim in claims]
    tags = frozenset(parse_tag(claim.request.tag) for claim in claims)
    return Demand(tags, types[0] or max(types))


def wanted_type(claim: Claim) -> str:
    """Type of messages that a claim's client expects: what it asked for, or got first."""
    return claim.request.datatype or claim.datatype.replace("*", "")


def may_share(claim: Claim, other: Claim) -> bool:
    """Whether whatever serves one claim, now and later, serves the other, so one topic will do."""
    return (
        parse_tag(claim.request.tag) == parse_tag(other.request.tag)
        and wanted_type(claim) in ("", wanted_type(other))
        and set(claim.request.exclude) == set(other.request.exclude)
    )
