# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Nodelet managers announce changes on the topic ``~changes``: the names of nodelets, no more.

A name says that the nodelet was loaded or unloaded, or that its ports or their topics changed;
it does not say how they are now. Names that come in quick succession are announced once, in one
message.

A node with ports that is not a nodelet manager announces its own name, on one topic that all of
them share. So it is found without a question to the ROS master, and listened to without a further
subscription.
"""

from __future__ import annotations

import itertools
from typing import Any, Callable, Iterable, Iterator

import rospy
from dyknow_msgs.msg import NodeletChanges

from dyknow.locks import state_lock, turn_lock
from dyknow.periodic import PeriodicWorker

TOPIC = "changes"
#: Of the nodes with ports that are not nodelet managers.
NODES_TOPIC = "/dyknow/rewirable_nodes"
#: Seconds after an announcement in which further changes are collected.
_WINDOW = 0.02
_QUEUE_SIZE = 1000


class Announcer(rospy.SubscribeListener):
    """The side of the nodelet manager.

    Args:
        everything: names for new listeners, which may have missed some.
        detail: describes a fault of a nodelet; empty if it has none.
        topic: where it announces them.
    """

    def __init__(
        self,
        everything: Callable[[], Iterable[str]],
        detail: Callable[[str], str] = lambda name: "",
        topic: str = f"~{TOPIC}",
    ) -> None:
        super().__init__()
        self._everything = everything
        self._detail = detail
        #: Global name of the topic that it publishes.
        self.topic = rospy.resolve_name(topic)
        self._lock = state_lock("announcer")
        self._names: set[str] = set()
        self._publisher: rospy.Publisher | None = None
        self._worker = PeriodicWorker("announcing changes", self._announce, pause=_WINDOW)

    def start(self) -> None:
        """Announce from now on; new listeners query immediately."""
        self._publisher = rospy.Publisher(
            self.topic, NodeletChanges, subscriber_listener=self, queue_size=_QUEUE_SIZE
        )
        self._worker.start()

    def announce(self, name: str) -> None:
        """Announce a nodelet; returns at once."""
        with self._lock:
            self._names.add(name)
        self._worker.wake()

    def peer_subscribe(self, topic: str, publish: Any, publish_to_peer: Any) -> None:
        """Announce every nodelet to a new listener; rospy calls it."""
        names = sorted(self._everything())
        if names:
            publish_to_peer(self._message(names))

    def close(self) -> None:
        self._worker.close()
        if self._publisher is not None:
            self._publisher.unregister()

    def _message(self, names: list[str]) -> NodeletChanges:
        return NodeletChanges(names, [self._detail(name) for name in names])

    def _announce(self) -> None:
        with self._lock:
            names, self._names = self._names, set()
        if not names or self._publisher is None:
            return
        try:
            self._publisher.publish(self._message(sorted(names)))
        except rospy.ROSException:
            return  # closed in between
        except BaseException:
            with self._lock:
                self._names |= names
            raise


class Listener:
    """The side that listens to any number of nodelet managers.

    Args:
        changed: called with the names of a nodelet manager and of its nodelet, and a description
            of that one's fault, on rospy's threads.
    """

    def __init__(self, changed: Callable[[str, str, str], None]) -> None:
        self._changed = changed
        self._turn = turn_lock("listening to nodelet managers")
        self._subscribers: dict[str, Any] = {}
        self._closed = False

    def follow(self, managers: Callable[[], Iterable[str]]) -> None:
        """Listen to exactly the nodelet managers of this moment, until it is closed.

        They are read within the turn: an older list must not replace a newer one.
        """
        with self._turn:
            wanted = [] if self._closed else sorted(managers())
            for manager in [each for each in self._subscribers if each not in wanted]:
                self._subscribers.pop(manager).unregister()
            for manager in wanted:
                if manager not in self._subscribers:
                    self._subscribers[manager] = rospy.Subscriber(
                        f"{manager}/{TOPIC}", NodeletChanges, self._receive, manager
                    )

    def _receive(self, message: NodeletChanges, manager: str) -> None:
        for name, detail in changes_in(message):
            self._changed(manager, name, detail)

    def close(self) -> None:
        self._closed = True
        self.follow(list)


def changes_in(message: NodeletChanges) -> Iterator[tuple[str, str]]:
    """Yield the nodelets that a message names, each with the description of its fault."""
    return itertools.zip_longest(message.nodelets, message.details, fillvalue="")
