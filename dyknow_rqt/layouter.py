# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Makes layouts in another process, with a time limit."""

from __future__ import annotations

from typing import Mapping, Optional, Tuple

from python_qt_binding.QtCore import QObject, QProcess, QTimer, Signal

from dyknow_rqt.graph.dot import BadLayout, read_layout, to_dot
from dyknow_rqt.graph.figure import Figure
from dyknow_rqt.graph.geometry import Layout, Size
from dyknow_rqt.graph.layered import layered
from dyknow_rqt.qt_slot import qt_slot

#: Seconds that graphviz may take.
LIMIT = 4.0
_Order = Tuple[Figure, Mapping[str, Size]]


class Layouter(QObject):
    """Runs ``dot`` for one figure at a time; of several that wait only the last is laid out."""

    #: A figure, its sizes and its layout.
    ready = Signal(object, object, object)
    #: graphviz failed and a simpler layout was used: the reason.
    failed = Signal(str)

    def __init__(self, program: str = "dot", limit: float = LIMIT) -> None:
        """Prepare.

        Args:
            program: graphviz's.
            limit: seconds that it may take.
        """
        super().__init__()
        self._program = program
        self._current: Optional[_Order] = None
        self._next: Optional[_Order] = None
        self._gap = 0.0
        self._complaint = ""
        self._process = QProcess(self)
        self._process.finished.connect(self._finished)
        self._process.errorOccurred.connect(self._could_not)
        self._limit = QTimer(self)
        self._limit.setSingleShot(True)
        self._limit.setInterval(int(limit * 1000))
        self._limit.timeout.connect(self._too_slow)

    def lay_out(self, figure: Figure, sizes: Mapping[str, Size], gap: float = 52.0) -> None:
        """Lay a figure out; ``ready`` is emitted when it is done."""
        self._next, self._gap = (figure, sizes), gap
        if self._current is None:
            self._begin()

    def close(self) -> None:
        """End the process."""
        self._next = self._current = None
        self._limit.stop()
        if self._process.state() != QProcess.NotRunning:
            self._process.kill()
            self._process.waitForFinished(1000)

    def report(self, text: str) -> None:
        """Report an error."""
        self.failed.emit(text)

    def _begin(self) -> None:
        self._current, self._next = self._next, None
        if self._current is None:
            return
        figure, sizes = self._current
        if not figure.vertices:
            self._end(Layout())
            return
        self._complaint = ""
        self._process.start(self._program, ["-Tjson0"])
        self._limit.start()
        self._process.write(to_dot(figure, sizes, self._gap).encode())
        self._process.closeWriteChannel()

    @qt_slot
    def _finished(self) -> None:
        if self._current is None:
            return
        answer = bytes(self._process.readAllStandardOutput()).decode("utf-8", "replace")
        self._process.readAllStandardError()
        try:
            layout = read_layout(answer, self._current[0])
        except BadLayout as error:
            self._fall_back(self._complaint or f"graphviz: {error}")
        else:
            self._end(layout)

    @qt_slot
    def _could_not(self, error: int) -> None:
        # `finished` follows a crash or a kill, but not a process that did not start.
        if error == QProcess.FailedToStart and self._current is not None:
            self._fall_back(f"'{self._program}' cannot be run; is graphviz installed?")

    @qt_slot
    def _too_slow(self) -> None:
        self._complaint = (
            f"graphviz took longer than {self._limit.interval() / 1000:g} s: a plainer layout is "
            "shown; hide a part of the graph for a better one"
        )
        self._process.kill()

    def _fall_back(self, reason: str) -> None:
        assert self._current is not None
        self.failed.emit(reason)
        self._end(layered(*self._current))

    def _end(self, layout: Layout) -> None:
        self._limit.stop()
        assert self._current is not None
        figure, sizes = self._current
        self._current = None
        self.ready.emit(figure, sizes, layout)
        if self._current is None:
            self._begin()
