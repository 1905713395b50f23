# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The manager, the proxies and the master as a command of the shell asks them: without a node.

Each call is a connection of its own with a time limit. Nothing registers with the master, so a
command starts fast and leaves no trace in the graph.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, Callable, Collection, Sequence, TypeVar
from xml.parsers.expat import ExpatError

from dyknow_msgs import msg
from std_srvs.srv import Trigger

from dyknow import names
from dyknow.errors import ManagerUnreachable, NodeletUnreachable, PeerTimeout, Refused
from dyknow.model.graph import Model, NodeletStatus
from dyknow.model.streams import StreamEvent
from dyknow.ros import client
from dyknow.ros.client import ManagerClient
from dyknow.ros.parameters import PrivateParameters
from dyknow.ros.wire.master import TIMEOUT, Master
from dyknow.ros.wire.messages import event_from, model_from
from dyknow.ros.wire.service_client import ServiceFailed, ServiceLost
from dyknow.ros.wire.topic_reader import TopicReader

if TYPE_CHECKING:
    from dyknow.ros.shell.load_meter import Loads

T = TypeVar("T")
_UNSET = object()

#: Seconds that a node may take to say how it is connected, and nodes that are queried at once.
_LOOK, _WORKERS = 1.0, 16
#: Seconds without an answer after which the user is told.
_SILENCE = 3.0
#: The service of a black box, and seconds that a bag may take.
_WRITE, _WRITING = "/write_bag", 120.0
#: Seconds within which the manager's model follows a change that was made on a proxy.
FOLLOW_TIMEOUT = 2.0


class EventReader:
    """Events of streams, from the moment on at which it was made."""

    def __init__(self, reader: TopicReader) -> None:
        self._reader = reader
        self.close = reader.close

    def next(self, timeout: float) -> StreamEvent | None:
        """Return the next event, or None; raises `ManagerUnreachable` if the manager is gone."""
        try:
            message = self._reader.read(timeout)
        except OSError as error:
            raise ManagerUnreachable(f"the manager is gone ({_words(error)})") from error
        return None if message is None else event_from(message)


class ShellClient(ManagerClient):
    """Asks one DyKnow manager and its nodelets.

    Every method raises `Refused` when the manager or the nodelet says no, `NodeletUnreachable`
    when the nodelet does not answer, and `ManagerUnreachable` when the manager or the master does
    not.
    """

    def __init__(
        self,
        manager: str,
        timeout: float | None = None,
        on_wait: Callable[[str], object] = lambda service: None,
    ) -> None:
        """Prepare calls.

        Args:
            manager: the manager's node.
            timeout: seconds for an answer; None for a time that suits the question.
            on_wait: called with a service, in another thread, when its answer takes long.
        """
        super().__init__(manager, f"/dyknow_{os.getpid()}")
        #: Where relative names of nodelets begin.
        self.namespace = names.parent(manager)
        self._timeout = timeout
        self._on_wait = on_wait
        self._master = Master(self._master.caller, timeout=min(timeout or TIMEOUT, TIMEOUT))
        self._master_seen = False

    def get_graph(self) -> Model:
        """Return the model without its transformations, which may be many."""
        seconds = self._timeout or client.ASK_TIMEOUT
        found = self._next_model(seconds, lambda model: True)
        if found is None:
            raise self._no_manager(PeerTimeout(self.manager, seconds), seconds)
        return found

    def wait_for_model(self, condition: Callable[[Model], bool]) -> Model | None:
        """Return the first model that meets a condition; None if there is none within 2 s."""
        return self._next_model(FOLLOW_TIMEOUT, condition)

    def stream_events(self) -> EventReader:
        """Listen to the events of all streams."""
        return EventReader(self._topic("stream_events", msg.StreamEvent))

    def nodelet_managers(self) -> list[str]:
        return self._on_master(super().nodelet_managers)

    def managers(self) -> list[str]:
        """Names of all registered DyKnow managers of the ROS graph."""
        return self._nodes_with("/add_transformation")

    def datatypes(self) -> dict[str, str]:
        """ROS types of all topics that the master knows."""
        return dict(self._on_master(lambda: self._master.ask("getTopicTypes")))

    def stored_parameters(self, nodelet: str, parameters: Sequence[str]) -> dict[str, Any]:
        """Values that the parameter server has for parameters of a nodelet, by their names."""
        given = self._on_master(lambda: self._looked_up("getParam", nodelet))
        stored = PrivateParameters(given)
        found = {name: stored.find(name, _UNSET) for name in parameters}
        return {name: value for name, value in found.items() if value is not _UNSET}

    def transports(self, nodes: Collection[str]) -> dict[tuple[str, str, str], list[str]]:
        """Query nodes for the transports of their connections, as ``Master.transports`` does."""
        found: dict[tuple[str, str, str], list[str]] = {}
        with ThreadPoolExecutor(_WORKERS) as pool:
            for each in pool.map(lambda node: self._master.transports(node, _LOOK), nodes):
                found.update(each)
        return found

    def loads(self, nodelets: Sequence[NodeletStatus]) -> Loads:
        """Measure for a moment what nodelets and their processes take."""
        from dyknow.ros.shell.load_meter import measure  # psutil takes its time to import

        return measure(self._master, nodelets)

    def topics_in_use(self) -> tuple[frozenset[str], frozenset[str]]:
        """Topics that have a publisher, and topics that have a subscriber."""
        published, heard, _ = self._on_master(lambda: self._master.ask("getSystemState"))
        return frozenset(name for name, _ in published), frozenset(name for name, _ in heard)

    def is_nodelet(self, name: str) -> bool:
        """Whether the master knows a nodelet or node with ports of this name."""
        service = names.join(name, "get_config")
        return bool(self._on_master(lambda: self._looked_up("lookupService", service)))

    def black_boxes(self) -> list[str]:
        """Names of the nodelets that keep the last seconds of the manager's streams."""
        return [each for each in self._nodes_with(_WRITE) if self._is_of_manager(each)]

    def write_bag(self, nodelet: str) -> str:
        """Let a black box write a bag, and return its path on the nodelet's host."""
        answer = self._call(nodelet + _WRITE, Trigger, _WRITING)
        if not answer.success:
            raise Refused(f"'{nodelet}' writes no bag: {answer.message}")
        return str(answer.message)

    # Inside

    def _is_of_manager(self, box: str) -> bool:
        given = self.stored_parameters(box, ["manager"]).get("manager", "dyknow_manager")
        return names.complete(str(given), names.parent(box), box) == self.manager

    def _next_model(self, seconds: float, condition: Callable[[Model], bool]) -> Model | None:
        """Read the topic of the model, which is latched, until a message meets a condition."""
        deadline = time.monotonic() + seconds
        with contextlib.closing(self._topic("model", msg.Model)) as reader:
            while True:
                try:
                    message = reader.read(max(0.0, deadline - time.monotonic()))
                except OSError as error:
                    raise self._no_manager(error, seconds) from error
                model = None if message is None else model_from(message)
                if model is None or condition(model):
                    return model

    def _call(self, service: str, kind: Any, timeout: float, *request: Any, **options: Any) -> Any:
        self._find_master()
        seconds = self._timeout or timeout
        owner = names.parent(service)
        call = partial(super()._call, service, kind, seconds, *request, **options)
        notice = threading.Timer(_SILENCE, self._on_wait, [service])
        notice.daemon = True
        notice.start()
        try:
            return call()
        except ServiceFailed as error:
            raise Refused(f"'{owner}': {error}") from error
        except (ServiceLost, PeerTimeout) as error:
            if owner == self.manager:
                raise self._no_manager(error, seconds) from error
            is_late = isinstance(error, PeerTimeout)
            why = (
                f"did not answer within {seconds:g} s" if is_late else f"does not answer: {error}"
            )
            raise NodeletUnreachable(f"nodelet '{owner}' {why}") from error
        finally:
            notice.cancel()

    def _topic(self, name: str, message_class: Any) -> TopicReader:
        """Connect to a topic of the manager."""
        seconds = self._timeout or client.ASK_TIMEOUT
        topic = names.join(self.manager, name)
        self._find_master()
        connect = partial(TopicReader, self._master, self.manager, topic, message_class, seconds)
        try:
            return self._once_up(connect, seconds)
        except (LookupError, PeerTimeout, OSError) as error:
            raise self._no_manager(error, seconds) from error

    def _nodes_with(self, service: str) -> list[str]:
        return self._on_master(lambda: super(ShellClient, self)._nodes_with(service))

    def _find_master(self) -> None:
        if not self._master_seen:
            seconds = self._timeout or client.CHANGE_TIMEOUT
            self._on_master(lambda: self._once_up(lambda: self._master.ask("getPid"), seconds))
            self._master_seen = True

    def _looked_up(self, question: str, name: str) -> Any:
        """Ask the master for the value of a name; an empty one if it has none."""
        try:
            return self._master.ask(question, name)
        except LookupError:
            return {}

    def _on_master(self, ask: Callable[[], T]) -> T:
        try:
            return ask()
        except (PeerTimeout, OSError, LookupError, ValueError, TypeError, ExpatError) as error:
            raise ManagerUnreachable(
                f"no ROS master at {self._master.uri} ({_words(error)}): is roscore running, and "
                "ROS_MASTER_URI right?"
            ) from error

    def _no_manager(self, error: BaseException, seconds: float) -> ManagerUnreachable:
        """Say why the manager does not answer, and what to do: it is not there, dead, or hangs."""
        cause = error.__cause__ or error
        is_timeout = isinstance(cause, (PeerTimeout, socket.timeout))
        if client.is_unoffered(error) and self._is_there():
            why = (
                "runs, but does not offer its services: it is being started or ended, or the node "
                "is not a DyKnow manager"
            )
        elif client.is_unoffered(error) and self._is_beginning():
            why = "does not answer yet, but a manager is being started: ask again"
        elif isinstance(cause, LookupError) or (not is_timeout and not self._is_registered()):
            why = self._how_to_start()
        elif is_timeout:
            why = (
                f"runs, but did not answer within {seconds:g} s: it hangs, is busy, or its host "
                "is away; ask again with a longer --timeout, or end it: rosnode kill "
                f"{self.manager}, if need be kill -9"
            )
        else:
            why = (
                f"is registered, but does not answer ({_words(error)}): it was probably killed; "
                "start it again with 'rosrun dyknow manager'"
            )
        return ManagerUnreachable(f"DyKnow manager '{self.manager}' {why}")

    def _how_to_start(self) -> str:
        others = [each for each in self.managers() if each != self.manager]
        if others:
            running = f"{' and '.join(others)} {'is' if len(others) == 1 else 'are'}"
            return f"is not running, but {running}: see --manager-node and $DYKNOW_MANAGER"
        space, _, name = self.manager.rpartition("/")
        words = f" __name:={name}" * (name != "dyknow_manager") + f" __ns:={space}" * bool(space)
        return f"is not running: start one with 'rosrun dyknow manager{words}'"

    def _is_registered(self) -> bool:
        """Whether the manager has not withdrawn itself, as it does at every end but by kill -9.

        The master knows the address of an ended node while it notifies that of a parameter.
        """
        try:
            return self.manager in self.managers()
        except ManagerUnreachable:
            return True


def _words(error: BaseException) -> str:
    """The words of an error of the system, without its number."""
    cause = error.__cause__ or error
    return re.sub(r"^\[Errno -?\d+\] ", "", str(cause)) or type(cause).__name__
