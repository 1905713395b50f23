# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What of rospy a NodeHandle offers as it is, or with its first argument resolved."""

from __future__ import annotations

import functools
import math
import time
from typing import Any, Callable, Dict

import rosgraph
import rospy

from dyknow import names
from dyknow.ros.errors import Interrupted

#: Seconds of a wait between two looks whether the nodelet is still there.
_SLICE = 1.0
_LOGGERS = frozenset(
    f"log{level}{variant}"
    for level in ("debug", "info", "warn", "err", "fatal")
    for variant in ("", "_throttle", "_throttle_identical", "_once")
)
#: Functions of rospy whose first argument is the name of a parameter, and what rospy calls it.
_NAMED = {
    "get_param": "param_name",
    "get_param_cached": "param_name",
    "set_param": "param_name",
    "has_param": "param_name",
    "delete_param": "param_name",
}
#: What has neither names nor a queue in it.
_PLAIN = frozenset(
    """Time Duration Rate sleep get_time get_rostime Header
    DEBUG INFO WARN ERROR FATAL AnyMsg Message SubscribeListener
    ROSException ROSInitException ROSInterruptException ROSSerializationException
    ROSInternalException ROSTimeMovedBackwardsException ServiceException
    TransportException TransportInitError TransportTerminated exceptions
    get_published_topics get_param_names get_node_uri get_ros_root get_master MasterProxy
    parse_rosrpc_uri myargv""".split()
)
_REFUSED = {
    "init_node": "the nodelet manager is a node already; drop the call",
    "spin": "a nodelet returns from on_init and is called back; drop the call",
    "remap_name": "use resolve_name()",
}


def member(name: str, handle: Any) -> Any:
    """Return what ``handle.name`` is.

    Raises:
        AttributeError: rospy has no such thing, or a nodelet must not use it.
    """
    if name in _LOGGERS:
        # A partial adds no frame: rospy tells call sites apart by their frames.
        logger = handle.get_name().strip("/").replace("/", ".")
        return functools.partial(getattr(rospy, name), logger_name=logger)
    if name in _NAMED:
        return functools.partial(
            _resolved, getattr(rospy, name), _NAMED[name], handle.resolve_name
        )
    if name == "ServiceProxy":
        resolve = functools.partial(_resolve_service, handle)
        return functools.partial(_resolved, rospy.ServiceProxy, "name", resolve)
    if name in _OURS:
        return functools.partial(_OURS[name], handle)
    if name in _PLAIN:
        return getattr(rospy, name)
    reason = _REFUSED.get(name, "rospy has no such thing for nodelets")
    raise AttributeError(f"a NodeHandle has no '{name}': {reason}")


def _resolved(
    function: Any, first: str, resolve: Callable[[str], str], *args: Any, **kwds: Any
) -> Any:
    """Call ``function`` with its first argument resolved, which may come as ``first=``, too."""
    if args:
        args = (resolve(args[0]), *args[1:])
    elif first in kwds:
        kwds[first] = resolve(kwds[first])
    return function(*args, **kwds)


def _resolve_service(handle: Any, name: str) -> str:
    return str(handle.resolve_name(names.check(name, "service name")))


def _search_param(handle: Any, param_name: str) -> Any:
    try:
        return rosgraph.Master(handle.get_name()).searchParam(param_name) or None
    except rosgraph.MasterError:
        return None


def _wait_for_service(handle: Any, service: str, timeout: Any = None) -> None:
    """Wait as ``rospy.wait_for_service`` does, until the nodelet is unloaded at most."""
    name = _resolve_service(handle, service)
    patience = timeout.to_sec() if hasattr(timeout, "to_sec") else timeout
    left = math.inf if patience is None else patience
    end = time.monotonic() + left
    while not handle.is_shutdown():
        try:
            rospy.wait_for_service(name, min(_SLICE, left))
            return
        except rospy.ROSInterruptException:
            raise
        except rospy.ROSException:
            left = end - time.monotonic()
            if left <= 0:
                raise
    raise Interrupted(f"service '{name}': nodelet {handle.get_name()} was unloaded")


#: What rospy does in another way for a nodelet.
_OURS: Dict[str, Callable[..., Any]] = {
    "search_param": _search_param,
    "wait_for_service": _wait_for_service,
}
