# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Finds the cheapest way to a stream.

First the cheapest *tree* of instances, in which a part that is used twice is paid twice
(`search`, guided by `bounds`). Then the plan is improved by counting shared parts once
(`improvement`), within a budget. Costs are Python's integers: stacked diamonds make trees that
cost 2**1000, without overflow. No function is recursive. Labels, bindings and ports decide
between equal costs, so equal problems have equal plans.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import AbstractSet, Callable, Iterable, Mapping, Sequence

from dyknow.garbage import without_collection
from dyknow.manager.planning.and_or_graph import Draft, Node, Reach
from dyknow.manager.planning.improvement import BOUNDED, STEPS, Budget, allowed, improve
from dyknow.manager.planning.library import Head, Operator, OperatorIndex, Reader
from dyknow.manager.planning.patterns import NO_TYPES, Names
from dyknow.manager.planning.problem import (
    AVOIDED,
    NO_FREE,
    NO_LABELS,
    NO_VERDICTS,
    NO_WISHES,
    NOT_PREFERRED,
    Answer,
    Demand,
    Free,
    Instance,
    New,
    NoPlan,
    Plan,
    PlanStep,
    Source,
    Streams,
    Verdicts,
    Wishes,
)
from dyknow.manager.planning.reasons import no_plan, too_few
from dyknow.manager.planning.request import NEVER, NO_FEEDERS, Request
from dyknow.manager.planning.search import Search
from dyknow.manager.specifications.tags import (
    NO_ONTOLOGY,
    Bindings,
    Subsumption,
    Term,
    read_tags,
    unify_all,
)
from dyknow.model.transformation import TOPIC, Transformation

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
        self, ontology: Subsumption = NO_ONTOLOGY, clock: Callable[[], float] = time.monotonic
    ) -> None:
        names = Names(ontology)
        self._reader = Reader(names)
        self._library = OperatorIndex(names, {}, {})
        self._clock = clock

    def __len__(self) -> int:
        return len(self._library.actions)

    @without_collection()
    def know(self, transformations: Iterable[Transformation]) -> None:
        """Plan with these transformations from now on; only changes are read.

        Topics are not actions.
        """
        new = {each.label: each for each in transformations if each.type != TOPIC}
        known = self._library.actions
        gone = {each for label, each in known.items() if each.transformation != new.get(label)}
        come = [
            self._reader.read(each)
            for label, each in new.items()
            if label not in known or known[label] in gone
        ]
        self._reader.forget(gone)
        self._library = self._library.changed(gone, come)

    @without_collection()
    def plan(
        self,
        demand: Demand,
        live: Streams = (),
        exclude: AbstractSet[str] = NO_LABELS,
        free: Free = NO_FREE,
        paused: AbstractSet[str] = NO_LABELS,
        budget: float = BUDGET,
        wishes: Wishes = NO_WISHES,
        feeders: Mapping[str, Sequence[str]] = NO_FEEDERS,
        verdicts: Verdicts | None = NO_VERDICTS,
        refused: AbstractSet[str] = NO_TYPES,
    ) -> Answer:
        """Find the cheapest way to a stream.

        Streams that are ``live`` exist, and cost nothing. Labels of ``exclude`` must not be used,
        live or new; of ``paused`` ones no new nodelet is made. Nodelets of ``free`` labels can be
        connected elsewhere at no cost, each with bindings that it has to keep. ``feeders`` are
        labels of the feeders of live streams, by nodelet; ``verdicts`` those that transformations
        require, None to disregard them; ``refused`` ROS types that the stream must not have.

        Beyond the budget (s) a plan is looked for, but not improved. It counts steps, so equal
        problems have equal plans; the clock ends the improvement only where a step takes long.
        """
        library, streams = self._library, list(live)
        charges = self.charges(demand, streams, exclude, wishes, library)
        request = Request(
            library, demand, streams, exclude, paused, free, charges, feeders, verdicts, refused
        )
        answer = self._answer(request, budget)
        if isinstance(answer, NoPlan) or not demand.min_rate:
            return answer
        if len({step.instance for step in answer.steps}) == len(answer.steps):
            return answer
        # A nodelet is made twice: with fast inputs and with others.
        request.is_strict = True
        strict = self._answer(request, budget)
        if isinstance(strict, NoPlan):
            return strict
        return replace(strict, least_cost=min(strict.least_cost, answer.least_cost))

    def _answer(self, request: Request, budget: float) -> Answer:
        demand, reach = request.demand, Reach(request)
        spent = BOUNDED * reach.size
        _, way = reach.trees
        if reach.is_simple and 0 in way:
            draft = reach.drafted(way)
        else:
            search = Search(reach)
            steps = _SEARCH + int(budget * STEPS)
            spent += steps - search.run(steps)
            if not search.goal.answers:
                return no_plan(search)
            draft = search.graph.drafted(search.way)
        is_late = request.limit is not None and draft.latency > request.limit
        if is_late or not draft.is_sound:
            draft, is_found, is_proven = allowed(reach, draft)
            if not is_found and is_proven and draft.cost >= NEVER:
                return too_few(draft)
            if not is_found and request.limit is not None:
                return NoPlan(demand, (), False, draft.latency / 1e6)
            if not is_found:
                return NoPlan(demand, (), is_proven, is_cut_short=not is_proven)
        if draft.cost <= reach.forced:
            return _written(draft, draft.cost)
        improving = Budget(budget, self._clock, spent)
        draft, least_cost = improve(reach, draft, improving)
        return _written(draft, least_cost, improving.is_cut_short)

    def charges(
        self,
        demand: Demand,
        live: Streams,
        exclude: AbstractSet[str],
        wishes: Wishes,
        library: OperatorIndex | None = None,
    ) -> dict[str, int]:
        """Return the charges of the parts that may help to meet a demand, by label.

        A part that the client avoids is charged `AVOIDED`. A part that supplies a demand that a
        preferred one could supply as well is charged `NOT_PREFERRED`, unless it is preferred
        itself. Both hold for running parts too, which cost nothing else, and for their feeders.
        The library is that of now by default.
        """
        if wishes == NO_WISHES:
            return {}
        library, streams = library or self._library, list(live)
        names = library.names
        request = Request(library, demand, streams, exclude)
        request.is_whole = True
        tags: dict[str, set[Term]] = {}
        for stream, terms in streams:
            if stream.label not in exclude:
                tags.setdefault(stream.label, set()).update(terms)
        actions = {library.actions[label] for label in tags if label in library.actions}
        suppliers: list[set[str]] = []
        for pattern in Reach(request).patterns:
            facts = [head for head, _ in request.facts(pattern)]
            makers = [offer.action for offer in request.offers(pattern)]
            new = {*makers, *[head.action for head in facts if head.live is None]}
            actions |= new
            suppliers.append({*[e.label for e in new], *[head.label for head in facts]})
        for action in actions:  # running parts are meant as new ones are, by the library's tags
            tags[action.label] = {each for e in action.heads for each in read_tags(e.port.tags)}

        def meant(wanted: Iterable[str]) -> frozenset[str]:
            concepts = frozenset(map(names.canonical, wanted))
            return frozenset(
                label
                for label, terms in tags.items()
                if label in wanted
                or any(
                    not concepts.isdisjoint(names.above(names.canonical(name)))
                    for term in terms
                    for name in (term.functor, *term.args)
                    if name not in term.variables
                )
            )

        charges = dict.fromkeys(meant(wishes.avoid), AVOIDED)
        preferred = meant(wishes.prefer)
        others = {each for some in suppliers if preferred & some for each in some - preferred}
        for label in others:
            charges[label] = charges.get(label, 0) + NOT_PREFERRED
        return charges

    @without_collection()
    def parts(
        self, demand: Demand, live: Streams = (), exclude: AbstractSet[str] = NO_LABELS
    ) -> set[Instance]:
        """Find every possible part of a plan, under any verdicts; the arguments are as for `plan`.

        Labels are also those of live streams; bindings are those of the variables that tell its
        nodelets apart.
        """
        request = Request(self._library, demand, list(live), exclude, verdicts=None)
        request.is_whole = True
        search = Search(Reach(request), NEVER)
        search.run(int(BUDGET * STEPS))
        written = request.names.written
        found: set[Instance] = set()
        for number, theta in enumerate(search.graph.thetas):
            action = search.graph.actions[number].base
            bindings = tuple(zip(action.variables, map(written, theta)))
            found.update(Instance(head.label, bindings) for head in action.heads)
        return found

    @without_collection()
    def bindings(
        self, demand: Demand, live: Streams = (), verdicts: Verdicts | None = NO_VERDICTS
    ) -> tuple[list[Bindings], bool]:
        """Find all that the variables of a demand can stand for; the arguments are as for `plan`.

        Returns:
            The bindings, sorted, and whether these are all. Without a variable there is an empty
            one if the stream can be made.
        """
        variables = sorted({each for term in demand.tags for each in term.variables})
        request = Request(self._library, demand, list(live), wanted=variables, verdicts=verdicts)
        search = Search(Reach(request))
        search.run(int(BUDGET * STEPS), is_all=True)
        written = request.names.written
        found = [
            tuple(zip(variables, map(written, search.graph.names[node])))
            for node in search.goal.answers
        ]
        return sorted(found), search.is_complete


class _Writer:
    """Writes the steps of one plan, suppliers first."""

    def __init__(self, draft: Draft) -> None:
        self._graph = draft.graph
        self._way = draft.way
        self._instances: dict[int, Instance] = {}
        self._sources: dict[Node, tuple[Source, Head]] = {}

    def source(self, node: Node) -> tuple[Source, Head]:
        """Return the supplier of a node, and its out-port."""
        found = self._sources.get(node)
        if found is None:
            maker = self._way[node]
            head = self._graph.head(maker, node)
            source = head.live or New(self._instances[maker], head.port.name)
            found = self._sources[node] = source, head
        return found

    def step(self, number: int, action: Operator, cost: int, charge: int) -> PlanStep:
        """Write an instance of the graph."""
        bindings: dict[str, str] = {}
        inputs = []
        joined = dict(zip(action.variables, self._graph.thetas[number]))
        for port, node in zip(action.in_ports, self._graph.needs[number]):
            source, head = self.source(node)
            inputs.append((port.name, source))
            if action.variables or action.has_private:
                way = self.bound(source, head, read_tags(port.tags), joined)
                bindings = {**way, **bindings}
        instance = Instance(action.label, tuple(sorted(bindings.items())))
        self._instances[number] = instance
        return PlanStep(instance, tuple(inputs), cost, charge)

    def bound(
        self, source: Source, head: Head, demanded: Iterable[Term], joined: Mapping[str, str]
    ) -> dict[str, str]:
        """Bind the variables of a demand to names as they are supplied."""
        names = self._graph.request.names
        terms = read_tags(head.port.tags)
        if isinstance(source, New):
            bindings = dict(source.instance.bindings)
            terms = tuple([term.substitute(bindings) for term in terms])
        for way in unify_all(terms, demanded, names.ontology):
            bound = {variable: names.canonical(name) for variable, name in way.items()}
            if all(joined.get(variable, name) == name for variable, name in bound.items()):
                return way
        raise AssertionError(f"{source} does not supply {demanded}")


def _written(draft: Draft, least_cost: int, is_cut_short: bool = False) -> Plan:
    graph, request = draft.graph, draft.graph.request
    writer = _Writer(draft)
    steps: list[PlanStep] = []
    charges: list[tuple[str, int]] = []
    surplus = graph.surplus(draft.order) if request.kept else ()
    for number in draft.order:
        action, theta = graph.actions[number].base, graph.thetas[number]
        if action.transformation is None:
            if action.cost:
                charges.append((action.label, action.cost))
            continue
        is_there = request.kept and number not in surplus and request.fitting(action, theta)
        cost = 0 if is_there else action.cost
        steps.append(writer.step(number, action, cost, request.charges.get(action, 0)))
    goal, head = writer.source(0)
    wanted = sorted(request.demand.tags)
    bindings = writer.bound(goal, head, wanted, {}) if request.goal.types else {}
    return Plan(
        request.demand,
        goal,
        tuple(steps),
        least_cost,
        tuple(sorted(bindings.items())),
        is_cut_short,
        tuple(sorted(charges)),
        draft.latency / 1e6,
    )
