"""The manager's hands in ROS: loads, unloads and asks nodelets, wherever they run.

Every remote call has a time limit, and a nodelet manager that hangs delays each question to it by
at most one such limit: as long as its last answer is due it is not asked again.
"""

from __future__ import annotations

import logging
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import (
    Any,
    Callable,
    Collection,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    Optional,
    Sequence,
    Set,
    Tuple,
)

from dyknow_msgs.msg import Port as PortMessage
from dyknow_msgs.msg import PortConfig
from dyknow_msgs.srv import GetConfig, SetConfig
from nodelet.srv import NodeletLoad, NodeletUnload

from dyknow import names
from dyknow.errors import HostError, HostTimeout, NameTaken, PeerTimeout
from dyknow.guards import NO_GUARDS, Guards
from dyknow.manager.host import (
    Count,
    Crash,
    Host,
    Listening,
    LoadRequest,
    ManagerState,
    NodeletKind,
)
from dyknow.manager.specifications.values import value_of
from dyknow.model.graph import PortState
from dyknow.model.transformation import Parameter
from dyknow.ros.hosting.children import Child, Children
from dyknow.ros.hosting.counting import Counting
from dyknow.ros.hosting.external_managers import ExternalManagers, ListClient
from dyknow.ros.hosting.message_counter import MessageCounter
from dyknow.ros.hosting.nodelet_types import NodeletTypes
from dyknow.ros.master import Master
from dyknow.ros.nodelets.guard_parameters import guards_key, to_parameter
from dyknow.ros.service_client import ServiceClient, ServiceFailed, ServiceLost
from dyknow.ros.transport.registrar import Registrar

_log = logging.getLogger("rosout.dyknow")

#: Seconds for an unload, which waits up to 1 s for ``on_shutdown``.
UNLOAD_TIMEOUT = 4.0
#: Seconds for the end of a process to be noticed.
DEATH_TIMEOUT = 2.0
#: Seconds for a proxy to connect ports, which waits up to 0.5 s for peers outside.
CONNECT_TIMEOUT = 4.0
#: Seconds for a proxy to say what its ports are.
PORTS_TIMEOUT = 2.0
#: Nodelet managers that are asked at the same time.
_ASKERS = 16


class RosHost(Host):
    """Nodelet managers of the ROS graph: children of ours, and others that were named."""

    def __init__(
        self,
        master: Master,
        children: Children,
        registrar: Registrar,
        peers: Sequence[str] = (),
        guards: Guards = NO_GUARDS,
    ) -> None:
        """Reach nothing yet.

        Args:
            master: the ROS master.
            children: nodelet managers that we start.
            registrar: registers the topics of this process.
            peers: global names of nodelet managers that others start.
            guards: handed to the nodelet managers that can enforce them.
        """
        self._master = master
        self._children = children
        self._peers = ExternalManagers(master, peers)
        self._guards_key = guards_key(master.caller)
        self._guards = guards
        #: Nodelets that are protected, by nodelet manager.
        self._protected: Dict[str, Tuple[str, ...]] = {}
        #: Incarnations of nodelet managers that have the guards, with the nodelets named to them.
        self._guarded: Dict[str, Tuple[str, Tuple[str, ...]]] = {}
        #: Nodelet managers that could not be given the guards yet, and why.
        self._unguarded: Dict[str, str] = {}
        self._declared = NodeletTypes()
        self._counting = Counting(master)
        self._hearing = MessageCounter(registrar)
        self._lists: Dict[Tuple[str, str], ListClient] = {}
        self._askers = ThreadPoolExecutor(_ASKERS, "asking nodelet managers")
        self._lock = threading.Lock()
        self._abandoned: Set[Tuple[str, str]] = set()
        self._refused: Set[Tuple[str, str]] = set()

    # Nodelet managers

    def kind_of(self, source: str) -> NodeletKind:
        """Look the type up in the packages' exports."""
        return self._declared.kind_of(source)

    def managers(self) -> List[ManagerState]:
        """List our children and the nodelet managers that were named to us."""
        states = [self._state_of_child(child) for child in self._children.all()]
        states += [peer.state for peer in self._peers.all()]
        for state in states:
            self._guard(state)
        return sorted(states, key=lambda state: state.name)

    def look_for(self, manager: str) -> None:
        """Let its thread look."""
        peer = self._peers.find(manager)
        if peer is not None:
            peer.look_now()

    def crashes(self) -> List[Crash]:
        """Those of our children; how the processes of others end is not seen here."""
        return self._children.crashes()

    def ensure(self, kind: NodeletKind, isolated_for: str = "") -> str:
        """Start a child if need be."""
        hanging = {state.name for state in self.managers() if not state.responsive}
        name = self._children.ensure(kind, isolated_for, hanging)
        self.managers()  # hands the guards over
        return name

    def protect(self, nodelets: Mapping[str, Sequence[str]]) -> None:
        """Say which nodelets each nodelet manager unloads for nobody but us, from the next look.

        Plain C++ nodelet managers do not listen to that.
        """
        with self._lock:
            self._protected = {each: tuple(sorted(nodelets[each])) for each in nodelets}

    def retire(self, manager: str) -> None:
        """End a child."""
        self._children.end(manager)
        self._counting.forget(manager)

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
        """Set the parameters and load."""
        self._children.await_up(manager, timeout)
        self._check_guarded(manager)
        # A manager that hangs would load it when it wakes up: it is asked something else first.
        if request.name in self.list(manager):
            raise NameTaken(request.name)
        for peer in self._peers.all():
            peer.forget(request.name)
        self._set_parameters(request.name, request.parameters)
        with self._lock:
            self._abandoned.discard((manager, request.name))
            self._refused.discard((manager, request.name))
        sources = sorted(request.remappings)
        try:
            self._call(
                f"{manager}/load_nodelet",
                NodeletLoad,
                timeout,
                name=request.name,
                type=request.source,
                remap_source_args=sources,
                remap_target_args=[request.remappings[source] for source in sources],
            )
        except PeerTimeout as error:
            with self._lock:
                self._abandoned.add((manager, request.name))
            raise HostError(f"'{request.source}' was not up within {timeout:g} s") from error
        except ServiceFailed as error:
            with self._lock:
                self._refused.add((manager, request.name))
            text = str(error) or "its nodelet manager gives no reason; its log may have one"
            raise HostError(text) from error

    def unload(self, manager: str, name: str) -> None:
        """Unload; there is nothing to be done where the load was refused."""
        with self._lock:
            if (manager, name) in self._refused:
                self._refused.discard((manager, name))
                raise HostError(f"nodelet '{name}' was not loaded")
        if any(each.name == manager and not each.responsive for each in self.managers()):
            self.list(manager)  # fails at once as long as it hangs
        incarnation = self._incarnation(manager)
        service = f"{manager}/unload_nodelet"
        try:
            self._asking(manager, lambda: self._call(service, NodeletUnload, UNLOAD_TIMEOUT, name))
        except ServiceLost:
            if incarnation:
                self._children.await_end(manager, incarnation, DEATH_TIMEOUT)
            raise

    def forget(self, name: str, parameters: Sequence[Parameter]) -> None:
        """Delete the parameters, and the namespace if nothing is left in it."""
        for parameter in parameters:
            self._delete_parameter(names.join(name, parameter.name))
        if parameters:
            try:
                if self._master.ask("getParam", name) == {}:
                    self._delete_parameter(name)
            except (LookupError, PeerTimeout):
                return

    def ports(self, name: str) -> Tuple[PortState, ...]:
        """Ask the proxy."""
        answer = self._ask_nodelet(name, "get_config", GetConfig, PORTS_TIMEOUT)
        return tuple(
            PortState(
                port.name,
                "out" if port.direction == PortMessage.OUT else "in",
                port.datatype,
                port.topic,
            )
            for port in answer.ports
        )

    def connect(self, name: str, config: Mapping[str, str]) -> None:
        """Tell the proxy."""
        pairs = [PortConfig(port, config[port]) for port in sorted(config)]
        answer = self._ask_nodelet(name, "set_config", SetConfig, CONNECT_TIMEOUT, pairs)
        if not answer.success:
            raise HostError(answer.message)

    def published(self, topics: Iterable[str]) -> FrozenSet[str]:
        """Ask the master."""
        wanted = frozenset(topics)
        if not wanted:
            return wanted
        publishers = self._asking("", lambda: self._master.ask("getSystemState"))[0]
        return wanted & {topic for topic, nodes in publishers if nodes}

    def counts(
        self, wanted: Mapping[str, Collection[str]]
    ) -> Dict[str, Optional[Mapping[str, Count]]]:
        """Ask over the kept connections."""
        return self._counting.counts(wanted)

    def listen(self, topic: str) -> Listening:
        """Subscribe."""
        return self._hearing.listen(topic)

    def close(self) -> None:
        """Let go of the nodelet managers of others; our children go on."""
        self._hearing.close()
        self._counting.close()
        for client in list(self._lists.values()):
            client.close()
        self._peers.close()
        self._askers.shutdown(wait=False)

    def release(self) -> None:
        """Take our guards off the nodelet managers of others, at an end on purpose."""
        for peer in self._peers.all():
            self._delete_parameter(names.join(peer.name, self._guards_key))

    # Inside

    def _state_of_child(self, child: Child) -> ManagerState:
        record, incarnation = child.record, child.incarnation
        client = self._lists.get((record.name, incarnation))
        return ManagerState(
            record.name,
            record.kind,
            incarnation,
            record.isolated_for,
            responsive=client is None or client.answers,
        )

    def _guard(self, state: ManagerState) -> None:
        """Hand our guards to a nodelet manager that does not have them yet.

        What does not work is tried again at the next look; nothing is loaded there before it does.
        """
        if not state.alive or state.kind is not NodeletKind.PYTHON:
            return
        with self._lock:
            protected = self._protected.get(state.name, ())
            if self._guarded.get(state.name) == (state.incarnation, protected):
                return
        try:
            key = names.join(state.name, self._guards_key)
            self._master.ask("setParam", key, to_parameter(self._guards, protected))
        except (PeerTimeout, LookupError) as error:
            with self._lock:
                is_news = state.name not in self._unguarded
                self._unguarded[state.name] = str(error)
            if is_news:
                _log.warning("%s cannot be given the guards yet: %s", state.name, error)
            return
        with self._lock:
            self._guarded[state.name] = (state.incarnation, protected)
            was_owed = self._unguarded.pop(state.name, None) is not None
        if was_owed:
            _log.info("%s has the guards now", state.name)

    def _check_guarded(self, manager: str) -> None:
        with self._lock:
            why = self._unguarded.get(manager)
        if why is not None:
            raise HostError(f"nodelet manager '{manager}' does not have the guards yet: {why}")

    def _list_of(self, state: ManagerState) -> Optional[List[str]]:
        try:
            return self._without_late(state.name, self._listed(state.name, state.incarnation))
        except HostError as error:
            if state.own and state.responsive:  # of others their peer tells
                _log.warning("nodelet manager %s: %s", state.name, error)
            return None

    def _listed(self, manager: str, incarnation: str = "") -> List[str]:
        peer = self._peers.find(manager)
        if peer is not None:
            return peer.list(incarnation)
        names: List[str] = self._asking(manager, self._client_of(manager).list)
        return names

    def _without_late(self, manager: str, listed: List[str]) -> List[str]:
        """Unload what came up after everybody had stopped waiting for it."""
        with self._lock:
            late = [each for each in listed if (manager, each) in self._abandoned]
            self._abandoned.difference_update((manager, name) for name in late)
        for name in late:
            self.unload(manager, name)
        return [each for each in listed if each not in late]

    def _client_of(self, manager: str) -> ListClient:
        incarnation = self._incarnation(manager)
        if not incarnation:
            raise HostError(f"nodelet manager '{manager}' is not running")
        with self._lock:
            for key in [key for key in self._lists if key[0] == manager and key[1] != incarnation]:
                self._lists.pop(key).close()
            key = (manager, incarnation)
            if key not in self._lists:
                self._lists[key] = ListClient(self._master, manager)
            return self._lists[key]

    def _incarnation(self, manager: str) -> str:
        """The process of a child of ours; empty while none is up."""
        children = self._children.all()
        return next((c.incarnation for c in children if c.record.name == manager), "")

    def _ask_nodelet(
        self, name: str, service: str, service_class: Any, timeout: float, *args: Any
    ) -> Any:
        """Call a service of a nodelet, unless its nodelet manager is known not to answer."""
        peer = self._peers.hosting(name)
        if peer is not None:
            peer.check()
        full = names.join(name, service)
        return self._asking(name, lambda: self._call(full, service_class, timeout, *args))

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
        try:
            self._master.ask("deleteParam", key)
        except (LookupError, PeerTimeout):
            return  # it was not set, or nobody is there to keep it

    @staticmethod
    def _asking(whom: str, question: Callable[[], Any]) -> Any:
        try:
            return question()
        except (PeerTimeout, LookupError) as error:
            kind = HostTimeout if isinstance(error, PeerTimeout) else HostError
            raise kind(f"{whom}: {error}" if whom else str(error)) from error
