# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The bench of tests that make no other."""

from __future__ import annotations

import pytest
from unit.proxy.bench import Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()
