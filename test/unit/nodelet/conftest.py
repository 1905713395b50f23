# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The world of tests that make no other, and the patience of all."""

from __future__ import annotations

from typing import Iterator

import pytest
from clocks import PATIENCE, Gate
from unit.nodelet.fakes import World

from dyknow.nodelet.loading import loader


@pytest.fixture(autouse=True)
def patient_loader(monkeypatch: pytest.MonkeyPatch) -> None:
    """No loader gives up an ``on_shutdown`` because the machine is busy."""
    monkeypatch.setattr(loader, "SHUTDOWN_PATIENCE", PATIENCE)


@pytest.fixture
def world() -> World:
    return World()


@pytest.fixture
def gate() -> Iterator[Gate]:
    made = Gate()
    yield made
    made.open()
