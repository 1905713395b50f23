# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Keeps the list of streams up to date."""

from __future__ import annotations

from typing import TYPE_CHECKING, Optional, Sequence, Tuple

from python_qt_binding.QtCore import QObject, Signal

from dyknow_rqt.background_calls import qt_slot

if TYPE_CHECKING:
    from dyknow.model.streams import StreamStatus
    from dyknow_rqt.monitor import GraphMonitor


class StreamWatch(QObject):
    """Reads the list after each event and each change, and takes those of the heartbeat."""

    #: The list has changed.
    changed = Signal()

    def __init__(self, monitor: GraphMonitor) -> None:
        super().__init__()
        self._monitor = monitor
        self.streams: Tuple[StreamStatus, ...] = ()
        self._asking = self._again = False
        for signal in (monitor.stream_event, monitor.settled):
            signal.connect(self.ask)
        monitor.heart.listed.connect(self._take)

    def stream(self, claim_id: str) -> Optional[StreamStatus]:
        return next((each for each in self.streams if each.claim_id == claim_id), None)

    @qt_slot
    def ask(self) -> None:
        """Read all claims; one call at a time, and once more if it was requested meanwhile."""
        if self._asking:
            self._again = True
            return
        self._asking, self._again = True, False
        self._monitor.ask(lambda client: client.list_streams(), self._answered, self._take_none)

    def _answered(self, streams: Sequence[StreamStatus]) -> None:
        self._asking = False
        self._take(streams)
        if self._again:
            self.ask()

    @qt_slot
    def _take(self, streams: Sequence[StreamStatus]) -> None:
        if tuple(streams) != self.streams:
            self.streams = tuple(streams)
            self.changed.emit()

    def _take_none(self, reason: str) -> None:
        # The window says already that the manager does not answer.
        self._asking = False
