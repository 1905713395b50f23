# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Makes layouts: graphviz runs in another process, all else in a thread."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any, Mapping, Sequence

from python_qt_binding.QtCore import QObject, QProcess, QTimer, Signal

from dyknow_rqt.background_calls import BackgroundCalls
from dyknow_rqt.graph.geometry import Drawing, Layout
from dyknow_rqt.graph.layout import (
    BadLayout,
    DrawingOrder,
    arranged,
    read_graphs,
    read_layout,
    to_dot,
)
from dyknow_rqt.graph.parts import MOST, Piece, divide

_LOG = logging.getLogger("rosout.dyknow_rqt")
#: Seconds of a processor that graphviz may take for a part; a busy machine takes longer.
BUDGET = 60
#: Milliseconds until a drawing is shown whose parts are not all laid out.
_WAITING = 1000
#: Milliseconds within which changes are one: they follow the drawing before the first of them.
_TOGETHER = 3000
#: The exit code of the shell where a program is not there.
_NOT_FOUND = 127
_TITLE = "digraph dyknow {"


@dataclass(frozen=True)
class _Plan:
    """An order with its parts, and what graphviz is given for each of them."""

    order: DrawingOrder
    parts: tuple[Piece, ...]
    texts: Mapping[Piece, str]


class Layouter(QObject):
    """Lays out one figure after the other; of several that wait only the last.

    The layouts of parts are kept, so only parts that have changed go to graphviz. If it takes
    long, a drawing is shown where these are spread, and its result is swapped in.
    """

    #: A ``Drawing``.
    ready = Signal(object)
    #: graphviz failed and a part is spread instead: the reason.
    failed = Signal(str)

    def __init__(self, program: str = "dot", budget: int = BUDGET) -> None:
        super().__init__()
        self._program = program
        self._budget = budget
        self._calls = BackgroundCalls(1)
        self._next: DrawingOrder | None = None
        self._plan: _Plan | None = None
        self._is_busy = False
        #: Whether an order that is not laid out as a whole is to be anew.
        self._is_anew = False
        #: What graphviz was given, with the layout; None if it failed.
        self._made: dict[str, Layout | None] = {}
        #: Parts that it lays out now, with their texts.
        self._running: list[tuple[Piece, str]] = []
        self._is_unwanted = False
        #: The last drawing, and that before the changes that are one.
        self._drawing = self._before = Drawing()
        self._process = QProcess(self)
        self._process.finished.connect(self._finished)
        self._process.errorOccurred.connect(self._fail)
        self._waiting = QTimer(self, singleShot=True, interval=_WAITING, timeout=self._arrange)
        self._together = QTimer(self, singleShot=True, interval=_TOGETHER, timeout=self._go_by)

    def lay_out(self, order: DrawingOrder) -> None:
        """Lay a figure out, then emit ``ready``, more than once if graphviz takes long."""
        self._is_anew = self._is_anew or order.anew
        self._next = replace(order, anew=self._is_anew)
        self._begin()

    @property
    def is_idle(self) -> bool:
        """Whether the last order is laid out as a whole."""
        return not (self._is_busy or self._plan or self._next)

    def close(self) -> None:
        self._next = self._plan = None
        self._calls.close()
        self._waiting.stop()
        if self._process.state() != QProcess.NotRunning:
            self._process.kill()
            self._process.waitForFinished(1000)

    def _begin(self) -> None:
        order = self._next
        if order is not None and not self._is_busy:
            self._next, self._is_busy = None, True
            self._calls.run(lambda: _planned(order), self._take_plan, self._give_up)

    def _take_plan(self, plan: _Plan) -> None:
        self._plan, self._is_busy = plan, False
        wanted = set(plan.texts.values())
        if self._running and not any(text in wanted for _, text in self._running):
            self._is_unwanted = True  # its figure is not drawn any more
            self._process.kill()
        if not self._waiting.isActive():
            self._waiting.start()
        self._go_on()

    @property
    def _missing(self) -> list[tuple[Piece, str]]:
        """What graphviz has yet to lay out: all small parts, or else one that is large."""
        texts = self._plan.texts.items() if self._plan is not None else ()
        found = [(part, text) for part, text in texts if text not in self._made]
        small = [each for each in found if len(each[0].figure.vertices) <= MOST]
        return small or found[:1]

    def _go_on(self) -> None:
        """Arrange the plan once all of its parts are laid out."""
        if self._next is not None:
            self._begin()
        elif self._plan is not None and not self._missing:
            self._arrange()
        elif self._plan is not None and not self._running:
            self._running = self._missing
            limited = ["-c", 'ulimit -t "$0"; exec "$@"', str(self._budget), self._program]
            self._process.start("/bin/sh", [*limited, "-Tjson0"])
            for number, (_, text) in enumerate(self._running):
                self._process.write(text.replace(_TITLE, f"digraph g{number} {{", 1).encode())
            self._process.closeWriteChannel()

    def _fail(self, error: QProcess.ProcessError) -> None:
        """Go on as after no answer where not even the shell was started."""
        if error == QProcess.FailedToStart:
            self._finished()

    def _finished(self) -> None:
        answer, running = bytes(self._process.readAllStandardOutput()), self._running
        self._process.readAllStandardError()
        is_crash = self._process.exitStatus() == QProcess.CrashExit
        is_there = is_crash or self._process.exitCode() != _NOT_FOUND

        def take(made: dict[str, Layout | None]) -> None:
            self._running, self._is_unwanted = [], False
            if None in made.values():
                why = "cannot be run; is graphviz installed?"
                why = "cannot lay out a part of the graph" if is_there else why
                self.failed.emit(f"'{self._program}' {why}")
            self._made.update(made)
            self._go_on()

        def give_up(error: Exception) -> None:
            take(dict.fromkeys(text for _, text in running))
            self._give_up(error)

        if self._is_unwanted:
            take({})
        else:
            self._calls.run(lambda: _read(answer, running), take, give_up)

    def _arrange(self) -> None:
        """Arrange the finished layouts, and all else as well as it goes without graphviz."""
        plan = self._plan
        if plan is None or self._is_busy:
            return
        is_last, before = not self._missing, None if plan.order.anew else self._before
        made = {part: self._made.get(text) for part, text in plan.texts.items()}
        layouts = {part: layout for part, layout in made.items() if layout is not None}
        if is_last:
            self._plan, self._is_anew = None, False
            self._waiting.stop()
            self._made = {text: self._made[text] for text in plan.texts.values()}
        self._is_busy = True

        def take(drawing: Drawing) -> None:
            self._is_busy = False
            if is_last:
                self._drawing = drawing
                if drawing.is_anew or not self._before.figure.vertices:
                    self._go_by()
                elif not self._together.isActive():
                    self._together.start()
            self.ready.emit(drawing)
            self._go_on()

        self._calls.run(
            lambda: arranged(plan.order, plan.parts, layouts, before), take, self._give_up
        )

    def _go_by(self) -> None:
        """Let what comes now follow the last drawing."""
        self._before = self._drawing

    def _give_up(self, error: Exception) -> None:
        """Go on after an error of the program."""
        _LOG.error("no layout", exc_info=error)
        self.failed.emit(f"no layout: {type(error).__name__}: {error}")
        self._is_busy = False
        self._begin()


def _planned(order: DrawingOrder) -> _Plan:
    parts = divide(order.figure)
    leaves = [leaf for part in parts for leaf in part.leaves()]
    texts = {each: to_dot(each.figure, order.sizes, order.gap, each.box) for each in leaves}
    return _Plan(order, parts, texts)


def _read(answer: bytes, running: Sequence[tuple[Piece, str]]) -> dict[str, Layout | None]:
    """Read the layouts of some parts by their texts; None for one that graphviz has not made."""
    graphs: Mapping[str, Any] = read_graphs(answer.decode("utf-8", "replace"))
    made: dict[str, Layout | None] = {}
    for number, (part, text) in enumerate(running):
        try:
            made[text] = read_layout(graphs.get(f"g{number}"), part.figure)
        except BadLayout as error:
            _LOG.debug("%s", error)
            made[text] = None
    return made
