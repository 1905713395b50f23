# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What libraries find out from rospy's inside: who is at the other end of a topic.

actionlib asks ``publisher.impl.has_connection(node)`` and ``subscriber.impl.connections``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, List, Optional, Tuple

from dyknow.nodelet import pubsub
from dyknow.nodelet.context import Context


@dataclass(frozen=True)
class Peer:
    """A nodelet of this process at the other end, as rospy's transports describe nodes.

    Attributes:
        endpoint_id: its name.
        done: whether the connection has ended.
    """

    endpoint_id: str
    done: bool = False
    transport_type: str = "INTRAPROCESS"

    @property
    def callerid_pub(self) -> str:
        """Its name, if it publishes."""
        return self.endpoint_id


class _Impl:
    """The connections of one end of a topic."""

    def __init__(self, end: Any, context: Optional[Context]) -> None:
        self._end = end
        self._context = context

    @property
    def connections(self) -> List[Any]:
        """One for each node, rospy's own for those outside."""
        if self._end is None or self._context is None:
            return []
        publishers, subscribers = self._context.runtime.bus.owners(self._end.name)
        inside = publishers if isinstance(self._end, pubsub.Subscriber) else subscribers
        return [*map(Peer, inside), *self._outside()]

    def has_connections(self) -> bool:
        """Whether there are any."""
        return bool(self.connections)

    def get_num_connections(self) -> int:
        """Count them."""
        return len(self.connections)

    def has_connection(self, endpoint_id: str) -> bool:
        """Whether that node is at the other end."""
        return any(each.endpoint_id == endpoint_id for each in self.connections)

    def get_stats(self) -> Tuple[str, List[Tuple[int, int, int, int, bool]]]:
        """The topic, and an entry for each connection; of that, only the last is known: alive."""
        topic = "" if self._end is None else self._end.name
        return topic, [(n, 0, 0, 0, True) for n, _ in enumerate(self.connections)]

    def _outside(self) -> List[Any]:
        raise NotImplementedError


class PublisherImpl(_Impl):
    """``rospy.Publisher.impl``."""

    def _outside(self) -> List[Any]:
        outside = self._end.publication.outside
        return [] if outside is None else [p for p in outside.peers() if hasattr(p, "endpoint_id")]


class SubscriberImpl(_Impl):
    """``rospy.Subscriber.impl``."""

    def _outside(self) -> List[Any]:
        connection = self._end.subscription.connection
        outside = connection.outside if connection is not None else None
        return [] if outside is None else list(outside.links())
