# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a client would rather have: parts that are charged besides their cost.

A part that the client avoids is charged ``AVOIDED``. A part that supplies what a preferred one
could supply as well is charged ``NOT_PREFERRED``, unless it is preferred itself. Both hold for
running parts too, which cost nothing else, and for what feeds them. The plan is cheapest with the
charges.
"""

from __future__ import annotations

from typing import AbstractSet, Dict, FrozenSet, Iterable, Sequence, Set

from dyknow.manager.planning.bounds import Bounds
from dyknow.manager.planning.library import RuleLibrary
from dyknow.manager.planning.problem import NO_WISHES, Demand, TaggedStream, Wishes
from dyknow.manager.planning.request import Request, base
from dyknow.manager.specifications.tags import Term, read_tags

#: What a part is charged besides its cost.
AVOIDED = 1000
NOT_PREFERRED = 100


def charges_of(
    library: RuleLibrary,
    goal: Demand,
    streams: Sequence[TaggedStream],
    exclude: AbstractSet[str],
    wishes: Wishes,
) -> Dict[str, int]:
    """Return what the parts that may help to reach a goal are charged, by label."""
    if wishes == NO_WISHES:
        return {}
    names = library.names
    bounds = Bounds(Request(library, goal, (), exclude), is_whole=True)
    request = Request(library, goal, streams, exclude)
    tags: Dict[str, Set[Term]] = {}
    for stream, terms in streams:
        if stream.label not in exclude:
            tags.setdefault(stream.label, set()).update(terms)
    suppliers: Dict[int, Set[str]] = {}
    for number in bounds.users:
        makers = [base(each) for each in request.makers(number)]
        facts = [head for head, _ in request.facts(number, ())]
        for action in {
            *makers,
            *[head.action for head in facts if head.action not in request.charged],
        }:
            texts = tuple([text for head in library.heads[action] for text in head.texts])
            tags.setdefault(library.labels[action], set()).update(read_tags(texts))
        suppliers[number] = {library.labels[each] for each in makers}
        suppliers[number].update([head.source.label for head in facts])

    def meant(wanted: Iterable[str]) -> FrozenSet[str]:
        labels = frozenset(wanted)
        concepts = frozenset(map(names.canonical, wanted))
        return frozenset(
            label
            for label, terms in tags.items()
            if label in labels
            or any(
                not concepts.isdisjoint(names.above(names.canonical(name)))
                for term in terms
                for name in (term.functor, *term.args)
                if name not in term.variables
            )
        )

    charges = dict.fromkeys(meant(wishes.avoid), AVOIDED)
    preferred = meant(wishes.prefer)
    others: Set[str] = set()
    for labels in suppliers.values():
        if not preferred.isdisjoint(labels):
            others.update(labels - preferred)
    for label in others:
        charges[label] = charges.get(label, 0) + NOT_PREFERRED
    return charges
