# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims that prefer or avoid something."""

from __future__ import annotations

from pathlib import Path

import pytest
from unit.manager.field import Field

from dyknow.errors import BadParameter
from dyknow.model.streams import ClaimState


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


def test_clients_with_equal_wishes_share_a_topic(field: Field) -> None:
    topics = [field.acquire(avoid=("bottom camera",)).claim.topic for _ in range(2)]
    assert topics[0] == topics[1]


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
