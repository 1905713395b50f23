# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Writes what a search found as a plan, or as what is missing for one."""

from __future__ import annotations

from typing import Dict, Iterable, List, Sequence, Set

from dyknow.manager.planning.improvement import Improved
from dyknow.manager.planning.instances import LIVE, Instances
from dyknow.manager.planning.knuth import Values
from dyknow.manager.planning.network import LiveStreams
from dyknow.manager.planning.patterns import Theta
from dyknow.manager.planning.problem import Live, New, NoPlan, Plan, PlanStep, Source
from dyknow.manager.planning.supply import Demand
from dyknow.manager.specifications.tags import Bindings, Term, unify_all

#: Combinations of one action that found no further in-port and are told.
_MOST_TOLD = 10


class _Writer:
    """Writes the steps of one plan, suppliers first."""

    def __init__(self, instances: Instances, streams: LiveStreams, improved: Improved) -> None:
        self._instances = instances
        self._network = instances.network
        self._streams = streams
        self._chosen = improved.draft.chosen
        self._bindings: Dict[int, Bindings] = {}

    def source(self, node: int) -> Source:
        """Return what supplies a node."""
        chosen = self._chosen[node]
        if chosen == LIVE:
            return self._instances.streams[node]
        label = self._instances.labels[chosen]
        demand, theta = self._instances.demand(node)
        network = self._network
        offers = network.suppliers(demand)
        if chosen in offers and not theta:
            return New(label, offers[chosen][0].head.port, self._bindings.get(chosen, ()))
        rule, bound = self._instances.rule(chosen)
        pattern = network.patterns[demand]
        port = min(
            each.head.port
            for other, found in offers.items()
            if network.base(other) == rule
            for each in found
            if theta in each.of(pattern, bound, network.names)
        )
        return New(label, port, self._bindings.get(chosen, ()))

    def step(self, number: int, is_free: bool) -> PlanStep:
        """Return the step of an action."""
        network = self._network
        rule, theta = self._instances.rule(number)
        action = network.actions[rule]
        if is_free:
            action = action._replace(cost=0)
        if rule not in network.rules:
            sources = [self.source(node) for node in network.inputs[rule]]
            return PlanStep(action, tuple(zip(network.ports[rule], sources)))
        return self._bound_step(number, PlanStep(action, ()), rule, theta)

    def _bound_step(self, number: int, step: PlanStep, rule: int, theta: Theta) -> PlanStep:
        network = self._network
        known = network.rules[rule]
        joined = dict(zip(known.variables, theta))
        bindings: Dict[str, str] = {}
        inputs = []
        nodes = self._instances.inputs.get(number, network.inputs[rule])
        for port, node in zip(known.in_ports, nodes):
            source = self.source(node)
            inputs.append((port.name, source))
            for variable, name in self._way(source, port.terms, joined).items():
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
        terms = self._network.terms(self._network.action(source.label), source.port)
        bindings = dict(source.bindings)
        return [term.substitute(bindings) for term in terms]


def plan_of(
    instances: Instances, streams: LiveStreams, demand: Demand, improved: Improved
) -> Plan:
    """Write a plan."""
    writer = _Writer(instances, streams, improved)
    costs = instances.costs
    steps: List[PlanStep] = []
    freed: Set[str] = set()
    total = 0
    for number in improved.draft.actions:
        label = instances.labels[number]
        # One nodelet is there: a second one of the label has to be made.
        is_free = not costs[number] and label not in freed and instances.is_free(label)
        if is_free:
            freed.add(label)
        step = writer.step(number, is_free)
        total += step.action.cost
        steps.append(step)
    goal = writer.source(instances.reach.goal)
    return Plan(
        demand,
        goal,
        tuple(steps),
        total,
        improved.least_cost,
        writer.goal_bindings(goal, demand),
        improved.is_cut_short,
    )


def no_plan(instances: Instances, trees: Values) -> NoPlan:
    """Tell why there is none."""
    network, reach = instances.network, instances.reach
    offers: Dict[int, List[int]] = {demand: [] for demand in reach.consumers}
    for action, demands in reach.served.items():
        for demand in demands:
            offers[demand].append(action)
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
    missing.update(network.demand(demand) for demand in unmet if not offers[demand])
    goal = network.demand(reach.goal)
    return NoPlan(goal, tuple(sorted(missing, key=str)), not missing)


def _unmatched(instances: Instances, trees: Values, action: int) -> List[Demand]:
    """Return what the in-ports of an action lack that are met, but not under equal bindings."""
    join = trees.joins.get(action)
    if join is None:
        return []
    rule = instances.network.rules[action]
    found: Dict[Demand, None] = {}
    for step, theta in join.unmatched():
        port = rule.in_ports[join.steps[step].port]
        known = dict(zip(rule.variables, map(instances.network.names.written, theta)))
        terms = frozenset(term.substitute(known) for term in port.terms)
        found[Demand(terms, port.datatype)] = None
    return list(found)[:_MOST_TOLD]
