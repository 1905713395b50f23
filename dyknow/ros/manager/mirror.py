# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The contents of a ROS master as values, and the differences between two masters' contents."""

from __future__ import annotations

import xmlrpc.client
from dataclasses import asdict, dataclass, field
from typing import Any, Collection, Iterable, Iterator, Mapping, Sequence

from dyknow import names
from dyknow.ros.nodelets.announcements import TOPIC
from dyknow.ros.wire.master import Question, is_hollow

#: Each roscore has its own, and refuses to start beside another one.
_RUN_ID = "run_id"
_ANY_TYPE = "*"


@dataclass(frozen=True)
class NodeAddress:
    """Where a node is: its address, and its process id, 0 while that is unknown."""

    uri: str
    pid: int = 0


@dataclass(frozen=True)
class NodeTopics:
    """The topics of a node that lives, with their types; None where it did not list them."""

    published: Mapping[str, str] | None = None
    subscribed: Mapping[str, str] | None = None


@dataclass(frozen=True)
class MasterMirror:
    """The contents of a ROS master at one moment.

    Attributes:
        pid: its process id.
        nodes: the registered nodes, by name.
        publishers: names of nodes, by topic.
        subscribers: names of nodes, by topic.
        services: names of nodes, by service.
        addresses: addresses of the services.
        types: of the topics.
        parameters: the tree of parameters.
    """

    pid: int
    nodes: Mapping[str, NodeAddress] = field(default_factory=dict)
    publishers: Mapping[str, Sequence[str]] = field(default_factory=dict)
    subscribers: Mapping[str, Sequence[str]] = field(default_factory=dict)
    services: Mapping[str, str] = field(default_factory=dict)
    addresses: Mapping[str, str] = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def to_text(self) -> str:
        """Write what ``from_text`` reads; parameters are values of XML-RPC, not of JSON."""
        return xmlrpc.client.dumps((asdict(self),))

    @classmethod
    def from_text(cls, text: str) -> MasterMirror:
        """Read a mirror; raises ValueError."""
        try:
            body: Any = xmlrpc.client.loads(text)[0][0]
            nodes = {name: NodeAddress(**each) for name, each in body.pop("nodes").items()}
            return cls(**body, nodes=nodes)
        except Exception as error:  # of the XML parser, or of a file from another version
            raise ValueError(str(error)) from error

    def is_of_the_same_master(self, other: MasterMirror) -> bool:
        """Whether both are of one process, also where each process has the same id."""
        runs = {self.parameters.get(_RUN_ID), other.parameters.get(_RUN_ID)} - {None}
        return self.pid == other.pid and len(runs) <= 1


@dataclass(frozen=True)
class MasterLoss:
    """The registrations and parameters that a new master lacks.

    Its own contents are newer, and stay: nodes may have registered with it already.

    Attributes:
        kept: the contents of the master before.
        present: those of the new one.
        living: the nodes of ``kept`` that answer at their addresses, and those that may.
        last: the node whose registrations come last among those of their kind.
    """

    kept: MasterMirror
    present: MasterMirror
    living: Mapping[str, NodeTopics]
    last: str

    def parameters(self) -> list[tuple[str, Any]]:
        """Return parameters, or whole namespaces, with their values."""
        return list(lost_parameters(self.kept.parameters, self.present.parameters))

    def services(self) -> list[str]:
        """Return the names of services of living nodes."""
        lost = self.kept.addresses.keys() - self.present.services.keys()
        mine = (each for each in lost if self.kept.services[each] in self.living)
        return sorted(mine, key=lambda each: (self.kept.services[each] == self.last, each))

    def service_registrations(self, offered: Iterable[str]) -> Iterator[Question]:
        """Yield the registrations of services that living nodes offer."""
        for service in offered:
            node, address = self.kept.services[service], self.kept.addresses[service]
            if node in self.living:
                yield "registerService", node, service, address, self.kept.nodes[node].uri

    def publisher_registrations(self) -> list[Question]:
        published = {name: topics.published for name, topics in self.living.items()}
        before, now = self.kept.publishers, self.present.publishers
        return list(self._registrations("registerPublisher", published, before, now))

    def subscriber_registrations(self) -> list[Question]:
        subscribed = {name: topics.subscribed for name, topics in self.living.items()}
        before, now = self.kept.subscribers, self.present.subscribers
        return list(self._registrations("registerSubscriber", subscribed, before, now))

    def is_news(self, node: str, topic: str, publishers: Collection[str]) -> bool:
        """Whether a subscriber does not know all addresses of the publishers of a topic yet."""
        known = set()
        if node in self.kept.subscribers.get(topic, ()):
            of = self.kept.publishers.get(topic, ())
            known = {self.kept.nodes[each].uri for each in of if each in self.kept.nodes}
        return not known.issuperset(publishers)

    def _registrations(
        self,
        function: str,
        listed: Mapping[str, Mapping[str, str] | None],
        before: Mapping[str, Sequence[str]],
        now: Mapping[str, Sequence[str]],
    ) -> Iterator[Question]:
        for node in sorted(listed, key=lambda each: (each == self.last, each)):
            registered = {topic for topic, nodes in before.items() if node in nodes}
            topics = listed[node]
            if topics is None:
                topics = {each: self.kept.types.get(each, _ANY_TYPE) for each in registered}
            elif TOPIC in registered:  # re-wirable programs do not list it
                topics = {**topics, TOPIC: self.kept.types[TOPIC]}
            for topic in sorted(topics):
                if node not in now.get(topic, ()):
                    yield function, node, topic, topics[topic], self.kept.nodes[node].uri


def lost_parameters(
    kept: Mapping[str, Any], present: Mapping[str, Any], namespace: str = "/"
) -> Iterator[tuple[str, Any]]:
    """Yield the parameters of one tree that another one lacks, or whole namespaces."""
    for key in sorted(kept):
        name = names.join(namespace, key)
        if key not in present:
            if name != f"/{_RUN_ID}" and not is_hollow(kept[key]):
                yield name, kept[key]
        elif isinstance(kept[key], dict) and isinstance(present[key], dict):
            yield from lost_parameters(kept[key], present[key], name)
