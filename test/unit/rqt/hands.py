# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A user's hands and eyes on the window."""

from __future__ import annotations

import time
from pathlib import Path

from python_qt_binding.QtCore import QEvent, QPoint, QPointF, Qt, QTimer
from python_qt_binding.QtGui import QMouseEvent, QWheelEvent
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import (
    QAbstractButton,
    QAction,
    QApplication,
    QLabel,
    QMenu,
    QMessageBox,
    QToolButton,
)

from dyknow.model.graph import PortRef, SpawnRequest
from dyknow_rqt.graph.changes import spawn
from dyknow_rqt.window import DyKnowWidget

FORMULAS = Path(__file__).resolve().parents[3] / "examples/transformations/formulas.xml"
CEILING = PortRef("/field/ceiling_camera", "field_position")
TRACKER = PortRef("/field/tracker", "position")
HSV_IN = PortRef("/nao1/line_detector", "hsv")


def window_of(qtbot, remote, size=(1400, 800)):
    """A window that is shown and reads."""
    window = DyKnowWidget(remote)
    # Which refers to it: qtbot itself forgets a window that a test has let go, and it would go on.
    qtbot.addWidget(window, before_close_func=lambda unused: window.shut_down())
    window.resize(*size)
    window.show()
    window.start()
    return window


def until(qtbot, condition):
    """Wait for something, as long as a busy machine may need."""
    qtbot.waitUntil(lambda: bool(condition()), timeout=120_000)


def is_ready(window):
    """Whether a change can begin, and no late answer makes the window read everything anew."""
    monitor = window.monitor
    return bool(monitor.heart._address) and monitor.is_linked and not monitor._must_wait


def is_settled(window):
    """Whether all that was requested is laid out and drawn."""
    graph, scene = window.graph, window.graph.view.scene()
    is_drawn = not (graph._calls.is_calling or scene.slices.is_wanted(scene._draw))
    return is_drawn and graph.layouter.is_idle


def topic(remote, ref):
    """The topic of a port; empty for none, and for a nodelet that is not there (yet)."""
    nodelet = remote.graph().nodelet(ref.nodelet)
    port = nodelet.port(ref.port) if nodelet is not None else None
    return port.topic if port is not None else ""


def drag(view, start, end):
    """Press, move and release, as a hand does."""
    port = view.viewport()
    QTest.mousePress(port, Qt.LeftButton, Qt.NoModifier, start)
    move(view, (start + end) / 2)
    move(view, end)
    QTest.mouseRelease(port, Qt.LeftButton, Qt.NoModifier, end)


def move(view, place):
    """Move with the left button held down."""
    where = QPointF(place), QPointF(view.viewport().mapToGlobal(place))
    event = QMouseEvent(QEvent.MouseMove, *where, Qt.NoButton, Qt.LeftButton, Qt.NoModifier)
    QApplication.sendEvent(view.viewport(), event)


def create(qtbot, window, name):
    """Make a nodelet, and wait until the window knows it."""
    until(qtbot, lambda: is_ready(window))
    window.monitor.do(spawn(SpawnRequest("tracker", name)))
    until(qtbot, lambda: not window.monitor.is_changing)
    until(qtbot, lambda: window.monitor.snapshot.nodelet(name) is not None)


def centre_of(view, key):
    return view.mapFromScene(view.scene().vertices[key].pos())


def click(qtbot, button):
    """Click a button, or that of an action, when the change before is made: one at a time."""
    button = button_of(button) if isinstance(button, QAction) else button
    window = button.window()
    until(qtbot, lambda: not (isinstance(window, DyKnowWidget) and window.monitor.is_changing))
    assert button.isEnabled()
    qtbot.mouseClick(button, Qt.LeftButton)


def undo(qtbot, window):
    """Take the last change back with the button, once there is one to take back."""
    until(qtbot, window.graph.bar.undo.isEnabled)
    click(qtbot, window.graph.bar.undo)


def turn_wheel(widget, place, angle):
    """Turn the wheel over a place (a point of the widget), by eighths of a degree."""
    where = QPointF(place), QPointF(widget.mapToGlobal(place))
    how = Qt.NoButton, Qt.NoModifier, Qt.NoScrollPhase, False
    QApplication.sendEvent(widget, QWheelEvent(*where, QPoint(), QPoint(0, angle), *how))


def show(window, panel):
    """Show the tab of a panel, and return that."""
    window.tabs.setCurrentWidget(panel)
    return panel


def button_of(action):
    return next(each for each in action.associatedWidgets() if isinstance(each, QToolButton))


def no_boxes():
    return not [w for w in QApplication.topLevelWidgets() if isinstance(w, QMessageBox)]


def vertex_keys(window):
    """Keys of the last drawing that is complete."""
    return {vertex.key for vertex in window.graph.drawn.vertices}


def cells_of(table, row):
    model = table.model()
    return [model.index(row, column).data() for column in range(model.columnCount())]


def texts_of(widget):
    kinds = (QAbstractButton, QLabel)
    return [each.text() for kind in kinds for each in widget.findChildren(kind)]


def description_of(widget):
    return type(widget).__name__, widget.accessibleName(), getattr(widget, "text", str)()


def wiring_of(nodelets):
    return [(n.name, n.transformation, [(p.name, p.topic) for p in n.ports]) for n in nodelets]


def context_menu(qtbot, window, item):
    window.graph.view.menu_wanted.emit(item, QPoint(50, 50))
    menu = next(menu for menu in window.graph.findChildren(QMenu) if menu.isVisible())
    entries = {action.text(): action for action in menu.actions()}
    menu.hide()
    return entries


def pauses(qtbot, most, until=lambda: False):
    """Processor time (s) of the window's thread between two ticks of its clock, for `most` ms."""
    ticks = [time.thread_time()]
    timer = QTimer()
    timer.timeout.connect(lambda: ticks.append(time.thread_time()))
    timer.start(10)
    end = time.monotonic() + most / 1000
    while time.monotonic() < end and not until():
        qtbot.wait(20)
    timer.stop()
    return [b - a for a, b in zip(ticks, ticks[1:])]
