# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Records of nodelets: their revision, their lifetimes, and the work that is under way on them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from clocks import HandClock

from dyknow.errors import Busy, NameTaken, UnknownNodelet
from dyknow.manager import graph as graph_module
from dyknow.manager.graph import Graph
from dyknow.manager.record import Record
from dyknow.manager.store import Store
from dyknow.model.graph import State

RUNNING = Record("/a", None, "/m", state=State.RUNNING, incarnation="1")
LOST = replace(RUNNING, state=State.LOST)


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def graph(clock: HandClock) -> Graph:
    return Graph(Store(), clock)


def test_no_revision_that_was_shown_comes_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(graph_module, "_BLOCK", 3)
    shown = []
    for _ in range(3):
        store = Store(str(tmp_path / "state"))
        graph = Graph(store)
        for number in range(5):
            shown.append(graph.revision)
            graph.put(replace(RUNNING, detail=str(number)))
        shown.append(graph.revision)
        store.close()
    assert shown == sorted(set(shown))


def test_what_does_not_change_a_record_is_no_change(graph: Graph) -> None:
    graph.put(RUNNING)
    revision, changes = graph.revision, []
    graph.on_change = lambda: changes.append("change")
    graph.put(replace(RUNNING))
    graph.remove("/b")
    assert (graph.revision, changes) == (revision, [])


def test_a_life_ends_when_it_is_lost_and_begins_when_it_comes_up(
    graph: Graph, clock: HandClock
) -> None:
    assert graph.lifetime("/a") == 0.0
    graph.put(RUNNING)
    clock.time += 5.0
    assert graph.lifetime("/a") == 5.0
    graph.put(LOST)
    clock.time += 100.0
    graph.put(replace(LOST, state=State.STARTING))
    assert graph.lifetime("/a") == 5.0, "the last life, while there is no other"
    graph.put(RUNNING)
    clock.time += 1.0
    assert graph.lifetime("/a") == 1.0
    graph.put(replace(RUNNING, detail="a change"))
    assert graph.lifetime("/a") == 1.0
    graph.put(replace(RUNNING, incarnation="2"))
    assert graph.lifetime("/a") == 0.0, "another process"


def test_a_name_is_busy_until_the_operation_ends(graph: Graph, clock: HandClock) -> None:
    with graph.changing("/a") as record:
        assert record is None
        assert graph.is_busy("/a")
        with pytest.raises(Busy), graph.changing("/a", patience=5.0):
            pass
        with pytest.raises(NameTaken), graph.changing("/a", new=True):
            pass
        with graph.changing("/b", new=True):
            pass
    assert clock.time == 5.0
    assert not graph.is_busy("/a")
    graph.put(RUNNING)
    with pytest.raises(NameTaken), graph.changing("/a", new=True):
        pass
    with graph.changing("/a") as record:
        assert record == RUNNING


def test_a_nodelet_that_is_being_made_is_awaited(graph: Graph, clock: HandClock) -> None:
    with pytest.raises(UnknownNodelet), graph.changing_present("/a"):
        pass
    assert clock.time == 0.0
    with graph.changing("/a", new=True):
        with pytest.raises(Busy), graph.changing_present("/a"):
            pass
        assert clock.time == 30.0
        graph.put(RUNNING)
        with pytest.raises(Busy), graph.changing_present("/a"):
            pass
        assert clock.time == 35.0
    with graph.changing_present("/a") as record:
        assert record == RUNNING
