# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The robot's battery: a node's topic, which the story drains and charges."""

from __future__ import annotations

from typing import Any

import rospy
from sensor_msgs.msg import BatteryState

#: Seconds between two messages.
PERIOD = 0.1


class Battery:
    """Publishes the state of a battery until it is closed; its ``level`` is from 0 to 1."""

    def __init__(self, topic: str, level: float) -> None:
        """Publish on a topic, from a level that stays until ``head_for`` is called."""
        self.level = self._goal = level
        self._step = 0.0
        self._publisher = rospy.Publisher(topic, BatteryState, queue_size=10)
        self._timer = rospy.Timer(rospy.Duration(PERIOD), self._publish)

    def head_for(self, level: float, seconds: float) -> None:
        """Drain, or charge, to a level within some time."""
        self._goal, self._step = level, abs(level - self.level) * PERIOD / seconds

    def close(self) -> None:
        self._timer.shutdown()
        self._timer.join(1.0)  # it may be publishing; with simulated time it may sleep for ever
        self._publisher.unregister()

    def _publish(self, event: Any) -> None:
        left = self._goal - self.level
        self.level += max(-self._step, min(self._step, left))
        message = BatteryState(percentage=self.level)
        message.header.stamp = rospy.Time.now()
        self._publisher.publish(message)
