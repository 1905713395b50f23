# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""rospy as a guest sees it: in its own name, on its own topics, until its own end.

``rospy.timer`` (``Rate``, ``Timer``, ``sleep``) is a copy of rospy's own module, which sleeps and
ends by the views below.
"""

from __future__ import annotations

import functools
import threading
from typing import Any, Callable, Dict, List, Mapping, Optional, Type

import genpy
import rospy
import rospy.client
import rospy.core
import rospy.impl.tcpros_service
import rospy.names
import rospy.rostime
import rospy.service
import rospy.topics

from dyknow import names
from dyknow.errors import HandleClosed
from dyknow.nodelet import pubsub
from dyknow.nodelet.handle import DEFAULT_BUFF_SIZE, PlainNodeHandle
from dyknow.nodelet.importer import Module, View
from dyknow.ros.scripts.connections import PublisherImpl, SubscriberImpl
from dyknow.ros.scripts.finalizers import outside_of_finalizers
from dyknow.ros.scripts.guest import Guest
from dyknow.ros.scripts.message_copies import copy_as, copy_of
from dyknow.ros.transport.anymsg import connection_header

#: The submodules that are views; below rospy, everything else is the process's.
_SUBMODULES = ("client", "core", "names", "rostime", "service", "topics")
#: The submodule of which a guest has a copy.
COPIED = "rospy.timer"
_TIMING = ("Rate", "Timer", "sleep")
#: Functions that are those of the guest's handle.
_OF_HANDLE = "get_param get_param_cached set_param has_param delete_param search_param".split()
#: Functions that are rospy's own for a guest with a process of its own.
_OF_NODE = "get_name get_caller_id get_namespace".split()
_LOGS = [name for name in dir(rospy) if name.startswith("log") and name != "logout"]


def rospy_views(
    guest: Guest, init_node: Callable[..., None], timer: Callable[[], Module]
) -> Dict[str, Callable[[], Module]]:
    """Return what makes the views of rospy and its submodules, by name.

    Args:
        guest: whose they are.
        init_node: is called as ``rospy.init_node``.
        timer: returns the guest's copy of ``rospy.timer``.
    """
    members = _members(guest, init_node)
    views: Dict[str, Module] = {f"rospy.{n}": _submodule(n, members) for n in _SUBMODULES}
    top = _Rospy({key: value for key, value in members.items() if hasattr(rospy, key)}, timer)
    for name, view in views.items():
        setattr(top, name.rpartition(".")[2], view)
    views["rospy"] = top
    return {name: functools.partial(_same, view) for name, view in views.items()}


class _Rospy(View):
    """rospy itself, whose ``Rate``, ``Timer`` and ``sleep`` are those of the guest's copy."""

    def __init__(self, members: Mapping[str, Any], timer: Callable[[], Module]) -> None:
        super().__init__(rospy, members)
        self.__dict__["_timer"] = timer

    def __getattr__(self, name: str) -> Any:
        if name != "timer" and name not in _TIMING:
            return getattr(rospy, name)
        timer = self.__dict__["_timer"]()  # waits for another thread that imports it just now
        return timer if name == "timer" else getattr(timer, name)


def _same(view: Module) -> Module:
    return view


def _submodule(name: str, members: Mapping[str, Any]) -> View:
    real = getattr(rospy, name)
    return View(real, {key: value for key, value in members.items() if hasattr(real, key)})


def _members(guest: Guest, init_node: Callable[..., None]) -> Dict[str, Any]:
    def handle() -> Any:
        """The guest's handle; rospy itself while it has none."""
        return guest.handle or rospy

    def of_handle(name: str) -> Callable[..., Any]:
        def call(*args: Any, **kwds: Any) -> Any:
            guest.waits()
            return getattr(handle(), name)(*args, **kwds)

        return call

    def wait_for_service(service: str, timeout: Any = None) -> None:
        _wait_for_service(guest, handle().resolve_name(service), timeout)

    def wait_for_message(topic: str, topic_type: Any, timeout: Any = None) -> Any:
        heard: List[Any] = []
        came = threading.Event()

        def receive(message: Any) -> None:
            heard.append(message)
            came.set()

        subscriber = members["Subscriber"](topic, topic_type, receive)
        try:
            _wait(guest, came.wait, timeout, f"message on topic {topic}")
        finally:
            subscriber.unregister()
        return heard[0]

    def resolve_name(name: str, caller_id: Optional[str] = None) -> str:
        if caller_id is None and hasattr(guest.handle, "tell_name"):
            return str(handle().tell_name(name))
        return str(handle().resolve_name(name, caller_id))

    def remap_name(name: str, caller_id: Optional[str] = None, resolved: bool = True) -> str:
        if guest.handle is None:
            return str(rospy.remap_name(name, caller_id, resolved))
        global_name = names.complete(name, guest.handle.namespace, guest.handle.get_name())
        remapped = resolve_name(name, caller_id)
        return name if remapped == global_name else remapped

    def spin() -> None:
        if guest.handle is None:
            raise rospy.ROSInitException("client code must call rospy.init_node() first")
        guest.waits()
        guest.closing.wait()

    def wallsleep(duration: Any) -> None:
        seconds = duration.to_sec() if isinstance(duration, genpy.Duration) else duration
        guest.rest(seconds)

    def get_rostime_cond() -> Any:
        guest.waits()
        return rospy.rostime.get_rostime_cond()

    def get_mappings() -> Dict[str, str]:
        return dict(guest.context.remappings) if guest.context is not None else {}

    def logger(name: str) -> Callable[..., Any]:
        # A partial adds no frame: rospy tells call sites apart by their frames.
        if guest.is_alone:
            return getattr(rospy, name)  # type: ignore[no-any-return]
        title = guest.name.strip("/").replace("/", ".")
        return functools.partial(getattr(rospy, name), logger_name=title)

    members: Dict[str, Any] = {name: of_handle(name) for name in _OF_HANDLE}
    members.update({name: logger(name) for name in _LOGS})
    members.update(
        init_node=init_node,
        myargv=lambda argv=None: rospy.myargv(guest.argv if argv is None else argv),
        is_initialized=lambda: guest.handle is not None,
        # names
        get_name=lambda: handle().get_name(),
        get_caller_id=lambda: handle().get_name(),
        get_namespace=lambda: handle().get_namespace(),
        resolve_name=resolve_name,
        remap_name=remap_name,
        get_mappings=get_mappings,
        get_resolved_mappings=get_mappings,
        # topics and services
        Publisher=_bound(GuestPublisher, guest),
        Subscriber=_bound(GuestSubscriber, guest),
        Service=_bound(GuestService, guest),
        ServiceProxy=_bound(GuestServiceProxy, guest),
        wait_for_message=wait_for_message,
        wait_for_service=wait_for_service,
        # time
        wallsleep=wallsleep,
        get_rostime_cond=get_rostime_cond,
        # the end
        spin=spin,
        is_shutdown=lambda: guest.closing.is_set() or rospy.is_shutdown(),
        is_shutdown_requested=lambda: guest.is_ending or rospy.core.is_shutdown_requested(),
        signal_shutdown=guest.signal_shutdown,
        on_shutdown=guest.hooks.append,
        add_client_shutdown_hook=guest.hooks.append,
        add_preshutdown_hook=guest.hooks_before.append,
        add_shutdown_hook=guest.hooks_after.append,
    )
    if guest.is_alone:
        for name in _OF_NODE:
            del members[name]
        members.update({name: _remapping(guest, name) for name in _OF_HANDLE})
        members["get_mappings"] = lambda: dict(guest.mappings)
    return members


def _remapping(guest: Guest, name: str) -> Callable[..., Any]:
    """Return rospy's function for parameters, which in this process knows no remappings."""

    def remapped(param_name: str) -> str:
        if name == "search_param":  # in rospy, too, a search begins with the name as it is given
            return guest.mappings.get(param_name, param_name)
        if not param_name or not isinstance(param_name, str) or guest.context is None:
            return param_name
        return guest.context.remappings.get(rospy.resolve_name(param_name), param_name)

    def call(param_name: str, *args: Any, **kwds: Any) -> Any:
        return getattr(rospy, name)(remapped(param_name), *args, **kwds)

    return call


def _wait(guest: Guest, condition: Callable[[float], bool], timeout: Any, what: str) -> None:
    """Wait for something as rospy does.

    Raises:
        ROSException: it took too long.
        ROSInterruptException: the guest is to end.
    """
    seconds = timeout.to_sec() if isinstance(timeout, genpy.Duration) else timeout
    if not guest.wait_for(lambda left: guest.closing.is_set() or condition(left), seconds):
        raise rospy.ROSException(f"timeout exceeded while waiting for {what}")
    if guest.closing.is_set():
        guest.pause(0.0)
        raise rospy.ROSInterruptException("rospy shutdown")


def _wait_for_service(guest: Guest, name: str, timeout: Any) -> None:
    def is_there(seconds: float) -> bool:
        try:
            rospy.wait_for_service(name, max(seconds, _LEAST))
        except rospy.ROSInterruptException:
            raise
        except rospy.ROSException:
            return False
        return True

    _wait(guest, is_there, timeout, f"service {name}")


def _bound(base: Type[Any], guest: Guest) -> Type[Any]:
    """A class of the guest's own, so that it can derive from it."""
    return type(base.__name__[len("Guest") :], (base,), {"guest": guest, "__doc__": base.__doc__})


def _gone(request: Any) -> Any:
    raise HandleClosed("the service")


class _Topic:
    """What rospy's publishers and subscribers have in common."""

    guest: Guest
    reg_type = ""

    def __init__(self, name: str, data_class: Any) -> None:
        if not name or not isinstance(name, str):
            raise ValueError("topic name is not a non-empty string")
        is_class = isinstance(data_class, type) and issubclass(data_class, genpy.Message)
        if not is_class:
            raise ValueError(f"data_class [{data_class}] is not a message data class")
        self._given = name
        self.data_class = data_class
        self.type = data_class._type
        self.md5sum = data_class._md5sum
        self._end: Any = None
        self.guest.ends.add(self)

    def let_go(self) -> None:
        """Drop the callback at the end of the guest."""

    @property
    def name(self) -> str:
        """Global name of its topic; before ``init_node``, the name that was given."""
        return self._end.name if self._end is not None else self._given

    resolved_name = name

    def get_num_connections(self) -> int:
        """Count the nodes at the other end."""
        return self._end.get_num_connections() if self._end is not None else 0

    def unregister(self) -> None:
        """End it."""
        if self._end is not None:
            outside_of_finalizers(self._end.unregister)


class GuestPublisher(_Topic):
    """``rospy.Publisher``, of a guest."""

    reg_type = "pub"
    _end: Optional[pubsub.Publisher]

    def __init__(
        self,
        name: str,
        data_class: Any,
        subscriber_listener: Any = None,
        tcp_nodelay: bool = False,
        latch: bool = False,
        headers: Any = None,
        queue_size: Optional[int] = None,
    ) -> None:
        """Advertise; the arguments are those of ``rospy.Publisher``."""
        super().__init__(name, data_class)
        self._header = connection_header(data_class, latch)
        options = (subscriber_listener, tcp_nodelay, latch, headers, queue_size or _QUEUE)

        def make(handle: PlainNodeHandle) -> None:
            self._end = handle.Publisher(name, data_class, *options)
            self._header["callerid"] = handle.get_name()

        self.guest.with_handle(make)

    def publish(self, *args: Any, **kwds: Any) -> None:
        """Publish a message, or one made of its fields."""
        if self._end is None:
            raise rospy.ROSException("rospy.init_node() has not been called")
        message = rospy.msg.args_kwds_to_message(self.data_class, args, kwds)
        if self.guest.copies:
            message = copy_of(message)
            message._connection_header = dict(self._header, topic=self._end.name)
        try:
            self._end.publish(message)
        except HandleClosed:
            if not self.guest.closing.is_set():
                raise
            # As in rospy: who publishes while the topics are closed cannot know it yet.

    @property
    def impl(self) -> PublisherImpl:
        """What libraries ask rospy's inside for."""
        return PublisherImpl(self._end, self.guest.context)


class GuestSubscriber(_Topic):
    """``rospy.Subscriber``, of a guest."""

    reg_type = "sub"
    _end: Optional[pubsub.Subscriber]

    def __init__(
        self,
        name: str,
        data_class: Any,
        callback: Optional[Callable[..., Any]] = None,
        callback_args: Any = None,
        queue_size: Optional[int] = None,
        buff_size: int = DEFAULT_BUFF_SIZE,
        tcp_nodelay: bool = False,
    ) -> None:
        """Subscribe; the arguments are those of ``rospy.Subscriber``."""
        super().__init__(name, data_class)
        self.callback = callback
        self.callback_args = callback_args
        receive = self._copying(callback) if callback is not None else None
        options = (callback_args, queue_size, buff_size, tcp_nodelay)

        def make(handle: PlainNodeHandle) -> None:
            self._end = handle.Subscriber(name, data_class, receive, *options)

        self.guest.with_handle(make)

    def let_go(self) -> None:
        """Drop the callback at the end of the guest."""
        self.callback = self.callback_args = None

    def _copying(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        call = self.guest.call
        if not self.guest.copies:
            return functools.partial(call, callback)
        datatype, header = self.data_class, connection_header(self.data_class, False)

        def receive(message: Any, *args: Any) -> None:
            own = copy_as(datatype, message)
            if getattr(own, "_connection_header", None) is None:
                own._connection_header = dict(header, topic=self.name)
            call(callback, own, *args)

        return receive

    @property
    def impl(self) -> SubscriberImpl:
        """What libraries ask rospy's inside for."""
        return SubscriberImpl(self._end, self.guest.context)


class GuestService:
    """``rospy.Service``, of a guest."""

    guest: Guest

    def __init__(
        self,
        name: str,
        service_class: Any,
        handler: Callable[[Any], Any],
        buff_size: int = DEFAULT_BUFF_SIZE,
        error_handler: Any = None,
    ) -> None:
        """Offer a service; the arguments are those of ``rospy.Service``."""
        self.service_class = service_class
        self.handler = handler
        self.resolved_name = name
        self._offered: Any = None
        self.guest.ends.add(self)
        answer = functools.partial(self.guest.call, handler)

        def make(handle: PlainNodeHandle) -> None:
            self._offered = handle.Service(name, service_class, answer, buff_size, error_handler)
            self.resolved_name = self._offered.resolved_name

        self.guest.with_handle(make)

    def let_go(self) -> None:
        """Drop the handler at the end of the guest."""
        self.handler = _gone

    def shutdown(self, reason: str = "") -> None:
        """Withdraw it."""
        if self._offered is not None:
            outside_of_finalizers(functools.partial(self._offered.shutdown, reason))

    def spin(self) -> None:
        """Wait for the end."""
        self.guest.waits()
        self.guest.closing.wait()


class GuestServiceProxy(rospy.ServiceProxy):
    """``rospy.ServiceProxy``, of a guest."""

    guest: Guest

    def __init__(
        self, name: str, service_class: Any, persistent: bool = False, headers: Any = None
    ) -> None:
        """Make it; the arguments are those of ``rospy.ServiceProxy``."""
        handle = self.guest.handle
        resolved = handle.resolve_name(name) if handle is not None else name
        super().__init__(resolved, service_class, persistent, headers)

    def wait_for_service(self, timeout: Any = None) -> None:
        """Wait until the service is there."""
        _wait_for_service(self.guest, self.resolved_name, timeout)


#: What rospy does without a bound is done with a generous one.
_QUEUE = 1000
#: Seconds for a look at a service; rospy accepts no 0.
_LEAST = 0.001
