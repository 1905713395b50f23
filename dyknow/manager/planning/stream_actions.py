# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Live streams that cost or take something, as actions without in-ports.

The search takes a live stream for one that costs nothing and is there at once. One that is
charged, or whose latency matters, is searched as an action, and is a stream again in the plan.
"""

from __future__ import annotations

from typing import Dict, FrozenSet, List, Mapping, Tuple

from dyknow.manager.planning.network import Network
from dyknow.manager.planning.problem import Charge, Live, New, Plan, Source
from dyknow.manager.planning.wishes import TaggedStream
from dyknow.manager.specifications.tags import Term
from dyknow.model.transformation import OUT, Port, Transformation


class StreamActions:
    """Enters streams in a network as actions, for the time of one search."""

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
        if not self._streams:
            return plan

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
