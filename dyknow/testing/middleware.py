# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""ROS as a nodelet in a harness sees it: rospy's types and exceptions, without a master."""

from __future__ import annotations

import copy
import functools
import logging
import re
from dataclasses import dataclass
from typing import Any, Callable, Iterator, Sequence

import rospy
import rospy.msg
import rospy.timer
from rosmaster.paramserver import ParamDictionary
from rospy.impl.tcpros_service import convert_return_to_response

from dyknow.nodelet.local import (
    LocalNode,
    LocalService,
    LocalServices,
    LocalTransport,
    ManualTicker,
)
from dyknow.nodelet.middleware import Converter, Handler, Receive
from dyknow.ros.transport.conversions import built, has_arrays, in_class, receive_in_class
from dyknow.ros.transport.node import ClosedHandle, Interrupted, MessageTimeout

#: Members of rospy that need neither a node nor a master.
_PLAIN = frozenset(
    """Duration AnyMsg Message SubscribeListener Header DEBUG INFO WARN ERROR FATAL
    ROSException ROSInitException ROSInterruptException ROSSerializationException
    ROSInternalException ROSTimeMovedBackwardsException ServiceException
    TransportException TransportInitError TransportTerminated exceptions""".split()
)
_LOG_FUNCTION = re.compile(r"log(debug|info|warn|err|fatal)(_throttle(?:_identical)?|_once)?")
_REQUIRED = object()


@dataclass(frozen=True)
class LogEntry:
    """A log entry of a nodelet.

    Attributes:
        level: ``debug``, ``info``, ``warn``, ``err`` or ``fatal``, as in ``loginfo``.
        text: with its arguments filled in.
    """

    level: str
    text: str


class HarnessTicker(ManualTicker):
    """Time that a test sets, with rospy's events."""

    pause = 0.0

    def event(self, last: Any, expected: float, real: float, duration: Any) -> Any:
        before = (None, None) if last is None else (last.current_expected, last.current_real)
        now = map(rospy.Time.from_sec, (expected, real))
        return rospy.timer.TimerEvent(*before, *now, duration)


class HarnessTransport(LocalTransport):
    """The local transport, with messages made as rospy makes them."""

    def build(self, datatype: Any, args: Sequence[Any], kwds: dict[str, Any]) -> Any:
        """Make a message as ``rospy.Publisher.publish`` does."""
        return built(datatype, args, kwds)

    def converter(self, datatype: Any) -> Converter | None:
        """Return what plain subscribers of ``numpy_msg`` publications need."""
        return in_class if has_arrays(datatype) else None

    def adapt(self, datatype: Any, receive: Receive) -> Receive:
        """Give subscribers of ``rospy.AnyMsg`` and ``numpy_msg`` the messages that they expect."""
        return receive_in_class(datatype, receive)


class HarnessServices(LocalServices):
    """The local services, whose handlers may return whatever rospy makes a response of."""

    def offer(
        self,
        service: str,
        service_class: Any,
        handler: Handler,
        options: dict[str, Any],
        owner: str,
    ) -> LocalService:
        def answer(request: Any) -> Any:
            return convert_return_to_response(handler(request), service_class._response_class)

        return super().offer(service, service_class, answer, options, owner)


class HarnessNode(LocalNode):
    """The local node with rospy's types and exceptions; ``log`` has what the nodelets log."""

    closed = ClosedHandle
    interrupted = Interrupted
    timed_out = MessageTimeout

    def __init__(
        self, ticker: HarnessTicker, services: HarnessServices, call: Callable[[str, Any], Any]
    ) -> None:
        super().__init__()
        self.ticker = ticker
        self.services = services
        self.call = call
        self.log: list[LogEntry] = []

    def member(self, name: str, handle: Any) -> Any:
        """Return rospy's own where that needs no master, else a substitute."""
        if name in _PLAIN:
            return getattr(rospy, name)
        log_function = _LOG_FUNCTION.fullmatch(name)
        if log_function is not None:
            level, variant = log_function.groups("")
            limited = variant.startswith("_throttle")
            return functools.partial(self._log_limited if limited else self._log, level)
        members = _Members(self, handle.resolve_name)
        if name.startswith("_") or not hasattr(members, name):
            raise AttributeError(
                f"a NodeHandle has no '{name}' without ROS; "
                "a test that needs it runs the nodelet in a RosHarness"
            )
        return getattr(members, name)

    def _log(self, level: str, msg: Any, *args: Any, **options: Any) -> None:
        record = logging.LogRecord("", 0, "", 0, msg, args, None)  # which knows a single mapping
        self.log.append(LogEntry(level, record.getMessage()))

    def _log_limited(self, level: str, period: Any, msg: Any, *args: Any, **options: Any) -> None:
        # Every call is an entry: a test wants to see them, however fast its time passes.
        self._log(level, msg, *args)


class _Members:
    """Members of rospy that depend on names, time or a master."""

    def __init__(self, node: HarnessNode, resolve: Callable[[str], str]) -> None:
        self._node = node
        self._resolve = resolve

    @property
    def Time(self) -> Any:  # noqa: N802
        ticker = self._node.ticker

        class Time(rospy.Time):  # type: ignore[misc]
            """``rospy.Time`` whose present is the harness's."""

            @staticmethod
            def now() -> Any:
                return rospy.Time.from_sec(ticker.now())

        return Time

    def get_time(self) -> float:
        return self._node.ticker.now()

    def get_rostime(self) -> Any:
        return rospy.Time.from_sec(self.get_time())

    def get_param(self, param_name: str, default: Any = _REQUIRED) -> Any:
        try:
            return self._tree().get_param(self._resolve(param_name))
        except KeyError:
            if default is _REQUIRED:
                raise
            return default

    get_param_cached = get_param

    def set_param(self, param_name: str, param_value: Any) -> None:
        tree = self._tree()
        tree.set_param(self._resolve(param_name), param_value)
        self._keep(tree)

    def has_param(self, param_name: str) -> bool:
        return bool(self._tree().has_param(self._resolve(param_name)))

    def delete_param(self, param_name: str) -> None:
        tree = self._tree()
        tree.delete_param(self._resolve(param_name))
        self._keep(tree)

    def _tree(self) -> ParamDictionary:
        """Make a copy of the parameters, as a master keeps them."""
        tree = ParamDictionary(None)
        for name, value in self._node.parameters.items():
            tree.set_param(name, copy.deepcopy(value))
        return tree

    def _keep(self, tree: ParamDictionary) -> None:
        parameters = dict(_leaves(tree.get_param("/"), ""))
        self._node.parameters.clear()
        self._node.parameters.update(parameters)

    def ServiceProxy(  # noqa: N802
        self, name: str, service_class: Any, persistent: bool = False, headers: Any = None
    ) -> LocalServiceProxy:
        return LocalServiceProxy(self._node, self._resolve(name), service_class)

    def wait_for_service(self, service: str, timeout: Any = None) -> None:
        """Return if it is offered: while the test's thread waits, no nodelet can offer it."""
        name = self._resolve(service)
        if name not in self._node.services.handlers:
            raise rospy.ROSException(f"service '{name}' is not offered in the harness")


def _leaves(tree: dict[str, Any], namespace: str) -> Iterator[tuple[str, Any]]:
    """Return the values in a tree of parameters by name; an empty dictionary is one, too."""
    for key, value in tree.items():
        name = f"{namespace}/{key}"
        if isinstance(value, dict) and value:
            yield from _leaves(value, name)
        else:
            yield name, value


class LocalServiceProxy:
    """Calls a service of the harness; use it as a ``rospy.ServiceProxy``."""

    def __init__(self, node: HarnessNode, name: str, service_class: Any) -> None:
        self._node = node
        self.resolved_name = name
        self.request_class = service_class._request_class

    def __call__(self, *args: Any, **kwds: Any) -> Any:
        """Call it with a request or its fields."""
        request = rospy.msg.args_kwds_to_message(self.request_class, args, kwds)
        try:
            return self._node.call(self.resolved_name, request)
        except rospy.ServiceException:
            raise
        except Exception as error:
            text = f"service [{self.resolved_name}] responded with an error: {error}"
            raise rospy.ServiceException(text) from error

    call = __call__

    def wait_for_service(self, timeout: float | None = None) -> None:
        if self.resolved_name not in self._node.services.handlers:
            raise rospy.ROSException(f"service '{self.resolved_name}' is not offered")

    def close(self) -> None:
        """Close nothing: there is no connection."""
