"""What the answer to a request says besides the plan: what was left out, and what may be meant."""

from __future__ import annotations

from typing import Sequence, Set, Tuple

from dyknow.errors import UnknownTransformation
from dyknow.manager.manager import Manager
from dyknow.manager.planning.problem import NoPlan
from dyknow.manager.specifications.findings import listed
from dyknow.model.transformation import OUT
from dyknow.similar import did_you_mean

#: Transformations beyond which nothing is suggested: looking would take too long.
_SEARCHED = 10_000
#: Missing tags, and unknown labels, for which something is suggested.
_EXPLAINED = 3


def refusal(manager: Manager, answer: NoPlan, exclude: Sequence[str]) -> str:
    """Explain to a client why there is no plan."""
    excluded = f" (excluded: {listed(exclude)})" if exclude else ""
    return "".join([str(answer), excluded, _meant(manager, answer), *_after(manager, exclude)])


def unknown_labels(manager: Manager, exclude: Sequence[str]) -> Tuple[str, ...]:
    """Say which labels that a client excludes are those of nothing."""
    known = {each.label for each in manager.library.all()}
    known |= {record.label for record in manager.graph.all()}
    unknown = [label for label in exclude if label not in known]
    among = known if len(known) < _SEARCHED else set()
    return tuple(
        str(UnknownTransformation(label, did_you_mean(label, among)))
        for label in unknown[:_EXPLAINED]
    )


def _after(manager: Manager, exclude: Sequence[str]) -> Sequence[str]:
    return [f"; {each}" for each in unknown_labels(manager, exclude)] if exclude else []


def _meant(manager: Manager, answer: NoPlan) -> str:
    transformations = manager.library.all()
    if len(transformations) > _SEARCHED:
        return ""
    supplied: Set[str] = {
        tag
        for each in transformations
        for port in each.ports
        if port.direction == OUT
        for tag in port.tags
    }
    missing = sorted({str(term) for demand in answer.missing for term in demand.tags})
    return "".join(
        did_you_mean(tag, supplied, at_most=2)
        for tag in missing[:_EXPLAINED]
        if tag not in supplied
    )
