# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets in a real nodelet manager, with a ROS master that belongs to the tests."""

from __future__ import annotations

import atexit
import contextlib
import itertools
import logging
import os
import time
import unittest
from typing import Any, Callable, Mapping, Sequence

import rosmaster.master
import rospy
from nodelet.srv import NodeletList, NodeletLoad, NodeletUnload
from roslib.packages import find_node

from dyknow import names
from dyknow.errors import DyKnowError, PeerTimeout
from dyknow.ros.client import ProxyClient
from dyknow.ros.process.owned import Processes
from dyknow.ros.wire.master import Master
from dyknow.testing.harness import Harness, check_ports, remappings_of_ports

#: Seconds that anything may take on a busy machine.
_PATIENCE = 30.0
_GLANCE = 0.01

_numbers = itertools.count(1)


class RosHarness(Harness):
    """Loads declared nodelets in a nodelet manager, connects their ports, and listens to them.

    The first harness of a process starts a ROS master on a free port and makes the process a ROS
    node, unless it is one already (in a rostest, say); they last until the process ends. Each
    harness has a nodelet manager of its own.

    Example::

        with RosHarness() as harness:
            harness.load("my_package/Doubler", ports={"in": "/numbers", "out": "/doubled"})
            doubled = harness.listen("/doubled", Int32)
            harness.publish("/numbers", Int32(4))
            harness.wait_until(lambda: doubled == [Int32(8)])
    """

    def __init__(self) -> None:
        """Start a nodelet manager; use the harness in a ``with`` block, or ``close`` it."""
        _join_ros()
        #: Name of the nodelet manager.
        self.manager = f"/nodelet_manager_{os.getpid()}_{next(_numbers)}"
        self._publishers: dict[str, rospy.Publisher] = {}
        self._subscribers: list[rospy.Subscriber] = []
        self._parameters: list[str] = []
        self._processes = Processes("dyknow_tests")
        command = [find_node("dyknow", "nodelet_manager")[0], f"__name:={self.manager[1:]}"]
        self._process = self._processes.start(self.manager, command)
        try:
            self.wait_until(self._is_up, what=f"{self.manager} is up")
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the nodelet manager; delete the parameters that were set for its nodelets."""
        self._processes.close()
        _forget(self.manager)
        for registration in (*self._publishers.values(), *self._subscribers):
            registration.unregister()
        for name in self._parameters:
            if rospy.has_param(name):
                rospy.delete_param(name)

    # Nodelets

    def load(
        self,
        nodelet_type: str,
        name: str = "/nodelet",
        ports: Mapping[str, str] | None = None,
        parameters: Mapping[str, Any] | None = None,
        remappings: Mapping[str, str] | None = None,
        my_argv: Sequence[str] = (),
    ) -> str:
        """Load a declared nodelet and return its global name once its ``on_init`` has returned.

        Args:
            nodelet_type: ``package/Class``.
            name: global name.
            ports: topics that ports are connected to from the start; the rest is disconnected, and
                ports with an empty topic.
            parameters: private parameters by their names without ``~``.
            remappings: as in a load request.
            my_argv: arguments for the nodelet.

        Raises:
            rospy.ServiceException: it could not be loaded; the text says why.
            UnknownPort: ``ports`` names one that the nodelet does not have; it is unloaded.
        """
        name, ports = names.resolve(name, "/", "/"), ports or {}
        for key, value in (parameters or {}).items():
            parameter = names.join(name, key.lstrip("~"))
            rospy.set_param(parameter, value)
            self._parameters.append(parameter)
        table = {**(remappings or {}), **remappings_of_ports(name, ports)}
        rospy.ServiceProxy(f"{self.manager}/load_nodelet", NodeletLoad)(
            name=name,
            type=nodelet_type,
            remap_source_args=list(table),
            remap_target_args=list(table.values()),
            my_argv=list(my_argv),
        )
        try:
            if ports:
                check_ports(ports, self.topics(name))
                self.connect(name, ports)
        except DyKnowError:
            self.unload(name)
            raise
        return name

    def unload(self, name: str) -> None:
        """Unload a nodelet."""
        rospy.ServiceProxy(f"{self.manager}/unload_nodelet", NodeletUnload)(name)

    def topics(self, name: str) -> dict[str, str]:
        """Return the topic of each port of a nodelet, empty where it is disconnected."""
        return {port.name: port.topic for port in self._proxies().get_config(name, _PATIENCE)}

    def connect(self, name: str, ports: Mapping[str, str]) -> None:
        """Connect ports of a nodelet to topics; an empty topic disconnects.

        Raises:
            DyKnowError: something is wrong with an entry; nothing was changed.
        """
        self._proxies().set_config(name, ports, _PATIENCE)

    @staticmethod
    def _proxies() -> ProxyClient:
        return ProxyClient(Master(rospy.get_name()))

    # Input and output

    def publish(self, topic: str, message: Any) -> None:
        """Publish a message; the first on a topic waits until its subscribers are connected.

        Raises:
            AssertionError: the topic has no subscriber.
        """
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = rospy.Publisher(topic, type(message), queue_size=1000)
            self._publishers[topic] = publisher
            self.wait_until(lambda: _reaches_all(topic), what=f"{topic} reaches its subscribers")
        connected = publisher.get_num_connections
        self.wait_until(lambda: connected() > 0, what=f"{topic} has a subscriber")
        publisher.publish(message)

    def listen(self, topic: str, datatype: Any) -> list[Any]:
        """Return a list to which every message is appended that arrives from now on.

        It returns once the present publishers of the topic are connected.
        """
        received: list[Any] = []
        subscriber = rospy.Subscriber(topic, datatype, received.append, queue_size=1000)
        self._subscribers.append(subscriber)
        self.wait_until(lambda: _comes_from_all(topic), what=f"{topic} is connected")
        return received

    def wait_until(
        self, condition: Callable[[], Any], timeout: float = _PATIENCE, what: str = "it is true"
    ) -> None:
        """Wait until ``condition()`` holds.

        Raises:
            AssertionError: not within ``timeout`` seconds; the text has ``output``.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            if self._process.poll() is not None or time.monotonic() > deadline:
                raise AssertionError(f"not within {timeout:g} s: {what}\n{self.output}")
            time.sleep(_GLANCE)

    @property
    def output(self) -> str:
        """The output of the nodelet manager: its log and those of its nodelets."""
        return self._processes.output(0)

    def _is_up(self) -> bool:
        try:
            rospy.ServiceProxy(f"{self.manager}/list", NodeletList)()
        except rospy.ServiceException:
            return False
        return True


class RosTestCase(unittest.TestCase):
    """Each test has a ``RosHarness``, ``self.harness``."""

    def setUp(self) -> None:
        """Start the nodelet manager."""
        self.harness = RosHarness()
        self.addCleanup(self.harness.close)


def _reaches_all(topic: str) -> bool:
    """Whether this node sends a topic that it publishes to all subscribers, of which there are."""
    topic, me = rospy.resolve_name(topic), rospy.get_name()
    subscribers = Master(me).subscribers(topic)
    return bool(subscribers) and subscribers <= _receivers(me, topic)


def _comes_from_all(topic: str) -> bool:
    """Whether the publishers of a topic send it to this node.

    rospy counts a connection of a subscriber before it is made.
    """
    topic, me = rospy.resolve_name(topic), rospy.get_name()
    return all(me in _receivers(each, topic) for each in Master(me).publishers(topic))


def _receivers(publisher: str, topic: str) -> set[str]:
    with contextlib.suppress(LookupError, PeerTimeout):  # it has ended
        return Master(rospy.get_name()).receivers(publisher, topic, _PATIENCE)
    return set()


def _forget(node: str) -> None:
    """Unregister what a nodelet manager that crashed has left at the master."""
    master = Master(rospy.get_name())
    uri = master.node(node)
    if uri:
        master.purge(node, uri)


def _join_ros() -> None:
    """Make this process a ROS node, with a master of its own, unless it is one."""
    if rospy.core.is_initialized():
        return
    if "ROS_HOSTNAME" not in os.environ:
        os.environ["ROS_IP"] = "127.0.0.1"
    logging.getLogger("rosmaster").setLevel(logging.WARNING)  # every call would be in the log
    master = rosmaster.master.Master(port=0)
    master.start()
    os.environ["ROS_MASTER_URI"] = master.uri
    rospy.init_node("tests", anonymous=True, disable_signals=True)
    atexit.register(master.stop)
