# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Asks the master and the manager again and again whether they are there."""

from __future__ import annotations

import logging
from typing import Sequence, Set

from python_qt_binding.QtCore import QObject, QTimer, Signal

from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.model.streams import StreamStatus
from dyknow_rqt.background_calls import BackgroundCalls, qt_slot
from dyknow_rqt.graph.contact import Contact
from dyknow_rqt.remote import Remote

_LOG = logging.getLogger("rosout.dyknow_rqt")
#: Milliseconds from beat to beat.
_PERIOD = 1000


class Heartbeat(QObject):
    """Tells the status of the contact once a second; the question itself has another use.

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
        self._contact = Contact(remote.manager, remote.master)
        self.status = self._contact.status()
        self._calls = BackgroundCalls(2)
        self._asked: Set[str] = set()
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

    def note_word(self) -> None:
        self._contact.hear_manager()
        self._tell()

    @qt_slot
    def _beat(self) -> None:
        self._tell()
        if "manager" not in self._asked:
            self._asked.add("manager")
            self._calls.run(self._remote.client.list_streams, self._hear, self._miss)
        if "master" not in self._asked:
            self._asked.add("master")
            self._calls.run(self._remote.find_manager, self._hear_master, self._miss_master)

    def _hear(self, streams: Sequence[StreamStatus]) -> None:
        self._asked.discard("manager")
        self.note_word()
        self.listed.emit(streams)

    def _miss(self, error: Exception) -> None:
        self._asked.discard("manager")
        if not isinstance(error, DyKnowError):
            _LOG.error("the manager's answer cannot be read", exc_info=error)
        self._contact.miss_manager(is_gone=not isinstance(error, PeerTimeout))
        self._tell()

    def _hear_master(self, address: str) -> None:
        self._asked.discard("master")
        self._contact.hear_master(is_known=bool(address))
        self._tell()
        if address and address != self._address:
            self._address = address
            self.linked.emit(self.status.is_current)

    def _miss_master(self, error: Exception) -> None:
        self._asked.discard("master")
        self._contact.miss_master()
        self._tell()

    def _tell(self) -> None:
        before, self.status = self.status, self._contact.status()
        if self.status != before:
            self.told.emit(self.status)
        if self.status.is_current != before.is_current:
            self.linked.emit(self.status.is_current)
