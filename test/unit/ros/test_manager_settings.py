# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a DyKnow manager makes of its parameters."""

from __future__ import annotations

import os
from pathlib import Path

import rospy

from dyknow.ros.manager import manager_settings
from dyknow.ros.manager.manager_settings import ManagerSettings


def test_a_manager_makes_its_state_dir_absolute(tmp_path, monkeypatch):
    """Which is then the same for those that read the parameter in another folder."""
    stored = {"~state_dir": "state"}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(rospy, "get_name", lambda: "/dyknow_manager")
    monkeypatch.setattr(rospy, "get_param", lambda name, default: stored.get(name, default))
    monkeypatch.setattr(rospy, "set_param", stored.__setitem__)
    settings = ManagerSettings.read()
    assert settings.state_dir == stored["~state_dir"] == str(tmp_path / "state")
    monkeypatch.chdir("/")
    assert ManagerSettings.read() == settings
    assert Path(manager_settings.mirror_path()).parent == tmp_path / "state"
    stored["~state_dir"] = ""
    assert ManagerSettings.read().state_dir == stored["~state_dir"] == ""
    stored["~state_dir"] = "~/state"
    assert (
        ManagerSettings.read().state_dir == stored["~state_dir"] == os.path.expanduser("~/state")
    )
