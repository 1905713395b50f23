# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The base class of nodelets, and the plain NodeHandle that it hands out.

The handle has rospy's API in the name and on the queue of one nodelet. This one declares topics;
derived from it, the one of ``dyknow.proxy`` declares ports.
"""

from __future__ import annotations

import contextlib
import threading
from typing import Any, Callable

from dyknow import names
from dyknow.errors import HandleClosed, described
from dyknow.nodelet.context import Context
from dyknow.nodelet.middleware import Closable
from dyknow.nodelet.streams import pubsub
from dyknow.nodelet.timers import Timer

DEFAULT_BUFF_SIZE = 65536  # rospy's default, in bytes


class PlainNodeHandle:
    """rospy's functions for one nodelet: ``rospy.X`` becomes ``handle.X``.

    Relative names begin in ``namespace``, a ``~`` stands for the nodelet. The members that depend
    on neither names nor queues (``Time``, ``Duration``, ``Rate``, ``loginfo``, ``ROSException`` …)
    are rospy's own. The signatures are rospy's too, and written here alone.
    """

    _place = "on"  # the preposition of a message's origin, in errors

    def __init__(self, context: Context, namespace: str, concurrent: bool = False) -> None:
        """Make a handle; relative names begin in ``namespace``.

        Callbacks of a ``concurrent`` one may overlap (each subscription keeps its order).
        """
        self.context = context
        self.namespace = namespace
        self.concurrent = concurrent

    def __getattr__(self, name: str) -> Any:
        """Return a member that is the same in ROS."""
        if name.startswith("__"):
            raise AttributeError(name)
        return self.context.runtime.node.member(name, self)

    # Names

    def resolve_name(self, name: str, caller_id: str | None = None) -> str:
        """Make a name global and remap it: the load request's table first, then the process's.

        As in rospy, ``~`` alone is the nodelet's own namespace, with a slash at its end, and names
        of parameters may have any characters.
        """
        private = caller_id or self.context.name
        namespace = self.namespace if caller_id is None else names.parent(caller_id)
        resolved = names.complete(name, namespace, private)
        if resolved.endswith("/"):  # all parameters below, in get_param("~")
            return resolved
        if resolved in self.context.remappings:
            return self.context.remappings[resolved]
        return self.context.runtime.node.remap(resolved)

    def get_name(self) -> str:
        """Global name of the nodelet."""
        return self.context.name

    get_caller_id = get_name  #: rospy's other name for it

    def get_namespace(self) -> str:
        """Namespace of the nodelet, with a slash at its end as in rospy."""
        return names.parent(self.context.name).rstrip("/") + "/"

    # Topics

    def Publisher(  # noqa: N802
        self,
        name: str,
        data_class: Any,
        subscriber_listener: Any = None,
        tcp_nodelay: bool = False,
        latch: bool = False,
        headers: Any = None,
        queue_size: int | None = None,
    ) -> pubsub.Publisher:
        """Publish on a topic; the arguments are those of ``rospy.Publisher``."""
        options = _given(tcp_nodelay=tcp_nodelay, headers=headers)
        return self._make_publisher(
            name, data_class, latch, queue_size, subscriber_listener, **options
        )

    def Subscriber(  # noqa: N802
        self,
        name: str,
        data_class: Any,
        callback: Callable[..., Any] | None = None,
        callback_args: Any = None,
        queue_size: int | None = None,
        buff_size: int = DEFAULT_BUFF_SIZE,
        tcp_nodelay: bool = False,
    ) -> pubsub.Subscriber:
        """Subscribe to a topic; the arguments are those of ``rospy.Subscriber``."""
        options = _given(buff_size=buff_size)
        return self._make_subscriber(
            name, data_class, callback, callback_args, queue_size, self.concurrent, **options
        )

    def wait_for_message(self, topic: str, topic_type: Any, timeout: Any = None) -> Any:
        """Block until one message arrives; the nodelet's queue is not needed for it.

        Raises:
            ROSException: nothing came within ``timeout`` (seconds, or a Duration).
            ROSInterruptException: the nodelet was unloaded meanwhile.
        """
        if timeout is not None:
            seconds = max(0.0, self.context.runtime.timers.ticker.seconds_of(timeout))
            timeout = min(seconds, threading.TIMEOUT_MAX)
        inbox, subscriber = Inbox(self.context), None
        try:
            with contextlib.suppress(HandleClosed):  # it was unloaded, which ends the wait at once
                subscriber = self._make_subscriber(
                    topic, topic_type, inbox.put, None, 1, overlaps=True, at_once=True
                )
            return inbox.get(f"a message {self._place} '{topic}'", timeout)
        finally:
            if subscriber is not None:
                subscriber.unregister()

    # On topics here, and on ports in ``dyknow.proxy``.

    def _make_publisher(
        self,
        name: str,
        datatype: Any,
        latch: bool,
        queue_size: int | None,
        listener: Any,
        **options: Any,
    ) -> pubsub.Publisher:
        topic = self.resolve_name(names.check(name, "topic name"))
        publication = self.context.publication(name, datatype, latch, queue_size, **options)
        publisher = pubsub.Publisher(self.context, name, publication, listener)
        publisher.connect(topic)
        return publisher

    def _make_subscriber(
        self, name: str, datatype: Any, *args: Any, **options: Any
    ) -> pubsub.Subscriber:
        topic = self.resolve_name(names.check(name, "topic name"))
        subscriber = pubsub.Subscriber(self.context, name, datatype, *args, **options)
        subscriber.connect(topic)
        return subscriber

    # Services, parameters, time

    def Service(  # noqa: N802
        self,
        name: str,
        service_class: Any,
        handler: Callable[[Any], Any],
        buff_size: int = DEFAULT_BUFF_SIZE,
        error_handler: Any = None,
    ) -> Service:
        """Offer a service; its handler runs on the nodelet's queue, between its callbacks."""
        options = _given(buff_size=buff_size, error_handler=error_handler)
        service = self.resolve_name(names.check(name, "service name"))
        return Service(self.context, service, service_class, handler, self.concurrent, options)

    def Timer(  # noqa: N802
        self,
        period: Any,
        callback: Callable[[Any], None],
        oneshot: bool = False,
        reset: bool = False,
    ) -> Timer:
        """Call back every ``period`` (a Duration), on the nodelet's queue.

        It follows simulated time; when that goes back, the next call is one period later whatever
        ``reset`` says.
        """
        strand = self.context.new_strand("timer") if self.concurrent else self.context.strand
        seconds = self.context.runtime.timers.ticker.seconds_of(period)
        return self.context.timer(seconds, callback, strand, oneshot)

    # Life

    def is_shutdown(self) -> bool:
        """Whether the nodelet is unloaded or the process ends."""
        return self.context.closed or self.context.runtime.node.is_shutdown()

    def on_shutdown(self, h: Callable[[], None]) -> None:
        """Call ``h`` when the nodelet is unloaded, or at once if it is."""
        if not callable(h):
            raise TypeError(f"on_shutdown expects a function, not {h!r}")
        if self.context.closed:
            h()
        else:
            self.context.shutdown_hooks.append(h)

    def signal_shutdown(self, reason: str = "") -> None:
        """Unload this nodelet; its neighbours and the process go on."""
        self.context.unload()


def _given(**options: Any) -> Any:
    return {key: value for key, value in options.items() if value and value != DEFAULT_BUFF_SIZE}


class Inbox(Closable):
    """Hands one message from a callback to a thread that waits for it."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._entries: list[Any] = []  # the first one counts
        self._has_one = threading.Event()
        self.putting = 0  # the thread that is about to put the message, if that is known

    def put(self, message: Any) -> None:
        self._put((message,))

    def close(self) -> None:
        """End the wait, unless the thread that calls is about to put the message."""
        if threading.get_ident() != self.putting:
            self._put(None)

    def get(self, what: str, timeout: float | None) -> Any:
        """Wait for the message."""
        node = self._context.runtime.node
        self._context.close_with(self)
        try:
            if not self._has_one.wait(timeout):
                raise node.timed_out(f"{what} did not come within {timeout:g} s")
        finally:
            self._context.forget(self)
        entry = self._entries.pop(0)  # it may hold the caller
        if entry is None:
            unloaded = f"nodelet {self._context.name} was unloaded"
            end = unloaded if self._context.closed else "it was shut down"
            raise node.interrupted(f"{what}: {end}")
        return entry[0]

    def _put(self, entry: Any) -> None:
        self._entries.append(entry)
        self._has_one.set()


class Service(Closable):
    """An offered service; use it as a ``rospy.Service``.

    It is called on any thread, and answered on the nodelet's queue.
    """

    def __init__(
        self,
        context: Context,
        resolved_name: str,
        service_class: Any,
        handler: Callable[[Any], Any],
        concurrent: bool,
        options: dict[str, Any],
    ) -> None:
        self.resolved_name = resolved_name
        self.service_class = service_class
        self.handler = handler
        self._context = context
        self._concurrent = concurrent
        self._waiting: set[Inbox] = set()
        if context.closed:  # its name may be that of another nodelet by now
            raise context.runtime.node.closed(f"nodelet {context.name}")
        self._offered = context.runtime.services.offer(
            resolved_name, service_class, self._call, options, context.name
        )
        context.close_with(self)

    def shutdown(self, reason: str = "") -> None:
        """Withdraw the service; callers that still wait get an error."""
        self._context.forget(self)
        self.close()

    def close(self) -> None:
        """Withdraw the service, and end the waits of its callers."""
        self._offered.close()
        self.handler = _withdrawn  # the handler refers to the nodelet, and that to the service
        for inbox in list(self._waiting):
            inbox.close()

    def _call(self, request: Any) -> Any:
        context = self._context
        inbox = Inbox(context)
        self._waiting.add(inbox)
        strand = context.new_strand(self.resolved_name) if self._concurrent else context.strand

        def answer() -> None:
            inbox.putting = threading.get_ident()
            inbox.put(self._answer(request))

        try:
            strand.post(answer)
            response, error = inbox.get(f"service '{self.resolved_name}'", None)
        finally:
            self._waiting.discard(inbox)
            if self._concurrent:
                context.drop_strand(strand)
        try:
            if error is not None:
                raise error
            return response
        finally:
            del error  # its traceback refers to this frame

    def _answer(self, request: Any) -> tuple[Any, BaseException | None]:
        context = self._context
        began = context.runtime.clock()
        try:
            return self.handler(request), None
        except Exception as error:  # the boundary: raised again where the caller waits
            text = f"service '{self.resolved_name}': {described(error)}"
            context.note_error(text, context.runtime.clock())
            return None, error
        except BaseException as error:  # sys.exit(): must end neither this worker nor the caller
            context.failed(f"service '{self.resolved_name}'", error)
            return None, RuntimeError(f"the handler raised {described(error)}")
        finally:
            context.spend(context.runtime.clock() - began)


def _withdrawn(request: Any) -> Any:
    raise HandleClosed("the service")


class Nodelet:
    """Derive from this, set things up in ``on_init`` and return; callbacks do the rest.

    ``on_init`` runs once, before any callback; its exception makes the load fail and is the
    answer to the request. ``on_shutdown`` runs once at the unload, which waits for it at most 1 s.
    """

    _context: Context | None = None

    def on_init(self) -> None:
        """Create publishers, subscribers, timers and services here."""
        raise NotImplementedError(f"{type(self).__name__} does not define on_init()")

    def on_shutdown(self) -> None:
        """Release resources that no handle made; publishing still works here."""

    def bind(self, context: Context) -> None:
        """Give the nodelet its place; the loader calls this before ``on_init``."""
        self._context = context

    @property
    def context(self) -> Context:
        """The nodelet's share of the runtime."""
        if self._context is None:
            raise RuntimeError(
                f"{type(self).__name__} has no name and no handles before on_init(): "
                "set up there, not in __init__()"
            )
        return self._context

    @property
    def name(self) -> str:
        """Global name."""
        return self.context.name

    @property
    def my_argv(self) -> list[str]:
        """Arguments of the load request."""
        return list(self.context.my_argv)

    @property
    def node_handle(self) -> PlainNodeHandle:
        """Handle in the namespace that the nodelet stands in; callbacks never overlap."""
        return PlainNodeHandle(self.context, names.parent(self.name))

    @property
    def private_node_handle(self) -> PlainNodeHandle:
        """Handle in the nodelet's own namespace; callbacks never overlap."""
        return PlainNodeHandle(self.context, self.name)

    @property
    def mt_node_handle(self) -> PlainNodeHandle:
        """Like ``node_handle``; callbacks of different subscriptions may overlap."""
        return PlainNodeHandle(self.context, names.parent(self.name), concurrent=True)

    @property
    def mt_private_node_handle(self) -> PlainNodeHandle:
        """Like ``private_node_handle``; callbacks of different subscriptions may overlap."""
        return PlainNodeHandle(self.context, self.name, concurrent=True)
