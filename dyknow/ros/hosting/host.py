# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The host of nodelets in ROS: loads, unloads and asks them, wherever they run.

Every remote call has a time limit. A nodelet manager that hangs delays at most one question by
that limit: while its last answer is due it is not queried again.
"""

from __future__ import annotations

import builtins
import contextlib
import time
from typing import Callable, Collection, Iterable, Iterator, Mapping, Sequence

import rosgraph.network
from dyknow_msgs.msg import HandedTopic, NodeletChanges, NodeletCounts
from dyknow_msgs.srv import HandOver, HandOverRequest
from nodelet.srv import NodeletLoad, NodeletUnload

from dyknow import names
from dyknow.errors import HostError, HostTimeout, NameTaken, PeerTimeout, Refused
from dyknow.locks import turn_lock
from dyknow.manager.host import (
    Count,
    HeardVerdict,
    Host,
    HostReport,
    Listening,
    LoadRequest,
    ProcessState,
    Reported,
    Usage,
)
from dyknow.manager.specifications.values import value_of
from dyknow.model.graph import NodeletKind, PortState
from dyknow.model.transformation import (
    FORMULA_CLASS,
    NODE,
    Parameter,
    Program,
    Transformation,
)
from dyknow.periodic import Workers
from dyknow.ros.client import ProxyClient
from dyknow.ros.hosting.children import Children
from dyknow.ros.hosting.code_files import CodeFiles
from dyknow.ros.hosting.external import Externals
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.installed import NodeletTypes
from dyknow.ros.hosting.listening import TopicCounter, VerdictTopics
from dyknow.ros.hosting.peer import POLL_TIMEOUT, Peer, host_errors
from dyknow.ros.hosting.reconfigure import reconfigure
from dyknow.ros.process import programs
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.wire import ages_and_sizes
from dyknow.ros.wire.addresses import ADDRESSES, host_of
from dyknow.ros.wire.poll_client import HAND_OVER
from dyknow.ros.wire.service_client import ServiceClient, ServiceFailed, ServiceLost

#: Seconds for an unload, which waits up to 1 s for ``on_shutdown``.
_UNLOAD_TIMEOUT = 4.0
#: Seconds for a nodelet that is up to be reported.
_REPORT_TIMEOUT = 3.0
#: Seconds for the end of a process to be noticed.
_DEATH_TIMEOUT = 2.0
#: Seconds for a proxy to connect ports, which waits up to 0.5 s for outside peers.
_CONNECT_TIMEOUT = 4.0
#: Seconds for one step of the move of a nodelet, which finishes its work.
_HAND_OVER_TIMEOUT = 20.0
#: Seconds that a caller waits for the counts of all processes together.
_COUNTS_PATIENCE = 0.5
#: Seconds to wait, at the end, for a registration that is going on.
_COUNTING_PATIENCE = 0.5
#: A formula with the first of these parameters has the second: it asks this manager for them.
_INDIVIDUALS, _MANAGER = "individuals", "manager"


class RosHost(Host):
    """Processes of the ROS graph that run nodelets: children of ours, and external ones."""

    def __init__(
        self,
        context: PeerContext,
        children: Children,
        registrar: Registrar,
        external: Sequence[str] = (),
        on_verdict: Callable[[], object] = lambda: None,
    ) -> None:
        """Prepare; ``start`` looks for the ``external`` nodelet managers.

        ``registrar`` registers the topics of this process; ``on_verdict`` is called when a verdict
        that is listened to differs.
        """
        self._context = context
        self._master = context.master
        self._proxies = ProxyClient(context.master)
        self._children = children
        self._external = Externals(context, external, lambda name: children.find(name) is not None)
        #: Look for the external nodelet managers, and listen to re-wirable nodes, from now on.
        self.start = self._external.start
        #: Find re-wirable nodes of these names that run already.
        self.look_for_nodes = self._external.look_for
        #: Use nodelet managers of these names that run, where nodelets of an earlier life are.
        self.use = self._external.use
        self._types = NodeletTypes()
        self._code = CodeFiles()
        #: Older guards or producers must not replace newer ones.
        self._grants_turn = turn_lock("grants to processes")
        self._registrar = registrar
        self._counting = Workers("registering to count messages", 1)
        self._verdicts = VerdictTopics(on_verdict)

    def listen_to_processes(self) -> None:
        """Listen to all processes that run nodelets from now on, and find foreign ones."""
        self._external.listen(self._hear)

    def _hear(self, node: str, changes: NodeletChanges) -> None:
        peer = self._peer(node)
        if peer is not None:
            peer.hear(changes)

    # Processes

    def kind_of(self, transformation: Transformation) -> NodeletKind:
        if transformation.type == NODE:
            return programs.kind_of(Program.of(transformation.source))
        return self._types.kind_of(transformation.source)

    def states(self) -> dict[str, ProcessState]:
        return {peer.name: peer.state for peer in self._peers()}

    def poll(self) -> HostReport:
        """Ask each process for its nodelets; how external ones end is not seen."""
        peers = [(peer, peer.state) for peer in self._peers()]
        crashes = {crash.incarnation: crash for crash in self._children.crashes()}
        asked = [
            (peer, state, peer.wake())
            for peer, state in peers
            if state.alive and not peer.presence.trouble
        ]
        nodelets = {}
        for peer, state, number in asked:
            with contextlib.suppress(HostError):
                nodelets[peer.name] = frozenset(self._list(peer, number, state.incarnation))
        return HostReport({peer.name: state for peer, state in peers}, nodelets, crashes)

    @property
    def here(self) -> str:
        return str(rosgraph.network.get_host_name())

    def address_of(self, name: str) -> str:
        with contextlib.suppress(OSError):  # socket.timeout too: it is being looked up
            return next(iter(ADDRESSES.of(name, 0.0)), "")
        return ""

    def publishing_hosts(self, topics: Iterable[str]) -> frozenset[str]:
        with host_errors():
            publishers = self._master.publications()
            nodes = {node for topic in topics for node in publishers.get(topic, ())}
            return frozenset(host_of(self._master.node(node)) for node in nodes) - {""}

    def look_for(self, manager: str) -> None:
        external = self._external.find(manager)
        if external is not None:
            external.look_now()

    def ensure(self, kind: NodeletKind, isolated_for: str = "") -> str:
        return isolated_for if kind.is_node else self._children.ensure(kind, isolated_for)

    def hand_over(self, protected: Callable[[], Mapping[str, Sequence[str]]]) -> None:
        """Have all processes that answer obey the guards as they are now.

        Args:
            protected: returns, by process, the nodelets that it unloads for us alone. Stock
                nodelet managers do not enforce it.
        """
        with self._grants_turn:
            self._context.protected = protected()
            for peer in self._peers():
                peer.hand_over_guards()

    def retire(self, manager: str) -> None:
        self._children.end(manager)

    def grant(self, granted: Callable[[], tuple[Mapping[str, str], Collection[str]]]) -> None:
        """Let these nodelets alone publish on topics of claims.

        Args:
            granted: returns, by topic, the nodelet that publishes there, empty for none at
                present; and the processes that run these nodelets, whose leases are renewed from
                now on.
        """
        with self._grants_turn:
            producers, managers = granted()
            is_new, self._context.producers = self._context.producers != producers, producers
            for peer in self._peers():
                is_granted = peer.lease.is_granted
                if (is_granted and is_new) or (not is_granted and peer.name in managers):
                    peer.lease.grant()
                    peer.wake()

    def may_publish(self, manager: str) -> bool:
        peer = self._peer(manager)
        return peer.may_publish if peer is not None else self._context.is_young

    def list(self, manager: str) -> builtins.list[str]:
        return self._list(self._known(manager))

    # Nodelets

    def memory(self, manager: str) -> int:
        child = self._children.find(manager)
        process = child.record.process if child is not None else None
        return process.memory() if process is not None else 0

    def renew(self, manager: str) -> None:
        self._children.renew(manager)

    def code_of(self, manager: str, transformation: Transformation, anew: bool = False) -> str:
        """Look at the files of this machine, for processes that run here."""
        peer = self._peer(manager)
        is_here = peer is None or peer.state.host == self.here
        return self._code.of(transformation, anew) if is_here else ""

    def check_code(self, transformation: Transformation) -> None:
        self._code.check(transformation)

    def load(self, manager: str, request: LoadRequest, timeout: float) -> None:
        if request.kind.is_node:
            self._start_node(request, timeout)
            return
        self._children.await_up(manager, timeout)
        peer = self._known(manager)
        # A hanging manager would load the nodelet when it goes on, so it is queried first.
        if request.name in self._list(peer):
            raise NameTaken(request.name)
        parameters = list(request.parameters)
        if request.source == FORMULA_CLASS and _INDIVIDUALS in [each.name for each in parameters]:
            parameters.insert(0, Parameter(_MANAGER, "string", self._master.caller))
        self._set_parameters(request.name, parameters)
        peer.late.discard(request.name)
        peer.refused.discard(request.name)
        sources = sorted(request.remappings)
        type_, arguments = request.source, []
        if request.kind is NodeletKind.SCRIPT:
            program = Program.of(request.source)
            type_, arguments = programs.SCRIPT, [program.name, *program.arguments]
        try:
            ServiceClient(self._master, f"{manager}/load_nodelet", NodeletLoad).call(
                timeout,
                name=request.name,
                type=type_,
                remap_source_args=sources,
                remap_target_args=[request.remappings[source] for source in sources],
                my_argv=arguments,
            )
        except PeerTimeout as error:
            peer.late.add(request.name)
            peer.nodelets()  # a timeout of the nodelet manager, if that hangs
            raise HostError(f"'{request.source}' was not up within {timeout:g} s") from error
        except ServiceFailed as error:
            peer.refused.add(request.name)
            text = str(error) or "its nodelet manager gives no reason; its log may have one"
            raise HostError(text) from error
        if peer.state.rewirable:
            peer.await_report(request.name, _REPORT_TIMEOUT)

    def unload(self, manager: str, name: str) -> None:
        """Unload, unless the load was refused; a node is ended."""
        peer = self._known(manager)
        state = peer.state
        if state.kind.is_node:
            self.retire(manager)
            return
        if name in peer.refused:
            peer.refused.discard(name)
            raise HostError(f"nodelet '{name}' was not loaded")
        if not state.responsive:
            self._list(peer)  # fails at once while it hangs
        service = ServiceClient(self._master, f"{manager}/unload_nodelet", NodeletUnload)
        try:
            with host_errors(manager):
                service.call(_UNLOAD_TIMEOUT, name)
        except ServiceLost:
            if state.own and state.alive:
                self._children.await_end(manager, state.incarnation, _DEATH_TIMEOUT)
            raise
        peer.late.discard(name)  # one that another client loads later is not ours to unload

    @contextlib.contextmanager
    def moving(self, name: str, source: str, target: str) -> Iterator[Callable[[], None]]:
        """Move a nodelet as ``dyknow.nodelet.hand_over`` says."""

        def hand_over() -> None:
            given = self._hand_over(source, name, HandOverRequest.GIVE, parked)
            with contextlib.suppress(HostError):
                self._hand_over(target, name, HandOverRequest.TAKE, given)

        try:
            topics = self._hand_over(source, name, HandOverRequest.NOTE)
            parked = self._hand_over(target, name, HandOverRequest.PARK, topics)
            yield hand_over
        finally:
            for manager in (target, source):
                with contextlib.suppress(HostError):
                    self._hand_over(manager, name, HandOverRequest.END)

    def _hand_over(
        self, manager: str, name: str, step: int, topics: Sequence[HandedTopic] = ()
    ) -> Sequence[HandedTopic]:
        peer = self._known(manager)
        peer.presence.check(peer.title)
        service, beside = names.join(manager, HAND_OVER), names.join(manager, "list")
        with host_errors(manager):
            client = ServiceClient(self._master, service, HandOver, beside=beside)
            answer = client.call(_HAND_OVER_TIMEOUT, name, step, topics)
        return tuple(answer.topics)

    def usage(self) -> dict[str, Usage]:
        return {peer.name: peer.usage for peer in self._peers() if peer.usage is not None}

    def widen(self, kind: NodeletKind) -> None:
        self._children.widen(kind)

    def set_parameter(self, name: str, parameter: Parameter) -> bool:
        self._set_parameters(name, [parameter])
        return reconfigure(self._master, name, parameter)

    def forget(self, name: str, parameters: Sequence[str]) -> None:
        own = [_MANAGER] * (_INDIVIDUALS in parameters)
        with contextlib.suppress(LookupError, PeerTimeout):  # no master
            self._master.delete_parameters(name, [*parameters, *own])

    def reported(self, manager: str, name: str) -> Reported | None:
        peer = self._peer(manager)
        return peer.presence.nodelets.get(name) if peer is not None else None

    def ports(self, name: str) -> tuple[PortState, ...]:
        reported = self._hosting(name).nodelets().get(name)
        if reported is None:
            raise HostError(f"nodelet '{name}' is not loaded, or has no ports")
        return reported.ports

    def connect(self, name: str, config: Mapping[str, str]) -> None:
        peer = self._hosting(name)
        peer.presence.check(peer.title)
        try:
            with host_errors(name):
                self._proxies.set_config(name, config, _CONNECT_TIMEOUT)
        except Refused as error:
            raise HostError(str(error)) from error
        with contextlib.suppress(HostError):
            peer.nodelets()  # from now on it is reported

    def published(self, topics: Iterable[str]) -> frozenset[str]:
        wanted = frozenset(topics)
        if not wanted:
            return wanted
        with host_errors():
            publishers = self._master.publications()
        return wanted & {topic for topic, nodes in publishers.items() if nodes}

    def counts(
        self, wanted: Mapping[str, Collection[str]]
    ) -> dict[str, Mapping[str, Count] | None]:
        deadline = time.monotonic() + _COUNTS_PATIENCE
        peers = {manager: self._peer(manager) for manager in wanted}
        numbers = {name: peer.ask_counts(wanted[name]) for name, peer in peers.items() if peer}
        found: dict[str, Mapping[str, Count] | None] = {}
        for name, peer in peers.items():
            if peer is None:
                found.update(dict.fromkeys(wanted[name]))
            else:
                found.update(peer.counts(numbers[name], wanted[name], deadline))
        return found

    def traffic(self) -> builtins.list[NodeletCounts]:
        """Count the messages of all nodelets; without those whose process does not answer."""
        deadline = time.monotonic() + _COUNTS_PATIENCE
        asked = [
            (peer, peer.ask_traffic())
            for peer in self._peers()
            if peer.state.rewirable and not peer.presence.trouble
        ]
        return [each for peer, number in asked for each in peer.traffic(number, deadline)]

    def is_stamped(self, datatype: str) -> bool | None:
        return ages_and_sizes.is_stamped(datatype)

    def verdicts(self, topics: Collection[str]) -> dict[str, HeardVerdict]:
        return self._verdicts.follow(topics)

    def listen(self, topic: str) -> Listening:
        return TopicCounter(topic, self._registrar, self._counting)

    def close(self) -> None:
        """Close all connections; our children go on."""
        self._counting.close(_COUNTING_PATIENCE)
        self._verdicts.close()
        for peer in self._peers():
            peer.close()
        self._external.close()

    def release(self) -> None:
        """Remove our guards and leases from the processes that outlive us."""
        for external in self._external.all():
            external.release()

    def part(self) -> None:
        """Let the streams go on as they are until the next manager comes."""
        granted = [each for each in self._peers() if each.lease.is_granted]
        for peer in granted:
            peer.lease.part()
        deadline = time.monotonic() + 2 * POLL_TIMEOUT
        for _ in range(2):  # the second has the clock of the answer to the first
            for peer, number in [(each, each.wake()) for each in granted]:
                peer.wait(number, deadline)

    # Inside

    def _peers(self) -> builtins.list[Peer]:
        """Return every process, by name."""
        found: dict[str, Peer] = {each.name: each for each in self._external.all()}
        found.update((each.name, each) for each in self._children.all())
        return [found[name] for name in sorted(found)]

    def _peer(self, name: str) -> Peer | None:
        return self._children.find(name) or self._external.find(name)

    def _known(self, name: str) -> Peer:
        """Return the process of a name; raises ``HostError`` if there is none."""
        found = self._peer(name)
        if found is None:
            raise HostError(f"nodelet manager '{name}' is not running")
        return found

    def _hosting(self, nodelet: str) -> Peer:
        """Return the process that runs a nodelet, or did when it answered last."""
        hosting = [each for each in self._peers() if nodelet in each.presence.nodelets]
        answering = [each for each in hosting if not each.presence.trouble]
        for each in (*answering, *hosting):
            return each
        raise HostError(f"no process runs nodelet '{nodelet}'")

    def _list(
        self, peer: Peer, number: int | None = None, incarnation: str = ""
    ) -> builtins.list[str]:
        """List the nodelets of a process; unload those whose load had been given up."""
        found = peer.nodelets(number, incarnation)
        late = peer.take_late(found)
        left = set(late)
        try:
            for name in sorted(late):
                left.discard(name)
                self.unload(peer.name, name)
        except HostTimeout:
            left.add(name)
            raise
        finally:
            peer.late |= left  # they are unloaded after the next look
        return sorted(found.keys() - late)

    def _start_node(self, request: LoadRequest, timeout: float) -> None:
        self._children.check_free(request.name)
        program = Program.of(request.source)
        path = programs.find_program(program.package, program.executable)
        remappings = (f"{each}:={request.remappings[each]}" for each in sorted(request.remappings))
        self._set_parameters(request.name, request.parameters)
        command = (path, *program.arguments, *remappings)
        self._children.start_node(request.kind, request.name, command, timeout)

    def _set_parameters(self, name: str, parameters: Sequence[Parameter]) -> None:
        for parameter in parameters:
            key = names.join(name, parameter.name)
            try:
                self._master.ask("setParam", key, value_of(parameter))
            except (LookupError, PeerTimeout, OverflowError, TypeError) as error:
                raise HostError(f"parameter '{key}' cannot be set: {error}") from error
