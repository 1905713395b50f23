# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A window on a manager that is made up."""

from __future__ import annotations

import pytest
from clocks import PATIENCE


@pytest.fixture(autouse=True)
def patient_window(request, monkeypatch):
    """No window takes a manager for silent because the machine is busy."""
    if "qtbot" in request.fixturenames:
        monkeypatch.setattr("dyknow_rqt.graph.health.PATIENCE", PATIENCE)


@pytest.fixture
def remote():
    from dyknow_rqt.monitoring.simulated import soccer

    return soccer()


@pytest.fixture
def window(qtbot, remote):
    """The whole window, once it shows the graph at its final places."""
    from unit.rqt.hands import is_ready, is_settled, until, window_of

    widget = window_of(qtbot, remote)
    with qtbot.waitActive(widget):
        widget.activateWindow()
    until(qtbot, lambda: len(widget.graph.drawn.vertices) > 15 and widget.monitor.library)
    # Before that changes are refused, or count as another manager's.
    until(qtbot, lambda: is_ready(widget))
    until(qtbot, lambda: is_settled(widget))
    return widget


@pytest.fixture
def view(window):
    return window.graph.view


@pytest.fixture
def scene(view):
    return view.scene()
