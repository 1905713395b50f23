# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers tell of changes on the topic ``~changes``: the names of nodelets, no more.

A name says that the nodelet was loaded or unloaded, or that its ports or their topics changed;
it does not say how they are now. Names that come in quick succession are told once, in one
message.

A node with ports that is no nodelet manager tells its own name on one topic that all of them
share, to everybody who begins to listen. So it is found without a question to the ROS master.
"""

from __future__ import annotations

import itertools
from typing import Any, Callable, Dict, Iterable, List, Optional, Set

import rospy
from dyknow_msgs.msg import NodeletChanges

from dyknow.locks import state_lock, turn_lock
from dyknow.periodic import PeriodicWorker

TOPIC = "changes"
#: Of the nodes with ports that are no nodelet managers.
NODES_TOPIC = "/dyknow/rewirable_nodes"
#: Seconds in which changes that follow one that was told are collected.
_WINDOW = 0.02
_QUEUE_SIZE = 1000


class Announcer:
    """The side that tells."""

    def __init__(
        self,
        everything: Callable[[], Iterable[str]],
        detail: Callable[[str], str] = lambda name: "",
    ) -> None:
        """Advertise the topic.

        Args:
            everything: names for new listeners, which may have missed some.
            detail: returns what ails a nodelet; empty if nothing does.
        """
        self._everything = everything
        self._detail = detail
        #: Global names of the topics that it publishes.
        self.topics = (rospy.resolve_name(f"~{TOPIC}"), NODES_TOPIC)
        self._lock = state_lock("announcer")
        self._names: Set[str] = set()
        self._publisher = rospy.Publisher(
            self.topics[0],
            NodeletChanges,
            subscriber_listener=_Newcomers(self),
            queue_size=_QUEUE_SIZE,
        )
        self._node_publisher: Optional[rospy.Publisher] = None
        self._worker = PeriodicWorker("announcing changes", self._announce, pause=_WINDOW)
        self._worker.start()

    def tell(self, name: str) -> None:
        """Announce a nodelet; returns at once."""
        with self._lock:
            self._names.add(name)
        self._worker.wake()

    def tell_newcomer(self, publish: Callable[[NodeletChanges], None]) -> None:
        """Announce everything to a new listener."""
        names = sorted(self._everything())
        if names:
            publish(self._message(names))

    def tell_of_node(self) -> None:
        """Announce this process as a node with ports, whose services are there."""
        self._node_publisher = rospy.Publisher(
            NODES_TOPIC, NodeletChanges, latch=True, queue_size=1
        )
        self._node_publisher.publish(NodeletChanges(nodelets=[rospy.get_name()]))

    def close(self) -> None:
        """Withdraw the topics."""
        self._worker.close()
        self._publisher.unregister()
        if self._node_publisher is not None:
            self._node_publisher.unregister()

    def _message(self, names: List[str]) -> NodeletChanges:
        return NodeletChanges(names, [self._detail(name) for name in names])

    def _announce(self) -> None:
        with self._lock:
            names, self._names = self._names, set()
        if not names:
            return
        try:
            self._publisher.publish(self._message(sorted(names)))
        except rospy.ROSException:
            return  # closed in between
        except BaseException:
            with self._lock:
                self._names |= names
            raise


class _Newcomers(rospy.SubscribeListener):
    def __init__(self, announcer: Announcer) -> None:
        self._announcer = announcer

    def peer_subscribe(
        self, topic_name: str, topic_publish: Any, peer_publish: Callable[[NodeletChanges], None]
    ) -> None:
        """Tell a new listener everything."""
        self._announcer.tell_newcomer(peer_publish)


class Listener:
    """The side that is told, by any number of nodelet managers."""

    def __init__(self, hear: Callable[[str, str, str], None]) -> None:
        """Begin without subscriptions.

        Args:
            hear: called with the names of a nodelet manager and of its nodelet, and what ails
                that, on rospy's threads.
        """
        self._hear = hear
        self._turn = turn_lock("listening to nodelet managers")
        self._subscribers: Dict[str, Any] = {}

    def follow(self, managers: Iterable[str]) -> None:
        """Listen to these nodelet managers and no others."""
        wanted: List[str] = sorted(managers)
        with self._turn:
            for manager in [each for each in self._subscribers if each not in wanted]:
                self._subscribers.pop(manager).unregister()
            for manager in wanted:
                if manager not in self._subscribers:
                    self._subscribers[manager] = rospy.Subscriber(
                        f"{manager}/{TOPIC}", NodeletChanges, self._told, manager
                    )

    def _told(self, message: NodeletChanges, manager: str) -> None:
        for name, detail in itertools.zip_longest(message.nodelets, message.details):
            self._hear(manager, name, detail or "")

    def close(self) -> None:
        """End all subscriptions."""
        self.follow(())
