# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Questions to the ROS master, each with a timeout (rosgraph's own have none)."""

from __future__ import annotations

import contextlib
import http.client
import os
import queue
import re
import xmlrpc.client
from typing import Any, Callable, Iterable, Iterator, Sequence, Tuple
from xml.parsers.expat import ExpatError

from dyknow import names
from dyknow.errors import PeerTimeout
from dyknow.locks import assert_no_state_lock
from dyknow.model.transformation import IN, OUT
from dyknow.ros.wire.addresses import connect

#: Seconds that the master may take to answer.
TIMEOUT = 3.0
#: The port of the subscriber in what rospy and roscpp say of a connection.
_PORT = re.compile(r"\bto \[[^]]*:(\d+) on socket")
#: Connections that are kept for the next question; each takes a thread of the master.
_KEPT = 2
#: Seconds for a node to list its subscriptions, while a switch waits for them.
_AT_ONCE = 0.5

Question = Tuple[Any, ...]
"""A function of the master's API and its arguments, of which the first is the caller."""


class _Connection(http.client.HTTPConnection):
    """One whose time limit includes the look-up of the host's address."""

    def connect(self) -> None:
        self.sock = connect(self.host, self.port, self.timeout or TIMEOUT)


class _Transport(xmlrpc.client.Transport):
    """Parses an answer as a whole; parsing takes longer than all the rest."""

    #: Only look whether the next answer has this text.
    wanted = b""

    def __init__(self, seconds: float, compares: bool) -> None:
        """Prepare; with ``compares`` an answer like the one before is not parsed again."""
        super().__init__()
        self._seconds = seconds
        self._compares = compares
        self._text = b""
        self._value: Any = None

    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        if self._connection and host == self._connection[0] and self._connection[1]:
            return self._connection[1]
        made = _Connection(self.get_host_info(host)[0], timeout=self._seconds)
        self._connection = host, made
        return made

    def parse_response(self, response: Any) -> Any:
        text = response.read()
        if response.getheader("Content-Encoding", "") == "gzip":
            text = xmlrpc.client.gzip_decode(text, -1)
        wanted, self.wanted = self.wanted, b""
        if wanted:
            return ((1, "", wanted in text),)
        if text == self._text:
            return self._value
        parser, unmarshaller = self.getparser()
        parser.feed(text)
        parser.close()
        value = unmarshaller.close()
        if self._compares:
            self._text, self._value = text, value
        return value


class _Server:
    """The XML-RPC API of the master or of a node; some connections are kept."""

    def __init__(self, uri: str, peer: str, timeout: float, compares: bool = False) -> None:
        self._uri = uri
        self._peer = peer
        self._timeout = timeout
        self._compares = compares
        self._idle: queue.LifoQueue[_Transport] = queue.LifoQueue(_KEPT)

    def ask(self, question: str, *args: Any, wanted: bytes = b"") -> Any:
        code, message, value = self._call(_one, question, *args, wanted=wanted)
        if code != 1:
            raise LookupError(message)
        return value

    def ask_all(self, questions: Iterable[Question]) -> list[Any]:
        calls = [{"methodName": each[0], "params": list(each[1:])} for each in questions]
        return self._call(_all, "system.multicall", calls) if calls else []

    def _call(
        self, read: Callable[[Any], Any], question: str, *args: Any, wanted: bytes = b""
    ) -> Any:
        assert_no_state_lock(f"asking {self._peer}: {question}")
        try:
            transport = self._idle.get_nowait()
        except queue.Empty:
            transport = _Transport(self._timeout, self._compares)
        transport.wanted = wanted
        try:
            server = xmlrpc.client.ServerProxy(self._uri, transport=transport)
            answer = read(getattr(server, question)(*args))
        except (OSError, http.client.HTTPException) as error:
            transport.close()
            raise PeerTimeout(self._peer, self._timeout) from error
        except (xmlrpc.client.Error, ExpatError, ValueError, TypeError, LookupError) as error:
            transport.close()
            raise LookupError(f"{self._peer}: {error}") from error
        try:
            self._idle.put_nowait(transport)
        except queue.Full:
            transport.close()
        return answer

    def close(self) -> None:
        with contextlib.suppress(queue.Empty):
            while True:
                self._idle.get_nowait().close()


def _one(answer: Sequence[Any]) -> tuple[Any, Any, Any]:
    code, message, value = answer
    return code, message, value


def _all(answers: Sequence[Any]) -> list[Any]:
    """Read a list with a list of one answer, or a description of a fault, for each question."""
    return [each[0][2] if isinstance(each, list) and each[0][0] == 1 else None for each in answers]


def is_hollow(tree: Any) -> bool:
    """Whether a value of the parameter server is a namespace with no parameter in it.

    Other values cannot be compared with ``{}``: Python 3.8 refuses that for dates.
    """
    return isinstance(tree, dict) and all(map(is_hollow, tree.values()))


def _hollow(tree: Any, name: str) -> Iterator[str]:
    """Yield the outermost namespaces of a tree, itself perhaps, with no parameter in them."""
    if is_hollow(tree):
        yield name
    elif isinstance(tree, dict):
        for key in sorted(tree):
            yield from _hollow(tree[key], names.join(name, key))


class Master:
    """The master at ``uri``, by default ``ROS_MASTER_URI``, queried in the name of one node.

    Every method raises `PeerTimeout` when the master, or a queried node, does not answer in time,
    and `LookupError` when it answers with an error, for instance to an unknown name.
    """

    def __init__(
        self, caller: str, uri: str = "", timeout: float = TIMEOUT, compares: bool = False
    ) -> None:
        """Prepare; with ``compares`` an answer like the one before is the same object."""
        self.caller = caller
        # As for rospy, an empty one is none.
        self.uri = uri or os.environ.get("ROS_MASTER_URI") or "http://localhost:11311"
        self.timeout = timeout
        self._server = _Server(self.uri, f"the ROS master at {self.uri}", timeout, compares)

    def ask(self, question: str, *args: Any) -> Any:
        """Call a function of the master's API and return its value."""
        return self._server.ask(question, self.caller, *args)

    def ask_all(self, questions: Iterable[Question]) -> list[Any]:
        """Call functions in one request; the value of one that fails is None."""
        return self._server.ask_all(questions)

    def publications(self) -> dict[str, list[str]]:
        """Return the publishers of each topic.

        Raises `PeerTimeout` if the master does not know the caller, a node: the master is new, and
        the DyKnow manager registers all nodes again (``dyknow.ros.manager.keeper``), itself last.
        """
        publishers = dict(self.ask("getSystemState")[0])
        if not any(self.caller in nodes for nodes in publishers.values()):
            raise PeerTimeout(f"the new ROS master at {self.uri}", self.timeout)
        return publishers

    def publishers(self, topic: str) -> set[str]:
        return self._nodes(topic, 0)

    def subscribers(self, topic: str) -> set[str]:
        return self._nodes(topic, 1)

    def datatype(self, topic: str) -> str:
        """Type of a topic with a live publisher or subscriber, else empty.

        The types that the master knows outlive the publishers, so only published topics are
        looked up, in the namespace of this one. Without a publisher the subscribers are queried,
        unless nothing has registered the topic, which is found out without parsing the answers.
        """
        published = dict(self.ask("getPublishedTopics", names.parent(topic)))
        if topic in published:
            return str(published[topic])
        if not (
            self._mentions("getTopicTypes", topic) and self._mentions("getSystemState", topic)
        ):
            return ""
        answers = (self._subscribed(node, topic) for node in sorted(self.subscribers(topic)))
        return next((answer for answer in answers if answer not in ("", "*")), "")

    def node(self, name: str) -> str:
        """Return the address of a node that is registered, dead or alive; else empty."""
        try:
            return str(self.ask("lookupNode", name))
        except LookupError:
            return ""

    def bearer(self, name: str) -> str:
        """Return the address of a node; raises `PeerTimeout` as `publications` does."""
        uri = self.node(name)
        if not uri and not self.node(self.caller):
            raise PeerTimeout(f"the new ROS master at {self.uri}", self.timeout)
        return uri or self.node(name)

    def pid(self, name: str, uri: str, timeout: float) -> int:
        return int(self._ask_node(name, uri, timeout, "getPid"))

    def pid_at(self, name: str, uri: str, timeout: float) -> int:
        """Return the process id of a node at an address; 0 if it does not answer in time."""
        try:
            return self.pid(name, uri, timeout)
        except (PeerTimeout, LookupError):
            return 0

    def pid_of(self, name: str, timeout: float) -> int:
        """Return the process id of a registered node; 0 if it, or the master, does not answer."""
        with contextlib.suppress(PeerTimeout):
            uri = self.node(name)
            return self.pid_at(name, uri, timeout) if uri else 0
        return 0

    def connections(self, uri: str, topic: str, timeout: float) -> set[int]:
        """Query the ports to which a node at ``uri`` sends a topic that it publishes."""
        infos = self._ask_node(f"at {uri}", uri, timeout, "getBusInfo")
        ports = (_PORT.search(str(info[-1])) for info in infos if info[2:5:2] == ["o", topic])
        return {int(port.group(1)) for port in ports if port}

    def receivers(self, node: str, topic: str, timeout: float) -> set[str]:
        """Query a node for the nodes to which it sends a topic that it publishes."""
        infos = self._ask_node(node, self.ask("lookupNode", node), timeout, "getBusInfo")
        return {str(info[1]) for info in infos if info[2:5:2] == ["o", topic]}

    def transports(self, node: str, timeout: float) -> dict[tuple[str, str, str], list[str]]:
        """Query a node for the transports of its connections to other processes.

        Returns:
            Names, by node, ``in`` or ``out``, and topic; none of a node that does not answer.
        """
        found: dict[tuple[str, str, str], list[str]] = {}
        with contextlib.suppress(PeerTimeout, LookupError):
            uri = self.ask("lookupNode", node)
            for info in self._ask_node(f"at {uri}", uri, timeout, "getBusInfo"):
                if info[3] != "INTRAPROCESS":
                    key = (node, OUT if info[2] == "o" else IN, str(info[4]))
                    found.setdefault(key, []).append(str(info[3]))
        return found

    def topics(self, name: str, uri: str, timeout: float) -> tuple[dict[str, str], dict[str, str]]:
        """Query the topics that a node publishes, and subscribes to, with their types."""
        with contextlib.closing(_Server(uri, f"node {name}", timeout)) as server:
            published = dict(server.ask("getPublications", self.caller))
            return published, dict(server.ask("getSubscriptions", self.caller))

    def update(
        self, name: str, uri: str, topic: str, publishers: Sequence[str], timeout: float
    ) -> None:
        """Notify a subscriber of the addresses of all publishers of a topic."""
        self._ask_node(name, uri, timeout, "publisherUpdate", topic, list(publishers))

    def shut_down(self, name: str, uri: str, reason: str, timeout: float) -> None:
        """Shut a node down, as the master does when another one takes its name."""
        self._ask_node(name, uri, timeout, "shutdown", reason)

    def purge(self, node: str, uri: str) -> None:
        """Unregister, in its name, everything that a dead node left, as ``rosnode cleanup`` does.

        The master forgets the node's address then, unless it subscribed to parameters of its own.
        Otherwise it would shut the address down when the name registers again, and with it any
        node that has the port by then.

        Registrations of a successor of that name, at another address, stay.
        """
        publishers, subscribers, services = self.ask("getSystemState")
        dead = Master(node, self.uri, self.timeout)
        for question, topics in (
            ("unregisterPublisher", publishers),
            ("unregisterSubscriber", subscribers),
        ):
            for topic, nodes in topics:
                if node in nodes:
                    dead.ask(question, topic, uri)
        for service, nodes in services:
            if node in nodes:
                dead.ask("unregisterService", service, self.ask("lookupService", service))
        dead.ask("unsubscribeParam", uri, names.LOG_PARAMETER)

    def delete_parameters(self, node: str, parameters: Iterable[str]) -> None:
        """Delete private parameters of a node, and its namespaces that are left without any."""
        deleted = [("deleteParam", self.caller, names.join(node, each)) for each in parameters]
        if deleted:
            left = self.ask_all([*deleted, ("getParam", self.caller, node)])[-1]
            self.ask_all(("deleteParam", self.caller, each) for each in _hollow(left, node))

    def _subscribed(self, node: str, topic: str) -> str:
        """Return the type a node subscribes to a topic with; empty without a quick answer."""
        uri = self.node(node)
        if not uri:
            return ""
        try:
            types: list[tuple[str, str]] = self._ask_node(node, uri, _AT_ONCE, "getSubscriptions")
        except (PeerTimeout, LookupError):
            return ""
        return next((datatype for name, datatype in types if name == topic), "")

    def _ask_node(self, name: str, uri: str, timeout: float, question: str, *args: Any) -> Any:
        with contextlib.closing(_Server(uri, f"node {name}", timeout)) as server:
            return server.ask(question, self.caller, *args)

    def _mentions(self, question: str, name: str) -> bool:
        """Whether a name is in an answer."""
        return bool(self._server.ask(question, self.caller, wanted=f">{name}<".encode()))

    def _nodes(self, topic: str, side: int) -> set[str]:
        state = self.ask("getSystemState")
        return {node for name, nodes in state[side] if name == topic for node in nodes}
