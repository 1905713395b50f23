# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A planner that is naive: it writes out all instances and tries their sets, cheapest first."""

from __future__ import annotations

import heapq
import itertools
from math import inf
from typing import Iterable, Iterator, Mapping, NamedTuple, Optional, Sequence, Tuple

from dyknow.manager.planning.problem import (
    NO_VERDICTS,
    NO_WISHES,
    Demand,
    Live,
    Plan,
    Verdicts,
    Wishes,
)
from dyknow.manager.specifications.tags import Bindings, Subsumption, Term, parse_tag
from dyknow.model.transformation import Port, Transformation

#: Sets of instances beyond which a problem counts as too large.
_MOST_SETS = 30_000


Nodelet = Tuple[str, Bindings]
"""The label of one that can be connected elsewhere, and the names that it keeps."""


class Problem(NamedTuple):
    """A library, live streams, and a goal.

    Attributes:
        free: the nodelets that can be connected elsewhere.
        paused: labels of which no new nodelet is made.
    """

    library: tuple[Transformation, ...]
    live: tuple[tuple[Live, tuple[Term, ...]], ...]
    exclude: frozenset[str]
    goal: Demand
    ontology: Subsumption
    free: tuple[Nodelet, ...] = ()
    verdicts: Verdicts = NO_VERDICTS
    paused: frozenset[str] = frozenset()
    wishes: Wishes = NO_WISHES


class TooLarge(Exception):
    """A problem has too many sets of instances."""


class Instance(NamedTuple):
    """A transformation under bindings of all its variables."""

    transformation: Transformation
    bindings: Mapping[str, str]


def tags_of(port: Port) -> list[Term]:
    return [parse_tag(text) for text in port.tags]


def tagged(transformation: Transformation, direction: str) -> list[Port]:
    """Return the ports of a direction that have tags."""
    return [port for port in transformation.ports if port.direction == direction and port.tags]


def variables_in(terms: Iterable[Term]) -> list[str]:
    return sorted({arg for term in terms for arg in term.args if arg.startswith("?")})


def fits(
    supplied: Sequence[Term],
    supplied_type: str,
    demanded: Sequence[Term],
    datatype: str,
    bindings: Mapping[str, str],
    ontology: Subsumption,
) -> bool:
    """Whether a stream meets a demand whose variables are bound."""
    if datatype not in ("", "*") and supplied_type not in ("", "*", datatype):
        return False

    def stands(want: str, have: str) -> bool:
        if want.startswith("?"):
            return ontology.canonical(bindings[want]) == ontology.canonical(have)
        return want in ontology.names_above(have)

    return all(
        any(
            want.functor in ontology.names_above(have.functor)
            and len(want.args) == len(have.args)
            and all(map(stands, want.args, have.args))
            for have in supplied
        )
        for want in demanded
    )


def bound(terms: Sequence[Term], bindings: Mapping[str, str]) -> list[Term]:
    return [Term(term.functor, tuple(bindings.get(a, a) for a in term.args)) for term in terms]


def is_typed(terms: Sequence[Term], bindings: Mapping[str, str], ontology: Subsumption) -> bool:
    """Whether every type of a variable subsumes its name."""
    return all(
        not type_ or type_ in ontology.names_above(bindings[arg])
        for term in terms
        for arg, type_ in zip(term.args, term.types)
    )


def individuals(problem: Problem) -> list[str]:
    """Return the names that are supplied, one of each entity."""
    terms = [term for _, tags in problem.live for term in tags]
    for each in problem.library:
        for port in each.ports:
            if port.direction == "out":
                terms += tags_of(port)
    names: dict[str, str] = {}
    for term in terms:
        for arg in term.args:
            if not arg.startswith("?"):
                names.setdefault(problem.ontology.canonical(arg), arg)
    return list(names.values())


def ways(
    terms: Sequence[Term], names: Sequence[str], ontology: Subsumption
) -> Iterator[Mapping[str, str]]:
    """Write out all bindings of the variables of terms to names that are of their types."""
    variables = variables_in(terms)
    for values in itertools.product(names, repeat=len(variables)):
        bindings = dict(zip(variables, values))
        if is_typed(terms, bindings, ontology):
            yield bindings


def instances(problem: Problem) -> Iterator[Instance]:
    names = individuals(problem)
    for each in problem.library:
        if each.label not in problem.exclude:
            terms = [term for port in each.ports for term in tags_of(port)]
            for bindings in ways(terms, names, problem.ontology):
                if is_usable(each, bindings, problem):
                    yield Instance(each, bindings)


def is_usable(
    transformation: Transformation, bindings: Mapping[str, str], problem: Problem
) -> bool:
    """Whether no verdict forbids a transformation under bindings."""
    canonical, (good, bad) = problem.ontology.canonical, problem.verdicts
    for requirement in transformation.requires:
        (term,) = bound([parse_tag(requirement.tag)], bindings)
        tag = Term(term.functor, tuple(map(canonical, term.args)))
        if tag in bad or (not requirement.initially and tag not in good):
            return False
    return True


def cost_of(needed: Sequence[Instance], problem: Problem) -> float:
    """Return the cost of instances if the free nodelets serve as well as they can.

    Instances of which no nodelet may be made cost infinitely much.
    """
    labels = {each.transformation.label for each in needed}
    return sum(
        _cost_of(
            [each for each in needed if each.transformation.label == label],
            [each for each in problem.free if each[0] == label],
            problem,
        )
        for label in labels
    )


def _cost_of(needed: Sequence[Instance], free: Sequence[Nodelet], problem: Problem) -> float:
    """Try everything with the instances of one transformation."""
    if not needed:
        return 0
    each, *rest = needed
    new = inf if each.transformation.label in problem.paused else each.transformation.cost
    best = _cost_of(rest, free, problem) + new
    for at, nodelet in enumerate(free):
        if serves(nodelet, each, problem):
            best = min(best, _cost_of(rest, (*free[:at], *free[at + 1 :]), problem))
    return best


def serves(nodelet: Nodelet, instance: Instance, problem: Problem) -> bool:
    """Whether a free nodelet could be an instance."""
    (label, kept), canonical = nodelet, problem.ontology.canonical
    return label == instance.transformation.label and all(
        canonical(instance.bindings[variable]) == canonical(name) for variable, name in kept
    )


class Suppliers(NamedTuple):
    """The suppliers of a demand.

    Attributes:
        mask: the suppliers as bits; the first one stands for the live streams.
        latencies: of the soonest stream of each supplier, in microseconds.
        fast: those that are fast enough by themselves.
        followers: those that are as fast as their inputs.
    """

    mask: int
    latencies: dict[int, int]
    fast: int
    followers: int

    def is_fast(self, there: int, quick: int) -> bool:
        """Whether there is a fast stream; ``quick`` are those of which all inputs are fast."""
        return bool(there & self.fast or quick & self.followers)


class Instances(NamedTuple):
    """A problem as a graph.

    Attributes:
        goal: the suppliers of the goal.
        needs: the suppliers of the in-ports of each instance.
        all: the instances.
    """

    goal: Suppliers
    needs: list[list[Suppliers]]
    all: list[Instance]

    def latency(self, there: int) -> float:
        """Return when the goal is supplied with some instances, in microseconds."""
        begun = {0: 0.0, **{n: inf for n in range(1, len(self.needs) + 1) if there >> n & 1}}

        def until(demand: Suppliers) -> float:
            return min([begun[n] + at for n, at in demand.latencies.items() if n in begun] + [inf])

        grown = True
        while grown:
            grown = False
            for number in begun.keys() - {0}:
                when = max(map(until, self.needs[number - 1]), default=0.0)
                grown |= when < begun[number]
                begun[number] = min(when, begun[number])
        return until(self.goal)


def least_cost(problem: Problem) -> Optional[int]:
    """Return the cost of the cheapest plan that is in time; None if there is none.

    Raises:
        TooLarge: it was not found among the sets that were tried.
    """
    every = written_out(problem)
    goal, needs, instances = every
    special = {label for label, _ in problem.free} | problem.paused
    groups = [
        (each.transformation.label, *[serves(free, each, problem) for free in problem.free])
        if each.transformation.label in special
        else None
        for each in instances
    ]
    known: dict[tuple[int, ...], float] = {}
    relevant = goal.mask
    grown = True
    while grown:
        grown = False
        for number, demands in enumerate(needs):
            if relevant >> number & 2:
                for demand in demands:
                    grown |= bool(demand.mask & ~relevant)
                    relevant |= demand.mask
    numbers = [number for number in range(len(needs)) if relevant >> number & 2]
    # Instances that need and supply the same are interchangeable: one of them will do.
    alike: dict[tuple[object, ...], int] = {}
    users = [demand for demands in [*needs, [goal]] for demand in demands]
    kept = []
    for number in numbers:
        needed = tuple(
            (tuple(sorted(each.latencies.items())), each.fast, each.followers)
            for each in needs[number]
        )
        made = tuple(
            (each.latencies.get(number + 1), each.fast >> number & 2, each.followers >> number & 2)
            for each in users
        )
        key = instances[number].transformation.cost, needed, made, groups[number]
        if key not in alike:
            alike[key] = number
            kept.append(number)
    max_age, min_rate = problem.goal.max_age, problem.goal.min_rate
    #: Cost, the instances, those all of whose inputs are fast, those that free nodelets may serve
    #: or that may not be made, and the cost of the rest.
    heap: list[tuple[float, int, int, tuple[int, ...], int]] = [(0, 1, 0, (), 0)]
    seen: set[tuple[int, int]] = set()
    while heap:
        cost, there, quick, chosen, paid = heapq.heappop(heap)
        if (there, quick) in seen:
            continue
        seen.add((there, quick))
        if len(seen) > _MOST_SETS:
            raise TooLarge
        is_met = goal.is_fast(there, quick) if min_rate else there & goal.mask
        if is_met and (not max_age or every.latency(there) <= round(max_age * 1e6)):
            return int(cost)
        for number in kept:
            bit = 2 << number
            if not there & bit and all(there & each.mask for each in needs[number]):
                is_quick = min_rate and all(each.is_fast(there, quick) for each in needs[number])
                more, plain = chosen, paid
                if groups[number]:
                    more = tuple(sorted((*chosen, number)))
                else:
                    plain += instances[number].transformation.cost
                if more not in known:
                    known[more] = cost_of([instances[each] for each in more], problem)
                total = plain + known[more]
                if total < inf:
                    quicker = quick | bit if is_quick else quick
                    heapq.heappush(heap, (total, there | bit, quicker, more, plain))
    return None


def least_latency(problem: Problem) -> float:
    """Return the latency of the soonest plan, in s."""
    return written_out(problem).latency(-1) / 1e6


class Supplied(NamedTuple):
    """A stream of an instance, by its number from 1 on, or a live stream, whose number is 0."""

    number: int
    label: str
    tags: Sequence[Term]
    datatype: str
    rate: float
    latency: float


def supplied(problem: Problem) -> list[Supplied]:
    """Write out the live streams and those that all instances would supply if they were made."""
    found = [
        Supplied(0, each.label, tags, each.datatype, each.rate, each.latency)
        for each, tags in problem.live
        if each.label not in problem.exclude
    ]
    for number, (each, bindings) in enumerate(instances(problem), 1):
        for port in tagged(each, "out"):
            tags = bound(tags_of(port), bindings)
            stated = port.datatype, port.rate, port.latency
            found.append(Supplied(number, each.label, tags, *stated))
    return found


def supplies(streams: Iterable[Supplied], demand: Demand, problem: Problem) -> bool:
    """Whether one of some streams meets a demand; a rate that is not stated will do."""
    terms = sorted(demand.tags)
    return any(
        demand.is_fast(each.rate)
        and fits(each.tags, each.datatype, terms, demand.datatype, bindings, problem.ontology)
        for bindings in ways(terms, individuals(problem), problem.ontology)
        for each in streams
    )


def written_out(problem: Problem) -> Instances:
    every = list(instances(problem))
    streams = supplied(problem)
    goal, goal_rate = sorted(problem.goal.tags), problem.goal.min_rate
    needy = [False, *(bool(tagged(each.transformation, "in")) for each in every)]

    def suppliers(
        demanded: Sequence[Term], datatype: str, many: Iterable[Mapping[str, str]]
    ) -> Suppliers:
        found: dict[int, int] = {}
        fast, followers = 0, 0
        for bindings in many:
            for number, _, tags, kind, rate, seconds in streams:
                if fits(tags, kind, demanded, datatype, bindings, problem.ontology):
                    latency = round(seconds * 1e6)
                    found[number] = min(latency, found.get(number, latency))
                    if rate >= goal_rate if rate else not needy[number]:
                        fast |= 1 << number
                    elif not rate:
                        followers |= 1 << number
        return Suppliers(sum(1 << number for number in found), found, fast, followers)

    return Instances(
        suppliers(goal, problem.goal.datatype, ways(goal, individuals(problem), problem.ontology)),
        [
            [suppliers(tags_of(port), port.datatype, [bindings]) for port in tagged(each, "in")]
            for each, bindings in every
        ],
        every,
    )


def assert_valid(plan: Plan, problem: Problem) -> None:
    """Live streams and earlier steps supply all that each step demands under its bindings."""
    ontology = problem.ontology
    library = {each.label: each for each in problem.library}
    live = dict(problem.live)
    made = {}

    def check(source, demanded, datatype, bindings) -> None:  # type: ignore[no-untyped-def]
        assert source.label not in problem.exclude
        if isinstance(source, Live):
            tags, kind = list(live[source]), source.datatype
        else:
            step = made[source.instance]
            ports = {port.name: port for port in library[step.instance.label].ports}
            tags = bound(tags_of(ports[source.port]), dict(step.instance.bindings))
            kind = ports[source.port].datatype
        assert fits(tags, kind, demanded, datatype, bindings, ontology)
        if bindings:
            supplied = {arg for term in tags for arg in term.args}
            wanted = {arg for term in demanded for arg in term.args if arg in bindings}
            canonical = {ontology.canonical(arg) for arg in supplied}
            assert {ontology.canonical(bindings[arg]) for arg in wanted} <= canonical

    for step in plan.steps:
        transformation = library[step.instance.label]
        bindings = dict(step.instance.bindings)
        terms = [term for port in transformation.ports for term in tags_of(port)]
        has_inputs = any(port.direction == "in" for port in transformation.ports)
        assert sorted(bindings) == variables_in(terms) or not has_inputs
        assert is_typed(terms, bindings, ontology)
        ports = tagged(transformation, "in")
        assert [name for name, _ in step.inputs] == [port.name for port in ports]
        for port, (_, source) in zip(ports, step.inputs):
            check(source, tags_of(port), port.datatype, bindings)
        assert step.instance not in made
        made[step.instance] = step
    goal = sorted(problem.goal.tags)
    assert is_typed(goal, dict(plan.bindings), ontology)
    check(plan.goal, goal, problem.goal.datatype, dict(plan.bindings))
    steps = [
        Instance(library[step.instance.label], dict(step.instance.bindings)) for step in plan.steps
    ]
    charges = [step.charge for step in plan.steps] + [charge for _, charge in plan.charges]
    assert plan.cost == cost_of(steps, problem) + sum(charges)
