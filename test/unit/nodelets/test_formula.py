# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet of a formula."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from dyknow.nodelets.formula import FormulaNodelet


def test_the_timer_goes_on_after_an_error():
    def advance(now):
        raise ValueError(now)

    timers = []
    nodelet: Any = FormulaNodelet()
    nodelet.individuals = None
    nodelet.monitor = SimpleNamespace(advance=advance, due=None)
    nodelet.nh = SimpleNamespace(
        Duration=float,
        Time=SimpleNamespace(now=lambda: 1.0),
        Timer=lambda wait, callback, oneshot: timers.append((wait, callback, oneshot)),
    )
    with pytest.raises(ValueError, match="1.0"):
        nodelet.on_timer(None)
    assert timers == [(0.1, nodelet.on_timer, True)]
