# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The client side of a nodelet manager: what `nodelet load` and `nodelet unload` do.

They work with every manager that offers nodelet_core's services, in Python or C++. `load` is a
node that carries the nodelet's name and stays as long as the nodelet shall. What may block has a
thread of its own, so that a signal is answered at once, even while the manager hangs.
"""

from __future__ import annotations

import threading
import traceback
import uuid
from typing import Any, Sequence

import rospy
from nodelet.srv import NodeletLoad, NodeletLoadRequest, NodeletUnload

from dyknow.errors import HostError, PeerTimeout
from dyknow.nodelet.middleware import Closable
from dyknow.periodic import in_background
from dyknow.ros.bonding.bonds import Bonds
from dyknow.ros.process.node_process import NodeProcess, init_node
from dyknow.ros.process.signals import DONE, FAILED, INTERRUPTED
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
    return _LoadClient(nodelet_type, manager, my_argv, bond).run(default_name, argv)


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


class _LoadClient(Closable):
    """One `nodelet load`, from the request to the unload."""

    def __init__(
        self, nodelet_type: str, manager: str, my_argv: Sequence[str], bond: bool
    ) -> None:
        self._type, self._manager = nodelet_type, manager
        self._my_argv = my_argv
        self._bond = bond
        self._name = self._bond_id = ""
        self._bonds: Bonds | None = None
        self._requested = self._succeeded = self._is_broken = False
        self._answered = threading.Event()
        self._exit_code = DONE

    def run(self, default_name: str, argv: Sequence[str]) -> int:
        self._process = NodeProcess(default_name, argv, self._begin)
        return self._process.run() or self._exit_code

    def close(self) -> None:
        """Unload it, unless it is gone or was refused.

        Nor is a nodelet left behind that the manager is just initialising. One that came up while
        this node was stopped has been loaded and then unloaded.
        """
        is_early = not self._answered.is_set()
        if is_early and self._requested:
            self._answered.wait(_LOAD_TIMEOUT_AT_EXIT)
        if not self._succeeded:
            self._exit_code = INTERRUPTED if is_early else FAILED
        may_be_loaded = self._requested and (self._succeeded or not self._answered.is_set())
        if self._is_broken:
            rospy.loginfo("Bond broken, exiting")
        elif may_be_loaded:
            unloaded = unload(self._name, self._manager, _UNLOAD_TIMEOUT_AT_EXIT, at_exit=True)
            if self._bonds is not None:
                self._bonds.close(_BOND_TIMEOUT_AT_EXIT if unloaded else _LAST_WORD)

    def _begin(self) -> _LoadClient:
        self._name = rospy.get_name()
        if self._bond:
            self._bond_id = f"{self._name}_{uuid.uuid4()}"
        in_background("load", self._load)
        return self

    def _load(self) -> None:
        try:
            self._succeeded = self._request()
            if self._succeeded and self._bond_id:
                self._bonds = Bonds(f"{self._manager}/bond")
                self._bonds.add(self._bond_id, self._on_broken)
        except rospy.ROSInterruptException:
            return  # The process ends; the answer is not awaited.
        except Exception:
            rospy.logfatal(f"Failed to load nodelet '{self._name}`:\n{traceback.format_exc()}")
        self._answered.set()
        if not self._succeeded:
            self._process.end()

    def _on_broken(self) -> None:
        self._is_broken = True
        self._process.end()

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
