# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Old requests, and nodelets that are gone, are forgotten."""

from __future__ import annotations

import gc
from typing import List

import pytest
from unit.manager.field import LIBRARY, Field

from dyknow.errors import NoPlanFound
from dyknow.model.streams import StreamRequest


def kept() -> int:
    """Objects that the planner keeps: values of its modules, whatever refers to them."""
    gc.collect()
    modules = (str(type(each).__module__) for each in gc.get_objects())
    return sum(module.startswith("dyknow.manager.planning") for module in modules)


def test_tags_that_were_asked_for_once(field: Field) -> None:
    after: List[int] = []
    for number in range(100):
        with pytest.raises(NoPlanFound):
            field.reconciler.acquire(StreamRequest(f"Nothing({number})"), dry_run=True)
        if number in (20, 99):
            after.append(kept())
    assert after[1] == after[0]
    field.acquire()
    field.settle()


def test_labels_that_were_replaced(field: Field) -> None:
    after: List[int] = []
    for cost in range(30):
        field.manager.add_transformation(LIBRARY.replace('cost="5"', f'cost="{cost}"'))
        field.manager.add_transformation(LIBRARY.replace("YUV(field)", f"YUV(field{cost})"))
        with pytest.raises(NoPlanFound):
            field.reconciler.acquire(StreamRequest("Nothing(x)"), dry_run=True)
        if cost in (9, 29):
            after.append(kept())
    assert after[1] <= after[0] + 20
    field.manager.add_transformation(LIBRARY)
    field.acquire()
    field.settle()


def test_the_same_library_again_is_nothing_new(field: Field) -> None:
    field.acquire()
    field.manager.add_transformation(LIBRARY)
    field.settle(2.0)
    before = kept()
    for _ in range(10):
        field.manager.add_transformation(LIBRARY)
        field.settle(0.2)
    assert kept() == before


def test_claims_that_could_not_be_made_and_ended(field: Field) -> None:
    for number in range(20):
        with pytest.raises(NoPlanFound) as raised:
            field.acquire(f"Nothing({number})")
        field.tick()
        field.reconciler.release(raised.value.claim_id)
        field.tick()
    assert field.reconciler._repair._unplannable == {}
