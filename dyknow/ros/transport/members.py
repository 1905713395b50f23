"""What of rospy a NodeHandle offers as it is, or with its first argument resolved."""

from __future__ import annotations

import functools
from typing import Any

import rosgraph
import rospy

_LOGGERS = frozenset(
    f"log{level}{variant}"
    for level in ("debug", "info", "warn", "err", "fatal")
    for variant in ("", "_throttle", "_throttle_identical", "_once")
)
#: Functions and classes of rospy whose first argument is a name.
_NAMED = frozenset(
    """ServiceProxy wait_for_service
    get_param get_param_cached set_param has_param delete_param""".split()
)
#: What has neither names nor a queue in it.
_PLAIN = frozenset(
    """Time Duration Rate sleep get_time get_rostime Header
    DEBUG INFO WARN ERROR FATAL AnyMsg Message SubscribeListener
    ROSException ROSInitException ROSInterruptException ROSSerializationException
    ROSInternalException ROSTimeMovedBackwardsException ServiceException
    TransportException TransportInitError TransportTerminated
    get_published_topics get_param_names get_node_uri get_ros_root get_master MasterProxy
    parse_rosrpc_uri myargv""".split()
)
_REFUSED = {
    "init_node": "the nodelet manager is a node already; drop the call",
    "spin": "a nodelet returns from on_init and is called back; drop the call",
    "get_caller_id": "use get_name()",
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
        return functools.partial(_resolved, getattr(rospy, name), handle)
    if name == "search_param":
        return functools.partial(_search_param, handle)
    if name in _PLAIN:
        return getattr(rospy, name)
    reason = _REFUSED.get(name, "rospy has no such thing for nodelets")
    raise AttributeError(f"a NodeHandle has no '{name}': {reason}")


def _resolved(function: Any, handle: Any, name: str, *args: Any, **kwds: Any) -> Any:
    return function(handle.resolve_name(name), *args, **kwds)


def _search_param(handle: Any, name: str) -> Any:
    try:
        return rosgraph.Master(handle.get_name()).searchParam(name) or None
    except rosgraph.MasterError:
        return None
