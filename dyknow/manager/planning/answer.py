# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Writes what a search found as a plan."""

from __future__ import annotations

from typing import Dict, Iterable, List, Set, Tuple

from dyknow.manager.planning.and_or_graph import Draft
from dyknow.manager.planning.improvement import Improved
from dyknow.manager.planning.library import Head
from dyknow.manager.planning.problem import Action, Charge, Live, Plan, PlanStep, Source
from dyknow.manager.planning.request import Need, Request, base
from dyknow.manager.planning.search import Instance
from dyknow.manager.specifications.tags import Bindings, Term, read_tags, unify_all

_Nodelet = Tuple[int, Tuple[str, ...]]
"""An action and the names of its variables."""


class _Writer:
    """Writes the steps of one plan, suppliers first."""

    def __init__(self, request: Request, draft: Draft) -> None:
        self._request = request
        self._chosen = draft.chosen
        self._bindings: Dict[_Nodelet, Bindings] = {}
        #: When nodelets have their inputs, in microseconds.
        self._begun: Dict[_Nodelet, int] = {}

    def source(self, node: Need) -> Tuple[Source, Tuple[str, ...], int]:
        """Return what supplies a node, its tags, and its latency in microseconds."""
        chosen = self._chosen[node]
        key = base(chosen.action), chosen.theta
        head: Head = self._request.source(chosen.action, chosen.theta, node)
        source = head.source
        latency = self._begun.get(key, 0) + head.latency
        bindings = self._bindings.get(key)
        if not bindings or isinstance(source, Live):
            return source, head.texts, latency
        return source._replace(bindings=bindings), head.texts, latency

    def step(self, instance: Instance, action: Action) -> PlanStep:
        """Return the step of an instance."""
        library = self._request.library
        number = base(instance.action)
        key = number, instance.theta
        rule = library.rules.get(number)
        sources = [self.source(node) for node in instance.needs]
        self._begun[key] = max([latency for _, _, latency in sources], default=0)
        inputs = tuple([(port, each[0]) for port, each in zip(library.ports[number], sources)])
        if rule is None:
            return PlanStep(action, inputs)
        joined = dict(zip(rule.variables, instance.theta))
        bindings: Dict[str, str] = {}
        for premise, (source, texts, _) in zip(rule.premises, sources):
            for variable, name in self._way(source, texts, premise.terms, joined).items():
                bindings.setdefault(variable, name)
        self._bindings[key] = tuple(sorted(bindings.items()))
        return PlanStep(action, inputs, self._bindings[key])

    def goal(self) -> Tuple[Source, Bindings, int]:
        """Return what supplies the goal, what its variables stand for, and when."""
        demand = self._request.demand
        source, texts, latency = self.source(Need(self._request.goal, ()))
        if not any(term.variables for term in demand.tags):
            return source, (), latency
        way = self._way(source, texts, sorted(demand.tags), {})
        return source, tuple(sorted(way.items())), latency

    def _way(
        self,
        source: Source,
        texts: Tuple[str, ...],
        demanded: Iterable[Term],
        joined: Dict[str, str],
    ) -> Dict[str, str]:
        """Bind the variables of a demand to names as they are supplied."""
        names = self._request.names
        terms = read_tags(texts)
        if not isinstance(source, Live):
            bindings = dict(source.bindings)
            terms = tuple([term.substitute(bindings) for term in terms])
        for way in unify_all(terms, demanded, names.ontology):
            if all(
                names.canonical(name) == joined.get(variable, names.canonical(name))
                for variable, name in way.items()
            ):
                return way
        raise AssertionError(f"{source} does not supply {demanded}")


def plan_of(request: Request, improved: Improved) -> Plan:
    """Write a plan."""
    draft = improved.draft
    writer = _Writer(request, draft)
    steps: List[PlanStep] = []
    charges: Dict[str, int] = {}
    freed: Set[int] = set()
    for instance in draft.order:
        number = base(instance.action)
        if number in request.charged:
            name, charge = request.charged[number]
            if charge:
                charges[name] = charge
            continue
        charge = request.charges.get(number, 0)
        cost = request.library.costs[number]
        if number not in freed and request.is_free(number, instance.theta):
            freed.add(number)  # one nodelet is there: a second one has to be made
            cost = 0
        steps.append(writer.step(instance, Action(request.label(number), cost, charge)))
    goal, bindings, latency = writer.goal()
    plan = Plan(
        request.demand,
        goal,
        tuple(steps),
        0,
        improved.least_cost,
        bindings,
        improved.is_cut_short,
        tuple([Charge(*each) for each in sorted(charges.items())]),
        latency / 1e6,
    )
    return plan._replace(cost=plan.total)
