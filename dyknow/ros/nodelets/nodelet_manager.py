# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet manager: a node that hosts nodelets on threads, in place of the C++ one.

Ownership: the manager owns the runtime, the loader, the bonds and its services. A load
or an unload that fails is a failed service call, with the cause as its text: stock clients rely
on that.
"""

from __future__ import annotations

import faulthandler
import itertools
import logging
import os
import sys
import traceback
from dataclasses import dataclass
from typing import Any, Callable, Mapping, Sequence
from weakref import WeakKeyDictionary

import rospy
from dyknow_msgs.msg import NodeletPorts
from nodelet import srv

from dyknow import names
from dyknow.errors import DyKnowError
from dyknow.model.graph import NodeletKind
from dyknow.nodelet.context import Context, Runtime
from dyknow.nodelet.crash_record import CrashRecord
from dyknow.nodelet.handle import Nodelet
from dyknow.nodelet.loading.leftovers import StuckCallbacks
from dyknow.nodelet.loading.loader import Loader
from dyknow.nodelet.middleware import Closable
from dyknow.nodelet.scheduler import Executor, WorkerPool
from dyknow.nodelet.texts import encodable, sendable
from dyknow.proxy.proxy import NodeletProxy
from dyknow.ros.bonding.bonded import BondedNodelets
from dyknow.ros.bonding.bonds import Bonds
from dyknow.ros.nodelets.announcements import TOPIC, Announcer
from dyknow.ros.nodelets.nodelet_log import NodeletLog
from dyknow.ros.nodelets.owner import end_when_orphaned
from dyknow.ros.nodelets.peer_services import HandOverService, PollService, watch_name
from dyknow.ros.nodelets.process_guards import SPAWNED, ProcessGuards, caller_of
from dyknow.ros.nodelets.proxy_services import ProxyServices, for_log
from dyknow.ros.parameters import PrivateParameters
from dyknow.ros.process import descriptors, programs
from dyknow.ros.process.node_process import NodeProcess
from dyknow.ros.transport.middleware import rospy_middleware
from dyknow.ros.transport.registrar import guard_topics, hide_topics, services_together
from dyknow.ros.wire.messages import port_message

#: Seconds, at the end, for clients that end at the same time.
CLIENTS_PATIENCE = 0.5


def _is_no_late_connection(record: logging.LogRecord) -> bool:
    """Pass on all but rospy's warnings of clients that connect to a bond that has just ended."""
    return "Could not process inbound connection" not in record.getMessage()


@dataclass(frozen=True)
class Settings:
    """Private parameters of a nodelet manager.

    Attributes:
        num_worker_threads: callbacks that can run at the same time; 0 for max(4, cores).
        switch_interval: seconds that a thread in Python code keeps the interpreter before it lets
            other threads in. Python's own 5 ms would let one busy nodelet delay each hop of all.
        stuck_after: seconds after which a callback that has not returned is reported.
        shared_memory: whether large messages reach other processes of this host through memory.
        rewirable: whether the ports of its nodelets may be connected elsewhere.
    """

    num_worker_threads: int = 0
    switch_interval: float = 0.0005
    stuck_after: float = 10.0
    shared_memory: bool = True
    rewirable: bool = True

    @classmethod
    def read(cls) -> Settings:
        """Read the node's private parameters.

        Raises:
            BadParameter: a parameter has no sensible value.
        """
        given = PrivateParameters(rospy.get_param("~", {}))

        def seconds(name: str, default: float) -> float:
            return given.number(name, default, "seconds above 0", lambda value: value > 0)

        return cls(
            given.integer("num_worker_threads", cls.num_worker_threads),
            seconds("switch_interval", cls.switch_interval),
            seconds("stuck_after", cls.stuck_after),
            given.flag("shared_memory", cls.shared_memory),
            given.flag("rewirable", cls.rewirable),
        )

    @property
    def workers(self) -> int:
        """Number of threads that it comes to."""
        return self.num_worker_threads or max(4, os.cpu_count() or 1)


class NodeletManager(Closable):
    """Hosts nodelets in this process; the node must be initialised.

    Args:
        settings: how it works.
        find_class: returns the class of the one thing that it hosts, whose callbacks have a
            thread each; by default it hosts nodelets that packages declare, on worker threads.
        bound: whether guards bind the nodelets' own connections, not only set_config.
    """

    def __init__(
        self,
        settings: Settings,
        find_class: Callable[[str, Context], type[Nodelet]] | None = None,
        bound: bool = True,
    ) -> None:
        self._workers = settings.workers
        sys.setswitchinterval(settings.switch_interval)
        self._record = _crash_record()
        blocking = WorkerPool(None, record=self._record)
        pool: Executor = blocking
        if find_class is None:
            pool = WorkerPool(settings.workers, settings.stuck_after, record=self._record)
        self._guards = ProcessGuards(settings.rewirable)
        self._runtime = Runtime(
            rospy_middleware(pool, settings.shared_memory),
            pool,
            guards=self._guards.current,
            bound=bound,
            blocking=blocking,
        )
        if bound:
            guard_topics(lambda topic: self._guards.current().check_topic(topic))
        self._bonds = Bonds(names.join(rospy.get_name(), "bond"))
        self._bonded = BondedNodelets(self._bonds, self._unload_only)
        self._loaders: WeakKeyDictionary[Context, str] = WeakKeyDictionary()
        self.loader = Loader(
            self._runtime, find_class or _declared_classes(), self._attach, self._unloaded
        )
        self._announcer = Announcer(self._describe)
        self._stuck = StuckCallbacks(
            self.loader, rospy.get_name(), settings.stuck_after, self._announcer.announce
        )
        self._stuck.start()
        if find_class is None:
            NodeletLog.install(self._topics_of)
        self._services: list[Any] = []
        self._poll_service: PollService | None = None
        self._hand_over_service: HandOverService | None = None

    def offer(self) -> None:
        """Offer the services of nodelet/Nodelet{Load,Unload,List}, and ``~poll``."""
        rospy.loginfo("Initializing nodelet with %d worker threads.", self._workers)
        self._offer_poll()
        self._hand_over_service = HandOverService(self.loader, self._guards, self._unload_only)
        with services_together():
            self._services += [
                rospy.Service("~load_nodelet", srv.NodeletLoad, self._load),
                rospy.Service("~unload_nodelet", srv.NodeletUnload, self._unload),
                rospy.Service("~list", srv.NodeletList, self._list),
            ]
        self._announcer.start()  # last: managers poll it at once

    def be(self, kind: NodeletKind, remappings: Mapping[str, str]) -> None:
        """Host one thing under the name of the node, which is not a nodelet manager then."""
        hide_topics([TOPIC])
        self.loader.load(rospy.get_name(), kind.value, remappings)
        self.appear(kind)

    def appear(self, kind: NodeletKind) -> None:
        """Let managers know of the one thing that bears the name of the node."""
        self._announcer.kind = kind
        self._announcer.announce(rospy.get_name())
        self._offer_poll()
        self._announcer.start()  # last: managers poll it at once

    def load(self, request: srv.NodeletLoadRequest, caller: str = "") -> None:
        """Load a nodelet; ``caller`` is the requesting node, empty when it is this one.

        Raises:
            DyKnowError: it could not be loaded, and nothing of it is left.
        """
        lists = (request.remap_source_args, request.remap_target_args, request.my_argv)
        texts = (request.name, request.type, request.bond_id, *itertools.chain(*lists))
        self._guards.current().check_sizes(texts, max(map(len, lists)))
        sources, targets, my_argv = lists
        name = _resolved(request.name)
        remappings = names.pair_remappings(name, sources, targets, names.parent(rospy.get_name()))
        if caller:
            self._guards.check_caller(caller, f"loading '{name}'")
            if request.type == programs.SCRIPT and my_argv:
                self._guards.check_program(caller, my_argv[0])
        descriptors.check_left()
        context = self.loader.load(name, request.type, remappings, my_argv).context
        self._loaders[context] = caller
        self._announcer.announce(name)
        if request.bond_id:
            self._bonded.add(context, request.bond_id)
        rospy.loginfo("loaded nodelet %s of type %s%s", name, request.type, _for(caller))

    def unload(self, name: str, caller: str = "", only: Context | None = None) -> None:
        """Unload a nodelet, or the ``only`` one of that name; ``caller`` is as in ``load``.

        Raises:
            DyKnowError: there is none of that name, or the caller must not unload it.
        """
        self._guards.current().check_sizes([name])
        name = _resolved(name)
        if caller:
            self._guards.check_caller(caller, f"unloading '{name}'")
            self._guards.check_protection(caller, name)
        self.loader.unload(name, only)
        rospy.loginfo("unloaded nodelet %s%s", name, _for(caller))

    def _unload_only(self, context: Context) -> None:
        self.unload(context.name, only=context)  # another nodelet may have the name by now

    def _topics_of(self, name: str) -> list[str] | None:
        """List the topics of a nodelet's ports; None if there is no nodelet of that name."""
        context = self.loader.known(name)
        proxy = context.attached if context is not None else None
        if isinstance(proxy, NodeletProxy):
            return sorted({port.topic for port in proxy.get_config() if port.topic})
        return None if context is None else []

    def close(self) -> None:
        """Unload everything and end.

        No client requested these unloads, so the list is not answered any more: a manager that
        keeps nodelets running has to see a process that ends, not nodelets that go.
        """
        logging.getLogger("rosout").addFilter(_is_no_late_connection)
        if self._poll_service is not None:
            self._poll_service.is_ending = True
        # Ctrl-C of a launch file ends the clients too: they unload their nodelets.
        self._bonded.wait(CLIENTS_PATIENCE)
        for service in self._services:
            service.shutdown("the nodelet manager ends")
        if self._poll_service is not None:
            self._poll_service.close()
        if self._hand_over_service is not None:
            self._hand_over_service.close()
        self.loader.close()
        self._stuck.close()
        self._announcer.close()
        self._bonds.close()
        self._runtime.close()
        self._record.close()

    def _unloaded(self, context: Context) -> None:
        self._announcer.announce(context.name)
        self._bonded.ended(context)

    def _attach(self, context: Context, thing: Any) -> Closable | None:
        if not isinstance(thing, NodeletProxy):
            return None
        thing.on_change = lambda: self._announcer.announce(context.name)
        return ProxyServices(thing, self._guards.check_rewiring)

    # Polls by managers

    def _offer_poll(self) -> None:
        self._poll_service = PollService(
            self.loader, self._runtime.bus, self._guards, self._announcer, self._stuck
        )

    def _describe(self, name: str) -> NodeletPorts:
        context = self.loader.find(name)
        proxy = context.attached if context is not None else None
        ports = proxy.get_config() if isinstance(proxy, NodeletProxy) else ()
        detail = self._stuck.detail(name)
        owner = self._guards.owner
        loader = self._loaders.get(context, owner) if context is not None else owner
        return NodeletPorts(
            name, context is not None, list(map(port_message, ports)), detail, loader
        )

    # Services

    def _load(self, request: Any) -> srv.NodeletLoadResponse:
        try:
            self.load(request, caller_of(request))
        except DyKnowError as error:
            raise _failed("Failed to load nodelet", request.name, error) from error
        return srv.NodeletLoadResponse(True)

    def _unload(self, request: Any) -> srv.NodeletUnloadResponse:
        try:
            self.unload(request.name, caller_of(request))
        except DyKnowError as error:
            raise _failed("Failed to unload nodelet", request.name, error) from error
        return srv.NodeletUnloadResponse(True)

    def _list(self, request: Any) -> srv.NodeletListResponse:
        running = self.loader.list()
        if self._poll_service is None or self._poll_service.is_ending:
            # Checked last: the end may have unloaded some.
            raise rospy.ServiceException("the nodelet manager ends")
        return srv.NodeletListResponse(running)


def _declared_classes() -> Callable[[str, Context], type[Nodelet]]:
    # Here: a script in a process of its own does not wait for the parser of XML.
    from dyknow.nodelet.loading.plugins import ClassImports, Plugins, plugin_files
    from dyknow.ros.scripts.modules import importer_with_libraries

    plugins, imports = Plugins(plugin_files), ClassImports(importer_with_libraries)
    return lambda type_name, context: imports.load(plugins.find(type_name), context)


def _resolved(name: str) -> str:
    name = names.check(name, "nodelet name")  # resolved, an empty one would be the namespace
    return names.resolve(name, names.parent(rospy.get_name()), rospy.get_name())


def _failed(what: str, name: str, error: DyKnowError) -> rospy.ServiceException:
    cause = error.__cause__
    lines = traceback.format_exception(type(cause), cause, cause.__traceback__) if cause else []
    text = "\n".join([str(error), "".join(lines)]).rstrip()
    rospy.logerr("%s [%s]: %s", what, for_log(name), encodable(text))
    return rospy.ServiceException(sendable(error))


def _for(caller: str) -> str:
    return f" for {for_log(caller)}" if caller else ""


def _end_without_owner(argv: Sequence[str], end: Callable[[], None]) -> None:
    """End a child of a DyKnow manager when that is gone for too long.

    Its command line has the details, since it may have to wait for a master that is gone as well.
    """
    given = rospy.client.load_command_line_node_params(argv)
    lock, timeout = given.get("owner_lock", ""), float(given.get("orphan_timeout", 0.0))

    def end_alone() -> None:
        print(f"its DyKnow manager is gone for {timeout:g} s", flush=True)
        end()

    if lock and timeout > 0:
        end_when_orphaned(str(lock), timeout, end_alone)


def _crash_record() -> CrashRecord:
    """Where a DyKnow manager looks for the nodelets at work, if this process should crash."""
    path = rospy.get_param("~crash_record", "")
    try:
        return CrashRecord(str(path))
    except OSError as error:
        rospy.logwarn("a crash of this process will not be explained: %s", error)
        return CrashRecord()


def _make(bound: bool = True) -> NodeletManager:
    faulthandler.enable()  # a crash prints the stack of each thread
    return NodeletManager(Settings.read(), bound=bound)


def run_manager(argv: Sequence[str], node: str = "manager") -> int:
    """Run a nodelet manager until it is to end; returns the exit code."""

    def start() -> NodeletManager:
        manager = _make()
        manager.offer()

        def begin_again() -> None:
            """Register with a new master; with nodelets the connections of these matter more."""
            if not manager.loader.list():
                rospy.logwarn("the ROS master is a new one that does not know it; starting again")
                process.start_again({})

        watch_name(rospy.get_name(), rospy.get_node_uri(), rospy.signal_shutdown, begin_again)
        return manager

    process = NodeProcess(node, argv, start)
    _end_without_owner(argv, process.end)
    return process.run()


def run_standalone(type_name: str, my_argv: Sequence[str], argv: Sequence[str]) -> int:
    """Run one nodelet in a process of its own, under the name of the node."""

    def start() -> NodeletManager | None:
        manager = _make(bound=SPAWNED in os.environ)
        table = rospy.names.get_resolved_mappings()
        remappings = {
            source: target
            for source, target in table.items()
            if source.startswith("/") and not source.startswith("/__")
        }
        for remapped in remappings.keys() & remappings.values():
            del table[remapped]  # rospy would remap a name again that the handle has remapped
        name, sources, targets = rospy.get_name(), list(remappings), list(remappings.values())
        try:
            manager.load(srv.NodeletLoadRequest(name, type_name, sources, targets, my_argv, ""))
        except DyKnowError as error:
            rospy.logfatal("Failed to load nodelet [%s]: %s", name, error)
            manager.close()
            return None
        manager.appear(NodeletKind.NODE)
        return manager

    return NodeProcess(type_name.replace("/", "_"), argv, start).run()
