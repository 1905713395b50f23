# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The last message of a topic, over the graph; listened to only while it is shown."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Any, Callable, Sequence

from python_qt_binding.QtCore import QPointF, QRect, QSize, Qt, QTimer
from python_qt_binding.QtGui import QImage, QPainter, QPalette, QPen, QPixmap, QPolygonF
from python_qt_binding.QtWidgets import QComboBox, QLabel, QMenu, QToolButton, QWidget

from dyknow.model.graph import PortRef, State
from dyknow_rqt.background_calls import BackgroundCalls
from dyknow_rqt.canvas.appearance import colours_of
from dyknow_rqt.canvas.view import GraphView, topic_of
from dyknow_rqt.graph.samples import HIGHEST, WIDEST, Sample, SmallImage
from dyknow_rqt.graph_panel.menus import VIEWERS, add_viewers
from dyknow_rqt.monitoring.monitor import GraphMonitor
from dyknow_rqt.widgets import column_in, row_of, text_of

#: Seconds that a curve shows, and milliseconds from one look at the age to the next.
_SPAN, _PERIOD = 20.0, 500
#: Milliseconds until the card tries again to listen.
_PATIENCE = 2000
#: Pixels: the distance from the edges of the view, and the widest card.
_MARGIN, _WIDE = 8, 330
#: The most lines of a message that are seen at a time.
_LINES = 13


class Curve(QWidget):
    """The last seconds of a number."""

    def __init__(self) -> None:
        super().__init__()
        self.setFixedHeight(44)
        self.setAccessibleName("Curve")
        self.points: deque[tuple[float, float]] = deque()

    def clear(self) -> None:
        self.points.clear()
        self.update()

    def add(self, moment: float, value: float) -> None:
        self.points.append((moment, value))
        while moment - self.points[0][0] > _SPAN:
            self.points.popleft()
        self.update()

    def paintEvent(self, event: Any) -> None:  # noqa: N802
        painter = QPainter(self)
        painter.setRenderHint(QPainter.Antialiasing)
        if not self.points:
            return
        values = [value for _, value in self.points]
        low, high = min(values), max(values)
        metrics, end = self.fontMetrics(), self.points[-1][0]
        words = [f"{high:.4g}", f"{low:.4g}"]
        margin = max(metrics.horizontalAdvance(word) for word in words) + 4
        room = QRect(2, 4, self.width() - margin - 6, self.height() - 8)
        painter.setPen(colours_of(self.palette()).muted)
        for word, side in zip(words, (Qt.AlignTop, Qt.AlignBottom)):
            painter.drawText(self.rect().adjusted(0, 0, -2, 0), Qt.AlignRight | side, word)
        line = QPolygonF()
        for moment, value in self.points:
            share = (value - low) / (high - low) if high > low else 0.5
            x = room.right() - (end - moment) / _SPAN * room.width()
            line.append(QPointF(x, room.bottom() - share * room.height()))
        painter.setPen(QPen(self.palette().highlight().color(), 1.6))
        painter.drawPolyline(line)
        painter.drawEllipse(line.last(), 1.5, 1.5)


class TopicCard(QWidget):
    """A card in a corner of the view; ``show_topic`` opens it, ``dismiss`` closes it."""

    def __init__(self, monitor: GraphMonitor, view: GraphView) -> None:
        super().__init__(view)
        self.topic = ""
        self._monitor, self._view = monitor, view
        self._calls = BackgroundCalls(1)
        #: The publishers of the shown topic, its type, and the function that stops listening.
        self._nodes: Sequence[str] = ()
        self._datatype = ""
        self._end: Callable[[], None] = lambda: None
        self._number = 0
        self._again = QTimer(self, singleShot=True, interval=_PATIENCE, timeout=self._follow)
        self._has_failed = False
        self._refs: Sequence[PortRef] = ()
        self._sinks: Sequence[PortRef] = ()
        self._sample: Sample | None = None
        self._came, self._why = 0.0, ""
        self._title, self.facts, self.image = QLabel(), QLabel(), QLabel()
        self.text = text_of("Last message")
        self.curve, self.field = Curve(), QComboBox()
        self.open_in = QToolButton()
        self._arrange()
        self._ageing = QTimer(self, interval=_PERIOD, timeout=self._tell)
        self.field.currentTextChanged.connect(self.curve.clear)
        monitor.changed.connect(self._follow)
        self.hide()

    def close_down(self) -> None:
        self.show_topic("")
        self._calls.close()

    def show_topic(self, topic: str) -> None:
        """Show the last message of a topic from now on; an empty name closes the card."""
        if topic == self.topic:
            return
        self.topic, self._sample = topic, None
        self.setVisible(bool(topic))
        self._title.setToolTip(topic)
        self.field.clear()
        self._listen_to(())
        if topic:
            self._ageing.start()
            self._show_parts()
            self._follow()
            self.place()
            self.raise_()
        else:
            self._ageing.stop()
            self._again.stop()

    def place(self) -> None:
        """Stand in the corner of the view where there is the least to see, and not the topic."""
        room = self._view.viewport().size()
        width = min(_WIDE, room.width() - 2 * _MARGIN)
        wide = max(40, width - 24)
        name = self._title.fontMetrics().elidedText(self.topic, Qt.ElideMiddle, wide - 24)
        self._title.setText(name)
        height = min(self.sizeHint().height(), room.height() - 2 * _MARGIN)
        right, bottom = room.width() - width - _MARGIN, room.height() - height - _MARGIN
        areas = [QRect(x, y, width, height) for y in (_MARGIN, bottom) for x in (right, _MARGIN)]

        def hidden(area: QRect) -> tuple[bool, int]:
            items = self._view.items(area)
            return any(topic_of(item) == self.topic for item in items), len(items)

        self.setGeometry(min(areas, key=hidden))

    def paintEvent(self, event: Any) -> None:  # noqa: N802
        painter = QPainter(self)
        painter.setPen(colours_of(self.palette()).box_line)
        painter.drawRect(self.rect().adjusted(0, 0, -1, -1))

    def keyPressEvent(self, event: Any) -> None:  # noqa: N802
        """Leave no key to the drawing below, whose selection it would delete or move."""
        button = self.focusWidget()
        if event.key() == Qt.Key_Escape:
            self.show_topic("")
        elif event.key() in (Qt.Key_Return, Qt.Key_Enter) and isinstance(button, QToolButton):
            button.click()

    # Listening

    def _follow(self) -> None:
        """Listen to the nodes that publish the topic now."""
        if self.topic:
            snapshot = self._monitor.snapshot
            found = snapshot.topics().get(self.topic)
            self._refs, self._sinks = (found.sources, found.targets) if found else ((), ())
            nodelets = (snapshot.nodelet(ref.nodelet) for ref in self._refs)
            nodes = [each.node for each in nodelets if each and each.state is State.RUNNING]
            nodes += [node.name for node in snapshot.nodes if self.topic in node.publishes]
            self._datatype = found.datatype if found is not None else ""
            self._listen_to(tuple(dict.fromkeys(nodes)))
            self._tell()

    def _listen_to(self, nodes: Sequence[str]) -> None:
        if nodes == self._nodes and not self._has_failed:
            return
        self._end()
        if not self._has_failed:
            self._why = "no message yet"
        self._nodes, self._end, self._has_failed = nodes, lambda: None, False
        self._number += 1
        number, topic, datatype = self._number, self.topic, self._datatype
        is_over = threading.Event()
        ends: list[Callable[[], None]] = []

        def hear(sample: Sample) -> None:
            self._calls.deliver(lambda: self._take(number, sample))

        def begin() -> None:
            follow = self._monitor.remote.follow
            for node in nodes:
                ends.append(follow(topic, datatype, node, hear))
            if is_over.is_set():  # before it had begun
                end()

        def end() -> None:
            is_over.set()
            for each in ends:
                each()

        def tell(why: str) -> None:
            if number == self._number:
                self._why = why
                self._tell()

        def fail(error: Exception) -> None:
            if number == self._number:
                self._has_failed = True
                self._again.start()
            tell(str(error))

        if nodes:
            self._end = end
            self._calls.run(begin, lambda done: tell("no message yet"), fail)

    def _take(self, number: int, sample: Sample) -> None:
        if number != self._number:
            return
        is_first = self._sample is None
        self._sample, self._came = sample, time.monotonic()
        # A number that a message lacks, as one that is NaN, stays chosen.
        self.field.addItems([name for name in sample.numbers if self.field.findText(name) < 0])
        value = sample.numbers.get(self.field.currentText())
        if value is not None:
            self.curve.add(self._came, value)
        if self.text.toPlainText() != sample.text:
            place = self.text.verticalScrollBar().value()
            self.text.setPlainText(sample.text)
            self.text.verticalScrollBar().setValue(place)
        if sample.image is not None:
            self._show_image(sample.image)
        if is_first:
            lines = min(sample.text.count("\n") + 2, _LINES)
            self.text.setFixedHeight(lines * self.text.fontMetrics().height() + 12)
        if self._show_parts():
            self.place()
        self._tell()

    # Showing

    def _show_image(self, image: SmallImage) -> None:
        if image.width:
            line = 3 * image.width
            picture = QImage(image.data, image.width, image.height, line, QImage.Format_RGB888)
        else:
            picture = QImage.fromData(image.data)
        if picture.isNull():
            self.image.setText(image.note)
        else:
            size = QSize(WIDEST, HIGHEST)
            self.image.setPixmap(QPixmap.fromImage(picture).scaled(size, Qt.KeepAspectRatio))
        self.image.setToolTip(image.note)

    def _show_parts(self) -> bool:
        """Show what there is to see; returns whether these are other parts than before."""
        is_image = self._sample is not None and self._sample.image is not None
        is_curve = self.field.count() > 0 and not is_image
        seen = {self.image: is_image, self.curve: is_curve, self.field: is_curve}
        seen[self.text] = self._sample is not None
        has_changed = any(part.isHidden() is on for part, on in seen.items())
        for part, on in seen.items():
            part.setVisible(on)
        return has_changed

    def _tell(self) -> None:
        """Say how much comes, and how old the last message is."""
        if not self._nodes:
            self.facts.setText("nothing publishes it")
            return
        traffic = self._monitor.traffic
        rates = [traffic[ref].rate for ref in self._refs if ref in traffic]
        if not self._refs:  # the fastest sink knows what ordinary nodes publish
            rates = sorted(traffic[ref].rate for ref in self._sinks if ref in traffic)[-1:]
        facts = [f"{sum(rates):.3g} Hz"] if rates else []
        if self._sample is None:
            facts.append(self._why)
        else:
            size = self._sample.size
            if rates:
                facts.append(f"{_bytes(size * sum(rates))}/s")
            facts += [f"{_bytes(size)} each", f"{time.monotonic() - self._came:.1f} s ago"]
        self.facts.setText(" · ".join(facts))
        self.facts.setToolTip(f"from {', '.join(self._nodes)}")

    def _arrange(self) -> None:
        self.setAutoFillBackground(True)
        self.setBackgroundRole(QPalette.Window)
        self.setAccessibleName("Last message of a topic")
        font = self._title.font()
        font.setBold(True)
        self._title.setFont(font)
        close = QToolButton(text="×", autoRaise=True, toolTip="Close (Esc)")
        close.setAccessibleName("Close")
        close.clicked.connect(lambda: self.show_topic(""))
        self.facts.setWordWrap(True)
        self.field.setToolTip("The number whose curve is shown")
        self.field.setAccessibleName("Number")
        self.field.setSizeAdjustPolicy(QComboBox.AdjustToContents)
        self.image.setAlignment(Qt.AlignCenter)
        self.text.setLineWrapMode(self.text.NoWrap)
        self.open_in.setText("Open in")
        self.open_in.setPopupMode(QToolButton.InstantPopup)
        menu = QMenu(self.open_in)
        menu.aboutToShow.connect(lambda: self._fill(menu))
        self.open_in.setMenu(menu)
        title = row_of(self._title, close)
        title.setStretch(0, 1)
        row = row_of(self.field, self.open_in)
        row.insertStretch(1)
        column = column_in(self, title, self.facts, self.image, self.curve, self.text, row)
        column.setStretchFactor(self.text, 1)
        column.setContentsMargins(8, 4, 4, 6)
        column.setSpacing(4)

    def _fill(self, menu: QMenu) -> None:
        menu.clear()
        add_viewers(menu, VIEWERS, self._datatype, self.topic, self.field.currentText())


def _bytes(count: float) -> str:
    units = ["B", "kB", "MB", "GB"]
    while count >= 1000 and len(units) > 1:
        count, units = count / 1000, units[1:]
    return f"{count:.3g} {units[0]}"
