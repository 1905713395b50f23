# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Finds the cheapest way to a stream.

First Knuth's generalisation of Dijkstra's algorithm (``knuth``) finds the cheapest *tree* of
instances, in which a part that is used twice is paid twice; lower bounds from a search without
bindings guide it (``refinement``). Then the plan is improved by counting shared parts once
(``improvement``), within a budget. Costs are Python's integers: stacked diamonds make trees that
cost 2**1000, without overflow. No function is recursive. Labels, bindings and ports decide
between equal costs, so equal problems have equal plans.
"""

from __future__ import annotations

import time
from types import MappingProxyType
from typing import (
    AbstractSet,
    Callable,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    Tuple,
)

from dyknow.manager.planning.budget import Budget
from dyknow.manager.planning.costs import Costs
from dyknow.manager.planning.extraction import no_plan, plan_of
from dyknow.manager.planning.improvement import Improved, drafted, improve, soonest
from dyknow.manager.planning.instances import Instances
from dyknow.manager.planning.knuth import cheapest
from dyknow.manager.planning.latency import microseconds
from dyknow.manager.planning.live_streams import LiveStreams
from dyknow.manager.planning.network import Network
from dyknow.manager.planning.problem import NO_FREE, NO_LABELS, Answer, NoPlan
from dyknow.manager.planning.reach import Scope
from dyknow.manager.planning.refinement import Refinement
from dyknow.manager.planning.stream_actions import StreamActions
from dyknow.manager.planning.supply import Demand
from dyknow.manager.planning.wishes import (
    NO_WISHES,
    TaggedStream,
    Wishes,
    charges_of,
)
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Bindings, Subsumption
from dyknow.model.transformation import Transformation

#: Seconds that the improvement of a plan may take.
BUDGET = 0.1

NO_FEEDERS: Mapping[str, FrozenSet[str]] = MappingProxyType({})
"""It is not known what feeds the live streams."""


class Planner:
    """Plans with a library that changes a little at a time; one call at a time."""

    def __init__(
        self,
        ontology: Subsumption = NO_ONTOLOGY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start with an empty library."""
        self._network = Network(ontology)
        self._clock = clock

    def __len__(self) -> int:
        """Count the transformations that can be planned with."""
        return len(self._network)

    @property
    def waste(self) -> int:
        """Numbers that are kept in vain; a new planner would have none."""
        return self._network.waste

    def add(self, transformations: Iterable[Transformation]) -> None:
        """Add transformations; those of known labels are replaced. Topics are no actions."""
        self._network.add(transformations)

    def remove(self, label: str) -> None:
        """Forget a transformation, if it is known."""
        self._network.remove(label)

    def plan(
        self,
        demand: Demand,
        live: Iterable[TaggedStream] = (),
        exclude: AbstractSet[str] = NO_LABELS,
        free: Mapping[str, Bindings] = NO_FREE,
        paused: AbstractSet[str] = NO_LABELS,
        budget: float = BUDGET,
        wishes: Wishes = NO_WISHES,
        feeders: Mapping[str, FrozenSet[str]] = NO_FEEDERS,
    ) -> Answer:
        """Find the cheapest way to a stream.

        Args:
            demand: tags and type of the stream.
            live: streams that exist, with their tags; they cost nothing.
            exclude: labels that must not be used, live or new.
            free: labels of which there is a nodelet that can be connected elsewhere, at no cost,
                each with the bindings that the nodelet has to keep.
            paused: labels of which no new nodelet is to be made; live streams may be used.
            budget: seconds that the improvement may take. It counts steps, so equal problems
                have equal plans; the clock ends it only where a step takes long.
            wishes: what is to be used rather than other things.
            feeders: labels of what feeds the live streams, by their nodelets.
        """
        network = self._network
        usable = [each for each in live if each[0].label not in exclude]
        charges = charges_of(network, demand, usable, exclude, wishes)
        used = StreamActions(network, charges, feeders, bool(demand.max_age))
        streams = LiveStreams(network.names)
        for stream, terms in usable:
            if not used.add(stream, terms):
                streams.add(stream, terms)
        with used:
            goal = network.goal(demand)
            scope = Scope(network, goal, streams, exclude | paused)
            problem = Refinement(scope, free, used.charges)
            instances, trees = problem.trees()
            if goal not in trees.value:
                return no_plan(instances, trees, demand)
            draft = drafted(instances, trees.chosen)
            limit = microseconds(demand.max_age) if demand.max_age else None

            def latency() -> float:
                return plan_of(streams, demand, Improved(draft, 0, False)).latency

            if limit is not None and microseconds(latency()) > limit:
                draft, is_in_time = soonest(problem, draft, limit)
                if not is_in_time:
                    return NoPlan(demand, (), False, latency())
            improved = improve(problem, draft, Budget(budget, self._clock), limit)
            return used.restored(plan_of(streams, demand, improved))

    def charges(
        self,
        demand: Demand,
        live: Iterable[TaggedStream],
        exclude: AbstractSet[str],
        wishes: Wishes,
    ) -> Dict[str, int]:
        """Return what the parts of a plan are charged besides their costs, by label."""
        usable = [each for each in live if each[0].label not in exclude]
        return charges_of(self._network, demand, usable, exclude, wishes)

    def bindings(
        self,
        demand: Demand,
        live: Iterable[TaggedStream] = (),
        budget: float = BUDGET,
    ) -> Tuple[List[Bindings], bool]:
        """Find all that the variables of a demand can stand for.

        Args:
            demand: tags and type of the stream.
            live: streams that exist, with their tags.
            budget: seconds that this may take, counted in steps.

        Returns:
            The bindings, sorted, and whether these are all. Without a variable there is an empty
            one if the stream can be made.
        """
        network = self._network
        streams = LiveStreams(network.names)
        for stream, terms in live:
            streams.add(stream, terms)
        variables = sorted({each for term in demand.tags for each in term.variables})
        goal = network.goal(demand, variables)
        reach = Scope(network, goal, streams, NO_LABELS).everything(False)
        instances = Instances(network, reach, Costs(network, NO_FREE))
        values = cheapest(instances, is_all=True, budget=Budget(budget, self._clock))
        written = network.names.written
        found = [
            tuple(zip(variables, map(written, theta)))
            for node, theta in instances.nodes_of(goal)
            if node in values.value
        ]
        return sorted(found), values.is_complete
