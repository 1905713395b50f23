# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which nodelet is used for which step of a plan."""

from __future__ import annotations

from dyknow.manager.claims.claim_planner import OwnNodelet, assigned
from dyknow.manager.planning.problem import Action, Demand, Instance, New, Plan, PlanStep
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Bindings, parse_tag

LEFT: Bindings = (("?c", "left"),)
RIGHT: Bindings = (("?c", "right"),)


def plan(*instances: Instance) -> Plan:
    steps = [PlanStep(Action(label, 1), (), bindings) for label, bindings in instances]
    label, bindings = instances[-1]
    demand = Demand(frozenset((parse_tag("Ball(?c)"),)))
    return Plan(demand, New(label, "out", bindings), tuple(steps), len(steps))


def test_each_nodelet_is_used_once_and_the_preferred_one_first() -> None:
    own = [OwnNodelet("/b", "t"), OwnNodelet("/a", "t"), OwnNodelet("/u", "u")]
    assert assigned(plan(("t", LEFT)), own, NO_ONTOLOGY) == {("t", LEFT): "/b"}
    both = plan(("t", LEFT), ("t", RIGHT), ("v", ()))
    assert assigned(both, own, NO_ONTOLOGY) == {("t", LEFT): "/b", ("t", RIGHT): "/a"}


def test_what_is_kept_has_to_be_what_the_plan_needs() -> None:
    own = [OwnNodelet("/r", "t", RIGHT, RIGHT), OwnNodelet("/l", "t", LEFT, LEFT)]
    assert assigned(plan(("t", LEFT)), own, NO_ONTOLOGY) == {("t", LEFT): "/l"}
    assert assigned(plan(("t", (("?c", "up"),))), own, NO_ONTOLOGY) == {}


def test_a_nodelet_that_need_not_change_is_not_taken_for_another_step() -> None:
    own = [OwnNodelet("/r", "t", (), RIGHT), OwnNodelet("/new", "t")]
    found = assigned(plan(("t", LEFT), ("t", RIGHT)), own, NO_ONTOLOGY)
    assert found == {("t", RIGHT): "/r", ("t", LEFT): "/new"}


def test_names_of_one_individual_are_the_same() -> None:
    class Names:
        def names_above(self, name: str) -> frozenset[str]:
            return frozenset((name, self.canonical(name)))

        def canonical(self, name: str) -> str:
            return name.split("/")[-1]

    own = [OwnNodelet("/l", "t", (("?c", "urn:x/left"),))]
    assert assigned(plan(("t", LEFT)), own, Names()) == {("t", LEFT): "/l"}
