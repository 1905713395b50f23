"""The window's view on ROS: the manager's client, its topics, the master. No Qt here.

``RosRemote`` owns two subscriptions; where the process is no node yet it makes it one, as soon as
there is a master.
"""

from __future__ import annotations

import threading
from typing import Any, Callable, Mapping, Optional, Sequence, Tuple

import rospy
from dyknow_msgs.msg import Model as ModelMessage
from dyknow_msgs.msg import StreamEvent as StreamEventMessage

from dyknow import names
from dyknow.errors import DyKnowError, HostError
from dyknow.model.graph import Model, PortState
from dyknow.model.statistics import NodeletStatistics
from dyknow.model.streams import Acquisition, Replanned, StreamEvent, StreamRequest, StreamStatus
from dyknow.model.transformation import Added
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
        self._client = ManagerClient(manager)
        self.manager = self._client.manager
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
        threading.Thread(target=self._subscribe, name="dyknow_rqt subscribe", daemon=True).start()

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
            return self._client.get_model()
        return latest

    def library(self) -> Model:
        """Ask the manager for everything."""
        return self._client.get_model()

    def ports(self, nodelet: str) -> Sequence[PortState]:
        """Ask a proxy."""
        return self._client.get_config(nodelet)

    def statistics(self, nodelet: str) -> NodeletStatistics:
        """Ask a proxy."""
        return self._client.get_statistics(nodelet)

    def system_state(self) -> Tuple[Side, Side]:
        """Ask the master."""
        publishers, subscribers, _ = self._master.ask("getSystemState")
        return publishers, subscribers

    def nodelet_managers(self) -> Sequence[str]:
        """Ask the master for those who offer the service."""
        suffix = "/load_nodelet"
        _, _, services = self._master.ask("getSystemState")
        return [name[: -len(suffix)] for name, _ in services if name.endswith(suffix)]

    def add_transformation(self, specification: str) -> Added:
        """Ask the manager."""
        return self._client.add_transformation(specification)

    def remove_transformation(self, label: str) -> None:
        """Ask the manager."""
        self._client.remove_transformation(label)

    def spawn(
        self,
        label: str,
        name: str,
        config: Optional[Mapping[str, str]] = None,
        is_protected: bool = False,
        isolated: bool = False,
        manager: str = "",
    ) -> None:
        """Ask the manager."""
        self._client.spawn(label, name, config, is_protected, isolated, manager)

    def destroy(self, name: str) -> None:
        """Ask the manager."""
        self._client.destroy(name)

    def set_protection(self, name: str, is_protected: bool) -> None:
        """Ask the manager."""
        self._client.set_protection(name, is_protected)

    def set_config(self, nodelet: str, config: Mapping[str, str]) -> None:
        """Ask a proxy."""
        self._client.set_config(nodelet, config)

    def acquire_stream(self, request: StreamRequest, dry_run: bool = False) -> Acquisition:
        """Ask the manager."""
        return self._client.acquire_stream(request, dry_run)

    def release_stream(self, claim_id: str) -> None:
        """Ask the manager."""
        self._client.release_stream(claim_id)

    def replan_stream(self, claim_id: str, dry_run: bool = False) -> Replanned:
        """Ask the manager."""
        return self._client.replan_stream(claim_id, dry_run)

    def streams(self) -> Sequence[StreamStatus]:
        """Ask the manager."""
        return self._client.list_streams()

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
