# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A window on a manager that is made up."""

from __future__ import annotations

import pytest


@pytest.fixture
def remote():
    from dyknow_rqt.example_graphs import soccer

    return soccer()


@pytest.fixture
def window(qtbot, remote):
    """The whole window, once it shows the graph."""
    from unit.rqt.hands import until

    from dyknow_rqt.window import DyKnowWidget

    widget = DyKnowWidget(remote)
    qtbot.addWidget(widget, before_close_func=lambda w: w.shut_down())
    widget.resize(1400, 800)
    with qtbot.waitActive(widget):
        widget.show()
        widget.activateWindow()
    widget.start()
    until(qtbot, lambda: len(widget.graph.drawn.vertices) > 15 and widget.monitor.library)
    return widget
