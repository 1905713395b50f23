# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Health at a glance: counts of what is not well, which lead to it."""

from __future__ import annotations

from collections import Counter
from typing import List, Mapping, Optional

from python_qt_binding.QtCore import QEvent, Qt, Signal
from python_qt_binding.QtWidgets import QLabel

from dyknow.model.graph import PortRef
from dyknow_rqt.background_calls import qt_slot
from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.graph.health import Ill, ills_of
from dyknow_rqt.graph.rates import PortRate
from dyknow_rqt.monitor import GraphMonitor
from dyknow_rqt.widgets import wrapped


class HealthLabel(QLabel):
    """Such as ``3 lost, 1 degraded, 2 slow``; each word is a link to the next of its kind."""

    #: Show an ``Ill``.
    wanted = Signal(object)

    def __init__(self, monitor: GraphMonitor) -> None:
        super().__init__()
        self._monitor = monitor
        self._traffic: Mapping[PortRef, PortRate] = {}
        self._ills: List[Ill] = []
        self._last: Optional[Ill] = None
        self.setTextInteractionFlags(Qt.LinksAccessibleByMouse | Qt.LinksAccessibleByKeyboard)
        self.setAccessibleName("What is not well")
        self.linkActivated.connect(self.lead)
        for signal in (monitor.changed, monitor.watch.changed, monitor.heart.linked):
            signal.connect(self._look)
        monitor.measured.connect(self._take_traffic)
        self.hide()

    @qt_slot
    def lead(self, word: str) -> None:
        """Lead to the next one of a word, or the next one at all."""
        ills = [ill for ill in self._ills if word in ("", ill.word)]
        if ills:
            number = ills.index(self._last) + 1 if self._last in ills else 0
            self._last = ills[number % len(ills)]
            self.wanted.emit(self._last)

    @qt_slot
    def next(self) -> None:
        self.lead("")

    @qt_slot
    def changeEvent(self, event: QEvent) -> None:  # noqa: N802
        super().changeEvent(event)
        if event.type() == QEvent.PaletteChange:
            self._show()

    @qt_slot
    def _take_traffic(self, traffic: Mapping[PortRef, PortRate]) -> None:
        self._traffic = traffic
        self._look()

    @qt_slot
    def _look(self) -> None:
        """Show nothing while it may be old."""
        monitor, ills = self._monitor, []
        if monitor.is_linked:
            ills = ills_of(monitor.snapshot, monitor.watch.streams, self._traffic)
        if ills != self._ills:
            self._ills = ills
            self._show()

    def _show(self) -> None:
        colour = colours_of(self.palette()).alarm.name()
        counts = Counter(ill.word for ill in self._ills)  # in their order
        links = (f"<a href='{w}' style='color: {colour}'>{n} {w}</a>" for w, n in counts.items())
        text = ", ".join(links)
        if text != self.text():
            self.setText(text)
        self.setToolTip(wrapped("\n".join(f"{ill.word}: {ill.title}" for ill in self._ills)))
        self.setVisible(bool(self._ills))
