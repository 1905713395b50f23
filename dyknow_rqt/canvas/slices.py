# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Long work of the interface's thread, in slices with the user's input between them."""

from __future__ import annotations

import time
from typing import Callable, Dict, Iterator, Set

from python_qt_binding.QtCore import QObject, QTimer

from dyknow_rqt.background_calls import qt_slot

#: A function that yields where its work may be interrupted.
Job = Callable[[], Iterator[None]]
#: Seconds of work until the next turn of the event loop.
SLICE = 0.02


class Slices(QObject):
    """Does jobs one after the other, each once however often it was wanted meanwhile.

    Attributes:
        is_working: whether a slice is being done; between two of them a user may be at work.
    """

    def __init__(self, report: Callable[[str], None], parent: QObject) -> None:
        super().__init__(parent)
        self.report = report
        self.is_working = False
        self._steps: Dict[Job, Iterator[None]] = {}
        self._again: Set[Job] = set()
        self._timer = QTimer(self, interval=0)
        self._timer.timeout.connect(self.go_on)

    def want(self, job: Job) -> None:
        """Do a job soon, and once more if it is under way."""
        if job in self._steps:
            self._again.add(job)
        else:
            self._steps[job] = job()
            self._timer.start()

    def is_wanted(self, job: Job) -> bool:
        return job in self._steps

    def close(self) -> None:
        self._timer.stop()
        self._steps.clear()

    @qt_slot
    def go_on(self) -> None:
        """Do one slice."""
        self.is_working = True
        try:
            self._do(time.monotonic() + SLICE)
        finally:
            self.is_working = False
        if not self._steps:
            self._timer.stop()

    def _do(self, end: float) -> None:
        for job in list(self._steps):
            try:
                for _ in self._steps[job]:
                    if time.monotonic() > end:
                        return
            except BaseException:
                self._steps.pop(job, None)
                raise
            self._steps.pop(job, None)
            if job in self._again:
                self._again.discard(job)
                self._steps[job] = job()
