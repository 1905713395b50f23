# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tells a subscriber listener which peers a publication has, as rospy does.

A lazy nodelet works only while it has listeners: its publisher has a ``subscriber_listener`` (see
``rospy.SubscribeListener``) that subscribes to the nodelet's inputs in ``peer_subscribe``.

No record is kept of joins and leaves. A change of the peers only asks for a comparison: the peers
of that moment with those that the listener knows of. So the listener and ``get_num_connections``
agree however a change came about: a subscriber of this process or of another, a publication that
moves to another topic, a subscription that does.
"""

from __future__ import annotations

import functools
from typing import Any, Callable, Dict, Tuple

from dyknow.nodelet.endpoints import Publication
from dyknow.nodelet.middleware import Closable
from dyknow.nodelet.scheduler import Strand


class SubscriberEvents(Closable):
    """Tells one listener of the peers of one publication, on the nodelet's strand."""

    def __init__(
        self,
        publication: Publication,
        listener: Any,
        strand: Strand,
        failed: Callable[[BaseException], None],
    ) -> None:
        """Begin to watch.

        Args:
            publication: whose peers.
            listener: has ``peer_subscribe`` and ``peer_unsubscribe``.
            strand: where they are called, so that they never overlap with the nodelet's callbacks.
            failed: called with what they raise.
        """
        self._publication = publication
        self._listener = listener
        self._strand = strand
        self._failed = failed
        self._told: Dict[Tuple[str, Any], None] = {}
        self._due = False
        publication.watch(self._changed)
        self._changed()

    def close(self) -> None:
        """End the calls, and drop the listener: mostly it refers to the publisher's nodelet."""
        self._listener = None
        self._publication.unwatch(self._changed)

    def _changed(self) -> None:
        if not self._due:  # two threads may both get here: then it is compared twice
            self._due = True
            self._strand.post(self._compare)

    def _compare(self) -> None:
        self._due = False  # first: what changes from now on is compared again
        listener = self._listener
        if listener is None:
            return
        topic, peers = self._publication.peers()
        present = [(topic, peer) for peer in peers]
        # Joins first: a lazy nodelet must not stop its inputs at a move between topics.
        for each in [each for each in present if each not in self._told]:
            self._told[each] = None
            to_peer = functools.partial(self._publication.publish_to, *each)
            self._tell(listener.peer_subscribe, topic, self._publication.publish, to_peer)
        for each in [each for each in self._told if each not in present]:
            del self._told[each]
            self._tell(listener.peer_unsubscribe, each[0], len(self._told))

    def _tell(self, method: Callable[..., Any], *args: Any) -> None:
        try:
            method(*args)
        except BaseException as error:  # the boundary: the next peer is told all the same
            self._failed(error)
