# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Writes what a search found as a plan, or as what is missing for one."""

from __future__ import annotations

from itertools import chain
from typing import Dict, Iterable, List, Sequence, Set

from dyknow.manager.planning.improvement import Improved
from dyknow.manager.planning.instances import FIRST, LIVE, Instances
from dyknow.manager.planning.latency import latency_of
from dyknow.manager.planning.live_streams import LiveStreams
from dyknow.manager.planning.problem import Action, Live, NoPlan, Plan, PlanStep, Source
from dyknow.manager.planning.supply import Demand
from dyknow.manager.planning.values import Values
from dyknow.manager.specifications.tags import Bindings, Term, unify_all

#: Combinations of one action that found no further in-port and are told.
_MOST_TOLD = 10


class _Writer:
    """Writes the steps of one plan, suppliers first."""

    def __init__(self, streams: LiveStreams, improved: Improved) -> None:
        instances = self._instances = improved.draft.instances
        self._network = instances.network
        self._streams = streams
        self._chosen = improved.draft.chosen
        self._bindings: Dict[int, Bindings] = {}
        # Those of actions without variables at once, for plans of many thousand steps.
        found, chosen, rules = self._network.found, self._chosen, self._network.rules
        plain = [each for each in improved.draft.actions if each < FIRST]
        needed = set(chain.from_iterable(map(self._network.needs.__getitem__, plain)))
        self._sources: Dict[int, Source] = {
            node: found[node][action][0].head.source
            for node in (needed if not self._network.latencies else ())
            for action in (chosen[node],)
            if LIVE < action < FIRST and action not in rules
        }

    def source(self, node: int) -> Source:
        """Return what supplies a node."""
        chosen = self._chosen[node]
        if chosen == LIVE:
            return self._instances.streams[node]
        source = self._instances.source(chosen, node)
        bindings = self._bindings.get(chosen)
        return source if bindings is None else source._replace(bindings=bindings)

    def steps(self, numbers: Sequence[int], actions: Iterable[Action]) -> List[PlanStep]:
        """Return the steps of actions, suppliers first."""
        network, sources = self._network, self._sources
        needed, ports, rules = network.inputs, network.ports, network.rules
        found = []
        for number, action in zip(numbers, actions):
            if number >= FIRST or number in rules:
                found.append(self._bound_step(number, PlanStep(action, ())))
                continue
            inputs = [sources.get(node) or self.source(node) for node in needed[number]]
            found.append(PlanStep(action, tuple(zip(ports[number], inputs))))
        return found

    def _bound_step(self, number: int, step: PlanStep) -> PlanStep:
        network = self._network
        rule, theta = self._instances.rule(number)
        known = network.rules[rule]
        joined = dict(zip(known.variables, theta))
        bindings: Dict[str, str] = {}
        inputs = []
        nodes = self._instances.inputs.get(number, network.inputs[rule])
        for premise, node in zip(known.premises, nodes):
            source = self.source(node)
            inputs.append((premise.port, source))
            for variable, name in self._way(source, premise.terms, joined).items():
                bindings.setdefault(variable, name)
        self._bindings[number] = tuple(sorted(bindings.items()))
        return step._replace(inputs=tuple(inputs), bindings=self._bindings[number])

    def goal_bindings(self, source: Source, demand: Demand) -> Bindings:
        """Return what the variables of the request stand for."""
        if not any(term.variables for term in demand.tags):
            return ()
        return tuple(sorted(self._way(source, sorted(demand.tags), {}).items()))

    def _way(
        self, source: Source, demanded: Iterable[Term], joined: Dict[str, str]
    ) -> Dict[str, str]:
        """Bind the variables of a demand to names as they are supplied."""
        names = self._network.names
        for way in unify_all(self._tags(source), demanded, names.ontology):
            if all(
                names.canonical(name) == joined.get(variable, names.canonical(name))
                for variable, name in way.items()
            ):
                return way
        raise AssertionError(f"{source} does not supply {demanded}")

    def _tags(self, source: Source) -> Sequence[Term]:
        if isinstance(source, Live):
            return self._streams.terms[source]
        terms = self._network.terms(source.label, source.port)
        bindings = dict(source.bindings)
        return [term.substitute(bindings) for term in terms]


def plan_of(streams: LiveStreams, demand: Demand, improved: Improved) -> Plan:
    """Write a plan."""
    writer, instances = _Writer(streams, improved), improved.draft.instances
    costs, labels = instances.costs, instances.network.labels
    stated = instances.network.costs
    actions: List[Action] = []
    freed: Set[str] = set()
    for number in improved.draft.actions:
        if number < FIRST and costs.are_plain:
            actions.append(Action(labels[number], stated[number]))
            continue
        rule = instances.rule(number)[0]
        charge = costs.charge(rule)
        cost = instances.cost(number) - charge
        label = labels[rule]
        if not cost and costs.is_free(label):
            if label in freed:  # one nodelet is there: a second one has to be made
                cost = stated[rule]
            freed.add(label)
        actions.append(Action(label, cost, charge))
    steps = writer.steps(improved.draft.actions, actions)
    total = sum([action.cost + action.charge for action in actions])
    goal = writer.source(instances.reach.goal)
    latencies = instances.network.latencies
    is_stated = bool(latencies) or any(stream.latency for stream in streams.terms)
    return Plan(
        demand,
        goal,
        tuple(steps),
        total,
        improved.least_cost,
        writer.goal_bindings(goal, demand),
        improved.is_cut_short,
        latency=latency_of(goal, steps, latencies) if is_stated else 0.0,
    )


def no_plan(instances: Instances, trees: Values, goal: Demand) -> NoPlan:
    """Tell why there is none."""
    network, reach = instances.network, instances.reach
    offers = {
        demand: [
            action
            for supplier in network.suppliers(demand)
            for action in network.specialised(demand, supplier)
            if action in reach.serves
        ]
        for demand in reach.above
    }
    met = {instances.demand(node)[0] for node in trees.value}
    unmet = {reach.goal}  # and what is reached from it through unmet demands only
    waiting = [reach.goal]
    missing: Set[Demand] = set()
    while waiting:
        for action in offers[waiting.pop()]:
            if all(need in met for need in network.needs[action]):
                missing.update(_unmatched(instances, trees, action))
            for need in network.needs[action]:
                if need not in met and need not in unmet:
                    unmet.add(need)
                    waiting.append(need)
    for demand in unmet:
        if not offers[demand]:
            missing.add(goal if demand == reach.goal else network.demand(demand))
    return NoPlan(goal, tuple(sorted(missing, key=str)), not missing)


def _unmatched(instances: Instances, trees: Values, action: int) -> List[Demand]:
    """Return what the in-ports of an action lack that are met, but not under equal bindings."""
    join = trees.joins.get(action)
    if join is None:
        return []
    rule = instances.network.rules[action]
    found: Dict[Demand, None] = {}
    for step, theta in join.unmatched():
        premise = rule.premises[join.steps[step].port]
        known = dict(zip(rule.variables, map(instances.network.names.written, theta)))
        terms = frozenset(term.substitute(known) for term in premise.terms)
        found[Demand(terms, premise.datatype)] = None
    return list(found)[:_MOST_TOLD]
