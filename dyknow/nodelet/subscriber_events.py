"""Who listens to a publication, told to a subscriber listener as rospy tells it.

A lazy nodelet works only while somebody listens: it gives its publisher a ``subscriber_listener``
(see ``rospy.SubscribeListener``) and subscribes to its own inputs in ``peer_subscribe``.

Nobody keeps a record of joins and leaves here. Whatever may have changed who listens only says so;
the peers of that moment are then compared with those that the listener knows of. So the listener
and ``get_num_connections`` agree however a change came about: a subscriber of this process or of
another, a publication that moves to another topic, a subscription that does.
"""

from __future__ import annotations

import functools
from typing import Any, Callable, Dict, Tuple

from dyknow.nodelet.endpoints import Publication
from dyknow.nodelet.scheduler import Strand


class SubscriberEvents:
    """Tells one listener of the peers of one publication, on the nodelet's strand."""

    def __init__(
        self,
        publication: Publication,
        listener: Any,
        strand: Strand,
        failed: Callable[[BaseException], None],
    ) -> None:
        """Begin to tell.

        Args:
            publication: whose peers.
            listener: has ``peer_subscribe`` and ``peer_unsubscribe``.
            strand: where they are called, so that they never overlap with the nodelet's callbacks.
            failed: told what they raise.
        """
        self._publication = publication
        self._listener = listener
        self._strand = strand
        self._failed = failed
        self._told: Dict[Tuple[str, Any], None] = {}
        self._due = False
        self._closed = False
        publication.watch(self._changed)
        self._changed()

    def close(self) -> None:
        """Tell nothing any more."""
        self._closed = True
        self._publication.unwatch(self._changed)

    def _changed(self) -> None:
        if not self._due:  # two threads may both get here: then it is compared twice
            self._due = True
            self._strand.post(self._compare)

    def _compare(self) -> None:
        self._due = False  # first: what changes from now on is compared again
        if self._closed:
            return
        topic, peers = self._publication.peers()
        present = [(topic, peer) for peer in peers]
        # Those who come first: a lazy nodelet shall not stop its inputs at a move between topics.
        for each in [each for each in present if each not in self._told]:
            self._told[each] = None
            to_peer = functools.partial(self._publication.publish_to, *each)
            self._tell(self._listener.peer_subscribe, topic, self._publication.publish, to_peer)
        for each in [each for each in self._told if each not in present]:
            del self._told[each]
            self._tell(self._listener.peer_unsubscribe, each[0], len(self._told))

    def _tell(self, method: Callable[..., Any], *args: Any) -> None:
        try:
            method(*args)
        except BaseException as error:  # the boundary: the next one is told all the same
            self._failed(error)
