# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A plan is cheaper only if all claims together cost less."""

from __future__ import annotations

import contextlib
import random
from typing import List

import pytest
from unit.manager.field import LIBRARY, POINT, Field, specification, transformation

from dyknow.errors import NoPlanFound


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
