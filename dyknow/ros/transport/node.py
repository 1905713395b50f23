# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The node of the process, as nodelets use it: members of rospy, names, and the time of timers."""

from __future__ import annotations

import contextlib
import functools
import logging
import math
import sys
import threading
import time
import types
import weakref
from typing import Any, Callable

import rospy
import rospy.core
import rospy.rostime
import rospy.timer

from dyknow import names
from dyknow.errors import DyKnowError, HandleClosed
from dyknow.locks import flag_lock
from dyknow.nodelet.middleware import Node, Ticker
from dyknow.ros.wire.master import Master

#: Seconds of a wait between two looks whether the nodelet is still there.
_SLICE = 1.0
#: rospy's functions for the log.
_LOGS = frozenset(
    f"log{level}{variant}"
    for level in ("debug", "info", "warn", "err", "fatal")
    for variant in ("", "_throttle", "_throttle_identical", "_once")
) | {"logout"}
#: Functions of rospy whose first argument is ``param_name``.
_OF_PARAMETERS = frozenset("get_param get_param_cached set_param has_param delete_param".split())
#: Members that depend on neither names nor queues.
_PLAIN = frozenset(
    """Time Duration get_time get_rostime Header
    DEBUG INFO WARN ERROR FATAL AnyMsg Message SubscribeListener
    ROSException ROSInitException ROSInterruptException ROSSerializationException
    ROSInternalException ROSTimeMovedBackwardsException ServiceException
    TransportException TransportInitError TransportTerminated exceptions
    get_published_topics get_param_names get_node_uri get_ros_root get_master MasterProxy
    parse_rosrpc_uri""".split()
)
_REFUSED = {
    "init_node": "the nodelet manager is a node already; drop the call",
    "spin": "a nodelet returns from on_init and is called back; drop the call",
    "remap_name": "use resolve_name()",
}


def _resolved(
    function: Any, first: str, resolve: Callable[[str], str], *args: Any, **kwds: Any
) -> Any:
    """Call ``function`` with its first argument resolved, which may come as ``first=``, too."""
    if args:
        args = (resolve(args[0]), *args[1:])
    elif first in kwds:
        kwds[first] = resolve(kwds[first])
    return function(*args, **kwds)


class _NodeletLogger(logging.LoggerAdapter):  # type: ignore[type-arg] # generic from 3.11 on
    """A logger whose lines are the nodelet's, and those of its children (``logger_name``) too."""

    def getChild(self, suffix: str) -> _NodeletLogger:  # noqa: N802
        return _NodeletLogger(self.logger.getChild(suffix), self.extra)

    def process(self, msg: Any, kwargs: Any) -> tuple[Any, Any]:
        return msg, {**kwargs, "extra": {**(kwargs.get("extra") or {}), **(self.extra or {})}}


def own_logs(name: str) -> dict[str, Callable[..., Any]]:
    """Return rospy's functions for the log in a nodelet's name, with tables of their own.

    They are rospy's code with other globals, which adds no frame: rospy distinguishes call sites
    by their frames, in tables of what was said once or lately.
    """
    space = dict(vars(rospy.core))
    title = name.strip("/").replace("/", ".")
    logger = _NodeletLogger(logging.getLogger(f"rosout.{title}"), {"nodelet": name})
    space["logging"] = types.SimpleNamespace(getLogger=lambda root: logger)
    for table in ("_logging_throttle", "_logging_identical", "_logging_once"):
        space[table] = type(space[table])()
        for attribute, shared in vars(type(space[table])).items():
            if isinstance(shared, (dict, set)):
                setattr(space[table], attribute, type(shared)())
    for each in ("_base_logger", *_LOGS):
        space[each] = types.FunctionType(
            space[each].__code__, space, each, space[each].__defaults__
        )
    return {each: space[each] for each in _LOGS}


def _own_timing(context: Any) -> dict[str, Any]:
    """Return rospy's ``sleep`` and ``Rate``; their waits for simulated time end with the nodelet.

    They are rospy's code with other globals, and do not keep the context.
    """
    nodelet = weakref.ref(context)

    def is_shutdown() -> bool:
        living = nodelet()
        return living is None or living.closed or rospy.is_shutdown()

    core = types.SimpleNamespace(is_shutdown=is_shutdown)
    space = dict(vars(rospy.timer))
    space["rospy"] = types.SimpleNamespace(**{**vars(rospy), "core": core})
    space["sleep"] = types.FunctionType(rospy.sleep.__code__, space, "sleep")
    sleep = types.FunctionType(rospy.Rate.sleep.__code__, space, "sleep")
    return {"sleep": space["sleep"], "Rate": type("Rate", (rospy.Rate,), {"sleep": sleep})}


def _resolve_service(handle: Any, name: str) -> str:
    return str(handle.resolve_name(names.check(name, "service name")))


def _service_proxy(handle: Any, name: str, *args: Any, **kwds: Any) -> Any:
    proxy = rospy.ServiceProxy(_resolve_service(handle, name), *args, **kwds)
    proxy.wait_for_service = functools.partial(_wait_until_offered, handle, proxy.resolved_name)
    return proxy


def _search_param(handle: Any, param_name: str) -> Any:
    try:
        return Master(handle.get_name()).ask("searchParam", param_name) or None
    except LookupError:
        return None


def is_offered_within(service: str, seconds: float) -> bool:
    """Wait for a service, at most so long; raises ROSInterruptException when the node ends."""
    try:
        rospy.wait_for_service(service, seconds)
    except rospy.ROSInterruptException:
        raise
    except rospy.ROSException:
        return False
    return True


def _wait_for_service(handle: Any, service: str, timeout: Any = None) -> None:
    _wait_until_offered(handle, _resolve_service(handle, service), timeout)


def _wait_until_offered(handle: Any, name: str, timeout: Any = None) -> None:
    """Wait as ``rospy.wait_for_service`` does, until the nodelet is unloaded at most."""
    patience = timeout.to_sec() if hasattr(timeout, "to_sec") else timeout
    left = math.inf if patience is None else patience
    end = time.monotonic() + left
    while not handle.is_shutdown():
        if is_offered_within(name, min(_SLICE, left)):
            return
        left = end - time.monotonic()
        if left <= 0:
            raise rospy.ROSException(f"timeout exceeded while waiting for service {name}")
    raise Interrupted(f"service '{name}': nodelet {handle.get_name()} was unloaded")


class ClosedHandle(HandleClosed, rospy.ROSException):
    """A handle was used after it was unregistered or its nodelet unloaded."""


class MessageTimeout(DyKnowError, rospy.ROSException):
    """A message did not come in time."""


class Interrupted(DyKnowError, rospy.ServiceException, rospy.ROSInterruptException):
    """The nodelet was unloaded during a wait."""


class RospyNode(Node):
    """rospy's node, with exceptions that are rospy's too."""

    closed = ClosedHandle
    interrupted = Interrupted
    timed_out = MessageTimeout

    def __init__(self) -> None:
        #: Members that a nodelet has of its own, by its context.
        self._own: weakref.WeakKeyDictionary[Any, Any] = weakref.WeakKeyDictionary()

    def is_shutdown(self) -> bool:
        return bool(rospy.is_shutdown())

    def remap(self, name: str) -> str:
        return str(rospy.resolve_name(name))

    def member(self, name: str, handle: Any) -> Any:
        if name in _LOGS or name in ("Rate", "sleep"):
            own = self._own.get(handle.context)
            if own is None:
                made = {**own_logs(handle.get_name()), **_own_timing(handle.context)}
                own = self._own.setdefault(handle.context, made)
            return own[name]
        if name in _OF_PARAMETERS:
            function = getattr(rospy, name)
            return functools.partial(_resolved, function, "param_name", handle.resolve_name)
        if name == "ServiceProxy":
            return functools.partial(_service_proxy, handle)
        if name == "search_param":
            return functools.partial(_search_param, handle)
        if name == "wait_for_service":
            return functools.partial(_wait_for_service, handle)
        if name == "myargv":
            words = [sys.argv[0], *handle.context.my_argv]
            return lambda argv=None: rospy.myargv(words if argv is None else argv)
        if name in _PLAIN:
            return getattr(rospy, name)
        reason = _REFUSED.get(name, "rospy has no such thing for nodelets")
        raise AttributeError(f"a NodeHandle has no '{name}': {reason}")


# Time


class _RospyTicker(Ticker):
    def event(self, last: Any, expected: float, real: float, duration: Any) -> Any:
        """Make a ``rospy.timer.TimerEvent``, on the scale of ROS time."""
        now = rospy.Time.now()
        late = rospy.Duration.from_sec(max(0.0, real - expected))
        due = now - late if now.to_sec() > late.to_sec() else rospy.Time()
        before = (None, None) if last is None else (last.current_expected, last.current_real)
        return rospy.timer.TimerEvent(*before, due, now, duration)


class SteadyTicker(_RospyTicker):
    """Steady time; sleeps until the next timer is due."""

    def __init__(self) -> None:
        self._wake = flag_lock()  # free once it was woken
        self._wake.acquire()

    def now(self) -> float:
        return time.monotonic()

    def wait(self, until: float | None) -> None:
        if until is None:
            self._wake.acquire()
        else:
            timeout = max(0.0, until - time.monotonic())
            self._wake.acquire(timeout=min(timeout, threading.TIMEOUT_MAX))

    def wake(self) -> None:
        with contextlib.suppress(RuntimeError):  # it was woken already
            self._wake.release()


class ClockTicker(_RospyTicker):
    """Simulated time; looks again with every message on /clock."""

    def __init__(self) -> None:
        self._changed: threading.Condition = rospy.rostime.get_rostime_cond()
        self._woken = False

    def now(self) -> float:
        """Seconds of /clock, 0 before its first message."""
        return float(rospy.rostime.get_time())

    def has_begun(self, now: float) -> bool:
        """Whether /clock says the time; as in rospy, 0 is none."""
        return now > 0.0

    def wait(self, until: float | None) -> None:
        with self._changed:
            if not self._woken and (until is None or self.now() < until):
                self._changed.wait()
            self._woken = False

    def wake(self) -> None:
        with self._changed:
            self._woken = True
            self._changed.notify_all()


def make_ticker() -> Ticker:
    """Choose the time of the system; the node must be initialised."""
    return SteadyTicker() if rospy.rostime.is_wallclock() else ClockTicker()
