"""The client's end of the bond that its claims hang on.

It only speaks: a client learns from its leases what has become of the manager, and goes on
speaking while that is away. So a manager that was killed finds its clients alive when it is back.
"""

from __future__ import annotations

import threading
import uuid
from typing import Any

import rospy
from bond.msg import Constants, Status

from dyknow import names
from dyknow.ros.claim_bonds import TOPIC

_QUEUE_SIZE = 10


class Heart:
    """Says once a second that this process is alive, until it is closed.

    Attributes:
        bond_id: what the bond is called.
    """

    def __init__(self, manager: str) -> None:
        """Begin to beat for a manager, whose global name this is."""
        self.bond_id = str(uuid.uuid4())
        self._instance_id = str(uuid.uuid4())
        self._publisher: Any = rospy.Publisher(
            names.join(manager, TOPIC), Status, queue_size=_QUEUE_SIZE
        )
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="stream heart", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Say that it is over, and beat no more."""
        self._closed.set()
        self._thread.join()
        self._say(active=False)
        self._publisher.unregister()

    def _run(self) -> None:
        while not self._closed.wait(Constants.DEFAULT_HEARTBEAT_PERIOD):
            self._say(active=True)

    def _say(self, active: bool) -> None:
        status = Status(
            id=self.bond_id,
            instance_id=self._instance_id,
            active=active,
            heartbeat_timeout=Constants.DEFAULT_HEARTBEAT_TIMEOUT,
            heartbeat_period=Constants.DEFAULT_HEARTBEAT_PERIOD,
        )
        status.header.stamp = rospy.Time.now()
        try:
            self._publisher.publish(status)
        except rospy.ROSException:
            return  # the node has shut down: silence says the same
