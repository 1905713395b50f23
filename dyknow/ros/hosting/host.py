# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The host of nodelets in ROS: loads, unloads and asks them, wherever they run.

Every remote call has a time limit. A nodelet manager that hangs delays at most one question by
that limit: while its last answer is due it is not asked again.
"""

from __future__ import annotations

import contextlib
import enum
import logging
import time
from concurrent.futures import ThreadPoolExecutor
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
)

import rosgraph.network
import rospy
from nodelet.srv import NodeletLoad, NodeletUnload

from dyknow import names
from dyknow.errors import HostError, HostTimeout, NameTaken, PeerTimeout, Refused
from dyknow.guards import NO_GUARDS, Guards
from dyknow.locks import state_lock
from dyknow.manager.host import (
    Count,
    Crash,
    Host,
    Listening,
    LoadRequest,
    ManagerState,
)
from dyknow.manager.specifications.values import value_of
from dyknow.model.graph import NodeletKind, PortState
from dyknow.model.transformation import NODE, Parameter, Program, Transformation
from dyknow.ros import ages, programs
from dyknow.ros.client import ProxyClient
from dyknow.ros.hosting.child_keeper import Child
from dyknow.ros.hosting.children import Children
from dyknow.ros.hosting.count_collector import CountCollector
from dyknow.ros.hosting.external_managers import ExternalManagers
from dyknow.ros.hosting.guard_handover import GuardHandover
from dyknow.ros.hosting.lease_keeper import LeaseKeeper
from dyknow.ros.hosting.list_client import ListClients
from dyknow.ros.hosting.message_counter import MessageCounter
from dyknow.ros.hosting.nodelet_types import NodeletTypes
from dyknow.ros.hosting.rewirable_nodes import RewirableNodes
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient, ServiceFailed, ServiceLost
from dyknow.ros.transport.registrar import Registrar

_log = logging.getLogger("rosout.dyknow")

#: Seconds for an unload, which waits up to 1 s for ``on_shutdown``.
UNLOAD_TIMEOUT = 4.0
#: Seconds for the end of a process to be noticed.
DEATH_TIMEOUT = 2.0
#: Seconds for a proxy to connect ports, which waits up to 0.5 s for outside peers.
CONNECT_TIMEOUT = 4.0
#: Seconds for a proxy to say what its ports are.
PORTS_TIMEOUT = 2.0
#: Nodelet managers that are asked at the same time.
_ASKERS = 16


class _Failure(enum.Enum):
    """How the last load of a nodelet failed."""

    LATE = "not up in time; it may still come up"
    REFUSED = "refused; there is nothing to unload"


class RosHost(Host):
    """Nodelet managers of the ROS graph: children of ours, and external ones."""

    def __init__(
        self,
        master: Master,
        children: Children,
        registrar: Registrar,
        external: Sequence[str] = (),
        guards: Guards = NO_GUARDS,
        running: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin to look for the external nodelet managers.

        Args:
            master: the ROS master.
            children: nodelet managers that we start.
            registrar: registers the topics of this process.
            external: global names of nodelet managers that others start.
            guards: handed to the nodelet managers that can enforce them.
            running: time for which this process has run, in seconds.
        """
        self._master = master
        self._proxies = ProxyClient(master)
        self._children = children
        self._external = ExternalManagers(master, external)
        self._guards = GuardHandover(master, guards)
        self._nodes = RewirableNodes(master, self._is_manager)
        self._nodes.on_end = self._guards.withdraw
        self._types = NodeletTypes()
        self._collector = CountCollector(master)
        self._counter = MessageCounter(registrar)
        self._list_clients = ListClients(master)
        self._on_change: Callable[[], object] = lambda: None
        self._leases = LeaseKeeper(
            master,
            rospy.get_node_uri() or "",
            self._answers,
            running,
            lambda: self._on_change(),
        )
        self._askers = ThreadPoolExecutor(_ASKERS, "asking nodelet managers")
        self._state_lock = state_lock("failed loads")
        #: By nodelet manager and nodelet.
        self._failures: Dict[Tuple[str, str], _Failure] = {}
        #: What ails nodelets, likewise.
        self._details: Dict[Tuple[str, str], str] = {}

    def look_for_nodes(self, nodes: Iterable[str]) -> None:
        """Ask for re-wirable nodes of these names, before the look begins that goes on."""
        self._nodes.look_for(nodes)

    def note_detail(self, manager: str, nodelet: str, detail: str) -> None:
        """Note what ails a nodelet, as its nodelet manager says; empty if nothing does."""
        with self._state_lock:
            self._details.pop((manager, nodelet), None)
            if detail:
                self._details[manager, nodelet] = detail

    def start(self, on_change: Callable[[], object]) -> None:
        """Begin to look for re-wirable nodes.

        Args:
            on_change: called when one has begun or ended, or a lease has run out.
        """
        self._on_change = self._nodes.on_change = on_change
        self._nodes.start()

    # Nodelet managers

    def kind_of(self, transformation: Transformation) -> NodeletKind:
        """Look the type up in the packages' exports, or look at the program."""
        if transformation.type == NODE:
            return programs.kind_of(Program.of(transformation.source))
        return self._types.kind_of(transformation.source)

    def managers(self) -> List[ManagerState]:
        """List our children, the external nodelet managers and nodes; all get the guards."""
        states = [self._state_of_child(child) for child in self._children.all()]
        states += [each.state for each in self._external.all()]
        states += self._nodes.all()
        self._forget_others({state.name for state in states})
        for state in states:
            self._guards.hand_over(state)
        return sorted(states, key=lambda state: state.name)

    def look_for(self, manager: str) -> None:
        """Wait for a look at an external one that was not found."""
        external = self._external.find(manager)
        if external is not None:
            external.look_now()

    def crashes(self) -> List[Crash]:
        """Return those of our children; how external processes end is not seen here."""
        return self._children.crashes()

    def ensure(self, kind: NodeletKind, isolated_for: str = "") -> str:
        """Start a child if need be; a node is one as soon as it is loaded."""
        if kind.is_node:
            return isolated_for
        hanging = {state.name for state in self.managers() if not state.responsive}
        name = self._children.ensure(kind, isolated_for, hanging)
        self.managers()  # hands the guards over
        return name

    def protect(self, nodelets: Mapping[str, Sequence[str]]) -> None:
        """Set which nodelets each nodelet manager unloads for us alone, from the next look.

        Stock nodelet managers do not enforce it.
        """
        self._guards.protect(nodelets)

    def retire(self, manager: str) -> None:
        """End a child."""
        self._children.end(manager)
        self.managers()  # forgets it

    def grant(self, producers: Mapping[str, str], managers: Collection[str]) -> None:
        """Let these nodelets, and no others, publish on topics of claims.

        Args:
            producers: by topic, the nodelet that publishes there; empty for none at present.
            managers: nodelet managers that run these nodelets; their leases are renewed from now
                on.
        """
        self._leases.grant(producers, managers)

    def may_publish(self, manager: str) -> bool:
        """Whether it may hold a lease; one that has ended publishes no more."""
        external = self._external.find(manager)
        if external is not None and external.presence.trouble and not external.presence.away:
            return False
        return self._leases.may_publish(manager)

    def list(self, manager: str) -> List[str]:
        """Ask over the kept connection."""
        return self._without_late(manager, self._listed(manager))

    def lists(self, managers: Iterable[ManagerState]) -> Dict[str, List[str]]:
        """Ask each over its kept connection."""
        alive = [state for state in managers if state.alive]
        answers = self._askers.map(self._list_of, alive)
        return {state.name: names for state, names in zip(alive, answers) if names is not None}

    # Nodelets

    def load(self, manager: str, request: LoadRequest, timeout: float) -> None:
        """Set the parameters and load; a node is started."""
        if request.kind.is_node:
            self._start_node(request, timeout)
            return
        self._children.await_up(manager, timeout)
        self._guards.check(manager)
        # A hanging manager would load the nodelet when it goes on, so it is asked this first.
        if request.name in self.list(manager):
            raise NameTaken(request.name)
        for external in self._external.all():
            external.forget(request.name)
        self._set_parameters(request.name, request.parameters)
        key = (manager, request.name)
        with self._state_lock:
            self._failures.pop(key, None)
        sources = sorted(request.remappings)
        type_, arguments = request.source, []
        if request.kind is NodeletKind.SCRIPT:
            program = Program.of(request.source)
            type_, arguments = programs.SCRIPT, [program.name, *program.arguments]
        try:
            self._call(
                f"{manager}/load_nodelet",
                NodeletLoad,
                timeout,
                name=request.name,
                type=type_,
                remap_source_args=sources,
                remap_target_args=[request.remappings[source] for source in sources],
                my_argv=arguments,
            )
        except PeerTimeout as error:
            with self._state_lock:
                self._failures[key] = _Failure.LATE
            self._listed(manager)  # a timeout of the nodelet manager, if that hangs
            raise HostError(f"'{request.source}' was not up within {timeout:g} s") from error
        except ServiceFailed as error:
            with self._state_lock:
                self._failures[key] = _Failure.REFUSED
            text = str(error) or "its nodelet manager gives no reason; its log may have one"
            raise HostError(text) from error

    def unload(self, manager: str, name: str) -> None:
        """Unload, unless the load was refused; a node that we started is ended.

        Raises:
            HostError: it is a node in a process of its own, which is not ours to end.
        """
        if self._child_kind(manager).is_node:
            self.retire(manager)
            return
        if self._nodes.has(name):
            raise HostError(
                f"'{name}' is a node in a process of its own; end it with: rosnode kill {name}"
            )
        with self._state_lock:
            if self._failures.get((manager, name)) is _Failure.REFUSED:
                del self._failures[manager, name]
                raise HostError(f"nodelet '{name}' was not loaded")
        if any(each.name == manager and not each.responsive for each in self.managers()):
            self.list(manager)  # fails at once while it hangs
        incarnation = self._incarnation(manager)
        try:
            with _host_errors(manager):
                self._call(f"{manager}/unload_nodelet", NodeletUnload, UNLOAD_TIMEOUT, name)
        except ServiceLost:
            if incarnation:
                self._children.await_end(manager, incarnation, DEATH_TIMEOUT)
            raise

    def forget(self, name: str, parameters: Sequence[str]) -> None:
        """Delete the parameters, and the namespace if nothing is left in it."""
        for parameter in parameters:
            self._delete_parameter(names.join(name, parameter))
        if parameters:
            with contextlib.suppress(LookupError, PeerTimeout):
                if self._master.ask("getParam", name) == {}:
                    self._delete_parameter(name)

    def ports(self, name: str) -> Tuple[PortState, ...]:
        """Ask the proxy."""
        with self._asking(name):
            return self._proxies.get_config(name, PORTS_TIMEOUT)

    def detail(self, name: str) -> str:
        """Return what was announced last."""
        with self._state_lock:
            details = [text for (_, nodelet), text in self._details.items() if nodelet == name]
        return "; ".join(details)

    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Tell the proxy."""
        with self._asking(name):
            self._proxies.set_config(name, config, CONNECT_TIMEOUT)

    def published(self, topics: Iterable[str]) -> FrozenSet[str]:
        """Ask the master."""
        wanted = frozenset(topics)
        if not wanted:
            return wanted
        with _host_errors():
            publishers, _, _ = self._master.ask("getSystemState")
        return wanted & {topic for topic, nodes in publishers if nodes}

    def counts(
        self, wanted: Mapping[str, Collection[str]]
    ) -> Dict[str, Optional[Mapping[str, Count]]]:
        """Ask over the kept connections."""
        return self._collector.counts(wanted)

    def is_stamped(self, datatype: str) -> Optional[bool]:
        """Look the message class up."""
        return ages.is_stamped(datatype)

    def listen(self, topic: str) -> Listening:
        """Subscribe."""
        return self._counter.listen(topic)

    def close(self) -> None:
        """Close all connections; our children go on."""
        self._counter.close()
        self._collector.close()
        self._list_clients.close()
        self._leases.close()
        self._external.close()
        self._nodes.close()
        self._askers.shutdown(wait=False)

    def release(self) -> None:
        """Take our guards and leases off what goes on without us, at an end on purpose."""
        self._leases.release()
        names = [each.name for each in self._external.all()]
        for name in [*names, *(each.name for each in self._nodes.all())]:
            self._guards.withdraw(name)

    # Inside

    def _state_of_child(self, child: Child) -> ManagerState:
        record, incarnation = child.record, child.incarnation
        responsive = self._list_clients.answers(record.name, incarnation)
        return ManagerState(
            record.name,
            record.kind,
            incarnation,
            record.isolated_for,
            responsive=responsive,
            rewirable=child.rewirable,
            host=rosgraph.network.get_host_name(),
            cure=_cure(child),
        )

    def _forget_others(self, managers: Collection[str]) -> None:
        """Forget what is known of processes that are not among these: they are gone."""
        self._guards.keep(managers)
        self._collector.keep(managers)
        self._list_clients.keep(managers)
        self._leases.keep(managers)
        with self._state_lock:
            for table in (self._failures, self._details):
                for key in [key for key in table if key[0] not in managers]:
                    del table[key]

    def _child(self, name: str) -> Optional[Child]:
        return next((each for each in self._children.all() if each.record.name == name), None)

    def _child_kind(self, name: str) -> NodeletKind:
        """What a child of ours hosts, or is; that of nodelet managers for any other name."""
        child = self._child(name)
        return child.record.kind if child is not None else NodeletKind.PYTHON

    def _incarnation(self, manager: str) -> str:
        """The process of a child of ours; empty while none is up."""
        child = self._child(manager)
        return child.incarnation if child is not None else ""

    def _list_of(self, state: ManagerState) -> Optional[List[str]]:
        try:
            return self._without_late(state.name, self._listed(state.name, state.incarnation))
        except HostError as error:
            if state.own and state.responsive:  # of an external one `ExternalManager` logs it
                _log.warning("nodelet manager %s: %s", state.name, error)
            return None

    def _answers(self, manager: str) -> bool:
        """Whether a nodelet manager or node answered when it was asked last."""
        external = self._external.find(manager)
        if external is not None:
            return not external.presence.trouble
        child = self._child(manager)
        if child is not None:
            return child.up and self._list_clients.answers(manager, child.incarnation)
        return any(each.name == manager and each.responsive for each in self._nodes.all())

    def _is_manager(self, name: str) -> bool:
        return self._external.find(name) is not None or self._child(name) is not None

    def _listed(self, manager: str, incarnation: str = "") -> List[str]:
        node = next((each for each in self._nodes.all() if each.name == manager), None)
        if node is not None:
            if not node.responsive:
                raise HostTimeout(f"node '{manager}' does not answer")
            return [manager]
        external = self._external.find(manager)
        if external is not None:
            return external.list(incarnation)
        current = self._incarnation(manager)
        if not current:
            raise HostError(f"nodelet manager '{manager}' is not running")
        with _host_errors(manager):
            return self._list_clients.of(manager, current, self._child_kind(manager)).list()

    def _without_late(self, manager: str, listed: List[str]) -> List[str]:
        """Unload what came up after its load had been given up."""
        with self._state_lock:
            late = [n for n in listed if self._failures.get((manager, n)) is _Failure.LATE]
            for name in late:
                del self._failures[manager, name]
        for name in late:
            self.unload(manager, name)
        return [each for each in listed if each not in late]

    @contextlib.contextmanager
    def _asking(self, nodelet: str) -> Iterator[None]:
        """Ask the proxy of a nodelet, unless its nodelet manager is known not to answer."""
        external = self._external.hosting(nodelet)
        if external is not None:
            external.check()
        with _host_errors(nodelet):
            try:
                yield
            except Refused as error:
                raise HostError(str(error)) from error

    def _start_node(self, request: LoadRequest, timeout: float) -> None:
        self._children.check_free(request.name)
        program = Program.of(request.source)
        path = programs.find_program(program.package, program.executable)
        remappings = (f"{each}:={request.remappings[each]}" for each in sorted(request.remappings))
        self._set_parameters(request.name, request.parameters)
        command = (path, *program.arguments, *remappings)
        self._children.start_node(request.kind, request.name, command, timeout)
        self.managers()  # hands the guards over
        self._guards.check(request.name)

    def _call(
        self, service: str, service_class: Any, timeout: float, *args: Any, **kwds: Any
    ) -> Any:
        return ServiceClient(self._master, service, service_class).call(timeout, *args, **kwds)

    def _set_parameters(self, name: str, parameters: Sequence[Parameter]) -> None:
        for parameter in parameters:
            key = names.join(name, parameter.name)
            try:
                self._master.ask("setParam", key, value_of(parameter))
            except (LookupError, PeerTimeout, OverflowError, TypeError) as error:
                raise HostError(f"parameter '{key}' cannot be set: {error}") from error

    def _delete_parameter(self, key: str) -> None:
        with contextlib.suppress(LookupError, PeerTimeout):  # not set, or no master
            self._master.ask("deleteParam", key)


def _cure(child: Child) -> str:
    """Say what to do about a child that does not answer."""
    if child.record.process is None:
        return ""
    pid = child.record.process.pid
    if child.record.kind.is_node:
        return f"if its process is stopped, kill -CONT {pid}; if it hangs, kill -9 {pid}"
    return (
        f"if its process is stopped, kill -CONT {pid}; if it hangs, kill -9 {pid}, and it is "
        "started again with its nodelets"
    )


@contextlib.contextmanager
def _host_errors(whom: str = "") -> Iterator[None]:
    """Turn a time-out or a refusal into an error of the host, whose text begins with ``whom``."""
    try:
        yield
    except (PeerTimeout, LookupError) as error:
        kind = HostTimeout if isinstance(error, PeerTimeout) else HostError
        raise kind(f"{whom}: {error}" if whom else str(error)) from error
