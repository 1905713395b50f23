"""Finds the cheapest way to a stream.

First Knuth's generalisation of Dijkstra's algorithm (``knuth``) gives for each demand the cheapest
*tree*, in which a part that is used twice is paid twice. Then the plan is improved by counting
shared parts once (``improvement``): exactly while the problem is small, within a number of steps
beyond.
Costs are Python's integers: stacked diamonds make trees of 2**1000 without overflow. Nothing is
recursive. Equal costs are decided by labels and ports, so equal problems have equal plans.
"""

from __future__ import annotations

from typing import AbstractSet, Dict, Iterable, List, Optional, Tuple

from dyknow.errors import InvalidTag
from dyknow.manager.improvement import improve
from dyknow.manager.knuth import Problem, Solution, cheapest
from dyknow.manager.planning import (
    NO_LABELS,
    Action,
    Answer,
    Live,
    Need,
    New,
    NoPlan,
    Source,
    assemble,
)
from dyknow.manager.supply import Demand, Supply
from dyknow.manager.tags import NO_ONTOLOGY, Subsumption, Term, parse_tag
from dyknow.manager.transformation import IN, OUT, TOPIC, Transformation

#: Steps that the improvement may take: about a tenth of a second.
STEPS = 100_000


class Planner:
    """Plans over a library that changes a little at a time."""

    def __init__(self, ontology: Subsumption = NO_ONTOLOGY) -> None:
        """Start with an empty library."""
        self._ontology = ontology
        self._supply: Supply[New] = Supply(ontology)
        self._actions: Dict[str, Action] = {}
        self._tags: Dict[str, List[Tuple[New, Tuple[Term, ...]]]] = {}
        self._terms: Dict[str, Optional[Term]] = {}

    def __len__(self) -> int:
        """Count the transformations that can be planned with."""
        return len(self._actions)

    def add(self, transformations: Iterable[Transformation]) -> None:
        """Add transformations; those of known labels are replaced. Topics are no actions."""
        for each in transformations:
            self.remove(each.label)
            if each.type == TOPIC:
                continue
            needs = []
            supplied = []
            for port in each.ports:
                terms = self.terms(port.tags)
                if not terms:
                    continue
                if port.direction == IN:
                    needs.append(Need(port.name, Demand(frozenset(terms), port.datatype)))
                elif port.direction == OUT:
                    source = New(each.label, port.name)
                    supplied.append((source, terms))
                    self._supply.add(source, terms, port.datatype)
            self._actions[each.label] = Action(each.label, each.cost, tuple(needs))
            self._tags[each.label] = supplied

    def remove(self, label: str) -> None:
        """Forget a transformation, if it is known."""
        if self._actions.pop(label, None) is not None:
            for source, terms in self._tags.pop(label):
                self._supply.remove(source, terms)

    def terms(self, tags: Iterable[str]) -> Tuple[Term, ...]:
        """Read tags; what is no term says nothing to the planner."""
        found = []
        for text in tags:
            if text not in self._terms:
                try:
                    self._terms[text] = parse_tag(text)
                except InvalidTag:
                    self._terms[text] = None
            term = self._terms[text]
            if term is not None:
                found.append(term)
        return tuple(found)

    def plan(
        self,
        demand: Demand,
        live: Iterable[Tuple[Live, Tuple[Term, ...]]] = (),
        exclude: AbstractSet[str] = NO_LABELS,
        free: AbstractSet[str] = NO_LABELS,
        steps: int = STEPS,
    ) -> Answer:
        """Find the cheapest way to a stream.

        Args:
            demand: tags and type of the stream.
            live: streams that are there, with their tags; they cost nothing.
            exclude: labels that must not be used, live or new.
            free: labels of which a nodelet is there that can be re-wired: they cost nothing.
            steps: choices that the improvement may try.
        """
        streams: Supply[Live] = Supply(self._ontology)
        for stream, terms in live:
            if stream.label not in exclude:
                streams.add(stream, terms, stream.datatype)
        problem = self._reach(demand, streams, exclude, free)
        trees = cheapest(problem)
        if demand not in trees.value:
            return _no_plan(problem, trees)
        plan = assemble(demand, trees.best, problem.actions)
        assert plan is not None  # a tree of least cost has no cycle
        return improve(problem, trees, plan, steps)

    def _reach(
        self,
        demand: Demand,
        streams: Supply[Live],
        exclude: AbstractSet[str],
        free: AbstractSet[str],
    ) -> Problem:
        problem = Problem(demand)
        waiting = [demand]
        seen = {demand}
        while waiting:
            wanted = waiting.pop()
            lives: List[Live] = sorted(streams.suppliers(wanted))
            news = sorted(
                each for each in self._supply.suppliers(wanted) if each.label not in exclude
            )
            sources: List[Source] = [*lives, *news]
            problem.sources[wanted] = sources
            for source in news:
                if source.label in problem.actions:
                    continue
                action = self._actions[source.label]
                if source.label in free:
                    action = action._replace(cost=0)
                problem.actions[source.label] = action
                for need in action.needs:
                    if need.demand not in seen:
                        seen.add(need.demand)
                        waiting.append(need.demand)
        return problem


def _no_plan(problem: Problem, trees: Solution) -> NoPlan:
    unmet = {problem.demand}  # reached through unmet demands only: each of them is a reason
    waiting = [problem.demand]
    while waiting:
        for source in problem.sources[waiting.pop()]:
            if isinstance(source, New):
                for need in problem.actions[source.label].needs:
                    if need.demand not in trees.value and need.demand not in unmet:
                        unmet.add(need.demand)
                        waiting.append(need.demand)
    missing = [demand for demand in unmet if not problem.sources[demand]]
    return NoPlan(problem.demand, tuple(sorted(missing, key=str)), not missing)
