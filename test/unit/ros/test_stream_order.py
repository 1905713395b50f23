# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""An outdated status or event does not replace newer ones of a client's stream."""

from __future__ import annotations

from dataclasses import replace
from typing import List
from unittest import mock

import pytest

from dyknow.model.streams import ClaimState, StreamEvent, StreamStatus
from dyknow.ros.acquiring import AcquiredStream

ACTIVE = StreamStatus("c", "me", "A", "/a", "std_msgs/Header", ClaimState.ACTIVE, "", (), 0.0)
DEGRADED = replace(ACTIVE, state=ClaimState.DEGRADED, detail="a part is in doubt")
RELEASED = replace(ACTIVE, state=ClaimState.RELEASED)


@pytest.fixture
def told() -> List[StreamEvent]:
    return []


@pytest.fixture
def stream(told: List[StreamEvent], monkeypatch: pytest.MonkeyPatch) -> AcquiredStream:
    monkeypatch.setattr("rospy.get_time", lambda: 0.0)
    return AcquiredStream(mock.Mock(), mock.Mock(), ACTIVE, 30.0, told.append)


def event(view: StreamStatus) -> StreamEvent:
    return StreamEvent(0.0, ACTIVE, view, "because")


def test_a_snapshot_from_before_an_event_does_not_win(stream: AcquiredStream) -> None:
    asked_at = stream.events
    stream.apply(event(DEGRADED))
    stream.update(ACTIVE, asked_at)
    assert stream.state is ClaimState.DEGRADED
    stream.update(ACTIVE, stream.events)
    assert stream.state is ClaimState.ACTIVE


def test_a_late_event_does_not_revive_what_was_released(
    stream: AcquiredStream, told: List[StreamEvent]
) -> None:
    stream.release()
    stream.apply(event(DEGRADED))
    stream.update(DEGRADED, stream.events)
    stream.end("unknown")
    assert stream.state is ClaimState.RELEASED
    assert [each.after.state for each in told] == [ClaimState.RELEASED]


def test_a_callback_that_releases_is_told_so_afterwards(
    stream: AcquiredStream, told: List[StreamEvent]
) -> None:
    def release(news: StreamEvent) -> None:
        told.append(news)
        stream.release()

    stream._notifications.listener = release
    stream.apply(event(DEGRADED))
    assert [each.after.state for each in told] == [ClaimState.DEGRADED, ClaimState.RELEASED]
