# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about the ROS graph: the test package, managers, and looks at the master.

Importing it makes the packages of test/packages known to this process and those that it starts.
"""

from __future__ import annotations

import collections
import contextlib
import json
import os
import signal
import sys
import unittest
import xmlrpc.client
from pathlib import Path
from typing import Any, Callable, Iterator, Mapping, Sequence

PACKAGES = Path(__file__).resolve().parent.parent / "packages"
os.environ["ROS_PACKAGE_PATH"] = os.pathsep.join([os.environ["ROS_PACKAGE_PATH"], str(PACKAGES)])
sys.path.insert(0, str(PACKAGES / "dyknow_test" / "src"))

import rosgraph  # noqa: E402
import rospy  # noqa: E402
from bond.msg import Status  # noqa: E402
from dyknow_msgs.msg import PortConfig  # noqa: E402
from dyknow_msgs.srv import GetConfig, GetStatistics, SetConfig  # noqa: E402
from dyknow_test.puppet import Call  # noqa: E402
from nodelet.srv import NodeletList, NodeletLoad, NodeletUnload  # noqa: E402
from processes import NODELET, Running, TellingCase, eventually  # noqa: E402
from std_msgs.msg import String  # noqa: E402

PEER = [sys.executable, str(Path(__file__).resolve().parent / "peer.py")]


class Ended(Running):
    """A process that gets SIGINT before it is killed, to unregister and end its children."""

    def __exit__(self, *unused: object) -> None:
        if not self.has_ended:
            self.stop(signal.SIGCONT)
            self.stop()
            self.ends_within(60.0)  # roslaunch gives its nodes 17 s to end
        super().__exit__()


class ManagerServices:
    """The services of a nodelet manager, whoever started it."""

    def __init__(self, name: str) -> None:
        self.name = name

    def forget_output(self) -> None:
        """Leave out earlier output from now on, if it has output."""

    def wait_until_up(self) -> None:
        eventually(self._answers, 20.0, f"{self.name} is up")

    def load(
        self,
        type_name: str,
        name: str,
        remappings: Mapping[str, str] | None = None,
        my_argv: Sequence[str] = (),
        bond_id: str = "",
        **parameters: Any,
    ) -> None:
        """Set the parameters and load a nodelet of the test package."""
        for key, value in parameters.items():
            rospy.set_param(f"{name}/{key}", value)
        remappings = remappings or {}
        self.load_nodelet(
            name=name,
            type=type_name if "/" in type_name else f"dyknow_test/{type_name}",
            remap_source_args=list(remappings),
            remap_target_args=list(remappings.values()),
            my_argv=list(my_argv),
            bond_id=bond_id,
        )

    def load_nodelet(self, **request: Any) -> Any:
        return rospy.ServiceProxy(f"{self.name}/load_nodelet", NodeletLoad)(**request)

    def unload(self, name: str) -> Any:
        return rospy.ServiceProxy(f"{self.name}/unload_nodelet", NodeletUnload)(name)

    def unload_all(self) -> None:
        """Unload all nodelets, and delete their parameters."""
        for name in self.list():
            self.unload(name)
            if rospy.has_param(name):
                rospy.delete_param(name)

    def list(self) -> list[str]:
        return list(rospy.ServiceProxy(f"{self.name}/list", NodeletList)().nodelets)

    def lists(self) -> bool:
        """Whether it lists its nodelets; it does until it ends."""
        try:
            self.list()
        except rospy.ServiceException:
            return False
        return True

    def is_free(self, name: str) -> bool:
        """Whether a nodelet can be loaded under a name; unloads it again."""
        try:
            self.load("dyknow_test/Introspector", name)
        except rospy.ServiceException:
            return False
        self.unload(name)
        return True

    def _answers(self) -> bool:
        try:
            return self.list() == [] and f"{self.name}/load_nodelet" in services_of(self.name)
        except rospy.ServiceException:
            return False


class Manager(Ended, ManagerServices):
    """A nodelet manager in a process of its own."""

    def __init__(self, name: str = "/manager", *arguments: str, wait: bool = True) -> None:
        namespace, _, base = name.rpartition("/")
        ManagerServices.__init__(self, name)
        super().__init__(
            *NODELET, "manager", f"__name:={base}", f"__ns:={namespace or '/'}", *arguments
        )
        if wait:
            self.wait_until_up()

    @property
    def pid(self) -> int:
        return self._process.pid

    def threads(self) -> int:
        return len(os.listdir(f"/proc/{self.pid}/task"))

    def descriptors(self) -> int:
        return len(os.listdir(f"/proc/{self.pid}/fd"))


class NodeletManagerCase(TellingCase):
    """Tests in one nodelet manager, that of the module, in which each leaves nothing."""

    manager: ManagerServices
    manager_name = "/manager"
    _of_module: Manager | None = None

    @classmethod
    def setUpClass(cls) -> None:
        cls.manager = cls.start_manager()

    @classmethod
    def start_manager(cls) -> ManagerServices:
        manager = NodeletManagerCase._of_module
        if manager is None or manager.has_ended:
            manager = NodeletManagerCase._of_module = Manager(cls.manager_name)
            unittest.addModuleCleanup(manager.__exit__)
        return manager

    def tearDown(self) -> None:
        self.manager.unload_all()
        self.manager.forget_output()


class Talker:
    """Publishes a word on a topic, many times a second, until it is closed."""

    def __init__(self, topic: str, word: str) -> None:
        self._publisher = rospy.Publisher(topic, String, queue_size=10)
        self._timer = rospy.Timer(rospy.Duration(0.02), lambda _: self._publisher.publish(word))

    def close(self) -> None:
        self._timer.shutdown()
        self._publisher.unregister()


@contextlib.contextmanager
def hearing(topic: str, message_class: Any = String) -> Iterator[list[Any]]:
    """The messages that come on a topic."""
    heard: list[Any] = []
    subscriber = rospy.Subscriber(topic, message_class, heard.append)
    try:
        yield heard
    finally:
        subscriber.unregister()


def comes(topic: str, message_class: Any, wanted: Callable[[Any], bool] = bool) -> Any:
    """Wait until a wanted message comes on a topic, and return it."""
    with hearing(topic, message_class) as heard:
        what = f"what is wanted comes on {topic}"
        eventually(lambda: any(map(wanted, list(heard))), 10.0, what, lambda: heard[-9:])
        return next(filter(wanted, heard))


def hears(topic: str, text: str, is_whole: bool = False) -> None:
    """Wait until a text comes on a topic, in a message or as the whole of one."""
    comes(topic, String, lambda each: text == each.data if is_whole else text in each.data)


def let_the_bond_form(topic: str) -> None:
    """Wait until both ends of a topic's only living bond have sent two messages.

    Then each has heard the other, and learns of its end at once. One that was not connected yet
    would not hear the other part, and wait for the connect timeout.
    """
    heard: collections.Counter[tuple[str, str]] = collections.Counter()

    def note(status: Status) -> None:
        if status.active:  # an earlier bond's ends may still be parting
            heard[status.id, status.instance_id] += 1

    def has_formed() -> bool:
        ends = collections.Counter(bond for (bond, _), count in [*heard.items()] if count > 1)
        return 2 in ends.values()

    watch = rospy.Subscriber(topic, Status, note)
    eventually(has_formed, 8.0, f"both ends are heard on {topic}", lambda: heard)
    watch.unregister()


def call(nodelet: str, method: str, *args: Any) -> Any:
    """Call a method of a puppet."""
    answer = rospy.ServiceProxy(f"{nodelet}/call", Call)(String(json.dumps([method, args])))
    return json.loads(answer.data)


def set_config(nodelet: str, **ports: str) -> Any:
    """Connect ports to topics."""
    return set_config_pairs(nodelet, *ports.items())


def set_config_pairs(nodelet: str, *pairs: tuple[str, str]) -> Any:
    return rospy.ServiceProxy(f"{nodelet}/set_config", SetConfig)(
        [PortConfig(port, topic) for port, topic in pairs]
    )


def topics_of_ports(nodelet: str) -> dict[str, str]:
    return {port.name: port.topic for port in get_config(nodelet)}


def get_config(nodelet: str) -> Any:
    return rospy.ServiceProxy(f"{nodelet}/get_config", GetConfig)().ports


def get_statistics(nodelet: str) -> Any:
    return rospy.ServiceProxy(f"{nodelet}/get_statistics", GetStatistics)()


def port_statistics(nodelet: str, port: str) -> Any:
    return next(each for each in get_statistics(nodelet).ports if each.port == port)


def registrations(node: str) -> dict[str, list[str]]:
    """A node's registrations: topics that it publishes, topics that it subscribes to, services."""
    state = rosgraph.Master(rospy.get_name()).getSystemState()
    kinds = ("publishers", "subscribers", "services")
    return {
        kind: sorted(name for name, nodes in part if node in nodes)
        for kind, part in zip(kinds, state)
    }


def services_of(node: str) -> list[str]:
    return registrations(node)["services"]


def nodes_on(topic: str) -> tuple[set[str], set[str]]:
    """Publishers and subscribers of a topic, according to the master."""
    state = rosgraph.Master(rospy.get_name()).getSystemState()
    publishers, subscribers = ({*dict(part).get(topic, ())} for part in state[:2])
    return publishers, subscribers


def bus_info(node: str) -> list[Any]:
    """The connections of a node, as `rosnode info` gets them."""
    uri = rosgraph.Master(rospy.get_name()).lookupNode(node)
    return xmlrpc.client.ServerProxy(uri).getBusInfo(rospy.get_name())[2]


def is_fed(topic: str) -> bool:
    """Whether each publisher of a topic has this process among its connections.

    A subscriber counts a connection before its publisher sends anything on it, so a message that
    is published in between is lost.
    """
    fed = []
    for node in nodes_on(topic)[0] - {rospy.get_name()}:
        with contextlib.suppress(ConnectionRefusedError):  # it was killed, and is still registered
            fed.append(
                any(
                    to == rospy.get_name() and name == topic
                    for _, to, _, _, name, *_ in bus_info(node)
                )
            )
    return any(fed) and all(fed)


def parameters() -> dict[str, Any]:
    """All parameters except those of roslaunch and rosout."""
    every = rospy.get_param("/")
    return {key: value for key, value in every.items() if key not in ("roslaunch", "run_id")}
