# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Which names a new process may take."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, Iterator

import pytest
from unit.ros.small_graph import SmallManager, SmallMaster, small_graph

from dyknow.ros.hosting import launcher
from dyknow.ros.hosting.launcher import Launcher
from dyknow.ros.wire.master import Master

NAME = "/dyknow_nodelet_manager"


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[SmallMaster]:
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    monkeypatch.setattr(launcher, "_ANSWER_TIMEOUT", 0.2)
    with small_graph() as graph:
        yield graph


@pytest.fixture
def made(graph: SmallMaster) -> Launcher:
    owner: Any = SimpleNamespace(path="")
    return Launcher(Master("/manager", graph.uri), owner, 0.0, {})


def test_a_name_that_nobody_bears_is_free(made: Launcher) -> None:
    assert made.is_free(NAME)


def test_a_name_that_a_living_node_bears_is_not_free(graph: SmallMaster, made: Launcher) -> None:
    graph.nodes[NAME] = SmallManager()
    assert not made.is_free(NAME)


def test_the_name_of_a_dead_node_is_free(graph: SmallMaster, made: Launcher) -> None:
    graph.nodes[NAME] = dead = SmallManager()
    dead.close()
    assert made.is_free(NAME)
    del graph.nodes[NAME]


def test_the_name_of_a_node_that_does_not_answer_is_not_free(
    graph: SmallMaster, made: Launcher
) -> None:
    """It may run on a host that is cut off, and would be told to end when that is back."""
    graph.nodes[NAME] = away = SmallManager()
    away.goes_on.clear()
    assert not made.is_free(NAME)
    away.goes_on.set()
