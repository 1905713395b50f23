# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Asks the master and the manager again and again whether they are there."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any, Callable, Sequence, Set

from python_qt_binding.QtCore import QObject, QTimer, Signal

from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.model.streams import StreamStatus
from dyknow_rqt.background_calls import BackgroundCalls, qt_slot
from dyknow_rqt.graph.contact import Contact
from dyknow_rqt.remote import Remote

_LOG = logging.getLogger("rosout.dyknow_rqt")
#: Milliseconds from beat to beat, and beats from question to question.
_PERIOD, _BEATS = 250, 4


class Heartbeat(QObject):
    """Tells the status of the contact with each beat.

    The manager is queried for its claims, since that shows whether its services work. Master and
    manager have a thread each, so that one that hangs is not mistaken for both.
    """

    #: A ``Status``.
    told = Signal(object)
    #: The manager, or another one of its name, answers from now on; or none does.
    linked = Signal(bool)
    #: The claims of the manager: a sequence of ``StreamStatus``.
    listed = Signal(object)

    def __init__(self, remote: Remote) -> None:
        super().__init__()
        self._remote = remote
        #: Takes any word of the manager, from any thread.
        self.contact = Contact(remote.manager, remote.master)
        self.status = self.contact.status()
        self._calls = BackgroundCalls(2)
        self._asked: Set[str] = set()
        self._beats = 0
        self._address = ""
        self._timer = QTimer(self)
        self._timer.setInterval(_PERIOD)
        self._timer.timeout.connect(self._beat)

    def start(self) -> None:
        self._timer.start()
        self._beat()

    def close(self) -> None:
        self._timer.stop()
        self._calls.close()

    @qt_slot
    def _beat(self) -> None:
        self._tell()
        self._beats += 1
        for peer, question, done in (
            ("manager", self._ask_manager, self._take_streams),
            ("master", self._ask_master, self._take_address),
        ):
            if peer not in self._asked and self._beats % _BEATS == 1:
                self._asked.add(peer)
                self._calls.run(
                    question, partial(self._end, peer, done), partial(self._miss, peer)
                )

    # An answer is noted at once in the thread that asked: that of the window may be at work.

    def _ask_manager(self) -> Sequence[StreamStatus]:
        try:
            streams = self._remote.client.list_streams()
        except DyKnowError as error:
            self.contact.miss_manager(is_gone=not isinstance(error, PeerTimeout))
            raise
        self.contact.hear_manager()
        return streams

    def _ask_master(self) -> str:
        try:
            address = self._remote.find_manager()
        except DyKnowError as error:
            self.contact.miss_master(is_gone=isinstance(error.__cause__, ConnectionError))
            raise
        self.contact.hear_master(is_known=bool(address))
        return address

    def _end(self, peer: str, take: Callable[[Any], None], answer: Any) -> None:
        self._asked.discard(peer)
        self._tell()
        take(answer)

    def _take_streams(self, streams: Sequence[StreamStatus]) -> None:
        self.listed.emit(streams)

    def _take_address(self, address: str) -> None:
        if address and address != self._address:
            self._address = address
            self.linked.emit(self.status.is_current)

    def _miss(self, peer: str, error: Exception) -> None:
        self._asked.discard(peer)
        if not isinstance(error, DyKnowError):
            _LOG.error("the answer of the %s cannot be read", peer, exc_info=error)
        self._tell()

    def _tell(self) -> None:
        before, self.status = self.status, self.contact.status()
        if self.status != before:
            self.told.emit(self.status)
        if self.status.is_current != before.is_current:
            self.linked.emit(self.status.is_current)
