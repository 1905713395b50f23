# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Long work of the interface's thread, done in slices between which it takes in what users do."""

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
    """Does jobs one after the other, each once however often it was wanted meanwhile."""

    def __init__(self, report: Callable[[str], None], parent: QObject) -> None:
        super().__init__(parent)
        self.report = report
        self._steps: Dict[Job, Iterator[None]] = {}
        self._again: Set[Job] = set()
        self._timer = QTimer(self)
        self._timer.setInterval(0)
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
        end = time.monotonic() + SLICE
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
        if not self._steps:
            self._timer.stop()
