# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Makes layouts in another process, with a time limit; their preparation runs in a thread."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Mapping, Optional, Tuple

from python_qt_binding.QtCore import QObject, QProcess, QTimer, Signal

from dyknow_rqt.background_calls import BackgroundCalls, qt_slot
from dyknow_rqt.graph.figure import Figure
from dyknow_rqt.graph.geometry import Drawing, Size
from dyknow_rqt.graph.layout import arranged, to_dot

_LOG = logging.getLogger("rosout.dyknow_rqt")
#: Seconds that graphviz may take.
LIMIT = 4.0


@dataclass(frozen=True)
class _Order:
    figure: Figure
    sizes: Mapping[str, Size]
    gap: float
    anew: bool


class Layouter(QObject):
    """Runs ``dot`` for one figure at a time; of several that wait only the last is laid out."""

    #: A ``Drawing``.
    ready = Signal(object)
    #: graphviz failed and a simpler layout was used: the reason.
    failed = Signal(str)

    def __init__(self, program: str = "dot", limit: float = LIMIT) -> None:
        super().__init__()
        self._program = program
        self._calls = BackgroundCalls(1)
        self._current: Optional[_Order] = None
        self._next: Optional[_Order] = None
        self._drawing = Drawing()
        self._complaint = ""
        self._process = QProcess(self)
        self._process.finished.connect(self._finished)
        self._process.errorOccurred.connect(self._could_not)
        self._limit = QTimer(self)
        self._limit.setSingleShot(True)
        self._limit.setInterval(int(limit * 1000))
        self._limit.timeout.connect(self._too_slow)

    def lay_out(
        self, figure: Figure, sizes: Mapping[str, Size], gap: float = 52.0, anew: bool = False
    ) -> None:
        """Lay a figure out, ``anew`` without regard to the drawing before; then emit ``ready``."""
        anew = anew or (self._next is not None and self._next.anew)
        self._next = _Order(figure, sizes, gap, anew)
        if self._current is None:
            self._begin()

    def close(self) -> None:
        self._next = self._current = None
        self._calls.close()
        self._limit.stop()
        if self._process.state() != QProcess.NotRunning:
            self._process.kill()
            self._process.waitForFinished(1000)

    def report(self, text: str) -> None:
        self.failed.emit(text)

    def _begin(self) -> None:
        order, self._current, self._next = self._next, self._next, None
        if order is not None:
            self._complaint = ""
            self._calls.run(
                lambda: to_dot(order.figure, order.sizes, order.gap), self._start, self._give_up
            )

    def _start(self, text: str) -> None:
        if self._current is not None:
            self._process.start(self._program, ["-Tjson0"])
            self._limit.start()
            self._process.write(text.encode())
            self._process.closeWriteChannel()

    @qt_slot
    def _finished(self) -> None:
        self._limit.stop()
        self._process.readAllStandardError()
        self._read(bytes(self._process.readAllStandardOutput()))

    @qt_slot
    def _could_not(self, error: int) -> None:
        # `finished` follows a crash or a kill, but not a process that did not start.
        if error == QProcess.FailedToStart:
            self._limit.stop()
            self._complaint = f"'{self._program}' cannot be run; is graphviz installed?"
            self._read(b"")

    @qt_slot
    def _too_slow(self) -> None:
        self._complaint = (
            f"graphviz took longer than {self._limit.interval() / 1000:g} s: a plainer layout is "
            "shown; hide a part of the graph for a better one"
        )
        self._process.kill()

    def _read(self, answer: bytes) -> None:
        order, before = self._current, self._drawing
        if order is not None:
            self._calls.run(
                lambda: arranged(
                    order.figure, order.sizes, answer, None if order.anew else before
                ),
                self._end,
                self._give_up,
            )

    def _end(self, result: Tuple[Drawing, str]) -> None:
        drawing, complaint = result
        if complaint:
            self.failed.emit(self._complaint or complaint)
        self._drawing = drawing
        self.ready.emit(drawing)
        self._begin()

    def _give_up(self, error: Exception) -> None:
        """Go on after an error of the program."""
        _LOG.error("no layout", exc_info=error)
        self.failed.emit(f"no layout: {type(error).__name__}: {error}")
        self._begin()
