# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Costs: wishes, cheaper plans, and the nodelets that a plan uses again."""

from __future__ import annotations

import contextlib
import random
from pathlib import Path
from typing import List

import pytest
from unit.manager.field import LIBRARY, POINT, Field, specification, transformation

from dyknow.errors import BadParameter, NoPlanFound
from dyknow.manager.claims.claim_planner import OwnNodelet, assigned
from dyknow.manager.planning.problem import Action, Demand, Instance, New, Plan, PlanStep
from dyknow.manager.specifications.tags import NO_ONTOLOGY, Bindings, parse_tag
from dyknow.model.streams import ClaimState

# A plan is cheaper only if all claims together cost less


@pytest.fixture
def field() -> Field:
    field = Field()
    field.host.sources["soccer/Alone"] = [("ball", "out", POINT)]
    return field


def total(field: Field) -> int:
    return sum(
        record.transformation.cost
        for record in field.manager.graph.all()
        if record.claimed and record.transformation is not None
    )


def news(field: Field) -> List[str]:
    return [reason for reason in field.reasons() if "cheaper" in reason]


ALONE = transformation("alone", "soccer/Alone", "out ball", "ball RelativePosition(ball)", 2)


def test_what_others_need_anyway_is_not_saved(field: Field) -> None:
    """A detector of cost 2 is cheaper than three parts, but two of them stay for the other."""
    whole = field.acquire("RelativePosition(ball)").claim
    planes = field.acquire("Planes(field)").claim
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert news(field) == []
    before = total(field)
    field.reconciler.replan(whole.claim_id)
    field.tidy()
    assert total(field) == before
    field.reconciler.release(planes.claim_id)
    field.manager.add_transformation(LIBRARY)  # something new: they are compared again
    field.settle(10.0)
    assert len(news(field)) == 1
    assert field.reconciler.replan(whole.claim_id).cost == 2
    field.tidy()
    assert total(field) == 2 < before


def test_what_all_clients_of_a_stream_share_is_saved(field: Field) -> None:
    claims = [field.acquire("RelativePosition(ball)").claim for _ in range(2)]
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert len(news(field)) == 2, "each of them is told"
    field.reconciler.replan(claims[0].claim_id)
    field.tidy()
    assert total(field) == 2
    assert {field.claim(each.claim_id).topic for each in claims} == {claims[0].topic}
    assert claims[0].topic in field.moving


def test_what_is_protected_is_not_saved(field: Field) -> None:
    field.acquire("RelativePosition(ball)")
    for name in ("/bottom_camera_1", "/subsampler_1"):
        field.manager.set_protection(name, True)
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert news(field) == []


@pytest.mark.parametrize("seed", range(12))
def test_an_offer_that_is_taken_never_raises_the_total(seed: int) -> None:
    choice = random.Random(seed)
    tags = [f"Tag{number}(x)" for number in range(6)]
    field = Field(":memory:", {"dyknow/Relay": [("in", "in", "*"), ("out", "out", "*")]}, "")

    def add(number: int) -> None:
        ports = {
            f"in{each}": ("in", [choice.choice(tags[:3])])
            for each in range(choice.choice([0, 0, 1, 2]))
        }
        ports["out"] = ("out", [choice.choice(tags)])
        source, cost = f"test/T{number}", choice.randrange(6)
        field.host.sources[source] = [(name, way, POINT) for name, (way, _) in ports.items()]
        text = specification(f"part {number}", source, ports, cost, POINT)
        field.manager.add_transformation(text)

    for number in range(6):
        add(number)
    for _ in range(5):
        with contextlib.suppress(NoPlanFound):
            field.acquire(choice.choice(tags))
    for number in range(6, 12):
        add(number)
        field.tidy()
        offered = [event.after.claim_id for event in field.events if "cheaper" in event.reason]
        field.events.clear()
        for claim_id in offered[:1]:
            before = total(field)
            field.reconciler.replan(claim_id)
            field.tidy()
            assert total(field) <= before


def test_a_way_that_comes_and_goes_is_not_reported(field: Field) -> None:
    claim = field.acquire("RelativePosition(ball)").claim
    for _ in range(12):
        field.manager.add_transformation(ALONE)
        field.settle(1.5)
        field.manager.remove_transformation("alone")
        field.settle(1.5)
    assert news(field) == []
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert len(news(field)) == 1
    field.manager.remove_transformation("alone")
    field.settle(1.5)
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert len(news(field)) == 1, "it is reported once"
    assert field.reconciler.replan(claim.claim_id).cost == 2
    field.settle()
    field.manager.remove_transformation("alone")
    field.settle(10.0)
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert len(news(field)) == 2, "after a repair it is news again"


# Claims that prefer or avoid something


def test_what_is_avoided_is_used_when_there_is_nothing_else(field: Field) -> None:
    claim = field.acquire(avoid=("bottom camera",)).claim
    assert "/ceiling_camera_1" in claim.nodelets
    field.manager.remove_transformation("ceiling camera")
    field.settle(5.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert "/bottom_camera_1" in field.claim(claim.claim_id).nodelets


def test_what_runs_for_others_does_not_stand_in_for_what_is_preferred(field: Field) -> None:
    other = field.acquire().claim
    assert "/bottom_camera_1" in other.nodelets
    claim = field.acquire(prefer=("ceiling camera",)).claim
    assert "/ceiling_camera_1" in claim.nodelets
    assert claim.topic != other.topic
    field.settle(5.0)
    assert field.claim(other.claim_id).wiring == other.wiring, "it is left alone"
    assert "/ceiling_camera_1" in field.claim(claim.claim_id).nodelets


def test_a_stream_of_what_is_avoided_is_dearer_than_another(field: Field) -> None:
    field.manager.remove_transformation("ceiling camera")
    claim = field.acquire(avoid=("bottom camera",)).claim
    field.manager.add_transformation(
        "<transformation cost='9'><label>spare camera</label><source>soccer/Camera</source>"
        "<ports><port type='out'>image</port></ports>"
        "<tags><tag port='image'>YUV(field)</tag></tags></transformation>"
    )
    field.settle(5.0)
    assert any("a cheaper way has appeared" in each for each in field.reasons())
    field.reconciler.replan(claim.claim_id)
    assert "/spare_camera_1" in field.claim(claim.claim_id).nodelets
    begin = len(field.events)
    field.settle(20.0)
    assert not [each for each in field.events[begin:] if "cheaper" in each.reason]


def test_what_is_both_preferred_and_avoided_is_refused(field: Field) -> None:
    with pytest.raises(BadParameter, match="'avoid' is 'x': expected a name that is not in pref"):
        field.acquire(prefer=("x", "y"), avoid=("x",))


def test_wishes_are_kept_over_a_restart(tmp_path: Path) -> None:
    field = Field(str(tmp_path / "state.db"))
    claim = field.acquire(prefer=("ceiling camera",), avoid=("x",)).claim
    field.kill_manager()
    assert field.claim(claim.claim_id).request == claim.request


# Which nodelet is used for which step of a plan


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
