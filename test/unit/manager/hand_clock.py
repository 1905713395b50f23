# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Time that is moved by hand."""

from __future__ import annotations

import threading
from typing import Optional

from dyknow.periodic import Clock


class HandClock(Clock):
    """A clock on which a wait returns at once and moves the time forward instead."""

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        return self.time

    def wait(self, condition: threading.Condition, seconds: Optional[float]) -> None:
        self.time += seconds or 0.0
