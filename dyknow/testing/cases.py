# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Test cases for unittest."""

from __future__ import annotations

import unittest

from dyknow.testing.harness import NodeletHarness
from dyknow.testing.ros_harness import RosHarness


class NodeletTestCase(unittest.TestCase):
    """Each test has a ``NodeletHarness``, ``self.harness``."""

    def setUp(self) -> None:
        """Make the harness."""
        self.harness = NodeletHarness()
        self.addCleanup(self.harness.close)


class RosTestCase(unittest.TestCase):
    """Each test has a ``RosHarness``, ``self.harness``."""

    def setUp(self) -> None:
        """Start the nodelet manager."""
        self.harness = RosHarness()
        self.addCleanup(self.harness.close)
