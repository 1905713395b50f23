# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The services of the manager: a change is published before it is answered."""

from __future__ import annotations

from typing import Any

import pytest
import rospy
from dyknow_msgs import srv
from unit.cli.fake_client import FakeClient
from unit.manager.world import World

from dyknow.ros.manager.services import ManagerServices


def test_a_change_is_published_before_it_is_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    offered: dict[str, Any] = {}
    monkeypatch.setattr(rospy, "Service", lambda name, _, answer: offered.update({name: answer}))
    client, published = FakeClient(World()), []
    unused: Any = None

    def publish() -> None:
        published.append(client.core.graph_model().nodelets)

    ManagerServices(client.reconciler, unused, unused, lambda: None, publish)
    for name, request, states in (
        ("spawn", srv.SpawnRequest(label="camera", name="/cam"), [("/cam", False)]),
        ("set_protection", srv.SetProtectionRequest("/cam", True), [("/cam", True)]),
        ("destroy", srv.DestroyRequest("/cam"), [("/cam", True)]),  # refused
        ("set_protection", srv.SetProtectionRequest("/cam", False), [("/cam", False)]),
        ("destroy", srv.DestroyRequest("/cam"), []),
    ):
        offered[f"~{name}"](request)
        assert [(each.name, each.is_protected) for each in published.pop()] == states
