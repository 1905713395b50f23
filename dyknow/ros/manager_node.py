"""The node dyknow_manager: the paper's manager, with all that it needs from ROS.

Who owns what: ``ManagerNode`` owns the store, the children, the host, the manager and what speaks
for it: services, the topic of the model, the watch. The main thread only waits to be told to end.
Being told (SIGINT, SIGTERM, rosnode kill) is an end on purpose: nodelets and nodelet managers end
too. A manager that is killed leaves them running, and its next life takes them over.
"""

from __future__ import annotations

import queue
import signal
import sys
import threading
from typing import TYPE_CHECKING, Sequence

import rospy

from dyknow import names
from dyknow.errors import DyKnowError
from dyknow.manager.host import Kind
from dyknow.manager.library import Library
from dyknow.manager.manager import Manager, Settings
from dyknow.manager.store import Store
from dyknow.ros.announcements import Listener
from dyknow.ros.children import Children
from dyknow.ros.cpp_nodelets import CppNodelets
from dyknow.ros.guard_parameters import GUARDS, to_parameter
from dyknow.ros.host import RosHost
from dyknow.ros.manager_services import ManagerServices
from dyknow.ros.manager_settings import ManagerSettings
from dyknow.ros.master import Master
from dyknow.ros.model_messages import ModelMessages
from dyknow.ros.model_publisher import ModelPublisher
from dyknow.ros.owner import OwnerLock
from dyknow.ros.watch import Watch

if TYPE_CHECKING:
    from dyknow.manager.ontology import Ontology

#: Seconds that rosnode kill is held up for an orderly end.
_LONGEST_END = 15.0
_SHUTDOWN_TIMEOUT = 2.0


class ManagerNode:
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
        if self._store.complaint:
            rospy.logerr("%s", self._store.complaint)
        master = Master(node)
        self._children = Children(
            master,
            settings.state_path("children.json"),
            self._owner,
            settings.orphan_timeout,
            {GUARDS: to_parameter(settings.guards, node)},
            self._on_child,
        )
        self._host = RosHost(master, self._children, settings.nodelet_managers, settings.guards)
        self.manager = Manager(
            self._host,
            self._store,
            Library(self._store, _ontology(settings.ontologies), settings.limits),
            settings.guards,
            Settings(names.parent(node), settings.spawn_timeout),
        )
        self._messages = ModelMessages()
        self._cpp = CppNodelets(self.manager)
        self._watch = Watch(self.manager, self._after_look)
        self._listener = Listener(self._watch.hear)

    def start(self) -> None:
        """Take over what runs, bring back what does not, and offer the services."""
        self._children.adopt()
        self._children.want(Kind.PYTHON, self._settings.num_nodelet_managers)
        self._load_transformations()
        self._publisher = ModelPublisher(
            "~model", self.manager.graph_model, self._messages, self._cpp.follow
        )
        self.manager.on_change = self._publisher.note_change
        self.manager.start()
        self._retire_empty()
        self._cpp.follow()
        self._listener.follow(self._python_managers())
        self._services = ManagerServices(self.manager, self._messages, self._cpp.follow)
        self._publisher.note_change()
        self._watch.start()

    def end(self) -> None:
        """End on purpose, with all nodelets and nodelet managers."""
        self._services.close()
        self._listener.close()
        self._watch.close(1.0)
        self._publisher.close()
        self._cpp.close()
        self._children.end_all()
        self.manager.end()
        self._host.release()
        self._host.close()
        self._store.close()
        self._owner.release()

    # Inside

    def _load_transformations(self) -> None:
        for path in self._settings.transformations:
            try:
                with open(path, encoding="utf-8") as file:
                    found = self.manager.library.add(file.read(), path)
            except (OSError, ValueError, DyKnowError) as error:
                rospy.logerr("transformations of '%s' are not added: %s", path, error)
                continue
            for warning in found.warnings:
                rospy.logwarn("%s", warning)

    def _retire_empty(self) -> None:
        """End processes for nodelets that nobody was told of."""
        for state in self._host.managers():
            if state.isolated_for and self.manager.graph.find(state.isolated_for) is None:
                self._host.retire(state.name)

    def _python_managers(self) -> Sequence[str]:
        return [
            state.name
            for state in self._host.managers()
            if state.kind is Kind.PYTHON and (state.own or state.alive)
        ]

    def _on_child(self) -> None:
        self._watch.hurry()

    def _after_look(self) -> None:
        self._listener.follow(self._python_managers())
        self._children.echo()


def _ontology(paths: Sequence[str]) -> "Ontology | None":
    if not paths:
        return None
    from dyknow.manager.ontology import load_ontology  # rdflib takes its time to import

    return load_ontology(paths)


def main(argv: Sequence[str] = ()) -> int:
    """Run the node until it is told to end; returns the exit code."""
    rospy.init_node("dyknow_manager", argv=list(argv or sys.argv), disable_signals=True)
    told: "queue.SimpleQueue[str]" = queue.SimpleQueue()  # a signal handler may put into it
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: told.put(signal.Signals(number).name))
    ended, shut_down = threading.Event(), threading.Event()

    def hold_up() -> None:
        told.put("rosnode kill")
        ended.wait(_LONGEST_END)

    rospy.on_shutdown(hold_up)
    rospy.core.add_shutdown_hook(lambda reason: shut_down.set())
    try:
        node = ManagerNode(ManagerSettings.read())
    except DyKnowError as error:
        rospy.logfatal("%s", error)
        ended.set()
        return 1
    try:
        node.start()
        rospy.loginfo("the manager of %s is told to end by %s", rospy.get_name(), told.get())
        node.end()
    finally:
        ended.set()
        rospy.signal_shutdown("the manager ends")
        # It returns at once if another thread (rosnode kill) is at it; that one has to finish.
        shut_down.wait(_SHUTDOWN_TIMEOUT)
    return 0
