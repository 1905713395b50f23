# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``Publisher`` and ``Subscriber``: a nodelet's handles on its streams.

The state that a switch changes, the topic and the registrations, belongs to the publication or
subscription behind them. The same classes serve topics here and, derived, ports
in ``dyknow.proxy``.
"""

from __future__ import annotations

import functools
from typing import Any, Callable, Sequence

from dyknow.nodelet.context import Context, check_message_class
from dyknow.nodelet.middleware import Closable
from dyknow.nodelet.streams.bus import Endpoint
from dyknow.nodelet.streams.endpoints import Publication


class _Handle:
    """Members of publishers and subscribers that rospy's have too."""

    def __init__(self, context: Context, endpoint: Endpoint, datatype: Any) -> None:
        self._context = context
        self._endpoint = endpoint
        self.data_class = datatype
        self.type = self.data_class._type
        self.md5sum = self.data_class._md5sum

    @property
    def name(self) -> str:
        """Global name of the topic; of a port, the topic that it is connected to now."""
        return self._endpoint.topic

    resolved_name = name

    def connect(self, topic: str) -> None:
        """Connect it to its first topic, or withdraw it."""
        try:
            self._context.runtime.bus.rewire(self._moves(topic))
        except BaseException:
            self.unregister()
            raise

    def _moves(self, topic: str) -> Sequence[tuple[Endpoint, str]]:
        return [(self._endpoint, topic)]

    def unregister(self) -> None:
        self._context.release(self._endpoint)


class Publisher(_Handle):
    """Publishes messages; use it as a ``rospy.Publisher``."""

    def __init__(
        self, context: Context, name: str, publication: Publication, listener: Any = None
    ) -> None:
        """Make a handle on a publication; ``name`` is for errors and logs."""
        super().__init__(context, publication, publication.datatype)
        #: Publish a message or its fields. It is the publication's own method: no call in between.
        self.publish: Callable[..., None] = publication.publish
        self.publication = publication
        self._events: SubscriberEvents | None = None
        if listener is not None:
            self._events = SubscriberEvents(context, name, publication, listener)
            context.close_with(self._events)

    def get_num_connections(self) -> int:
        """Count the subscribers: one for each node outside, one for this process."""
        return len(self.publication.peers()[1])

    @property
    def is_watched(self) -> bool:
        """Whether a listener is notified of its subscribers."""
        return self._events is not None

    def unregister(self) -> None:
        """Withdraw it; publishing raises ``rospy.ROSException`` afterwards."""
        refusal = self.publication.refusal

        def refuse(*args: Any, **kwds: Any) -> None:
            raise refusal()

        self.publish = refuse
        if self._events is not None:
            self._context.forget(self._events)
            self._events.close()
        self._withdraw()

    def _withdraw(self) -> None:
        super().unregister()


class Subscriber(_Handle):
    """Receives messages; use it as a ``rospy.Subscriber``."""

    def __init__(
        self,
        context: Context,
        name: str,
        datatype: Any,
        callback: Callable[..., Any] | None,
        callback_args: Any,
        queue_size: int | None,
        overlaps: bool = False,
        at_once: bool = False,
        **options: Any,
    ) -> None:
        """Make a handle with a subscription of its own, which is not connected yet.

        If it ``overlaps`` with other callbacks of the nodelet it has a strand of its own, which
        runs ``at_once``, or after ``on_init``. ``options`` are those of ``Context.subscription``.
        """
        check_message_class(name, datatype)
        strand = context.new_strand(name, at_once) if overlaps else context.strand
        self.subscription = context.subscription(name, datatype, queue_size, strand, **options)
        super().__init__(context, self.subscription, datatype)
        if callback is not None:
            self.registerCallback(callback, *(() if callback_args is None else (callback_args,)))

    def get_num_connections(self) -> int:
        """Count the publishers that are connected; all of this process are one."""
        outside = self.subscription.outside
        return outside.publishers() if outside is not None else 0

    def registerCallback(self, callback: Callable[..., Any], *args: Any) -> int:  # noqa: N802
        """Call back with each message and ``args`` too, as message_filters expects of its inputs.

        Returns the number of the callback.
        """
        return self.subscription.add(callback, args)

    def unregister(self) -> None:
        """Stop receiving; messages that wait are dropped."""
        super().unregister()
        self._context.drop_strand(self.subscription.strand)


class SubscriberEvents(Closable):
    """Notifies a listener of the peers of one publication, on the nodelet's strand, as rospy does.

    A lazy nodelet works only while it has subscribers: its publisher has a ``subscriber_listener``
    (see ``rospy.SubscribeListener``) that subscribes to the nodelet's inputs in
    ``peer_subscribe``.

    No record is kept of joins and leaves. A change of the peers only asks for a comparison of the
    present peers with those that the listener knows of. So the listener and
    ``get_num_connections`` agree however a change came about: a subscriber of this process or of
    another, a publication that moves to another topic, a subscription that does.
    """

    def __init__(
        self, context: Context, name: str, publication: Publication, listener: Any
    ) -> None:
        self._context = context
        self._what = f"the subscriber listener of '{name}'"
        self._publication = publication
        self._listener = listener
        self._known: dict[tuple[str, Any], None] = {}
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
            self._context.strand.post(self._compare)

    def _compare(self) -> None:
        self._due = False  # first: a later change is compared again
        listener = self._listener
        if listener is None:
            return
        topic, peers = self._publication.peers()
        present = [(topic, peer) for peer in peers]
        # Joins first: a lazy nodelet must not stop its inputs at a move between topics.
        for each in [each for each in present if each not in self._known]:
            self._known[each] = None
            to_peer = functools.partial(self._publication.publish_to, *each)
            self._notify(listener.peer_subscribe, topic, self._publication.publish, to_peer)
        for each in [each for each in self._known if each not in present]:
            del self._known[each]
            self._notify(listener.peer_unsubscribe, each[0], len(self._known))

    def _notify(self, method: Callable[..., Any], *args: Any) -> None:
        try:
            method(*args)
        except BaseException as error:  # the boundary: the other peers are reported all the same
            self._context.failed(self._what, error)
