"""The state behind ``Publisher`` and ``Subscriber`` handles."""

from __future__ import annotations

from typing import Any, Callable, List, Optional, Tuple

from dyknow.nodelet.context import Context
from dyknow.nodelet.endpoints import Publication
from dyknow.nodelet.scheduler import Strand
from dyknow.nodelet.subscriber_events import SubscriberEvents

Callback = Callable[..., Any]


class PublisherState:
    """A publication that belongs to one handle."""

    def __init__(
        self, context: Context, name: str, publication: Publication, listener: Any = None
    ) -> None:
        """Make the state of one handle.

        Args:
            context: the owner.
            name: what it is called in errors and logs.
            publication: what the handle publishes through.
            listener: told who listens, as rospy's ``subscriber_listener``; None for nobody.
        """
        self.context = context
        self.name = name
        self.publication = publication
        self._events: Optional[SubscriberEvents] = None
        if listener is not None:
            what = f"the subscriber listener of '{name}'"
            self._events = SubscriberEvents(
                publication, listener, context.strand, lambda error: context.failed(what, error)
            )

    def closed(self) -> Exception:
        """Make the exception for a use after ``unregister``."""
        what = f"publisher '{self.name}' of {self.context.name}"
        return self.context.runtime.node.closed(what)

    def unregister(self) -> None:
        """Withdraw the publication."""
        self.stop_telling()
        self.context.release(self.publication)

    def stop_telling(self) -> None:
        """Leave the subscriber listener alone from now on."""
        if self._events is not None:
            self._events.close()


class SubscriberState:
    """A subscription and the callbacks that it feeds."""

    def __init__(
        self,
        context: Context,
        name: str,
        datatype: Any,
        callback: Optional[Callback],
        callback_args: Any,
        queue_size: Optional[int],
        strand: Strand,
        **options: Any,
    ) -> None:
        """Make a subscription that is not connected yet.

        Args:
            context: the owner.
            name: what it is called in errors and logs.
            datatype: message class.
            callback: called with each message; more can be added.
            callback_args: given to ``callback`` after the message, unless None, as in rospy.
            queue_size: messages that wait at most.
            strand: where the callbacks run; one of its own goes with the subscription.
            options: for the outside half.
        """
        self.context = context
        self.name = name
        self.datatype = datatype
        self._strand = strand
        self._callbacks: Tuple[Tuple[Callback, Tuple[Any, ...]], ...] = ()
        if callback is not None:
            args = () if callback_args is None else (callback_args,)
            self._callbacks = ((callback, args),)
        plain = callback is not None and callback_args is None
        self.subscription = context.subscription(
            name,
            datatype,
            callback if plain and callback is not None else self._spread,
            queue_size,
            strand,
            **options,
        )

    def add_callback(self, callback: Callback, args: Tuple[Any, ...]) -> int:
        """Call back with the message and ``args`` too; returns the number of the callback."""
        self._callbacks = (*self._callbacks, (callback, args))
        adapt = self.context.runtime.transport.adapt
        self.subscription.receive = adapt(self.datatype, self._spread)
        return len(self._callbacks) - 1

    def _spread(self, message: Any) -> None:
        errors: List[BaseException] = []
        for callback, args in self._callbacks:
            try:
                callback(message, *args)
            except BaseException as error:  # the boundary, for each callback by itself
                errors.append(error)
        for raised in errors:
            self.subscription.failed(raised)

    def unregister(self) -> None:
        """Stop receiving."""
        self.context.release(self.subscription)
        self.context.drop_strand(self._strand)
