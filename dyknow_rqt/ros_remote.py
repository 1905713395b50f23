# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The window's view on ROS: the manager's client, its topics, the master. No Qt here.

``RosRemote`` owns two subscriptions; where the process is no node yet it makes it one, as soon as
there is a master.
"""

from __future__ import annotations

import threading
from typing import Any, Callable, Optional, Tuple

import rospy
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.msg import StreamEvent as StreamEventMessage

from dyknow import names
from dyknow.errors import DyKnowError, HostError
from dyknow.model.graph import Model
from dyknow.model.streams import StreamEvent
from dyknow.periodic import in_background
from dyknow.ros.client import ManagerClient
from dyknow.ros.master import Master
from dyknow.ros.messages import event_from, model_from
from dyknow_rqt.graph.snapshot import Side
from dyknow_rqt.remote import Remote

#: Seconds from one look for a master to the next.
_MASTER_PERIOD = 1.0


class RosRemote(Remote):
    """Speaks with the manager of the given name."""

    def __init__(self, manager: str = "dyknow_manager") -> None:
        """Prepare; nothing is sent yet.

        Args:
            manager: node name; a relative one begins in the namespace of the environment.
        """
        self.client: ManagerClient = ManagerClient(manager)
        self._master = Master(f"{self.manager}_window")
        self._on_model: Callable[[Model], None] = lambda model: None
        self._on_event: Callable[[StreamEvent], None] = lambda event: None
        self._subscriber: Any = None
        self._event_subscriber: Any = None
        self._latest: Optional[Model] = None
        self._closed = threading.Event()

    def start(
        self,
        on_model: Callable[[Model], None],
        on_event: Callable[[StreamEvent], None],
    ) -> None:
        """Subscribe, as soon as there is a master."""
        self._on_model, self._on_event = on_model, on_event
        in_background("subscribing to the manager", self._subscribe)

    def close(self) -> None:
        """Listen no more."""
        self._closed.set()
        subscribers = (self._subscriber, self._event_subscriber)
        self._subscriber = self._event_subscriber = None
        for subscriber in subscribers:
            if subscriber is not None:
                subscriber.unregister()

    def graph(self) -> Model:
        """Ask the manager, or take its last message while it is connected to us."""
        subscriber, latest = self._subscriber, self._latest
        if subscriber is None or latest is None or subscriber.get_num_connections() == 0:
            latest = self._latest = None
            self._look_for_master()
            return self.client.get_model()
        return latest

    def system_state(self) -> Tuple[Side, Side]:
        """Ask the master."""
        publishers, subscribers, _ = self._master.ask("getSystemState")
        return publishers, subscribers

    # Inside

    def _look_for_master(self) -> None:
        try:
            self._master.ask("getPid")
        except DyKnowError as error:
            raise HostError(f"there is no ROS master at {self._master.uri}") from error

    def _subscribe(self) -> None:
        while not self._closed.is_set():
            try:
                self._look_for_master()
                break
            except HostError:
                self._closed.wait(_MASTER_PERIOD)
        if self._closed.is_set():
            return
        if not rospy.core.is_initialized():
            rospy.init_node("dyknow_rqt", anonymous=True, disable_signals=True)
        topic = names.join(self.manager, "stream_events")
        self._event_subscriber = rospy.Subscriber(
            topic, StreamEventMessage, self._hear_event, queue_size=100
        )
        topic = names.join(self.manager, "model")
        self._subscriber = rospy.Subscriber(topic, ModelMessage, self._hear, queue_size=1)

    def _hear(self, message: ModelMessage) -> None:
        if not self._closed.is_set():
            self._latest = model_from(message)
            self._on_model(self._latest)

    def _hear_event(self, message: StreamEventMessage) -> None:
        if not self._closed.is_set():
            self._on_event(event_from(message))
