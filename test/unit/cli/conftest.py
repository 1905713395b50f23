# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Fixtures of the tests of commands, on a manager without ROS."""

from __future__ import annotations

import pytest
from unit.cli.fake_client import FakeClient
from unit.manager.world import World


@pytest.fixture(name="client")
def _client():
    return FakeClient(World())


@pytest.fixture(name="chain")
def _chain(client):
    """A camera and a relay behind it."""
    client.world.spawn("camera", "cam", config={"image": "raw"})
    client.world.spawn("relay", "/robot/relay", config={"in": "/raw"}, is_protected=True)
    return client


@pytest.fixture(name="pair")
def _pair(client):
    """A camera and a relay that are not connected."""
    client.world.spawn("camera", "cam")
    client.world.spawn("relay", "/robot/relay")
    return client
