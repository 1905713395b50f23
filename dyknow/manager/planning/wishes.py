# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a client would rather have: parts that are charged besides their cost.

A part that the client avoids is charged ``AVOIDED``. A part that supplies what a preferred one
could supply as well is charged ``NOT_PREFERRED``, unless it is preferred itself. Both hold for
running parts too, which cost nothing else, and for what feeds them. The plan is cheapest with the
charges.
"""

from __future__ import annotations

from typing import (
    AbstractSet,
    Dict,
    FrozenSet,
    Iterable,
    NamedTuple,
    Sequence,
    Tuple,
)

from dyknow.manager.planning.live_streams import LiveStreams
from dyknow.manager.planning.network import Network
from dyknow.manager.planning.problem import Live
from dyknow.manager.planning.reach import Scope
from dyknow.manager.planning.supply import Demand
from dyknow.manager.specifications.tags import Term

#: What a part is charged besides its cost.
AVOIDED = 1000
NOT_PREFERRED = 100

TaggedStream = Tuple[Live, Tuple[Term, ...]]
"""A stream and what it is about."""


class Wishes(NamedTuple):
    """What is preferred, and what is avoided: labels, and concepts of tags of out-ports."""

    prefer: Tuple[str, ...] = ()
    avoid: Tuple[str, ...] = ()


NO_WISHES = Wishes()
"""Everything is as good as everything else."""


def charges_of(
    network: Network,
    goal: Demand,
    streams: Sequence[TaggedStream],
    exclude: AbstractSet[str],
    wishes: Wishes,
) -> Dict[str, int]:
    """Return what the parts that may help to reach a goal are charged, by label."""
    if wishes == NO_WISHES:
        return {}
    names = network.names
    everything = LiveStreams(names)
    tags: Dict[str, FrozenSet[Term]] = {}
    for stream, terms in streams:
        everything.add(stream, terms)
        tags[stream.label] = tags.get(stream.label, frozenset()).union(terms)
    reach = Scope(network, network.goal(goal), LiveStreams(names), exclude).everything(False)
    for action in reach.serves:
        tags[network.labels[action]] = frozenset(network.tags(action))

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
    others: FrozenSet[str] = frozenset()
    if preferred:
        for demand in reach.above:
            suppliers = {network.labels[action] for action in network.suppliers(demand)} - exclude
            suppliers |= everything.labels(network.patterns[demand])
            if not preferred.isdisjoint(suppliers):
                others = others.union(suppliers - preferred)
    for label in others:
        charges[label] = charges.get(label, 0) + NOT_PREFERRED
    return charges
