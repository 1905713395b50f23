# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window's view on ROS: the manager's client, its topics, the master. No Qt here.

``RosRemote`` owns connections to three topics of the manager, to each topic of verdicts, and to
those that the user looks at. It registers nothing with the master, so it needs no node, outlives
any master, and leaves nothing behind.
"""

from __future__ import annotations

import os
from functools import partial
from typing import AbstractSet, Any, Callable, Collection

from dyknow_msgs.msg import Counts as CountsMessage
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.msg import StreamEvent as StreamEventMessage
from dyknow_msgs.msg import Verdict as VerdictMessage

from dyknow import names
from dyknow.datatypes import ANY
from dyknow.errors import HostError
from dyknow.formulas import Truth, Verdict
from dyknow.model.graph import Model
from dyknow.ros.client import ManagerClient
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.message_classes import message_class
from dyknow.ros.wire.messages import counts_from, event_from, model_from
from dyknow.ros.wire.topic_reader import TopicFollower
from dyknow_rqt.graph.samples import Sample, sample_of
from dyknow_rqt.graph.snapshot import Side, Transports
from dyknow_rqt.monitoring.remote import Remote

#: Seconds for a node to name its connections.
_PATIENCE = 1.0


class RosRemote(Remote):
    """Speaks with the manager of the given name."""

    def __init__(self, manager: str = "dyknow_manager") -> None:
        """Prepare; nothing is sent yet.

        Args:
            manager: node name; a relative one begins in the namespace of the environment.
        """
        caller = f"/dyknow_rqt_{os.getpid()}"
        self._master = Master(caller)
        super().__init__(self._master.uri)
        self.client: ManagerClient = ManagerClient(manager, caller)
        self._service = names.join(self.manager, "list_streams")
        self._address = ""
        self._latest: Model | None = None
        self._models = self._follower("model", ModelMessage, self._hear)
        counts = self._follower("counts", CountsMessage, lambda m: self.on_counts(counts_from(m)))
        events = self._follower(
            "stream_events", StreamEventMessage, lambda m: self.on_event(event_from(m)), False
        )
        self._followers = (self._models, counts, events)
        self._verdicts: dict[tuple[str, str], TopicFollower] = {}

    def start(self) -> None:
        for follower in self._followers:
            follower.start()

    def follow_verdicts(self, sources: AbstractSet[tuple[str, str]]) -> None:
        for source in self._verdicts.keys() - sources:
            self._verdicts.pop(source).close()
        for node, topic in sources - self._verdicts.keys():
            hear = partial(self._hear_verdict, topic)
            follower = TopicFollower(
                self._master, node, topic, VerdictMessage, hear, last_only=True
            )
            self._verdicts[node, topic] = follower
            follower.start()

    def follow(
        self, topic: str, datatype: str, node: str, on_sample: Callable[[Sample], None]
    ) -> Callable[[], None]:
        if datatype in ANY:
            types = dict(self._master.ask("getTopicTypes"))
            datatype = types.get(topic, "")
        found = message_class(datatype)
        if found is None:
            raise HostError(f"{topic}: messages of type '{datatype}' are not known here")
        reduced = _Reduced(found)
        follower = TopicFollower(self._master, node, topic, reduced, on_sample, last_only=True)
        follower.start()
        return follower.close

    def close(self) -> None:
        for follower in self._followers:
            follower.close()
        self.follow_verdicts(frozenset())

    def graph(self) -> Model:
        """Ask the manager, or take its last message while we are connected to it."""
        latest = self._latest
        if latest is None or not self._models.is_connected:
            self._latest = None
            return self.client.get_model()
        return latest

    def system_state(self) -> tuple[Side, Side]:
        publishers, subscribers, _ = self._master.ask("getSystemState")
        return publishers, subscribers

    def find_manager(self) -> str:
        try:
            address = str(self._master.ask("lookupService", self._service))
        except LookupError:
            return ""
        if self._address not in ("", address):
            self.client.close()
            for follower in self._followers:
                follower.reconnect()
        self._address = address
        return address

    def transports(self, nodes: Collection[str]) -> Transports:
        found: dict[tuple[str, str, str], list[str]] = {}
        for node in nodes:
            found.update(self._master.transports(node, _PATIENCE))
        return found

    # Inside

    def _follower(
        self, name: str, kind: type, take: Callable[[Any], None], last_only: bool = True
    ) -> TopicFollower:
        """A follower of a topic of the manager."""
        topic = names.join(self.manager, name)
        return TopicFollower(self._master, self.manager, topic, kind, take, last_only=last_only)

    def _hear(self, message: ModelMessage) -> None:
        self._latest = model_from(message)
        self.on_model(self._latest)

    def _hear_verdict(self, topic: str, message: VerdictMessage) -> None:
        since = message.since.to_nsec()
        self.on_verdict(topic, Verdict(since, Truth(message.value), since, message.why))


class _Reduced:
    """Takes the place of a class of messages, and reads only the shown part of each."""

    def __init__(self, message_class: Any) -> None:
        self._class = message_class
        self._type, self._md5sum = message_class._type, message_class._md5sum

    def __call__(self) -> _Reduced:
        return self

    def deserialize(self, frame: bytes) -> Sample:
        return sample_of(self._class().deserialize(frame), len(frame))
