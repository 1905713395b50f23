# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Shared by the suites about the ROS graph: the test package, managers, and looks at the master.

Importing it makes the packages of test/packages known to this process and those that it starts,
and the modules of test/ to this process.
"""

from __future__ import annotations

import collections
import contextlib
import itertools
import json
import os
import sys
import time
import unittest
import xmlrpc.client
from pathlib import Path
from typing import Any, Callable, Mapping, Sequence

TEST = Path(__file__).resolve().parent.parent
PACKAGES = TEST / "packages"
os.environ["ROS_PACKAGE_PATH"] = os.pathsep.join([os.environ["ROS_PACKAGE_PATH"], str(PACKAGES)])
sys.path[:0] = [str(TEST), str(PACKAGES / "dyknow_test" / "src")]

import rosgraph  # noqa: E402
import rospy  # noqa: E402
from bond.msg import Status  # noqa: E402
from dyknow_msgs.msg import PortConfig  # noqa: E402
from dyknow_msgs.srv import GetConfig, GetStatistics, SetConfig  # noqa: E402
from dyknow_test.puppet import Call  # noqa: E402
from nodelet.srv import NodeletList, NodeletLoad, NodeletUnload  # noqa: E402
from processes import NODELET, Ended, TellingCase, becomes, eventually, forget  # noqa: E402
from sensor_msgs.msg import BatteryState  # noqa: E402
from std_msgs.msg import Header, String  # noqa: E402

from dyknow.ros.nodelets.announcements import TOPIC  # noqa: E402
from dyknow.ros.wire.master import Master  # noqa: E402
from dyknow.ros.wire.poll_client import PollClient  # noqa: E402

PEER = [sys.executable, str(Path(__file__).resolve().parent / "peer.py")]
_number = itertools.count(1)


def peer(*words: str) -> list[str]:
    """A command of `peer.py`, as a node that is forgotten when it was killed."""
    return [*PEER, *words, f"__name:=peer_{next(_number)}"]


class ManagerServices:
    """The services of a nodelet manager, started here or elsewhere."""

    #: Of the types of nodelets that are named without one.
    package = "dyknow_test"

    def __init__(self, name: str) -> None:
        self.name = name

    def forget_output(self) -> None:
        """Leave out earlier output from now on, if it has output."""

    def wait_until_up(self) -> None:
        """Wait for its last service."""
        eventually(self.lists, 20.0, f"{self.name} is up")

    def load(
        self,
        type_name: str,
        name: str,
        remappings: Mapping[str, str] | None = None,
        my_argv: Sequence[str] = (),
        bond_id: str = "",
        **parameters: Any,
    ) -> None:
        """Set the parameters and load a nodelet."""
        for key, value in parameters.items():
            rospy.set_param(f"{name}/{key}", value)
        remappings = remappings or {}
        self.load_nodelet(
            name=name,
            type=type_name if "/" in type_name else f"{self.package}/{type_name}",
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
            with contextlib.suppress(rospy.ServiceException):  # a script that ends just now
                self.unload(name)
            forget(name)
        assert self.list() == [], self.list()

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
            self.load("Introspector", name)
        except rospy.ServiceException:
            return False
        self.unload(name)
        return True


class Manager(Ended, ManagerServices):
    """A nodelet manager in a process of its own, by default DyKnow's."""

    def __init__(
        self,
        name: str = "/manager",
        *arguments: str,
        command: Sequence[str] = (*NODELET, "manager"),
        wait: bool = True,
    ) -> None:
        namespace, _, base = name.rpartition("/")
        ManagerServices.__init__(self, name)
        super().__init__(*command, f"__name:={base}", f"__ns:={namespace or '/'}", *arguments)
        if wait:
            self.wait_until_up()

    def wait_until_up(self) -> None:
        """Wait for all that it registers by itself."""
        super().wait_until_up()
        last = f"publishers {TOPIC}"
        if NODELET[-1] in self.command:
            eventually(lambda: last in registered(self.name), 20.0, f"{last} are registered")

    def threads(self) -> int:
        return len(os.listdir(f"/proc/{self.pid}/task"))

    def descriptors(self) -> int:
        return len(os.listdir(f"/proc/{self.pid}/fd"))


class NodeletManagerCase(TellingCase):
    """Tests in one nodelet manager, that of the module, in which each leaves nothing."""

    manager: ManagerServices
    manager_name = "/manager"
    #: Registrations of the manager itself.
    own: set[str]
    _of_module: Manager | None = None

    @classmethod
    def setUpClass(cls) -> None:
        cls.manager = cls.start_manager()
        cls.own = registered(cls.manager_name)

    @classmethod
    def start_manager(cls) -> ManagerServices:
        manager = NodeletManagerCase._of_module
        if manager is None or manager.has_ended:
            manager = NodeletManagerCase._of_module = Manager(cls.manager_name)
            unittest.addModuleCleanup(manager.__exit__)
        return manager

    def tearDown(self) -> None:
        self.manager.unload_all()
        self.nothing_is_left()
        self.manager.forget_output()

    def nothing_is_left(self) -> None:
        """Wait until nothing of nodelets is registered: an unload awaits no `on_shutdown`."""
        becomes(lambda: registered(self.manager_name) - self.own, set())


class Talker:
    """Publishes a message on a topic, many times a second, until it is closed."""

    def __init__(self, topic: str, message: Any) -> None:
        self._publisher = rospy.Publisher(topic, type(message), queue_size=10)
        self._timer = rospy.Timer(rospy.Duration(0.05), lambda _: self._publisher.publish(message))

    def __enter__(self) -> Talker:
        return self

    def __exit__(self, *unused: object) -> None:
        self._timer.shutdown()
        self._timer.join()
        self._publisher.unregister()


def battery(stamp: float, percentage: float) -> BatteryState:
    message = BatteryState(percentage=percentage)
    message.header.stamp = rospy.Time(stamp)
    return message


class Battery:
    """Publishes the battery's state 50 times a second, until it is closed."""

    def __init__(self, percentage: float, topic: str = "/battery") -> None:
        self.percentage = percentage
        self._publisher = rospy.Publisher(topic, BatteryState, queue_size=10)
        self._timer = rospy.Timer(rospy.Duration(0.02), self._publish)

    def __enter__(self) -> Battery:
        return self

    def __exit__(self, *unused: object) -> None:
        self._timer.shutdown()
        self._timer.join()
        self._publisher.unregister()

    def _publish(self, event: Any) -> None:
        self._publisher.publish(battery(rospy.get_time(), self.percentage))


class WordsCase(TellingCase):
    """A word comes on each of two topics."""

    WORDS = {"/a": "left", "/b": "right"}

    def setUp(self) -> None:
        super().setUp()
        for topic, word in self.WORDS.items():
            self.enter(Talker(topic, String(word)))


class Heard(list):
    """The messages of a topic, in order, or the results of a function of each.

    Once it is made, each node that publishes the topic sends to it, so that nothing is missed.
    """

    def __init__(
        self,
        topic: str,
        message_class: Any = Header,
        note: Callable[[Any], Any] = lambda message: message,
    ) -> None:
        super().__init__()
        #: When they came, in the time of the steady clock.
        self.times: list[float] = []
        self._topic = topic
        self._note = note
        self._subscriber = rospy.Subscriber(topic, message_class, self._add, tcp_nodelay=True)
        eventually(lambda: not unlinked(topic, rospy.get_name()), 10.0, f"connected to {topic}")

    def __enter__(self) -> Heard:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        self._subscriber.unregister()

    def flows(self, count: int = 2, timeout: float = 10.0) -> float:
        """Wait until so many more have come; returns how long (s) that took."""
        wanted = len(self) + count
        return eventually(lambda: len(self) >= wanted, timeout, f"{self._topic} flows")

    def has(self, wanted: Callable[[Any], object], timeout: float = 10.0) -> Any:
        """Wait for a message that is wanted, and return it."""
        what = f"what is wanted comes on {self._topic}"
        eventually(lambda: any(map(wanted, list(self))), timeout, what, lambda: self[-9:])
        return next(filter(wanted, self))

    def longest_pause(self, since: float) -> float:
        """Longest time (s) without a message, counted from the last message before ``since``."""
        times = [when for when in self.times if when <= since][-1:]
        times += [when for when in self.times if when > since]
        return max((later - earlier for earlier, later in zip(times, times[1:])), default=0.0)

    def _add(self, message: Any) -> None:
        self.times.append(time.monotonic())
        self.append(self._note(message))


def comes(topic: str, message_class: Any, wanted: Callable[[Any], object] = bool) -> Any:
    """Wait until a wanted message comes on a topic, and return it."""
    with Heard(topic, message_class) as heard:
        return heard.has(wanted)


def hears(topic: str, text: str, is_whole: bool = False) -> None:
    """Wait until a text comes on a topic, in a message or as the whole of one."""
    comes(topic, String, lambda each: text == each.data if is_whole else text in each.data)


def let_the_bond_form(topic: str) -> None:
    """Wait until both ends of a topic's only living bond have heard each other.

    Then each learns of the other's end at once. One that was not connected yet would not hear the
    other part, and wait for the connect timeout.
    """

    def ends() -> list[int]:
        """How often each end was heard, in the bond of which both were."""
        bonds: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
        for bond, end in list(heard):
            bonds[bond][end] += 1
        return next((list(each.values()) for each in bonds.values() if len(each) == 2), [])

    def note(status: Status) -> tuple[str, str]:
        # An earlier bond's ends may still be parting.
        return (status.id, status.instance_id) if status.active else ("", "")

    with Heard(topic, Status, note) as heard:
        eventually(lambda: ends() and not unlinked(topic), 10.0, "both ends are linked")
        del heard[:]
        # One message of each may have been sent before they were.
        eventually(lambda: ends() and min(ends()) > 1, 10.0, "each hears the other", heard.copy)


def call(nodelet: str, method: str, *args: Any) -> Any:
    """Call a method of a puppet."""
    answer = rospy.ServiceProxy(f"{nodelet}/call", Call)(String(json.dumps([method, args])))
    return json.loads(answer.data)


def set_config(nodelet: str, **ports: str) -> Any:
    """Connect ports to topics."""
    return set_config_pairs(nodelet, *ports.items())


def connect(nodelet: str, **ports: str) -> None:
    """Connect ports to topics, and succeed."""
    answer = set_config(nodelet, **ports)
    assert answer.success, answer.message


def refusal(nodelet: str, port: str, topic: str) -> str:
    """Why a topic is refused for its type, which its subscribers have to tell within 0.5 s."""
    before = topics_of_ports(nodelet)[port]
    answers = []

    def is_refused() -> bool:
        connect(nodelet, **{port: before})
        answers.append(set_config(nodelet, **{port: topic}))
        return not answers[-1].success

    eventually(is_refused, 5.0, f"{topic} is refused")
    return str(answers[-1].message)


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


def registered(node: str) -> set[str]:
    """The registrations of a node, each as a kind and a name."""
    return {f"{kind} {name}" for kind, names in registrations(node).items() for name in names}


def poll(name: str, *counted: str, is_node: bool = False, guards: Sequence[Any] = ()) -> Any:
    """Poll a process as a DyKnow manager does, and have messages of nodelets counted."""
    with contextlib.closing(PollClient(Master("/dyknow_manager"), name, is_node)) as client:
        return client.ask(5.0, counted=counted, guards=guards)


def named(changes: Any) -> list[str]:
    """The nodelets that an announcement describes."""
    return [each.nodelet for each in changes.nodelets]


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


def unlinked(topic: str, *listeners: str) -> set[tuple[str, str]]:
    """Publishers of a topic, each with a subscriber to which it does not send yet.

    A subscriber counts a connection before its publisher sends anything on it, so a message that
    is published in between is lost.

    Args:
        topic: its name.
        listeners: only these subscribers are looked at; by default all.
    """
    publishers, subscribers = nodes_on(topic)
    found = set()
    for node in publishers - {*listeners}:
        with contextlib.suppress(ConnectionError, rosgraph.MasterException):  # it has ended
            to = {info[1] for info in bus_info(node) if info[2:5:2] == ["o", topic]}
            found |= {(node, each) for each in {*(listeners or subscribers)} - to - {node}}
    return found


def is_fed(topic: str) -> bool:
    """Whether a topic has publishers, and each sends to this process."""
    me = rospy.get_name()
    return bool(nodes_on(topic)[0] - {me}) and not unlinked(topic, me)


def is_linked(topic: str, subscribers: int = 1) -> bool:
    """Whether the publishers of a topic send to all its subscribers, of which there are enough."""
    publishers, present = nodes_on(topic)
    return bool(publishers) and len(present) >= subscribers and not unlinked(topic)


def parameters() -> dict[str, Any]:
    """All parameters except those of roslaunch and rosout."""
    every = rospy.get_param("/")
    return {key: value for key, value in every.items() if key not in ("roslaunch", "run_id")}
