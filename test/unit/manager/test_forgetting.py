# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Old requests, and nodelets that are gone, are forgotten."""

from __future__ import annotations

from typing import Iterator

import pytest
from unit.manager.field import LIBRARY, Field

from dyknow.errors import NoPlanFound
from dyknow.manager.claims import claim_planner
from dyknow.model.streams import StreamRequest


@pytest.fixture
def field(monkeypatch: pytest.MonkeyPatch) -> Iterator[Field]:
    monkeypatch.setattr(claim_planner, "_WASTE", 20)
    yield Field()


def numbers(field: Field) -> int:
    library = field.reconciler._planner._planner._planner._writer.library
    return len(library.labels) + len(library.patterns)


def test_tags_that_were_asked_for_once(field: Field) -> None:
    for number in range(100):
        with pytest.raises(NoPlanFound):
            field.reconciler.acquire(StreamRequest(f"Nothing({number})"), dry_run=True)
        assert numbers(field) < 60
    field.acquire()
    field.settle()


def test_labels_that_were_replaced(field: Field) -> None:
    for cost in range(30):
        field.manager.add_transformation(LIBRARY.replace('cost="5"', f'cost="{cost}"'))
        field.manager.add_transformation(LIBRARY.replace("YUV(field)", f"YUV(field{cost})"))
        with pytest.raises(NoPlanFound):
            field.reconciler.acquire(StreamRequest("Nothing(x)"), dry_run=True)
        assert numbers(field) < 60
    field.manager.add_transformation(LIBRARY)
    field.acquire()
    field.settle()


def test_the_same_library_again_is_nothing_new(field: Field) -> None:
    field.acquire()
    field.manager.add_transformation(LIBRARY)
    field.settle(2.0)
    before = numbers(field)
    for _ in range(10):
        field.manager.add_transformation(LIBRARY)
        field.settle(0.2)
    assert numbers(field) == before


def test_claims_that_could_not_be_made_and_ended(field: Field) -> None:
    for number in range(20):
        with pytest.raises(NoPlanFound) as raised:
            field.acquire(f"Nothing({number})")
        field.tick()
        field.reconciler.release(raised.value.claim_id)
        field.tick()
    assert field.reconciler._repair._unplannable == {}
