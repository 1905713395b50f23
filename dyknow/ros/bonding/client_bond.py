# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The client's end of the bond that its claims hang on.

It only publishes heartbeats. A client learns from its leases what has become of the manager, and
goes on while that is away, so a manager that was killed finds its clients alive when it is back.
"""

from __future__ import annotations

import threading
import uuid
from typing import Any, Callable

import rospy
from bond.msg import Constants, Status

from dyknow import names
from dyknow.periodic import PeriodicWorker
from dyknow.ros.bonding.claim_bonds import TOPIC

_QUEUE_SIZE = 10
#: Seconds to wait, at the end, for a beat that is going out.
_CLOSE_PATIENCE = 1.0


class ClientBond(rospy.SubscribeListener):
    """Tells every new subscriber at once, and all of them once a second, that this process lives.

    Attributes:
        bond_id: what the bond is called.
    """

    def __init__(self, manager: str) -> None:
        """Begin the heartbeats for a manager of this global name."""
        self.bond_id = str(uuid.uuid4())
        self._instance_id = str(uuid.uuid4())
        self._closed = threading.Event()
        self._publisher: Any = rospy.Publisher(
            names.join(manager, TOPIC), Status, subscriber_listener=self, queue_size=_QUEUE_SIZE
        )
        self._worker = PeriodicWorker(
            "heartbeats of streams",
            lambda: self._say(active=True),
            float(Constants.DEFAULT_HEARTBEAT_PERIOD),
        )
        self._worker.start()

    def close(self) -> None:
        """End the heartbeats, and say so."""
        self._closed.set()
        self._worker.close(_CLOSE_PATIENCE)
        self._say(active=False)
        self._publisher.unregister()

    def peer_subscribe(
        self, topic_name: str, topic_publish: Any, peer_publish: Callable[[Status], None]
    ) -> None:
        """Send a heartbeat to a new subscriber, which misses us sooner once it heard one."""
        if not self._closed.is_set():
            peer_publish(self._status(active=True))

    def _say(self, active: bool) -> None:
        try:
            self._publisher.publish(self._status(active))
        except rospy.ROSException:
            return  # the node has shut down: silence says the same

    def _status(self, active: bool) -> Status:
        status = Status(
            id=self.bond_id,
            instance_id=self._instance_id,
            active=active,
            heartbeat_timeout=Constants.DEFAULT_HEARTBEAT_TIMEOUT,
            heartbeat_period=Constants.DEFAULT_HEARTBEAT_PERIOD,
        )
        status.header.stamp = rospy.Time.now()
        return status
