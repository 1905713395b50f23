# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The harnesses as fixtures of pytest; a conftest.py imports them."""

from __future__ import annotations

from typing import Iterator

import pytest

from dyknow.testing.harness import NodeletHarness
from dyknow.testing.ros_harness import RosHarness


@pytest.fixture
def nodelet_harness() -> Iterator[NodeletHarness]:
    """Nodelets in this process, without a ROS master."""
    with NodeletHarness() as harness:
        yield harness


@pytest.fixture
def ros_harness() -> Iterator[RosHarness]:
    """Nodelets in a nodelet manager, with a ROS master of the tests."""
    with RosHarness() as harness:
        yield harness
