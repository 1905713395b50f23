# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelets in the test's own process, without a ROS master."""

from __future__ import annotations

import functools
import logging
import time
import unittest
from concurrent.futures import Future
from typing import Any, Collection, Mapping, Sequence, TypeVar

import rospy

from dyknow import names
from dyknow.errors import DyKnowError, UnknownPort
from dyknow.nodelet.context import Context, Runtime
from dyknow.nodelet.handle import Nodelet, PlainNodeHandle
from dyknow.nodelet.loading.loader import Loader
from dyknow.nodelet.middleware import Handler, Middleware
from dyknow.nodelet.scheduler import ManualExecutor
from dyknow.nodelet.streams.pubsub import Publisher
from dyknow.periodic import in_background
from dyknow.proxy.proxy import NodeletProxy
from dyknow.testing.middleware import (
    HarnessNode,
    HarnessServices,
    HarnessTicker,
    HarnessTransport,
    LogEntry,
)

_PATIENCE = 10.0  # seconds of real time after which another thread is given up
_GLANCE = 0.001  # seconds between two looks whether a service was called
_ROUNDING = 1e-6  # seconds that sums of periods may be wrong by

NodeletType = TypeVar("NodeletType", bound=Nodelet)
HarnessType = TypeVar("HarnessType", bound="Harness")


class CallbackFailed(AssertionError):
    """A callback of a nodelet raised; the text has its traceback."""


class _Anything:
    """Fits messages of every type, without serialising them."""

    _type = _md5sum = "*"


class Harness:
    """A harness closes at the end of a ``with`` block."""

    def close(self) -> None:
        """Unload every nodelet."""
        raise NotImplementedError

    def __enter__(self: HarnessType) -> HarnessType:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()


class NodeletHarness(Harness):
    """Loads nodelets, connects their ports, sends them messages and collects their output.

    Everything runs in the test's thread, when it calls ``drain``, ``advance`` or ``call``: no
    callback runs at any other moment. Time stands still but for ``advance``. Messages pass by
    reference, as they do in a nodelet manager. A callback that raises fails the test.

    Calls that block until something happens elsewhere (``sleep``, ``wait_for_message``) cannot
    work in a callback here, nor can anything that needs a master. ``RosHarness`` has both.

    Example::

        with NodeletHarness() as harness:
            harness.load(Doubler, ports={"in": "/numbers", "out": "/doubled"})
            doubled = harness.listen("/doubled")
            harness.publish("/numbers", Int32(4))
            harness.drain()
            assert doubled == [Int32(8)]
    """

    def __init__(self) -> None:
        """Make an empty harness; use it in a ``with`` block, or ``close`` it."""
        self._ticker = HarnessTicker()
        self._services = HarnessServices()
        self._node = HarnessNode(self._ticker, self._services, self._call)
        self._executor = ManualExecutor(self._ticker.now)
        middleware = Middleware(HarnessTransport(), self._services, self._ticker, self._node)
        self._runtime = Runtime(middleware, self._executor)
        self._classes: dict[str, type[Nodelet]] = {}
        self._loader = Loader(self._runtime, lambda type_name, _: self._classes[type_name])
        self._publishers: dict[str, Publisher] = {}
        context = Context(self._runtime, "/harness")
        context.start()
        self._handle = PlainNodeHandle(context, "/")
        self._failures = _FailureLog()
        self._raised = 0

    def close(self) -> None:
        """Unload every nodelet."""
        self._loader.close()
        self._runtime.close()
        self._failures.close()

    def __exit__(self, error_type: object = None, *unused: object) -> None:
        """Close the harness; unless the block raised, raise CallbackFailed if a callback did."""
        self.close()
        if error_type is None:
            self._raise_failures()

    # Nodelets

    def load(
        self,
        nodelet_class: type[NodeletType],
        name: str = "/nodelet",
        ports: Mapping[str, str] | None = None,
        parameters: Mapping[str, Any] | None = None,
        remappings: Mapping[str, str] | None = None,
        my_argv: Sequence[str] = (),
    ) -> NodeletType:
        """Load a nodelet and return it once its ``on_init`` has returned.

        Args:
            nodelet_class: what to load.
            name: global name.
            ports: topics that ports are connected to from the start, those of a private handle at
                the end of ``on_init`` unless written with ``~``; the rest is disconnected, and
                ports with an empty topic.
            parameters: private parameters by their names without ``~``.
            remappings: of names that are not ports, as in a load request.
            my_argv: arguments for the nodelet.

        Raises:
            LoadFailed: ``on_init`` raised; ``__cause__`` is its error.
            NameTaken: a nodelet of that name is loaded.
            UnknownPort: ``ports`` names one that the nodelet does not have; it is unloaded.
        """
        name, ports = _global(name), ports or {}
        for key, value in (parameters or {}).items():
            self.parameters[names.join(name, key.lstrip("~"))] = value
        table = {_global(key): _global(target) for key, target in (remappings or {}).items()}
        table.update(remappings_of_ports(name, ports))
        self._classes[name] = nodelet_class
        nodelet = self._loader.load(name, name, table, my_argv)
        assert isinstance(nodelet, nodelet_class)
        try:
            check_ports(ports, self.topics(nodelet))
            self.connect(nodelet, ports)  # those whose names the handle has made private
        except DyKnowError:
            self._loader.unload(name)
            raise
        return nodelet

    def unload(self, nodelet: Nodelet) -> None:
        """Unload a nodelet, ``on_shutdown`` included."""
        self._loader.unload(nodelet.name)
        self._raise_failures()

    def topics(self, nodelet: Nodelet) -> dict[str, str]:
        """Return the topic of each port of a nodelet, empty where it is disconnected."""
        return {port.name: port.topic for port in NodeletProxy.of(nodelet.context).get_config()}

    def connect(self, nodelet: Nodelet, ports: Mapping[str, str]) -> None:
        """Connect ports of a nodelet to topics; an empty topic disconnects.

        The reconfigure callback runs with the next ``drain``.

        Raises:
            InvalidConfiguration: something is wrong with an entry; nothing was changed.
        """
        NodeletProxy.of(nodelet.context).set_config(list(ports.items()))

    # Input and output

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameter server, by global names."""
        return self._node.parameters

    @property
    def log(self) -> list[LogEntry]:
        """The log entries of the nodelets, in order."""
        return self._node.log

    def publish(self, topic: str, message: Any) -> None:
        """Publish a message; it is received with the next ``drain``."""
        topic = _global(topic)
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._handle.Publisher(topic, type(message))
            self._publishers[topic] = publisher
        publisher.publish(message)

    def listen(self, topic: str) -> list[Any]:
        """Return a list to which every message is appended that is published from now on.

        They are the very objects that were published.
        """
        received: list[Any] = []
        self._handle.Subscriber(_global(topic), _Anything, received.append)
        return received

    def call(self, service: str, request: Any) -> Any:
        """Call a service of a nodelet and return its response; callbacks run meanwhile.

        An error of its handler is raised here.

        Raises:
            CallbackFailed: a callback raised meanwhile.
            rospy.ServiceException: it is not offered, or has not answered within 10 s.
        """
        response = self._call(service, request)
        self._raise_failures()
        return response

    def _call(self, service: str, request: Any) -> Any:
        handler = self._services.handlers.get(_global(service))
        if handler is None:
            raise rospy.ServiceException(f"service [{service}] unavailable")
        answer: Future[Any] = Future()
        in_background("service call", functools.partial(_answer, handler, request, answer))
        deadline = time.monotonic() + _PATIENCE
        while not answer.done():
            time.sleep(_GLANCE)
            self._executor.drain()
            if time.monotonic() > deadline:
                raise rospy.ServiceException(f"service [{service}] has not answered")
        if answer.exception() is not None:
            self._raised += 1  # the test, or the nodelet that calls, knows it by this error
        return answer.result()

    # Time

    @property
    def time(self) -> float:
        """Seconds since the harness was made, as nodelets see them."""
        return self._ticker.now()

    def drain(self) -> None:
        """Run all callbacks that wait, and those that they cause, but let no time pass.

        Raises:
            CallbackFailed: a callback raised.
        """
        self._ticker.next_due(_PATIENCE)  # due timers have fired
        self._executor.drain()
        self._raise_failures()

    def advance(self, seconds: float) -> None:
        """Let time pass, and every timer and callback run when its time has come.

        Negative seconds set the time back, as simulated time may be.

        Raises:
            CallbackFailed: a callback raised.
        """
        end = self.time + seconds
        while True:
            self.drain()
            due = self._ticker.next_due(_PATIENCE)
            if due is None or due > end + _ROUNDING:
                break
            end = max(end, due)
            self._ticker.set(due)
        self._ticker.set(end)

    # Inside

    def _count_errors(self) -> int:
        return sum(context.callback_errors for context in self._loader.contexts())

    def _raise_failures(self) -> None:
        texts, count = self._failures.take(), self._count_errors()
        more, self._raised = count - self._raised, count
        if texts or more > 0:
            raise CallbackFailed("\n".join(texts) or f"{more} callbacks raised, as before")


class NodeletTestCase(unittest.TestCase):
    """Each test has a ``NodeletHarness``, ``self.harness``."""

    def setUp(self) -> None:
        """Make the harness."""
        self.harness = NodeletHarness()
        self.addCleanup(self.harness.__exit__)


def _answer(handler: Handler, request: Any, answer: Future[Any]) -> None:
    try:
        answer.set_result(handler(request))
    except Exception as error:  # the boundary of the thread; raised again where it was called
        answer.set_exception(error)


class _FailureLog(logging.Handler):
    """Keeps the errors that the runtime logs: those of callbacks, with their tracebacks."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self._texts: list[str] = []
        self._logger = logging.getLogger("rosout.dyknow")
        self._logger.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        self._texts.append(record.getMessage())

    def take(self) -> list[str]:
        texts, self._texts = self._texts, []
        return texts

    def close(self) -> None:
        self._logger.removeHandler(self)
        super().close()


def _global(name: str) -> str:
    return names.resolve(name, "/", "/")


def remappings_of_ports(nodelet: str, ports: Mapping[str, str]) -> dict[str, str]:
    """Return the remappings that connect ports of a nodelet at its load.

    Ports that it declares by a private handle without ``~`` are not among them: its parameters and
    services may have these names.
    """
    space = names.parent(nodelet)
    return {
        names.resolve(port, space, nodelet): names.resolve(topic, space, nodelet)
        for port, topic in ports.items()
        if topic
    }


def check_ports(wanted: Collection[str], known: Collection[str]) -> None:
    """Raise UnknownPort if a wanted port is not there."""
    for port in wanted:
        if port not in known:
            raise UnknownPort(port, known)
