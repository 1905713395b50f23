# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Finds the cheapest way to a stream.

First Knuth's generalisation of Dijkstra's algorithm (``knuth``) finds the cheapest *tree*, in
which a part that is used twice is paid twice. Then the plan is improved by counting shared parts
once (``improvement``): exactly if the problem is small, else within a number of steps. Costs are
Python's integers: stacked diamonds make trees that cost 2**1000, without overflow. No function is
recursive. Labels and ports decide between equal costs, so equal problems have equal plans.
"""

from __future__ import annotations

import contextlib
import gc
from typing import AbstractSet, Dict, Iterable, Iterator, List, Tuple

from dyknow.manager.planning.improvement import PlanDraft, drafted, improve
from dyknow.manager.planning.knuth import Values, cheapest
from dyknow.manager.planning.network import Network, Reach
from dyknow.manager.planning.problem import NO_LABELS, Answer, Live, NoPlan, Plan, PlanStep
from dyknow.manager.planning.supply import Demand, Supply
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Subsumption, Term
from dyknow.model.transformation import Transformation

#: Steps that the improvement may take: about a tenth of a second.
STEPS = 100_000


class Planner:
    """Plans with a library that changes a little at a time; one call at a time."""

    def __init__(self, ontology: Subsumption = NO_ONTOLOGY) -> None:
        """Start with an empty library."""
        self._network = Network(ontology)

    def __len__(self) -> int:
        """Count the transformations that can be planned with."""
        return len(self._network)

    @property
    def waste(self) -> int:
        """Numbers that are kept in vain; a new planner would have none."""
        return self._network.waste

    def add(self, transformations: Iterable[Transformation]) -> None:
        """Add transformations; those of known labels are replaced. Topics are no actions."""
        with _no_collection():
            self._network.add(transformations)

    def remove(self, label: str) -> None:
        """Forget a transformation, if it is known."""
        self._network.remove(label)

    def plan(
        self,
        demand: Demand,
        live: Iterable[Tuple[Live, Tuple[Term, ...]]] = (),
        exclude: AbstractSet[str] = NO_LABELS,
        free: AbstractSet[str] = NO_LABELS,
        steps: int = STEPS,
        paused: AbstractSet[str] = NO_LABELS,
    ) -> Answer:
        """Find the cheapest way to a stream.

        Args:
            demand: tags and type of the stream.
            live: streams that exist, with their tags; they cost nothing.
            exclude: labels that must not be used, live or new.
            free: labels of which there is a nodelet that can be connected elsewhere: no cost.
            steps: budget of the improvement.
            paused: labels of which no new nodelet is to be made; live streams may be used.
        """
        network = self._network
        streams: Supply[Live] = Supply(network.ontology)
        for stream, terms in live:
            if stream.label not in exclude:
                streams.add(stream, terms, stream.datatype)
        with _no_collection():
            reach = network.reach(demand, streams, exclude | paused)
            nothing = network.numbers(free) & reach.served.keys()
            trees = cheapest(network, reach, nothing, until=reach.goal)
            if reach.goal not in trees.value:
                return _no_plan(network, reach, trees)
            draft = drafted(network, reach, trees.chosen, nothing)
            assert draft is not None  # a tree of least cost has no cycle
            draft = improve(network, reach, draft, nothing, steps)
            return _plan(network, reach, draft, nothing)


def _plan(network: Network, reach: Reach, draft: PlanDraft, free: AbstractSet[int]) -> Plan:
    sources = network.sources(reach, draft.chosen)
    source_of = sources.__getitem__
    steps = []
    for number in draft.actions:
        action = network.actions[number]
        if number in free:
            action = action._replace(cost=0)
        inputs = zip(network.ports[number], map(source_of, network.inputs[number]))
        steps.append(PlanStep(action, tuple(inputs)))
    return Plan(network.demands[reach.goal], sources[reach.goal], tuple(steps), draft.cost)


def _no_plan(network: Network, reach: Reach, trees: Values) -> NoPlan:
    offers: Dict[int, List[int]] = {demand: [] for demand in reach.consumers}
    for action, demands in reach.served.items():
        for demand in demands:
            offers[demand].append(action)
    unmet = {reach.goal}  # and what is reached from it through unmet demands only
    waiting = [reach.goal]
    while waiting:
        for action in offers[waiting.pop()]:
            for need in network.needs[action]:
                if need not in trees.value and need not in unmet:
                    unmet.add(need)
                    waiting.append(need)
    missing = [network.demands[demand] for demand in unmet if not offers[demand]]
    goal = network.demands[reach.goal]
    return NoPlan(goal, tuple(sorted(missing, key=str)), not missing)


@contextlib.contextmanager
def _no_collection() -> Iterator[None]:
    """Keep the garbage collector from walking through a large library again and again."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        if not gc.get_freeze_count():
            # Moves new objects to the oldest generation without a walk through them.
            gc.freeze()
            gc.unfreeze()
        gc.enable()
