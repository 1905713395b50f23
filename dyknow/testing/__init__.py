# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Tests of your own nodelets: fast and deterministic without a ROS master, or in the real thing.

``NodeletHarness`` runs nodelets in the test's own process, without a ROS master, on time that
stands still until the test advances it. ``RosHarness`` runs them in a nodelet manager of their
own process, with a ROS master that belongs to the tests. Both have the same methods to load a
nodelet, connect its ports, publish and listen.

``dyknow.testing.fixtures`` has both as pytest fixtures; ``NodeletTestCase`` and ``RosTestCase``
are their counterparts for unittest.
"""

from dyknow.testing.harness import CallbackFailed, NodeletHarness, NodeletTestCase
from dyknow.testing.middleware import LogEntry
from dyknow.testing.ros_harness import RosHarness, RosTestCase

__all__ = [
    "CallbackFailed",
    "LogEntry",
    "NodeletHarness",
    "NodeletTestCase",
    "RosHarness",
    "RosTestCase",
]
