# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The time-line below the graph: what changed when, scrubbed back and forth."""

from __future__ import annotations

import time
from typing import Any

from python_qt_binding.QtCore import QRectF, Qt, Signal
from python_qt_binding.QtGui import QColor, QPainter, QPen
from python_qt_binding.QtWidgets import QLabel, QWidget

from dyknow.model.streams import ClaimState
from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.graph.snapshot import Difference, GraphMoment, Moments, difference
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.widgets import bare_column_in, wrapped

#: Pixels: the line with the moments, a lane of a claim, the most lanes, the margin at the ends.
_LINE, _LANE, _LANES, _MARGIN = 18, 7, 5, 10
#: So many changes are named in the line of words.
_NAMED = 3


class MomentTrack(QWidget):
    """A tick for each moment, above lanes with the states of claims.

    A press or a drag chooses a moment; with Shift the one that it is compared with.
    """

    #: Another moment is chosen.
    chosen = Signal()

    def __init__(self, moments: Moments) -> None:
        super().__init__()
        self._moments = moments
        #: The chosen moment and the one it is compared with; None for the present.
        self.moment: GraphMoment | None = None
        self.anchor: GraphMoment | None = None
        self.setFocusPolicy(Qt.StrongFocus)
        self.setAccessibleName("Time-line")
        self.setToolTip(
            "Each tick is a change; press, drag or use the arrow keys to see the graph as it was, "
            "with Shift to compare with another moment; End: now"
        )

    def choose(self, moment: GraphMoment | None, is_anchor: bool = False) -> None:
        """Show a moment; the last one is the present."""
        every = self._moments.all
        moment = None if every and moment is every[-1] else moment
        if is_anchor:
            self.anchor = moment
        else:
            self.moment = moment
            self.anchor = self.anchor if moment is not None else None
        self.update()
        self.chosen.emit()

    def lanes(self) -> list[tuple[str, str]]:
        """Ids and tags of the claims whose states are shown: the latest."""
        found: dict[str, str] = {}
        for moment in self._moments.all:
            found.update((each.claim_id, each.bound_tag) for each in moment.streams)
        return list(found.items())[-_LANES:]

    def follow(self) -> None:
        """Show the noted moments; a chosen one that is forgotten gives way to the present."""
        every = list(self._moments.all)
        self.setFixedHeight(_LINE + _LANE * len(self.lanes()))
        if self.moment is not None and not any(each is self.moment for each in every):
            self.choose(None)
        self.update()

    def paintEvent(self, event: Any) -> None:  # noqa: N802
        colours, every = colours_of(self.palette()), list(self._moments.all)
        painter = QPainter(self)
        painter.setPen(colours.box_line)
        painter.drawLine(_MARGIN, _LINE // 2, self.width() - _MARGIN, _LINE // 2)
        for number, moment in enumerate(every):
            x = self._x(number)
            is_chosen = moment is (self.moment or every[-1])
            is_anchor = self.moment is not None and moment is (self.anchor or every[-1])
            marked = colours.chosen if is_chosen or is_anchor else colours.line
            painter.setPen(QPen(marked, 3.0 if is_chosen else 1.4))
            reach = 7 if is_chosen or is_anchor else 4
            painter.drawLine(int(x), _LINE // 2 - reach, int(x), _LINE // 2 + reach)
        for lane, (claim, _) in enumerate(self.lanes()):
            for number, moment in enumerate(every):
                state = next((s.state for s in moment.streams if s.claim_id == claim), None)
                left, right = self._x(number), self._x(number + 1)
                area = QRectF(left, _LINE + lane * _LANE, max(right - left, 3.0), _LANE - 2)
                if state is not None and not state.ended:
                    painter.fillRect(area, self._colour(state))

    def _colour(self, state: ClaimState) -> QColor:
        colours = colours_of(self.palette())
        return {
            ClaimState.ACTIVE: colours.true,
            ClaimState.PENDING: colours.box_line,
            ClaimState.DEGRADED: colours.both,
            ClaimState.RECOVERING: colours.both,
        }.get(state, colours.alarm)

    def _x(self, number: int) -> float:
        """Where a moment is: changes stand in equal distances, whenever they happened."""
        count = max(len(self._moments.all) - 1, 1)
        return float(_MARGIN + min(number / count, 1.0) * (self.width() - 2 * _MARGIN))

    def mousePressEvent(self, event: Any) -> None:  # noqa: N802
        every = self._moments.all
        if every:
            numbers = range(len(every))
            nearest = min(numbers, key=lambda number: abs(self._x(number) - event.pos().x()))
            self.choose(every[nearest], bool(event.modifiers() & Qt.ShiftModifier))

    def mouseMoveEvent(self, event: Any) -> None:  # noqa: N802
        self.mousePressEvent(event)

    def keyPressEvent(self, event: Any) -> None:  # noqa: N802
        steps = {Qt.Key_Left: -1, Qt.Key_Right: 1, Qt.Key_Home: -(10**6), Qt.Key_End: 10**6}
        every, step = list(self._moments.all), steps.get(event.key())
        if step is None or not every:
            super().keyPressEvent(event)
            return
        is_anchor = bool(event.modifiers() & Qt.ShiftModifier)
        now = (self.anchor if is_anchor else self.moment) or every[-1]
        number = next((n for n, each in enumerate(every) if each is now), len(every) - 1)
        self.choose(every[max(0, min(len(every) - 1, number + step))], is_anchor)


class TimelinePanel(QWidget):
    """The track, with the difference of two moments in words."""

    #: The graph of a ``GraphMoment`` is to be shown, or None for the present; a ``Difference``.
    wanted = Signal(object, object)
    #: Something changed now: a ``Difference``.
    changed = Signal(object)

    def __init__(self, monitor: GraphMonitor) -> None:
        super().__init__()
        self._monitor = monitor
        self.moments = Moments()
        self.track = MomentTrack(self.moments)
        self.words = QLabel()
        bare_column_in(self, self.words, self.track).setContentsMargins(0, 0, 0, 2)
        self.words.setMinimumWidth(1)
        self.words.setIndent(_MARGIN)
        self.track.chosen.connect(self._tell)
        monitor.changed.connect(self._note)
        monitor.streams_changed.connect(self._note)
        self.hide()

    @property
    def moment(self) -> GraphMoment | None:
        """The moment that is shown; None for the present."""
        return self.track.moment

    def _note(self) -> None:
        before = self.moments.all[-1] if self.moments.all else None
        monitor = self._monitor
        if not monitor.snapshot.nodelets and before is None:
            return  # nothing is known yet
        moment = GraphMoment(time.time(), monitor.snapshot, monitor.streams)
        if self.moments.note(moment):
            self.track.follow()
            if before is not None:
                self.changed.emit(difference(before, moment))
            (self._say if self.moment is None else self._tell)()

    def _tell(self) -> None:
        self._say()
        self.wanted.emit(self.moment, self._difference())

    def _difference(self) -> Difference:
        """From the chosen moment to the other one; of the present to the one before it."""
        every = self.moments.all
        if len(every) < 2:
            return Difference()
        if self.moment is None:
            return difference(every[-2], every[-1])
        order = {id(each): number for number, each in enumerate(every)}
        ends = (self.moment, self.track.anchor or every[-1])
        return difference(*sorted(ends, key=lambda each: order.get(id(each), -1)))

    def _say(self) -> None:
        every = self.moments.all
        if not every:
            return
        moment, lines = self.moment or every[-1], self._difference().lines
        clock = _clock(moment.time)
        when, what = f"{clock} (now)", "last change"
        if self.moment is not None:
            anchor = self.track.anchor
            until = "now" if anchor is None else _clock(anchor.time)
            when, what = f"{clock}, as it was", f"to {until}"
        more = f", and {len(lines) - _NAMED} more" if len(lines) > _NAMED else ""
        room = self.width() - 3 * _MARGIN
        text = f"{when}; {what}: {', '.join(lines[:_NAMED]) or 'nothing'}{more}"
        self.words.setText(self.words.fontMetrics().elidedText(text, Qt.ElideRight, room))
        self.words.setToolTip(wrapped("\n".join(lines)))

    def resizeEvent(self, event: Any) -> None:  # noqa: N802
        super().resizeEvent(event)
        self._say()

    def hideEvent(self, event: Any) -> None:  # noqa: N802
        """Return to the present."""
        super().hideEvent(event)
        if self.moment is not None:
            self.track.choose(None)


def _clock(moment: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(moment))
