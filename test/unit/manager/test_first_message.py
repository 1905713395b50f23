# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""An active claim says when no message has come since its stream was changed last."""

from __future__ import annotations

from pathlib import Path

import pytest
from unit.manager.field import FIRST_MESSAGE, POINT, Field

from dyknow.model.streams import NO_MESSAGE, ClaimState

REFEREE = (
    '<transformation type="topic"><label>referee</label><source>/referee/ball</source>'
    f'<ports><port type="out" datatype="{POINT}">position</port></ports>'
    '<tags><tag port="position">FieldPosition(ball)</tag></tags></transformation>'
)
UNKNOWN = "not known whether messages come: the publisher of {} cannot be asked"


@pytest.fixture
def field() -> Field:
    return Field()


def details(field: Field) -> list[str]:
    assert all(claim.state is ClaimState.ACTIVE for claim in field.living())
    return [claim.detail for claim in field.living()]


def test_a_new_stream_says_so_until_the_first_message(field: Field) -> None:
    field.host.silent.add("/localization_1")
    assert field.acquire().claim.detail == NO_MESSAGE
    field.settle(20.0)
    assert details(field) == [NO_MESSAGE]
    assert field.reasons() == ["requested"]
    field.host.silent.clear()
    field.settle(2.0)
    assert details(field) == [""]
    assert field.reasons() == ["requested", FIRST_MESSAGE]
    assert (field.events[-1].before.detail, field.events[-1].after.detail) == (NO_MESSAGE, "")


def test_nobody_listens_or_counts_any_longer_than_need_be(field: Field) -> None:
    field.acquire()
    field.settle(2.0)
    assert details(field) == [""]
    field.host.calls.clear()
    field.settle(10.0)
    assert not [call for call in field.host.calls if call[0] == "counts"]


def test_what_is_mended_says_so_again(field: Field) -> None:
    field.acquire()
    field.settle(2.0)
    field.host.silent.add("soccer/Localization")
    field.host.vanish("/localization_1")
    field.settle(5.0)
    assert details(field) == [NO_MESSAGE]
    field.host.silent.clear()
    field.settle(2.0)
    assert field.reasons()[-1] == FIRST_MESSAGE
    assert sum(reason == FIRST_MESSAGE for reason in field.reasons()) == 2


def test_what_came_before_the_change_does_not_count(field: Field) -> None:
    field.acquire()
    field.settle(2.0)
    field.host.silent.add("/localization_1")
    assert field.acquire(request_id="another", client_id="me").claim.detail == NO_MESSAGE
    field.settle(5.0)
    assert sorted(details(field)) == ["", NO_MESSAGE]
    field.host.silent.clear()
    field.settle(2.0)
    assert details(field) == ["", ""]


def test_a_replanned_stream_says_so(field: Field) -> None:
    claim = field.acquire().claim
    field.settle(2.0)
    again = field.reconciler.replan(claim.claim_id)
    assert again.claim.detail == NO_MESSAGE
    field.settle(2.0)
    assert details(field) == [""]


def test_what_can_be_used_again_says_so(field: Field) -> None:
    field.spawn("localization", "/mine", isolated=True, config={"position": "/mine/position"})
    field.manager.remove_transformation("localization")
    planes = field.acquire("RelativePosition(ball)").claim
    field.manager.host.connect("/mine", {"ball": planes.topic})
    field.manager.look({"/mine"})
    field.acquire()
    field.settle(2.0)
    assert details(field) == ["", ""]
    manager = field.manager.graph.get("/mine").manager
    field.host.hang(manager)
    field.settle(5.0)
    field.host.silent.add("/mine")
    field.host.wake(manager)
    field.settle(5.0)
    assert field.reasons()[-1] == "it can be made now"
    assert sorted(details(field)) == ["", NO_MESSAGE]


def test_who_is_patient_does_not_make_others_wait(field: Field) -> None:
    field.acquire(max_silence=100.0)
    field.settle(2.0)
    field.acquire("RelativePosition(ball)")
    field.settle(2.0)
    assert details(field) == ["", ""]


def test_nothing_is_counted_where_nothing_is(field: Field) -> None:
    field.host.silent.add("/localization_1")
    field.acquire()
    field.host.vanish("/localization_1")
    field.manager.remove_transformation("localization")
    field.settle(2.0)
    assert field.living()[0].state is ClaimState.PENDING
    assert not [call for call in field.host.calls if call[0] == "listen"]


def test_a_latched_message_counts(field: Field) -> None:
    field.host.silent.add("/localization_1")
    field.acquire()
    field.settle(2.0)
    assert details(field) == [NO_MESSAGE]
    field.host.nodelet("/localization_1").latched.add("position")
    field.settle(2.0)
    assert details(field) == [""]


def test_nobody_listens_to_an_ordinary_topic_merely_to_find_out(field: Field) -> None:
    field.manager.add_transformation(REFEREE)
    field.host.topics.add("/referee/ball")
    field.acquire()
    field.settle(5.0)
    assert details(field) == [UNKNOWN.format("/referee/ball")]
    assert not [call for call in field.host.calls if call[0] == "listen"]
    assert field.reasons() == ["requested"]


def test_where_somebody_listens_anyway_it_is_known(field: Field) -> None:
    field.manager.add_transformation(REFEREE)
    field.host.topics.add("/referee/ball")
    assert field.acquire(max_silence=2.0).claim.detail == NO_MESSAGE
    field.settle(2.0)
    assert details(field) == [""]
    assert [each.topic for each in field.host.listeners] == ["/referee/ball"]


def test_nodelets_with_fixed_topics_cannot_be_asked(field: Field) -> None:
    field.host.cpp.add("soccer/Camera")
    field.host.stock = True
    field.spawn("bottom camera", "/mine", config={"image": "/mine/image"})
    claim = field.acquire("YUV(field)").claim
    assert claim.topic == "/mine/image"
    field.settle(5.0)
    assert details(field) == [UNKNOWN.format(claim.topic)]
    assert not [call for call in field.host.calls if call[0] == "listen"]


def test_the_next_life_of_the_manager_waits_on(tmp_path: Path) -> None:
    field = Field(str(tmp_path / "state"))
    field.host.silent.add("/localization_1")
    field.acquire()
    field.settle(2.0)
    field.kill_manager()
    field.settle(2.0)
    assert details(field) == [NO_MESSAGE]
    field.host.silent.clear()
    field.settle(2.0)
    assert details(field) == [""]
