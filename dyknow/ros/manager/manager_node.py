# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The node dyknow_manager: the paper's manager with its ROS interface.

Ownership: ``ManagerNode`` owns the store, the nodelet managers that it started, the host, the
manager, and its connections with ROS: services, the topic of the model, the streams, the watch and
the workers that restore nodelets. SIGINT, SIGTERM and rosnode kill end it on purpose: nodelets,
claims and nodelet managers end too. A manager that is killed leaves them, and its next life takes
them over. When the master reports that another node bears the name, it does not end
(``dyknow.ros.manager.tenure``).
"""

from __future__ import annotations

import functools
import os
import sys
from typing import TYPE_CHECKING, Any, Collection, Dict, List, Mapping, Sequence, Set, Tuple

import rosgraph.names
import rospy

import dyknow
from dyknow import names
from dyknow.errors import BadParameter, DyKnowError, PeerTimeout, StoreError
from dyknow.manager.claims.reconciler import open_reconciler
from dyknow.manager.library import Library
from dyknow.manager.manager import ManagerOptions
from dyknow.manager.store import Store
from dyknow.model.graph import NodeletKind, State
from dyknow.model.streams import ClaimState
from dyknow.nodelet.middleware import Closable
from dyknow.periodic import PeriodicWorker, RunningClock, Workers
from dyknow.ros.hosting.children import Children
from dyknow.ros.hosting.fixed_nodelets import FixedNodelets
from dyknow.ros.hosting.grants import PeerContext
from dyknow.ros.hosting.host import RosHost
from dyknow.ros.hosting.installed import missing_here
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.manager.loops import ModelPublisher, Watch
from dyknow.ros.manager.manager_settings import ManagerSettings
from dyknow.ros.manager.services import ManagerServices
from dyknow.ros.manager.stream_node import StreamNode
from dyknow.ros.manager.tenure import VARIABLE, Tenure
from dyknow.ros.nodelets.announcements import Listener
from dyknow.ros.nodelets.guard_parameters import guards_key, to_parameter
from dyknow.ros.nodelets.owner import OwnerLock
from dyknow.ros.process.node_process import NodeProcess
from dyknow.ros.process.signals import FAILED
from dyknow.ros.transport.registrar import Registrar
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.model_messages import ModelMessages

if TYPE_CHECKING:
    from dyknow.manager.specifications.ontology import Ontology

#: Seconds between two backups of the state, if it changes.
_BACKUP_PERIOD = 10.0
#: Nodelets that are brought back at the same time.
_WORKERS = 4
#: Seconds to wait, at the end, for those that are being brought back.
_WORKERS_PATIENCE = 3.0
_ANSWER_TIMEOUT = 1.0
_NAME = "dyknow_manager"
#: Seconds that a thread keeps the interpreter while other threads want it. With Python's own 5 ms
#: a plan for a client would delay a repair at each of its calls.
_SWITCH_INTERVAL = 0.0005
#: States of a claim whose stream flows as far as is known.
_RELIED_ON = (ClaimState.ACTIVE, ClaimState.DEGRADED)


class ManagerNode(Closable):
    """The manager and its surroundings; the node must be initialised."""

    def __init__(self, settings: ManagerSettings) -> None:
        """Open the state and put the parts together.

        Raises:
            DyKnowError: the state or an ontology cannot be used.
        """
        node = rospy.get_name()
        self._settings = settings
        self._owner = OwnerLock(settings.state_path("lock"))
        self._store = Store(settings.state_path("sqlite3"))
        master = self._master = Master(node)
        running = self._running = RunningClock.started()
        context = PeerContext(
            master,
            settings.guards,
            rospy.get_node_uri() or "",
            lambda: self._watch.refresh_now(),
            running,
        )
        launcher = Launcher(
            master,
            self._owner,
            settings.orphan_timeout,
            {guards_key(node): to_parameter(settings.guards)},
        )
        self._children = Children(
            context, launcher, names.parent(node), settings.state_path("children.json")
        )
        self._workers = Workers("work of the manager", _WORKERS)
        self._backups = PeriodicWorker("backup", self._store.back_up, _BACKUP_PERIOD)
        self._host = RosHost(context, self._children, Registrar(), settings.nodelet_managers)
        ontology = _ontology(settings)
        for warning in ontology.warnings if ontology is not None else ():
            rospy.logwarn("%s", warning)
        self._reconciler = open_reconciler(
            self._host,
            self._store,
            Library(self._store, ontology, settings.limits),
            settings.guards,
            ManagerOptions(names.parent(node), settings.spawn_timeout),
            self._workers.run,
            running=running,
        )
        self.manager = self._reconciler.manager
        self._messages = ModelMessages()
        self._fixed = FixedNodelets(self.manager)
        self._watch = Watch(self.manager, self._after_look)
        self._listener = Listener(self._hear)
        #: Whether another manager goes on in this name: then the end is not on purpose.
        self.leaves = False

    def start(self) -> None:
        """Take over the nodelets of an earlier life, and offer the services."""
        self._host.start()
        self._children.adopt()
        self._children.want(NodeletKind.PYTHON, self._settings.num_nodelet_managers)
        self._load_transformations()
        self._host.look_for_nodes(self.manager.library.nodes())  # claims may need them
        self._publisher = ModelPublisher(
            "~model", self.manager.graph_model, self._messages, self._fixed.follow
        )
        self.manager.on_change = self._publisher.note_change
        self._introduce()
        self.manager.start()
        self._after_change()
        self._streams = StreamNode(
            self.manager, self._reconciler, self._after_change, self._running
        )
        self.manager.on_change = self._on_change
        self._services = ManagerServices(
            self.manager, self._messages, self._after_change, self._publisher.publish
        )
        self._publisher.note_change()
        self._watch.start()
        self._backups.start()
        self._host.listen_for_nodes()

    def _hear(self, manager: str, nodelet: str, detail: str) -> None:
        """Hear of a change of a nodelet."""
        self._host.note_detail(manager, nodelet, detail)
        self._watch.refresh(nodelet)

    def close(self) -> None:
        """End on purpose, with all nodelets and nodelet managers.

        A manager that leaves ends for the elder manager of its name, which has the name's nodelets
        and claims. Nothing is forgotten then: the state on disk is that of a manager that was
        killed. Its own nodelet managers end, since the elder's bear the same names; external ones
        are the elder's.
        """
        if self.leaves:
            rospy.logwarn(
                "an older manager %s goes on, so this one leaves; its state stays in %s",
                rospy.get_name(),
                self._settings.state_path("sqlite3"),
            )
        else:
            rospy.loginfo("the manager %s ends, and its nodelets with it", rospy.get_name())
        self._services.close()
        if self.leaves:
            self._streams.suspend()
        else:
            self._streams.close()
        self._listener.close()
        self._watch.close(1.0)
        self._backups.close(1.0)
        self._publisher.close()
        self._fixed.close()
        self._children.end_all()
        self._workers.close(_WORKERS_PATIENCE)
        if not self.leaves:
            self.manager.end()
            self._host.release()
            self._forget_transformations()
        self._host.close()
        self._store.close()
        self._owner.release()

    # Inside

    def _introduce(self) -> None:
        """Log the version, the master and the state that was found."""
        found = {
            "transformations": len(self.manager.library.all()),
            "nodelets": len(self._store.nodelets()),
            "claims": len(self._store.claims()),
        }
        rospy.loginfo(
            "DyKnow manager %s, version %s, of the ROS master at %s; its state is in '%s': %s",
            rospy.get_name(),
            dyknow.__version__,
            self._master.uri,
            self._settings.state_path("sqlite3"),
            ", ".join(f"{count} {what}" for what, count in found.items()),
        )

    def _load_transformations(self) -> None:
        for path in self._settings.transformations:
            try:
                with open(path, encoding="utf-8") as file:
                    text = file.read(self._settings.limits.text_size + 1)
                found = self.manager.library.add(text, path)
            except (OSError, ValueError, DyKnowError) as error:
                rospy.logerr("transformations of '%s' are not added: %s", path, error)
                continue
            for warning in (*found.warnings, *missing_here(path, found.transformations)):
                rospy.logwarn("%s", warning)

    def _forget_transformations(self) -> None:
        """Delete ``~transformations``: they are in the durable library, until they are removed.

        Otherwise the parameter would add them to the library of the next manager of this name.
        """
        try:
            self._master.ask("deleteParam", names.join(self._master.caller, "transformations"))
        except (LookupError, PeerTimeout):
            return  # it was not set, or the ROS master is gone

    def _announcers(self) -> Sequence[str]:
        return [
            state.name
            for state in self._host.states().values()
            if state.rewirable and (state.own or state.alive)
        ]

    def _on_change(self) -> None:
        self._publisher.note_change()
        self._streams.note_change()

    def _protected(self) -> Dict[str, List[str]]:
        protected: Dict[str, List[str]] = {}
        for record in self.manager.graph.all():
            if record.is_protected:
                protected.setdefault(record.manager, []).append(record.name)
        return protected

    def _after_change(self) -> None:
        self._fixed.follow()
        self._host.grant(self._granted)
        self._host.hand_over(self._protected)
        self._listener.follow(self._announcers)

    def _granted(self) -> Tuple[Mapping[str, str], Collection[str]]:
        """Return the producers of claims by topic, and the processes that run them."""
        producers: Dict[str, str] = {}
        managers: Set[str] = set()
        for claim in self._reconciler.claims():
            if claim.state.ended or not claim.topic:
                continue
            producers.setdefault(claim.topic, "")
            record = self.manager.graph.find(claim.goal[0])
            if record is not None and record.state is State.RUNNING and claim.state in _RELIED_ON:
                producers[claim.topic] = record.name
                managers.add(record.manager)
        return producers, managers

    def _after_look(self) -> None:
        self._after_change()
        self._children.echo()


def _name_of(argv: Sequence[str]) -> str:
    """Global name that the node will have."""
    mappings = rosgraph.names.load_mappings(argv)
    namespace = mappings.get("__ns", rosgraph.names.get_ros_namespace(argv=[]))
    return names.join(str(namespace), str(mappings.get("__name", _NAME)))


def _is_running(name: str) -> bool:
    """Whether a manager of that name runs already, and answers."""
    master = Master(name)
    try:
        uri = master.node(name)
        pid = master.pid(name, uri, _ANSWER_TIMEOUT) if uri else 0
    except (PeerTimeout, LookupError):
        return False  # rospy waits for the master; a node that does not answer is dead or ends
    if pid:
        print(f"{name} runs already (process {pid}); end it first: rosnode kill {name}")
    return bool(pid)


def _ontology(settings: ManagerSettings) -> Ontology | None:
    if not settings.ontologies:
        return None
    from dyknow.manager.specifications.ontology import (
        load_ontology,  # rdflib takes its time to import
    )

    return load_ontology(
        settings.ontologies, language=settings.language, catalogues=settings.catalogues
    )


def run(argv: Sequence[str]) -> int:
    """Run the node until it has to end; returns the exit code.

    Args:
        argv: the command line, program name first.
    """
    name = _name_of(argv)
    tenure = Tenure(name, kept=os.environ.pop(VARIABLE, ""))
    if not tenure.is_resumed and _is_running(name):
        return FAILED
    tenure.take()

    def start() -> ManagerNode:
        parameters = rospy.get_param("~", {})
        node = _start()
        back = functools.partial(come_back, parameters)
        tenure.watch(rospy.get_node_uri(), functools.partial(leave, node), back)
        return node

    def leave(node: ManagerNode) -> None:
        node.leaves = True
        process.end()

    def come_back(parameters: Any) -> None:
        rospy.logwarn("another manager took the name %s; taking it back", name)
        tenure.take_back(parameters)
        process.start_again(tenure.variables)

    process = NodeProcess(_NAME, argv, start, tenure.wake)
    code = process.run()
    tenure.give_back()
    return code


def _start() -> ManagerNode:
    sys.setswitchinterval(_SWITCH_INTERVAL)
    settings = ManagerSettings.read()
    try:
        node = ManagerNode(settings)
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
