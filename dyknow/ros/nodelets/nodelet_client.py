# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The client side of a nodelet manager: what `nodelet load` and `nodelet unload` do.

They work with every manager that offers nodelet_core's services, in Python or C++. `load` is a
node that carries the nodelet's name and stays as long as the nodelet shall: its main thread only
waits for the next event (the nodelet is loaded, the bond broke, a signal to stop), and
everything that may block has a thread of its own. So a signal is answered at once, even
while the manager hangs.
"""

from __future__ import annotations

import enum
import queue
import signal
import threading
import traceback
import uuid
from typing import Any, Sequence

import rospy
from nodelet.srv import NodeletLoad, NodeletLoadRequest, NodeletUnload

from dyknow.errors import HostError, PeerTimeout
from dyknow.periodic import in_background
from dyknow.ros.bonding.bonds import Bonds
from dyknow.ros.process.node_process import init_node
from dyknow.ros.process.signals import DONE, FAILED, INTERRUPTED, on_signals
from dyknow.ros.transport.node import is_offered_within
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.service_client import ServiceClient, ServiceFailed, ServiceLost

#: Seconds for a load, which may take its time: days.
_LOAD_TIMEOUT = 1e6
_UNLOAD_TIMEOUT = 10.0
_LOAD_TIMEOUT_AT_EXIT = 0.5
_UNLOAD_TIMEOUT_AT_EXIT = 2.0
_BOND_TIMEOUT_AT_EXIT = 0.2
_LAST_WORD = 0.05
_LONGEST_EXIT = 4.0
_SHUTDOWN_TIMEOUT = 2.0


class _Event(enum.Enum):
    LOADED = enum.auto()
    REFUSED = enum.auto()
    BROKEN = enum.auto()
    STOP = enum.auto()


def run_load(
    default_name: str,
    nodelet_type: str,
    manager: str,
    my_argv: Sequence[str],
    bond: bool,
    argv: Sequence[str],
) -> int:
    """Load a nodelet, stay until it is gone or a signal comes, and unload it then.

    The node and the nodelet have the default name unless ``argv``, the command line with ROS's
    own arguments, has another. Returns the process's exit code.
    """
    init_node(default_name, argv=list(argv), disable_signals=True)
    return _LoadClient(rospy.get_name(), nodelet_type, manager, my_argv, bond).run()


def run_unload(name: str, manager: str, argv: Sequence[str]) -> int:
    """Unload a nodelet by its name; returns the process's exit code."""
    init_node("nodelet_unloader", argv=list(argv), disable_signals=True)
    return DONE if unload(name, manager, _UNLOAD_TIMEOUT) else FAILED


def unload(name: str, manager: str, timeout: float, at_exit: bool = False) -> bool:
    """Request an unload within ``timeout`` s, and log the outcome.

    At exit a manager that is gone already is as good: everything may be ending.
    """
    rospy.loginfo(f"Unloading nodelet {name} from manager {manager}")
    service = f"{manager}/unload_nodelet"
    failure = f"Failed to unload nodelet '{name}` from manager `{manager}'"
    try:
        _client(service, NodeletUnload).call(timeout, name)
    except ServiceLost:
        (rospy.logdebug if at_exit else rospy.logwarn)(
            f"Couldn't find service {service}, perhaps the manager is already shut down"
        )
        return False
    except (ServiceFailed, PeerTimeout) as error:
        rospy.logfatal(failure + _cause(error))
        return False
    return True


class _LoadClient:
    """One `nodelet load`, from the request to the unload."""

    def __init__(
        self, name: str, nodelet_type: str, manager: str, my_argv: Sequence[str], bond: bool
    ) -> None:
        self._name, self._type, self._manager = name, nodelet_type, manager
        self._my_argv = my_argv
        self._bond_id = f"{name}_{uuid.uuid4()}" if bond else ""
        self._events: queue.SimpleQueue[_Event] = queue.SimpleQueue()
        self._requested = False
        self._ended = threading.Event()
        self._shut_down = threading.Event()

    def run(self) -> int:
        on_signals((signal.SIGINT, signal.SIGTERM), lambda: self._events.put(_Event.STOP))
        rospy.on_shutdown(self._on_shutdown_request)
        rospy.core.add_shutdown_hook(lambda reason: self._shut_down.set())
        in_background("load", self._load)
        try:
            return self._follow()
        finally:
            self._ended.set()
            rospy.signal_shutdown("nodelet load ends")
            # It returns at once if another thread (rosnode kill) is at it; that one has to finish.
            self._shut_down.wait(_SHUTDOWN_TIMEOUT)

    def _follow(self) -> int:
        event = self._events.get()
        if event is _Event.REFUSED:
            return FAILED
        if event is _Event.STOP:
            return self._abandon_load()
        bonds: Bonds | None = None
        if self._bond_id:
            bonds = Bonds(f"{self._manager}/bond")
            bonds.add(self._bond_id, lambda: self._events.put(_Event.BROKEN))
        if self._events.get() is _Event.BROKEN:
            rospy.loginfo("Bond broken, exiting")
            return DONE
        unloaded = unload(self._name, self._manager, _UNLOAD_TIMEOUT_AT_EXIT, at_exit=True)
        if bonds is not None:
            bonds.close(_BOND_TIMEOUT_AT_EXIT if unloaded else _LAST_WORD)
        return DONE

    def _abandon_load(self) -> int:
        """Leave no nodelet behind that the manager is just initialising; returns the exit code.

        A nodelet that came up while we were stopped is one that was loaded and then unloaded.
        """
        if not self._requested:
            return INTERRUPTED
        try:
            event = self._events.get(timeout=_LOAD_TIMEOUT_AT_EXIT)
        except queue.Empty:
            event = _Event.STOP
        if event is not _Event.REFUSED:
            unload(self._name, self._manager, _UNLOAD_TIMEOUT_AT_EXIT, at_exit=True)
        return DONE if event is _Event.LOADED else INTERRUPTED

    def _on_shutdown_request(self) -> None:
        """Hold up a shutdown by rosnode kill: the unload needs the node."""
        if not self._ended.is_set():
            rospy.logwarn("Shutdown request received.")
            self._events.put(_Event.STOP)
            self._ended.wait(_LONGEST_EXIT)

    def _load(self) -> None:
        try:
            self._events.put(_Event.LOADED if self._request() else _Event.REFUSED)
        except rospy.ROSInterruptException:
            pass  # The process ends; the event is not awaited.
        except Exception:
            rospy.logfatal(f"Failed to load nodelet '{self._name}`:\n{traceback.format_exc()}")
            self._events.put(_Event.REFUSED)

    def _request(self) -> bool:
        resolved = rospy.names.get_resolved_mappings()
        remappings = {
            each: resolved[each] for each in sorted(resolved) if not each.startswith("_")
        }
        rospy.loginfo(
            f"Loading nodelet {self._name} of type {self._type} to manager {self._manager}"
            " with the following remappings:"
        )
        for source, target in remappings.items():
            rospy.loginfo(f"{source} -> {target}")
        service = f"{self._manager}/load_nodelet"
        _wait_for(service)
        request = NodeletLoadRequest(
            name=self._name,
            type=self._type,
            remap_source_args=list(remappings),
            remap_target_args=list(remappings.values()),
            my_argv=list(self._my_argv),
            bond_id=self._bond_id,
        )
        self._requested = True
        try:
            if _client(service, NodeletLoad).call(_LOAD_TIMEOUT, request).success:
                return True
            cause = ""
        except (HostError, PeerTimeout) as error:
            cause = _cause(error)
        rospy.logfatal(
            f"Failed to load nodelet '{self._name}` of type `{self._type}` "
            f"to manager `{self._manager}'{cause}"
        )
        return False


def _client(service: str, service_class: Any) -> ServiceClient:
    return ServiceClient(Master(rospy.get_name()), rospy.resolve_name(service), service_class)


def _cause(error: Exception) -> str:
    return f": {error}" if str(error) else ""


def _wait_for(service: str) -> None:
    """Wait until the service is offered, and log it now and then."""
    rospy.logdebug(f"Waiting for service {service} to be available...")
    if is_offered_within(service, 1.0):
        return
    resolved = rospy.resolve_name(service)
    rospy.loginfo(f"waitForService: Service [{resolved}] has not been advertised, waiting...")
    seconds = 0
    while not is_offered_within(service, 10.0):
        seconds += 10
        rospy.logwarn(f"Waiting for service {service} to be available for {seconds} seconds...")
    rospy.loginfo(f"waitForService: Service [{resolved}] is now available.")
