# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Finds the cheapest way to a stream.

First the cheapest *tree* of instances, in which a part that is used twice is paid twice
(``search``, guided by ``bounds``). Then the plan is improved by counting shared parts once
(``improvement``), within a budget. Costs are Python's integers: stacked diamonds make trees that
cost 2**1000, without overflow. No function is recursive. Labels, bindings and ports decide
between equal costs, so equal problems have equal plans.
"""

from __future__ import annotations

import time
from typing import AbstractSet, Callable, Dict, FrozenSet, Iterable, List, Mapping, Tuple

from dyknow.manager.planning.and_or_graph import Draft, drafted
from dyknow.manager.planning.answer import plan_of
from dyknow.manager.planning.bounds import Bounds
from dyknow.manager.planning.budget import STEPS, Budget
from dyknow.manager.planning.improvement import Improved, improve, soonest
from dyknow.manager.planning.library import LibraryWriter
from dyknow.manager.planning.problem import (
    NO_FREE,
    NO_LABELS,
    NO_WISHES,
    Answer,
    Demand,
    NoPlan,
    TaggedStream,
    Wishes,
)
from dyknow.manager.planning.reasons import no_plan
from dyknow.manager.planning.request import NO_FEEDERS, Need, Request
from dyknow.manager.planning.search import Instance, Search
from dyknow.manager.planning.wishes import charges_of
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Bindings, Subsumption
from dyknow.model.transformation import Transformation

#: Seconds that the improvement of a plan may take.
BUDGET = 0.1
#: Steps that the search for the cheapest tree may take, besides the budget: some seconds. For
#: any of 100,000 cameras it takes a third of them.
_SEARCH = 60_000_000


class Planner:
    """Plans with a library that changes a little at a time.

    One thread at a time changes the library. Any thread plans meanwhile, with the library as it
    was when it began, without a lock.
    """

    def __init__(
        self,
        ontology: Subsumption = NO_ONTOLOGY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start with an empty library."""
        self._writer = LibraryWriter(ontology)
        self._clock = clock

    def __len__(self) -> int:
        """Count the transformations that can be planned with."""
        return len(self._writer.library.by_label)

    @property
    def waste(self) -> int:
        """Numbers that are kept in vain; a new planner would have none."""
        return self._writer.waste

    def add(self, transformations: Iterable[Transformation]) -> None:
        """Add transformations; those of known labels are replaced. Topics are no actions."""
        self._writer.change((), transformations)

    def remove(self, *labels: str) -> None:
        """Forget transformations, as far as they are known."""
        self._writer.change(labels, ())

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
        library = self._writer.library
        streams = list(live)
        charges = charges_of(library, demand, streams, exclude, wishes)
        request = Request(library, demand, streams, exclude, paused, free, charges, feeders)
        bounds = Bounds(request)
        least, actions = bounds.least()
        goal = Need(request.goal, ())
        if bounds.is_simple and request.goal in least:
            draft = drafted(request, _choices(request, actions), goal)
        else:
            search = Search(request, bounds, least)
            search.run(_SEARCH + int(budget * STEPS))
            if goal not in search.value:
                return no_plan(request, search)
            draft = drafted(request, search.chosen, goal)

        def latency(draft: Draft) -> float:
            return plan_of(request, Improved(draft, 0, False)).latency

        if request.limit is not None and not demand.is_soon(latency(draft)):
            draft, is_in_time = soonest(request, bounds, draft)
            if not is_in_time:
                return NoPlan(demand, (), False, latency(draft))
        return plan_of(request, improve(request, bounds, draft, Budget(budget, self._clock)))

    def charges(
        self,
        demand: Demand,
        live: Iterable[TaggedStream],
        exclude: AbstractSet[str],
        wishes: Wishes,
    ) -> Dict[str, int]:
        """Return what the parts of a plan are charged besides their costs, by label."""
        return charges_of(self._writer.library, demand, list(live), exclude, wishes)

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
        library = self._writer.library
        variables = sorted({each for term in demand.tags for each in term.variables})
        request = Request(library, demand, list(live), wanted=variables)
        bounds = Bounds(request)
        search = Search(request, bounds, bounds.least()[0])
        search.run(int(budget * STEPS), is_all=True)
        written = request.names.written
        found = [tuple(zip(variables, map(written, node.theta))) for node in search.goal.answers]
        return sorted(found), search.is_complete


def _choices(request: Request, actions: Dict[int, int]) -> Dict[Need, Instance]:
    """Return what supplies the nodes where no name is bound."""
    found: Dict[Need, Instance] = {}
    made: Dict[int, Instance] = {}
    waiting = [request.goal]
    for number in waiting:  # grows meanwhile
        action = actions[number]
        instance = made.get(action)
        if instance is None:
            inputs = request.inputs(action)
            cost = request.floor(action)
            instance = made[action] = Instance(
                action, (), cost, tuple([Need(each, ()) for each in inputs])
            )
            waiting += inputs
        found[Need(number, ())] = instance
    return found
