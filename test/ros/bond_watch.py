# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What tests hear of the bonds of other nodes."""

from __future__ import annotations

import collections

import rospy
from bond.msg import Status
from processes import eventually


def let_the_bond_form(topic: str) -> None:
    """Wait until both ends of a topic's only bond have sent two messages.

    Then each has heard the other, and learns of its end at once. One that was not connected yet
    would not hear the other part, and wait for the connect timeout.
    """
    heard: collections.Counter[str] = collections.Counter()
    watch = rospy.Subscriber(topic, Status, lambda status: heard.update([status.instance_id]))
    eventually(
        lambda: len(heard) == 2 and min(heard.values()) >= 2,
        8.0,
        f"both ends are heard on {topic}",
        lambda: heard,
    )
    watch.unregister()
