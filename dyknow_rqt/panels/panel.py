# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The base of the tabs."""

from __future__ import annotations

from typing import Optional, Sequence

from python_qt_binding.QtWidgets import QWidget

from dyknow_rqt.graph.changes import Change
from dyknow_rqt.monitor import Monitor
from dyknow_rqt.status_line import StatusLine


class Panel(QWidget):
    """A tab of the control panel: makes changes by the monitor, and asks in the status line."""

    def __init__(
        self, monitor: Monitor, line: StatusLine, parent: Optional[QWidget] = None
    ) -> None:
        super().__init__(parent)
        self._monitor, self._line = monitor, line
        self.report = line.report

    def _do_in_turn(self, changes: Sequence[Change]) -> None:
        """Make changes one after the other, up to the first that is refused."""
        if changes:
            self._monitor.do(changes[0], lambda: self._do_in_turn(changes[1:]))
