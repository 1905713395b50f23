# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Asks the master and the manager again and again whether they are there."""

from __future__ import annotations

from typing import Sequence

from python_qt_binding.QtCore import QObject, QTimer, Signal

from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.model.streams import StreamStatus
from dyknow_rqt.background_calls import BackgroundCalls
from dyknow_rqt.graph.health import Contact
from dyknow_rqt.monitoring.remote import Remote

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
        self._beats = 0
        self._address = ""
        self._timer = QTimer(self, interval=_PERIOD, timeout=self._beat)

    def start(self) -> None:
        self._timer.start()
        self._beat()

    def close(self) -> None:
        self._timer.stop()
        self._calls.close()

    def list_streams(self) -> None:
        """Ask the manager for its claims, again after a running call: its answer may be older."""
        self._calls.run_once("the claims", self._ask_manager, self.listed.emit, again=True)

    def _beat(self) -> None:
        self._tell()
        if self._beats % _BEATS == 0:
            self._calls.run_once("the claims", self._ask_manager, self.listed.emit)
            self._calls.run_once("the address", self._ask_master, self._take_address)
        self._beats += 1

    # An answer is noted at once in the calling thread: that of the window may be at work.

    def _ask_manager(self) -> Sequence[StreamStatus]:
        try:
            streams = self._remote.client.list_streams()
            self.contact.hear_manager()
            return streams
        except DyKnowError as error:
            self.contact.miss_manager(is_gone=not isinstance(error, PeerTimeout))
            raise
        finally:
            self._calls.deliver(self._tell)

    def _ask_master(self) -> str:
        try:
            address = self._remote.find_manager()
            self.contact.hear_master(is_known=bool(address))
            return address
        except DyKnowError as error:
            self.contact.miss_master(is_gone=isinstance(error.__cause__, ConnectionError))
            raise
        finally:
            self._calls.deliver(self._tell)

    def _take_address(self, address: str) -> None:
        if address and address != self._address:
            self._address = address
            self.linked.emit(self.status.is_current)

    def _tell(self) -> None:
        before, self.status = self.status, self.contact.status()
        if self.status != before:
            self.told.emit(self.status)
        if self.status.is_current != before.is_current:
            self.linked.emit(self.status.is_current)
