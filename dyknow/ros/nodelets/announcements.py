# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Numbers the changes of a process's nodelets, and announces them with the nodelets' ports.

Nodelet managers and nodes with ports announce on one topic, which all of them share. So they are
found without a question to the ROS master, whoever started them, and listened to without a further
subscription.

A description of a nodelet is made after the number of its last change was taken, so it contains
that change, and one with a smaller number never replaces it (``dyknow.ros.hosting.peer``).
"""

from __future__ import annotations

import os
from typing import Any, Callable

import rospy
from dyknow_msgs.msg import NodeletChanges, NodeletPorts

from dyknow.locks import state_lock
from dyknow.model.graph import NodeletKind
from dyknow.periodic import PeriodicWorker

TOPIC = "/dyknow/rewirable_nodes"
#: Seconds after an announcement in which further changes are collected.
_WINDOW = 0.02
_QUEUE_SIZE = 1000


class Announcer(rospy.SubscribeListener):
    """The changes of this process; the node must be initialised.

    ``describe`` returns the message about a nodelet, loaded or not.
    """

    def __init__(self, describe: Callable[[str], NodeletPorts]) -> None:
        super().__init__()
        self._describe = describe
        self._process = f"{rospy.get_node_uri()}@{os.getpid()}"
        #: Kind of the nodelets.
        self.kind = NodeletKind.PYTHON
        self._lock = state_lock("announcer")
        self._sequence = self._announced = 0
        self._changed: dict[str, int] = {}  # number of the last change of each nodelet
        self._publisher: rospy.Publisher | None = None
        self._worker = PeriodicWorker("announcing changes", self._announce, pause=_WINDOW)

    def start(self) -> None:
        """Announce from now on."""
        self._publisher = rospy.Publisher(
            TOPIC, NodeletChanges, subscriber_listener=self, queue_size=_QUEUE_SIZE
        )
        self._worker.start()

    def announce(self, name: str) -> None:
        """Number a change of a nodelet, and announce it soon."""
        with self._lock:
            self._sequence += 1
            self._changed[name] = self._sequence
        self._worker.wake()

    def since(self, sequence: int) -> NodeletChanges:
        """Return all changes after one; those after 0 describe every nodelet."""
        with self._lock:
            last = self._sequence
            names = sorted(name for name, number in self._changed.items() if number > sequence)
        nodelets = [self._describe(name) for name in names]
        return NodeletChanges(self._process, last, nodelets, self.kind.value)

    def peer_subscribe(self, topic: str, publish: Any, publish_to_peer: Any) -> None:
        """Announce every nodelet to a new subscriber; rospy calls it."""
        changes = self.since(0)
        if changes.nodelets:
            publish_to_peer(changes)

    def close(self) -> None:
        self._worker.close()
        if self._publisher is not None:
            self._publisher.unregister()

    def _announce(self) -> None:
        changes = self.since(self._announced)
        if not changes.nodelets or self._publisher is None:
            return
        try:
            self._publisher.publish(changes)
        except rospy.ROSException:
            return  # closed in between
        with self._lock:
            self._announced = changes.sequence
            for each in changes.nodelets:
                if not each.is_loaded and self._changed[each.nodelet] <= changes.sequence:
                    del self._changed[each.nodelet]
