# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What most tests of the manager begin with; its state is in a file, so that it can be killed."""

from __future__ import annotations

from pathlib import Path

import pytest
from unit.manager.field import Field
from unit.manager.world import World


@pytest.fixture
def field(tmp_path: Path) -> Field:
    return Field(str(tmp_path / "state.db"))


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(str(tmp_path / "state.db"))
