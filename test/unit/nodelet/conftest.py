# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The world of tests that make no other."""

from __future__ import annotations

import pytest
from unit.nodelet.fakes import World


@pytest.fixture
def world() -> World:
    return World()
