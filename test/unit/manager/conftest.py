# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Fixtures of most tests of the manager; its state is in a file, so that it can be killed."""

from __future__ import annotations

from logging import Logger
from pathlib import Path
from typing import Callable, Iterator
from unittest import mock

import pytest
from unit.manager.field import Field
from unit.manager.world import World

from dyknow.errors import DyKnowError


@pytest.fixture(autouse=True)
def defects_are_raised() -> Iterator[None]:
    """A defect that rounds of the reconciler would only log is raised, so no test misses it."""

    def attempt(what: str, work: Callable[[], object], logger: Logger) -> None:
        try:
            work()
        except DyKnowError as error:
            logger.warning("%s: %s", what, error)

    with mock.patch("dyknow.manager.claims.reconciler.attempt", attempt):
        yield


@pytest.fixture
def field(tmp_path: Path) -> Field:
    return Field(str(tmp_path / "state.db"))


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(str(tmp_path / "state.db"))
