# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""rospy as the code in a sandbox sees it: in its name, on its topics, until it is unloaded.

``rospy.timer`` (``Rate``, ``Timer``, ``sleep``) is a copy of rospy's own module, which sleeps and
ends by the views below.
"""

from __future__ import annotations

import functools
import threading
from typing import Any, Callable, Mapping

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
from dyknow.nodelet.loading.importer import Importer, Module, View
from dyknow.ros.scripts.rospy_classes import bound_classes, wait_for, wait_for_service
from dyknow.ros.scripts.sandbox import Sandbox
from dyknow.ros.transport.node import own_logs

#: The submodules that are views; below rospy, everything else is the process's.
_SUBMODULES = ("client", "core", "names", "rostime", "service", "topics")
#: The submodule of which a sandbox has a copy.
COPIED = "rospy.timer"
_TIMING = ("Rate", "Timer", "sleep")
#: Functions that are those of the sandbox's handle.
_OF_HANDLE = "get_param get_param_cached set_param has_param delete_param search_param".split()
#: Functions that are rospy's own for a sandbox with a process of its own.
_OF_NODE = "get_name get_caller_id get_namespace".split()


def rospy_views(
    sandbox: Sandbox, init_node: Callable[..., None], importer: Callable[[], Importer]
) -> dict[str, Callable[[], Module]]:
    """Return factories of the views of rospy and its submodules, by name.

    ``importer`` returns that of the sandbox, which has a copy of ``rospy.timer``.
    """
    members = _members(sandbox, init_node)

    def of(real: Module) -> dict[str, Any]:
        return {name: member for name, member in members.items() if hasattr(real, name)}

    submodules = {name: getattr(rospy, name) for name in _SUBMODULES}
    below: dict[str, Module] = {name: View(real, of(real)) for name, real in submodules.items()}
    views = {f"rospy.{name}": view for name, view in below.items()}
    views["rospy"] = _Rospy({**of(rospy), **below}, importer)
    return {name: functools.partial(_same, view) for name, view in views.items()}


class _Rospy(View):
    """rospy itself, whose ``Rate``, ``Timer`` and ``sleep`` are those of the sandbox's copy."""

    def __init__(self, members: Mapping[str, Any], importer: Callable[[], Importer]) -> None:
        super().__init__(rospy, members)
        self.__dict__["_importer"] = importer

    def __getattr__(self, name: str) -> Any:
        if name != "timer" and name not in _TIMING:
            return getattr(rospy, name)
        # The import waits for that of another thread.
        timer = self.__dict__["_importer"]().import_module(COPIED)
        return timer if name == "timer" else getattr(timer, name)


def _same(view: Module) -> Module:
    return view


def _members(sandbox: Sandbox, init_node: Callable[..., None]) -> dict[str, Any]:
    def handle() -> Any:
        """The sandbox's handle; rospy itself while it has none."""
        return sandbox.handle or rospy

    def of_handle(name: str) -> Callable[..., Any]:
        return lambda *args, **kwds: getattr(handle(), name)(*args, **kwds)

    def wait_for_own_service(service: str, timeout: Any = None) -> None:
        wait_for_service(sandbox, handle().resolve_name(service), timeout)

    def wait_for_message(topic: str, topic_type: Any, timeout: Any = None) -> Any:
        heard: list[Any] = []
        came = threading.Event()

        def receive(message: Any) -> None:
            heard.append(message)
            came.set()

        subscriber = members["Subscriber"](topic, topic_type, receive)
        try:
            wait_for(sandbox, came.wait, timeout, f"message on topic {topic}")
        finally:
            subscriber.unregister()
        return heard[0]

    def resolve_name(name: str, caller_id: str | None = None) -> str:
        if caller_id is None and hasattr(sandbox.handle, "tell_name"):
            return str(handle().tell_name(name))
        return str(handle().resolve_name(name, caller_id))

    def remap_name(name: str, caller_id: str | None = None, resolved: bool = True) -> str:
        if sandbox.handle is None:
            return str(rospy.remap_name(name, caller_id, resolved))
        own = names.as_in_rospy(name)
        global_name = names.complete(own, sandbox.handle.namespace, sandbox.handle.get_name())
        remapped = resolve_name(name, caller_id)
        return name if remapped == global_name else remapped

    def spin() -> None:
        if sandbox.handle is None:
            raise rospy.ROSInitException("client code must call rospy.init_node() first")
        sandbox.waits()
        sandbox.closing.wait()

    def wallsleep(duration: Any) -> None:
        seconds = duration.to_sec() if isinstance(duration, genpy.Duration) else duration
        sandbox.rest(seconds)

    def get_rostime_cond() -> Any:
        sandbox.waits()
        return rospy.rostime.get_rostime_cond()

    def get_mappings() -> dict[str, str]:
        return dict(sandbox.context.remappings) if sandbox.context is not None else {}

    members: dict[str, Any] = {name: of_handle(name) for name in _OF_HANDLE}
    if not sandbox.is_alone:
        members.update(own_logs(sandbox.name))
    members.update(
        init_node=init_node,
        myargv=lambda argv=None: rospy.myargv(sandbox.argv if argv is None else argv),
        is_initialized=lambda: sandbox.handle is not None,
        # names
        get_name=lambda: handle().get_name(),
        get_caller_id=lambda: handle().get_name(),
        get_namespace=lambda: handle().get_namespace(),
        resolve_name=resolve_name,
        remap_name=remap_name,
        get_mappings=get_mappings,
        get_resolved_mappings=get_mappings,
        # topics and services
        **bound_classes(sandbox),
        wait_for_message=wait_for_message,
        wait_for_service=wait_for_own_service,
        # time
        wallsleep=wallsleep,
        get_rostime_cond=get_rostime_cond,
        # the end
        spin=spin,
        is_shutdown=lambda: sandbox.closing.is_set() or rospy.is_shutdown(),
        is_shutdown_requested=lambda: sandbox.is_ending or rospy.core.is_shutdown_requested(),
        signal_shutdown=sandbox.signal_shutdown,
        on_shutdown=sandbox.hooks.append,
        add_client_shutdown_hook=sandbox.hooks.append,
        add_preshutdown_hook=sandbox.hooks_before.append,
        add_shutdown_hook=sandbox.hooks_after.append,
    )
    if sandbox.is_alone:
        for name in _OF_NODE:
            del members[name]
        members.update({name: _remapping(sandbox, name) for name in _OF_HANDLE})
        members["get_mappings"] = lambda: dict(sandbox.mappings)
    return members


def _remapping(sandbox: Sandbox, name: str) -> Callable[..., Any]:
    """Return rospy's function for parameters, which in this process knows no remappings."""

    def remapped(param_name: str) -> str:
        if name == "search_param":  # in rospy, too, a search begins with the name as it is given
            return sandbox.mappings.get(param_name, param_name)
        if not param_name or not isinstance(param_name, str) or sandbox.context is None:
            return param_name
        return sandbox.context.remappings.get(rospy.resolve_name(param_name), param_name)

    def call(param_name: str, *args: Any, **kwds: Any) -> Any:
        return getattr(rospy, name)(remapped(param_name), *args, **kwds)

    return call
