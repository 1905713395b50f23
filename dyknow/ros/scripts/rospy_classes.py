# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``rospy.Publisher``, ``Subscriber``, ``Service`` and ``ServiceProxy`` of a sandbox.

Their arguments are those of rospy's classes. ``impl`` has the internals that libraries read:
actionlib uses ``publisher.impl.has_connection(node)`` and ``subscriber.impl.connections``.
"""

from __future__ import annotations

import functools
import inspect
from dataclasses import dataclass
from typing import Any, Callable

import genpy
import rospy

from dyknow.errors import HandleClosed
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.nodelet.streams import pubsub
from dyknow.ros.scripts.sandbox import Sandbox, outside_of_finalizers
from dyknow.ros.transport.conversions import connection_header, copy_of
from dyknow.ros.transport.node import is_offered_within

#: rospy's queues have no bound by default; ours have a generous one.
_QUEUE = 1000
#: Seconds for one check of a service; rospy accepts no 0.
_LEAST = 0.001


def wait_for(
    sandbox: Sandbox, condition: Callable[[float], bool], timeout: Any, what: str
) -> None:
    """Wait for something, with rospy's exceptions."""
    seconds = timeout.to_sec() if isinstance(timeout, genpy.Duration) else timeout
    if not sandbox.wait_for(lambda left: sandbox.closing.is_set() or condition(left), seconds):
        raise rospy.ROSException(f"timeout exceeded while waiting for {what}")
    if sandbox.closing.is_set():
        sandbox.pause(0.0)
        raise rospy.ROSInterruptException("rospy shutdown")


def wait_for_service(sandbox: Sandbox, name: str, timeout: Any) -> None:
    """Wait until a service is there, as rospy does."""
    wait_for(
        sandbox,
        lambda seconds: is_offered_within(name, max(seconds, _LEAST)),
        timeout,
        f"service {name}",
    )


def _arguments(rospy_class: type[Any], *args: Any, **kwds: Any) -> dict[str, Any]:
    """Return the arguments of one of rospy's classes by name, with its defaults."""
    bound = inspect.signature(rospy_class.__init__).bind(None, *args, **kwds)
    bound.apply_defaults()
    arguments = dict(bound.arguments)
    del arguments["self"]
    return arguments


@dataclass(frozen=True)
class NodeletLink:
    """A nodelet of this process at the other end, as rospy's transports describe nodes."""

    endpoint_id: str
    done: bool = False
    transport_type: str = "INTRAPROCESS"

    @property
    def callerid_pub(self) -> str:
        return self.endpoint_id


class _Impl:
    """The connections of one end of a topic, as rospy's ``impl`` has them."""

    def __init__(self, end: Any, context: Context | None) -> None:
        self._end = end
        self._context = context

    @property
    def connections(self) -> list[Any]:
        """One for each node, rospy's own for those outside."""
        end = self._end
        if end is None or self._context is None:
            return []
        publishers, subscribers = self._context.runtime.bus.owners(end.name)
        if isinstance(end, pubsub.Subscriber):
            source = end.subscription.outside
            return [*map(NodeletLink, publishers), *(source.links() if source is not None else ())]
        outside = end.publication.outside
        peers = outside.peers() if outside is not None else ()
        return [*map(NodeletLink, subscribers), *(p for p in peers if hasattr(p, "endpoint_id"))]

    def has_connections(self) -> bool:
        return bool(self.connections)

    def get_num_connections(self) -> int:
        return len(self.connections)

    def has_connection(self, endpoint_id: str) -> bool:
        return any(each.endpoint_id == endpoint_id for each in self.connections)

    def get_stats(self) -> tuple[str, list[tuple[int, int, int, int, bool]]]:
        """The topic, and an entry for each connection; of that, only the last is known: alive."""
        topic = "" if self._end is None else self._end.name
        return topic, [(n, 0, 0, 0, True) for n, _ in enumerate(self.connections)]


class _Topic:
    """Common members of rospy's publishers and subscribers."""

    sandbox: Sandbox
    reg_type = ""

    def __init__(self, arguments: dict[str, Any]) -> None:
        name = arguments["name"]
        data_class: Any = arguments["data_class"]
        if not name or not isinstance(name, str):
            raise ValueError("topic name is not a non-empty string")
        is_class = isinstance(data_class, type) and issubclass(data_class, genpy.Message)
        if not is_class:
            raise ValueError(f"data_class [{data_class}] is not a message data class")
        self._given: str = name
        self.data_class = data_class
        self.type = data_class._type
        self.md5sum = data_class._md5sum
        self._end: Any = None
        self._is_gone = False  # perhaps before ``init_node``

    @property
    def name(self) -> str:
        """Global name of its topic; before ``init_node``, the name that was given."""
        return str(self._end.name) if self._end is not None else self._given

    resolved_name = name

    @property
    def impl(self) -> _Impl:
        """The internals of rospy that libraries use."""
        return _Impl(self._end, self.sandbox.context)

    def get_num_connections(self) -> int:
        return self._end.get_num_connections() if self._end is not None else 0

    def unregister(self) -> None:
        self._is_gone = True
        if self._end is not None:
            outside_of_finalizers(self._end.unregister)


class SandboxedPublisher(_Topic):
    """``rospy.Publisher`` of a sandbox."""

    reg_type = "pub"

    def __init__(self, *args: Any, **kwds: Any) -> None:
        arguments = _arguments(rospy.Publisher, *args, **kwds)
        super().__init__(arguments)
        arguments["queue_size"] = arguments["queue_size"] or _QUEUE
        self._header = connection_header(self.data_class, arguments["latch"])

        def make(handle: PlainNodeHandle) -> None:
            if not self._is_gone:
                self._end = handle.Publisher(**arguments)
                self._header["callerid"] = handle.get_name()

        self.sandbox.with_handle(make)

    def publish(self, *args: Any, **kwds: Any) -> None:
        if self._end is None:
            raise rospy.ROSException("rospy.init_node() has not been called")
        message = rospy.msg.args_kwds_to_message(self.data_class, args, kwds)
        if self.sandbox.copies:
            message = copy_of(message)
            message._connection_header = dict(self._header, topic=self._end.name)
        try:
            self._end.publish(message)
        except HandleClosed:
            if not self.sandbox.closing.is_set():
                raise
            # As in rospy: code that publishes while its topics are closed cannot know it yet.


class SandboxedSubscriber(_Topic):
    """``rospy.Subscriber`` of a sandbox."""

    reg_type = "sub"

    def __init__(self, *args: Any, **kwds: Any) -> None:
        arguments = _arguments(rospy.Subscriber, *args, **kwds)
        super().__init__(arguments)
        self.callback = arguments["callback"]
        self.callback_args = arguments["callback_args"]
        if self.callback is not None:
            arguments["callback"] = self._copying(self.callback)

        def make(handle: PlainNodeHandle) -> None:
            if not self._is_gone:
                self._end = handle.Subscriber(**arguments)

        self.sandbox.ends.add(self)
        self.sandbox.with_handle(make)

    def let_go(self) -> None:
        """Drop the callback at the end of the sandbox."""
        self.callback = self.callback_args = None

    def _copying(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        call = self.sandbox.call
        if not self.sandbox.copies:
            return functools.partial(call, callback)
        datatype, header = self.data_class, connection_header(self.data_class, False)

        def receive(message: Any, *args: Any) -> None:
            own = copy_of(message, datatype)
            if getattr(own, "_connection_header", None) is None:
                own._connection_header = dict(header, topic=self.name)
            call(callback, own, *args)

        return receive


class SandboxedService:
    """``rospy.Service`` of a sandbox."""

    sandbox: Sandbox

    def __init__(self, *args: Any, **kwds: Any) -> None:
        arguments = _arguments(rospy.Service, *args, **kwds)
        self.service_class = arguments["service_class"]
        self.handler = arguments["handler"]
        self.resolved_name = arguments["name"]
        self._offered: Any = None
        self._is_gone = False  # perhaps before ``init_node``
        arguments["handler"] = functools.partial(self.sandbox.call, self.handler)

        def make(handle: PlainNodeHandle) -> None:
            if not self._is_gone:
                self._offered = handle.Service(**arguments)
                self.resolved_name = self._offered.resolved_name

        self.sandbox.ends.add(self)
        self.sandbox.with_handle(make)

    def let_go(self) -> None:
        """Drop the handler at the end of the sandbox."""
        self.handler = None

    def shutdown(self, reason: str = "") -> None:
        self._is_gone = True
        if self._offered is not None:
            outside_of_finalizers(functools.partial(self._offered.shutdown, reason))

    def spin(self) -> None:
        self.sandbox.waits()
        self.sandbox.closing.wait()


class SandboxedServiceProxy(rospy.ServiceProxy):
    """``rospy.ServiceProxy`` of a sandbox."""

    sandbox: Sandbox

    def __init__(self, name: str, *args: Any, **kwds: Any) -> None:
        handle = self.sandbox.handle
        super().__init__(handle.resolve_name(name) if handle is not None else name, *args, **kwds)

    def wait_for_service(self, timeout: Any = None) -> None:
        wait_for_service(self.sandbox, self.resolved_name, timeout)


def bound_classes(sandbox: Sandbox) -> dict[str, type[Any]]:
    """Return classes of the sandbox's own by name, so that its code can derive from them."""
    classes: tuple[type[Any], ...] = (
        SandboxedPublisher,
        SandboxedSubscriber,
        SandboxedService,
        SandboxedServiceProxy,
    )
    names = (each.__name__[len("Sandboxed") :] for each in classes)
    return {
        name: type(name, (base,), {"sandbox": sandbox, "__doc__": base.__doc__})
        for name, base in zip(names, classes)
    }
