# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a client would rather have: parts that are charged besides their cost.

A part that the client avoids is charged ``AVOIDED``. A part that supplies what a preferred one
could supply as well is charged ``NOT_PREFERRED``, unless it is preferred itself. Both hold for
running parts too, which cost nothing else, and for what feeds them. The plan is cheapest with the
charges.

The search knows no live stream that costs or takes something, so such a stream is searched as an
action without in-ports.
"""

from __future__ import annotations

from typing import (
    AbstractSet,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Sequence,
    Tuple,
)

from dyknow.manager.planning.live_streams import LiveStreams
from dyknow.manager.planning.network import Network
from dyknow.manager.planning.problem import Charge, Live, New, Plan, Source
from dyknow.manager.planning.reach import Scope
from dyknow.manager.planning.supply import Demand
from dyknow.manager.specifications.tags import Term
from dyknow.model.transformation import OUT, Port, Transformation

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
    for action in reach.actions:
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
        for demand in reach.demands:
            suppliers = {network.labels[action] for action in network.suppliers(demand)} - exclude
            suppliers |= everything.labels(network.patterns[demand])
            if not preferred.isdisjoint(suppliers):
                others = others.union(suppliers - preferred)
    for label in others:
        charges[label] = charges.get(label, 0) + NOT_PREFERRED
    return charges


class StreamActions:
    """Live streams that are charged, or late where that matters, as actions of a network."""

    def __init__(
        self,
        network: Network,
        charges: Mapping[str, int],
        feeders: Mapping[str, FrozenSet[str]],
        is_timed: bool,
    ) -> None:
        """Begin without a stream.

        Args:
            network: where the actions are entered, for the time of one search.
            charges: by label.
            feeders: labels of what feeds a nodelet, by its name.
            is_timed: whether the latency of streams matters.
        """
        self._network = network
        self._charges = charges
        self._feeders = feeders
        self._is_timed = is_timed
        self._streams: Dict[str, Dict[str, TaggedStream]] = {}
        #: What is charged, by label of the library or of an action made here.
        self.charges: Dict[str, int] = dict(charges)

    def add(self, stream: Live, terms: Tuple[Term, ...]) -> bool:
        """Enter a stream, if it costs or takes something; tell whether it does."""
        feeders = self._feeders.get(stream.nodelet, frozenset())
        charge = sum([self._charges.get(each, 0) for each in {stream.label, *feeders}])
        is_used = bool(charge or (self._is_timed and stream.latency))
        if is_used:
            label = f"\0{stream.nodelet or stream.topic}"
            self._streams.setdefault(label, {})[stream.port or "out"] = (stream, terms)
            self.charges[label] = charge
        return is_used

    def __enter__(self) -> StreamActions:
        """Let the network know them."""
        self._network.add(
            Transformation(
                label,
                "",
                cost=0,
                ports=tuple(
                    Port(
                        port,
                        OUT,
                        stream.datatype,
                        tuple(map(str, terms)),
                        stream.rate,
                        stream.latency,
                    )
                    for port, (stream, terms) in ports.items()
                ),
            )
            for label, ports in self._streams.items()
        )
        return self

    def __exit__(self, *unused: object) -> None:
        for label in self._streams:
            self._network.remove(label)

    def restored(self, plan: Plan) -> Plan:
        """Put the streams in the places of the actions."""

        def source(each: Source) -> Source:
            if isinstance(each, New) and each.label in self._streams:
                return self._streams[each.label][each.port][0]
            return each

        charged: List[Charge] = []
        steps = []
        for step in plan.steps:
            label = step.action.label
            if label in self._streams and self.charges[label]:
                charged.append(Charge(label[1:], self.charges[label]))
            elif label not in self._streams:
                inputs = tuple((port, source(each)) for port, each in step.inputs)
                steps.append(step._replace(inputs=inputs))
        return plan._replace(
            goal=source(plan.goal), steps=tuple(steps), charges=tuple(sorted(charged))
        )
