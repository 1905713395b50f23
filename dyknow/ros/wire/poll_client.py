# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Polls one process that runs nodelets, over a connection that is kept."""

from __future__ import annotations

from dyknow_msgs.msg import NodeletChanges
from dyknow_msgs.srv import Poll, PollResponse
from nodelet.srv import NodeletList

from dyknow import names
from dyknow.errors import HostError
from dyknow.model.graph import NodeletKind
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import (
    OTHER_VERSION,
    ConnectionRefused,
    ServiceClient,
    ServiceFailed,
)

#: Services of our nodelet managers and of re-wirable nodes that the master does not list.
POLL, HAND_OVER = "poll", "hand_over"


class PollClient:
    """Polls one process for its nodelets; not for several threads at once.

    When the connection breaks another process may have the name by now, so there is no other
    connection. A stock nodelet manager, which has no such service, is queried for its list.

    Attributes:
        is_stock: whether it turned out to be a stock nodelet manager.
    """

    def __init__(self, master: Master, name: str, is_node: bool) -> None:
        """Prepare; nothing is sent yet."""
        registered = names.join(name, "get_config" if is_node else "list")
        self._poll = ServiceClient(
            master, names.join(name, POLL), Poll, True, reconnects=False, beside=registered
        )
        self._list = ServiceClient(master, registered, NodeletList, True, reconnects=False)
        self._is_node = is_node
        self._seen = 0
        self.is_stock = False

    def ask(self, timeout: float, **request: object) -> PollResponse:
        """Poll it once; raises `PeerTimeout` or ``HostError``.

        The ``request`` has the fields of ``Poll`` except for the last seen change.
        """
        if not self.is_stock:
            try:
                answer = self._poll.call(timeout, seen=self._seen, **request)
            except ServiceFailed as error:
                self._find_reason(error)
            else:
                self._seen = answer.changes.sequence
                return answer
        found = self._list.call(timeout)
        changes = NodeletChanges(kind=NodeletKind.CPP.value)
        return PollResponse(nodelets=sorted(found.nodelets), changes=changes)

    def close(self) -> None:
        self._poll.close()
        self._list.close()

    def _find_reason(self, error: ServiceFailed) -> None:
        """Raise an error, unless the process is of roscpp, as stock nodelet managers are."""
        refusal = error.__cause__
        if not isinstance(refusal, ConnectionRefused) or "md5sum" in refusal.answer:
            raise error
        if self._is_node or "nonexistent service" not in refusal.answer:
            raise HostError(f"{error}; {OTHER_VERSION}") from error
        self.is_stock = True
