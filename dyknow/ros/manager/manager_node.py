# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The node dyknow_manager: the paper's manager with its ROS interface.

Ownership: ``ManagerNode`` owns the store, the nodelet managers that it started, the host, the
manager, and its connections with ROS: services, topics, and bonds with the clients of claims. Its
periodic work is keys of one control loop: observing processes, reconciling claims, publishing the
model and counts, backups, bringing nodelets back, and keeping the node's name. SIGINT, SIGTERM and
rosnode kill end it on purpose: nodelets, claims and nodelet managers end too, unless they are to
be kept. A manager that is killed leaves them, and its next life takes them over. When the master
reports that another node bears the name, it does not end (``dyknow.ros.manager.tenure``).
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from typing import Any, Callable, Collection, Iterator, Mapping, NamedTuple, Sequence

import rospy
from dyknow_msgs.msg import NodeletChanges

import dyknow
from dyknow import names
from dyknow.errors import BadParameter, PeerTimeout, StoreError
from dyknow.manager.claim import ClaimEvent
from dyknow.manager.claims.answers import StreamAnswers
from dyknow.manager.claims.reconciler import open_reconciler
from dyknow.manager.graph import Graph
from dyknow.manager.library import Library
from dyknow.manager.record import Record
from dyknow.manager.store import Store
from dyknow.manager.supervision.lifecycle import ManagerContext
from dyknow.manager.supervision.observer import PERIOD
from dyknow.manager.supervision.spread import SPREAD_PERIOD, Spread
from dyknow.manager.supervision.watchdog import WATCH_PERIOD, Watchdog
from dyknow.model.graph import NodeletKind, State
from dyknow.model.streams import ClaimState
from dyknow.nodelet.middleware import Closable
from dyknow.periodic import ControlLoop, RunningClock, Work, in_background
from dyknow.ros.bonding.bonded import ClaimBonds
from dyknow.ros.formulas.message_types import message_type
from dyknow.ros.hosting.children import Children
from dyknow.ros.hosting.fixed_nodelets import FixedNodelets
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.host import RosHost
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.manager.boot_wiring import BootWiring
from dyknow.ros.manager.diagnostics import DiagnosticsTopic
from dyknow.ros.manager.keeper import MIRROR, MasterKeeper
from dyknow.ros.manager.library_files import LOOK_PERIOD, LibraryFiles, PackageExports
from dyknow.ros.manager.manager_settings import ManagerSettings, mirror_path
from dyknow.ros.manager.services import CountsTopic, EventTopic, ManagerServices, ModelTopic
from dyknow.ros.manager.tenure import KEY, VARIABLE, Tenure
from dyknow.ros.nodelets.owner import OwnerLock
from dyknow.ros.nodelets.process_guards import to_environment
from dyknow.ros.process.node_process import NodeProcess, is_given, name_of
from dyknow.ros.process.signals import FAILED
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.messages import guards_message
from dyknow.ros.wire.model_messages import ModelMessages

#: Seconds between two backups of the state, if it changes.
_BACKUP_PERIOD = 10.0
#: Least seconds between two messages with the model.
_MODEL_PERIOD = 0.05
#: Nodelets that are brought back at the same time.
_WORKERS = 4
#: Seconds to wait, at the end, for rounds that are going on.
_PATIENCE = 3.0
_ANSWER_TIMEOUT = 1.0
_NAME = "dyknow_manager"
#: Keys of the control loop that are woken.
_OBSERVE = "looking at the nodelet managers"
_RECONCILE = "reconciling streams"
_PUBLISH = "publishing the model"
#: Seconds that a thread keeps the interpreter while other threads want it. With Python's own 5 ms
#: a plan for a client would delay a repair at each of its calls.
_SWITCH_INTERVAL = 0.0005
#: Parameters that the command line sets for one life. The parameter server would keep them for the
#: next manager of the name; those of a launch file or of ``rosparam`` are meant for all lives.
_OF_ONE_LIFE = ("transformations", "ontologies", "catalogues", "wiring", "keep")
#: States of a claim whose stream flows as far as is known.
_RELIED_ON = (ClaimState.ACTIVE, ClaimState.DEGRADED)


class WiringCalls(NamedTuple):
    """Operations on wirings, which are above this node.

    Attributes:
        check: raises SpecificationError; takes content, name and the most nodelets.
        load: raises DyKnowError; takes the manager, these, and labels that stay as they are.
    """

    check: Callable[[bytes, str, int], object]
    load: Callable[[str, bytes, str, int, Collection[str]], object]


class ManagerNode(Closable):
    """The manager and its surroundings; the node must be initialised."""

    def __init__(
        self,
        settings: ManagerSettings,
        loop: ControlLoop,
        kept: MasterKeeper,
        wirings: WiringCalls,
        passing: Collection[str] = (),
    ) -> None:
        """Open the state and put the parts together; they work in rounds of the ``loop``.

        ``passing`` are private parameters that an end on purpose deletes.

        Raises:
            BadParameter: the wiring cannot be used.
            DyKnowError: the state or an ontology cannot be used.
        """
        node = rospy.get_name()
        self._settings = settings
        self._loop = loop
        self._keeper = kept
        self._passing = passing
        settings.take_state()
        self._owner = OwnerLock(settings.state_path("lock"))
        self._store = Store(settings.state_path("sqlite3"))
        most = settings.guards.nodelets
        self._wiring = BootWiring(
            settings.wiring,
            self._store,
            lambda data, file: wirings.check(data, file, most),
            lambda data, file: wirings.load(node, data, file, most, self._files.labels),
        )
        self._master = Master(node)
        self._running = running = RunningClock.started()
        context = PeerContext(
            self._master,
            settings.guards,
            rospy.get_node_uri() or "",
            lambda: loop.wake(_OBSERVE),
            running,
            lambda topic, hear: rospy.Subscriber(topic, NodeletChanges, hear),
        )
        launcher = Launcher(
            self._master,
            self._owner,
            settings.orphan_timeout,
            to_environment(node, guards_message(settings.guards)),
            settings.shared_memory,
        )
        self._children = Children(context, launcher, names.parent(node), self._store)
        self._host = RosHost(
            context,
            self._children,
            Registrar(),
            settings.nodelet_managers,
            lambda: loop.wake(_RECONCILE),
        )
        self._files = LibraryFiles(settings, self._store, PackageExports())
        manager = ManagerContext(
            self._host,
            self._store,
            Library(self._store, self._files.ontology(), settings.limits, message_type),
            Graph(self._store, on_change=self._on_change),
            settings.guards,
            run=loop.once,
            namespace=names.parent(node),
            spawn_timeout=settings.spawn_timeout,
        )
        self._reconciler = open_reconciler(
            manager, running=running, on_event=self._on_event, recover=settings.recover
        )
        self.manager = self._reconciler.manager
        self._messages = ModelMessages()
        self._answers = StreamAnswers(rospy.get_time)
        self._events = EventTopic(self._answers)
        self._fixed = FixedNodelets(self.manager)
        self._bonds = ClaimBonds(self._reconciler.claims, self._reconciler.expire, running)
        #: Whether another manager goes on in this name: then the end is not on purpose.
        self.leaves = False

    def start(self) -> None:
        """Take over the nodelets and claims of an earlier life, and offer the services."""
        self._host.start()
        self._children.adopt()
        stored = self._store.read("nodelets", Record.from_body).values()
        self._host.use({each.manager for each in stored if each.is_spawned and not each.isolated})
        self._children.want(NodeletKind.PYTHON, self._settings.num_nodelet_managers)
        self._files.look(self.manager.library)
        self._host.look_for_nodes(self.manager.library.nodes())  # claims may need them
        self._model = ModelTopic(self.manager.graph_model, self._messages, self._fixed.follow)
        self._counts = CountsTopic(self._host.traffic)
        self._diagnostics = DiagnosticsTopic(
            self.manager.graph_model,
            lambda: map(self._answers.status, self._reconciler.claims()),
            lambda: self._store.trouble or self._store.complaint,
            self._counts.latest,
            lambda: (self.manager.hosts(), self._settings.max_clock_offset),
        )
        self._loop.start()
        self._introduce(sum(each.is_spawned for each in stored))
        self.manager.start()
        self._after_change()
        if self._store.complaint:
            self._reconciler.report(self._store.complaint)
        self._bonds.follow()
        self._services = ManagerServices(
            self._reconciler,
            self._messages,
            self._answers,
            self._after_change,
            self._model.publish,
        )
        # Not before: readers of the model take the manager for one that answers.
        self._loop.add(_PUBLISH, self._model.publish, 0.0, _MODEL_PERIOD)
        self._keeper.watch(self._loop)
        for job in self._jobs():
            self._loop.add(*job)
        self._host.listen_to_processes()

    def close(self) -> None:
        """End on purpose, with all nodelets, claims and nodelet managers.

        If these are to be kept, they and the state are left as by a manager that was killed.

        A manager that leaves ends for the elder manager of its name, which has the name's nodelets
        and claims. Nothing is forgotten then: the state on disk is that of a manager that was
        killed. Its own nodelet managers end, since the elder's bear the same names; external ones
        are the elder's.
        """
        keeps = self._settings.keep and not self.leaves
        forgets = not (self.leaves or keeps)
        if keeps:
            rospy.loginfo("the manager %s ends, and its nodelets go on", rospy.get_name())
        elif self.leaves:
            rospy.logwarn(
                "an older manager %s goes on, so this one leaves; its state stays in %s",
                rospy.get_name(),
                self._settings.state_path("sqlite3"),
            )
        else:
            rospy.loginfo("the manager %s ends, and its nodelets with it", rospy.get_name())
        self._services.close()
        self._loop.close(1.0)
        if forgets:
            in_background("ending the claims", self._reconciler.end).join(_PATIENCE)
        if not keeps:
            self._bonds.close()
        self._model.close()
        self._diagnostics.close()
        self._counts.close()
        self._fixed.close()
        if not keeps:
            self._children.end_all()
        self._loop.close(_PATIENCE)
        if forgets:
            self._wiring.forget()
            self.manager.end()
            self._host.release()
        elif keeps:
            self._host.part()
        if not self.leaves:
            self._forget_parameters()
        self._host.close()
        self._store.close()
        if keeps:
            self._keeper.leave()
        else:
            self._keeper.close()
        self._owner.release()

    # Rounds and changes

    def _jobs(self) -> Iterator[tuple[str, Work, float]]:
        """Yield the periodic work: its key, a round of it, and seconds until the first one."""
        host, manager, settings = self._host, self.manager, self._settings
        report, running = self._reconciler.report, self._running
        follow = functools.partial(self._files.look, manager.library, self._on_files)
        yield _OBSERVE, self._observe, PERIOD
        yield _RECONCILE, self._reconciler.work, 0.0
        yield "diagnostics", self._diagnostics.publish, 0.0
        yield "counting messages", self._counts.publish, 0.0
        yield "loading the wiring", self._wiring.work, 0.0
        yield "looking at the files of the library", follow, LOOK_PERIOD
        yield "backup", self._back_up, _BACKUP_PERIOD
        if settings.watchdog:
            limits, restart = settings.watchdog, manager.renew
            watchdog = Watchdog(host, manager.graph, restart, limits, report, running)
            yield "watchdog", watchdog.look, WATCH_PERIOD
        if settings.spread and not settings.guards.read_only:
            limit, most = settings.spread_load, os.cpu_count() or 1
            spread = Spread(host, manager.graph, self._move, report, limit, most, running)
            yield "spreading nodelets", spread.look, SPREAD_PERIOD

    def _observe(self) -> float:
        try:
            return self.manager.look()
        finally:
            self._after_change()
            self._children.echo()

    def _move(self, name: str, target: str) -> None:
        try:
            self.manager.move(name, target)
        finally:
            self._after_change()

    def _back_up(self) -> float:
        self._store.back_up()
        return _BACKUP_PERIOD

    def _on_files(self, labels: Collection[str]) -> None:
        self._host.look_for_nodes(self.manager.library.nodes())
        for label in labels:
            self.manager.lifecycle.acquit(label)
        self._on_change()

    def _on_change(self) -> None:
        for key in (_PUBLISH, _RECONCILE, MIRROR):
            self._loop.wake(key)

    def _on_event(self, event: ClaimEvent) -> None:
        self._events.publish(event)
        self._bonds.follow()
        self._loop.wake(_RECONCILE)

    def _after_change(self) -> None:
        self._fixed.follow()
        self._host.grant(self._granted)
        self._host.hand_over(self._protected)

    # Inside

    def _introduce(self, nodelets: int) -> None:
        """Log the version, the master and the state that was found."""
        found = {
            "transformations": len(self.manager.library.all()),
            "nodelets": nodelets,
            "claims": len(self._reconciler.claims()),
        }
        rospy.loginfo(
            "DyKnow manager %s, version %s, of the ROS master at %s; its state is in '%s': %s",
            rospy.get_name(),
            dyknow.__version__,
            self._master.uri,
            self._settings.state_path("sqlite3"),
            ", ".join(f"{count} {what}" for what, count in found.items()),
        )

    def _forget_parameters(self) -> None:
        """Delete the parameters that are to end with this life."""
        with contextlib.suppress(LookupError, PeerTimeout):  # no ROS master
            self._master.delete_parameters(self._master.caller, self._passing)

    def _protected(self) -> dict[str, list[str]]:
        protected: dict[str, list[str]] = {}
        for record in self.manager.graph.all():
            if record.is_protected:
                protected.setdefault(record.manager, []).append(record.name)
        return protected

    def _granted(self) -> tuple[Mapping[str, str], Collection[str]]:
        """Return the producers of claims by topic, and the processes that run them."""
        producers: dict[str, str] = {}
        managers: set[str] = set()
        for claim in self._reconciler.claims():
            if claim.state.ended or not claim.topic:
                continue
            producers.setdefault(claim.topic, "")
            record = self.manager.graph.find(claim.goal[0])
            if record is None or claim.state not in _RELIED_ON:
                continue
            if record.state is State.RUNNING or record.name in self.manager.graph.restarting:
                producers[claim.topic] = record.name
                managers.add(record.manager)
        return producers, managers


def _is_running(name: str) -> bool:
    """Whether a manager of that name runs already, and answers."""
    # rospy waits for a master that does not answer; a node that does not is dead or ends.
    pid = Master(name).pid_of(name, _ANSWER_TIMEOUT)
    if pid:
        print(
            f"manager: {name} runs already (process {pid}); end it first: rosnode kill {name}",
            file=sys.stderr,
        )
    return bool(pid)


def run(argv: Sequence[str], wirings: WiringCalls) -> int:
    """Run the node until it has to end; returns the exit code."""
    name = name_of(argv, _NAME)
    tenure = Tenure(name, kept=os.environ.pop(VARIABLE, ""))
    if not tenure.is_resumed and _is_running(name):
        return FAILED
    tenure.take()

    def start() -> ManagerNode:
        kept = MasterKeeper(Master(name), mirror_path())
        kept.look()  # first: a new master may lack our own parameters
        parameters = rospy.get_param("~", {})
        passing = [each for each in _OF_ONE_LIFE if is_given(argv, each)]
        node = _start(ManagerSettings.read(parameters), loop, kept, wirings, passing)
        back = functools.partial(come_back, parameters)
        tenure.watch(loop, rospy.get_node_uri(), functools.partial(leave, node), back)
        return node

    def leave(node: ManagerNode) -> None:
        node.leaves = True
        process.end()

    def come_back(parameters: Any) -> None:
        rospy.logwarn("another manager took the name %s; taking it back", name)
        tenure.take_back(parameters)
        process.start_again(tenure.variables)

    loop = ControlLoop(_WORKERS)
    process = NodeProcess(_NAME, argv, start, lambda: loop.wake(KEY))
    code = process.run()
    tenure.give_back()
    return code


def _start(
    settings: ManagerSettings,
    loop: ControlLoop,
    kept: MasterKeeper,
    wirings: WiringCalls,
    passing: Collection[str],
) -> ManagerNode:
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        node = ManagerNode(settings, loop, kept, wirings, passing)
    except StoreError as error:
        cause = error.__cause__
        if not isinstance(cause, OSError):
            raise
        why = f"{cause.strerror}: '{cause.filename}'"
        if settings.state_dir:
            expected = f"a folder that can be written ({why})"
            raise BadParameter("~state_dir", settings.state_dir, expected) from error
        cure = "choose another folder with the parameter ~state_dir (_state_dir:=FOLDER)"
        raise StoreError(settings.state_path("sqlite3"), f"{why}; {cure}") from error
    node.start()
    return node
