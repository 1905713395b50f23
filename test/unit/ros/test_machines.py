# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The machine of a process, and the offset of its clock, from answers to polls."""

from __future__ import annotations

import time

import pytest
from genpy import Time

from dyknow.ros.nodelets.peer_services import machine_message
from dyknow.ros.wire import poll_client
from dyknow.ros.wire.poll_client import OffsetMeter


class Answers:
    """Answers of a process whose clock is ahead, over a way that takes its time."""

    def __init__(self, patch: pytest.MonkeyPatch, ahead: float) -> None:
        self.now = 1000.0
        self.ahead = ahead
        patch.setattr(poll_client.time, "time", lambda: 5e5 + self.now)
        patch.setattr(poll_client.time, "monotonic", lambda: self.now)
        self.meter = OffsetMeter()

    def take(self, there: float, back: float) -> None:
        began = self.meter.begin()
        self.now += there
        stamp = Time.from_sec(5e5 + self.now + self.ahead)
        self.now += back
        self.meter.add(began, stamp)


def test_the_quickest_of_the_latest_answers_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = Answers(monkeypatch, 2.5)
    assert answers.meter.offset.offset != answers.meter.offset.offset, "it is not a number yet"
    answers.take(0.3, 0.1)
    assert answers.meter.offset.offset == pytest.approx(2.6, abs=1e-6)
    assert answers.meter.offset.error == pytest.approx(0.2)
    answers.take(0.001, 0.003)
    for _ in range(7):
        answers.take(0.2, 0.2)
        found = answers.meter.offset
        assert found.offset == pytest.approx(2.499, abs=1e-6)
        assert abs(found.offset - 2.5) <= found.error + 1e-9
    answers.take(0.2, 0.2)
    assert answers.meter.offset.error == pytest.approx(0.2), "a clock drifts: old ones go"


def test_a_machine_describes_itself() -> None:
    found = machine_message()
    assert found.cores >= 1 and found.load >= 0.0 and 0.0 < found.memory < 1.0
    assert abs(found.stamp.to_sec() - time.time()) < 60.0
