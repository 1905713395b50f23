# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window, used as hands do, with the time of every turn. Imported only where Qt is."""

from __future__ import annotations

import contextlib
import itertools
import sys
import time
from types import TracebackType
from typing import Callable, Iterator, NamedTuple, Sequence

from python_qt_binding.QtCore import QTimer
from python_qt_binding.QtTest import QTest
from python_qt_binding.QtWidgets import QApplication

from dyknow.model.graph import State
from dyknow.ros.process.signals import raise_swallowed
from dyknow_benchmark.session import (
    MANAGER,
    NODELET_MANAGER,
    MeasurementFailed,
    Session,
    kill,
    say,
    steps,
)
from dyknow_rqt.canvas.view import GraphView
from dyknow_rqt.monitoring.ros_remote import RosRemote
from dyknow_rqt.monitoring.simulated import spawn_relay
from dyknow_rqt.window import DyKnowWidget, spare_imports

_PATIENCE = 180.0
_REST = 2.0  # seconds that something must hold for it to be over
#: Nothing happens for so many seconds.
_IDLE, IDLE = 8.0, "idle"
_FRAMES = 60  # frames of each movement


class Tick(NamedTuple):
    """A turn of the window's event loop, or a frame."""

    time: float  # seconds on the clock
    own: float  # seconds of a processor that the window's thread has taken
    all: float  # those of all threads


class Row(NamedTuple):
    """A row of the table: an action, and its gaps.

    Those by the clock depend on what else the machine does, those of the processor's time do not.
    """

    nodelets: int
    what: str
    frames: int
    frames_per_s: float
    longest_ms: float
    frames_per_cpu_s: float
    longest_cpu_ms: float
    load_percent: float

    @property
    def is_moved(self) -> bool:
        return self.what.startswith(("zoom", "pan", "point"))


def use(count: int) -> list[Row]:
    """Open a window on a manager, kill the hosts of its nodelets, and see them come back."""
    application = QApplication.instance() or QApplication(["benchmark"])
    rows = []

    def watch(what: str, is_done: Callable[[], bool]) -> None:
        say(f"{count} nodelets: {what}")
        rows.append(_row(count, what, _gaps(is_done)))

    with contextlib.ExitStack() as stack:
        stack.callback(setattr, sys, "excepthook", sys.excepthook)
        sys.excepthook = _survive
        session = stack.enter_context(Session())
        client = session.dyknow_manager()
        for number in steps(range(count), "spawning", "nodelet"):
            spawn_relay(client, number)
        window = stack.enter_context(_window(DyKnowWidget(RosRemote(MANAGER))))
        watch("open", lambda: _is_whole(window, count))
        end = time.monotonic() + _IDLE
        watch(IDLE, lambda: time.monotonic() > end)
        for what, nodes in (
            ("nodelet manager killed", [NODELET_MANAGER]),
            ("both managers killed", [MANAGER, NODELET_MANAGER]),
        ):
            kill(*nodes)
            if MANAGER in nodes:
                session.start_manager()
            watch(what, _is_whole_again(window, count))
        say(f"{count} nodelets: moves")
        rows += [_row(count, *moved) for moved in _moves(window)]
    application.processEvents()
    return rows


def _survive(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Let an exception that leaves a slot pass: without a hook of ours PyQt aborts the process.

    Ctrl-C is raised again as soon as no slot runs.
    """
    if kind is not KeyboardInterrupt:
        sys.__excepthook__(kind, error, trace)


@contextlib.contextmanager
def _window(widget: DyKnowWidget) -> Iterator[DyKnowWidget]:
    spare_imports()
    widget.resize(1366, 768)
    widget.show()
    widget.start()
    try:
        yield widget
    finally:
        widget.shut_down()
        widget.close()
        widget.deleteLater()
        QTest.qWait(50)


def _is_whole(window: DyKnowWidget, count: int) -> bool:
    vertices = window.graph.view.scene().vertices
    nodelets = window.monitor.snapshot.nodelets
    return (
        len(nodelets) == count
        and all(each.state is State.RUNNING for each in nodelets)
        and all(f"n_{each.name}" in vertices for each in nodelets)
        and all(vertices[f"n_{each.name}"].state is each.state for each in nodelets)
    )


def _is_whole_again(window: DyKnowWidget, count: int) -> Callable[[], bool]:
    """Return a question: whether nodelets that were gone when it was asked before are back."""
    answers = [True]

    def is_whole_again() -> bool:
        answers.append(_is_whole(window, count))
        return answers[-1] and not all(answers)

    return is_whole_again


def _gaps(is_done: Callable[[], bool]) -> Sequence[Tick]:
    """Let the window run until something holds and goes on to; take the times of its turns."""
    ticks = [_now()]
    timer = QTimer()
    timer.timeout.connect(lambda: ticks.append(_now()))
    timer.start(5)
    end, since = time.monotonic() + _PATIENCE, 0.0
    while not since or time.monotonic() < since + _REST:
        QTest.qWait(20)
        raise_swallowed()
        since = (since or time.monotonic()) if is_done() else 0.0
        if time.monotonic() > end:
            raise MeasurementFailed(f"waited {_PATIENCE:g} s for the window to show all nodelets")
    timer.stop()
    return ticks


def _moves(window: DyKnowWidget) -> Iterator[tuple[str, Sequence[Tick]]]:
    """Zoom from the whole to one nodelet and back, move about, point at one after the other."""
    view = window.graph.view
    view.fit()
    view.setTransformationAnchor(view.AnchorViewCenter)
    items = sorted(view.scene().vertices.items())
    middle = items[len(items) // 2][1].pos()
    step = max(1.0 / view.zoom, 2.0) ** (1 / _FRAMES)

    def zoom(factor: float) -> None:
        view.zoom_by(factor)
        view.centerOn(middle)

    yield "zoom in", _frames(window, lambda: zoom(step))
    yield "zoom out", _frames(window, lambda: zoom(1 / step))
    for scale in (0.1, 0.3, 0.6):
        zoom(scale / view.zoom)
        yield f"pan at {scale:.0%}", _frames(window, lambda: _drag(view))
    keys = itertools.cycle(key for key, _ in items)
    zoom(0.3 / view.zoom)
    yield "point at nodelets", _frames(window, lambda: view.scene().highlight(next(keys)))


def _frames(window: DyKnowWidget, move: Callable[[], None]) -> Sequence[Tick]:
    view = window.graph.view
    QTest.qWait(300)
    ticks = [_now()]
    for _ in range(_FRAMES):
        move()
        view.viewport().update()  # all of it, also where a scroll would move pixels
        QApplication.processEvents()
        raise_swallowed()
        ticks.append(_now())
    return ticks


def _drag(view: GraphView) -> None:
    """Move the view as a hand does in a sixtieth of a second."""
    bar = view.horizontalScrollBar()
    bar.setValue(bar.value() + 20)


def _now() -> Tick:
    return Tick(time.monotonic(), time.thread_time(), time.process_time())


def _row(count: int, what: str, ticks: Sequence[Tick]) -> Row:
    gaps = [[b - a for a, b in zip(*pair)] for pair in zip(ticks, ticks[1:])]
    times, own, whole = zip(*gaps)
    return Row(
        nodelets=count,
        what=what,
        frames=len(gaps),
        frames_per_s=len(gaps) / sum(times),
        longest_ms=1e3 * max(times),
        frames_per_cpu_s=len(gaps) / sum(own),
        longest_cpu_ms=1e3 * max(own),
        load_percent=100 * sum(whole) / sum(times),
    )
