# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Sections without a collection of garbage, and the work that is done in them."""

from __future__ import annotations

import gc
import sys
from pathlib import Path
from typing import Any, Dict, FrozenSet, Iterator

import pytest
from unit.manager.planning.examples import demand, make

from dyknow.garbage import without_collection
from dyknow.manager.library import Library
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Plan, TaggedStream
from dyknow.manager.store import Store
from dyknow.periodic import current_frames
from dyknow_benchmark.planning_libraries import Things


def is_on() -> bool:
    """Whether Python collects garbage by itself."""
    return gc.isenabled() and gc.get_threshold()[0] > 0


@pytest.fixture(autouse=True)
def on() -> Iterator[None]:
    before = gc.get_threshold()
    assert is_on()
    yield
    gc.enable()
    gc.set_threshold(*before)


def test_the_collector_has_its_turn_when_the_first_of_several_sections_ends() -> None:
    first, second = without_collection(), without_collection()
    first.__enter__()
    second.__enter__()
    assert not is_on()
    first.__exit__(None, None, None)
    assert is_on()
    second.__exit__(None, None, None)
    assert is_on()


def test_frames_are_looked_at_in_a_section_that_ends_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    section = without_collection()
    section.__enter__()

    def frames() -> Dict[int, bool]:
        section.__exit__(None, None, None)
        return {1: gc.isenabled()}

    monkeypatch.setattr(sys, "_current_frames", frames)
    assert current_frames() == {1: False}
    assert is_on()


def test_an_error_ends_a_section() -> None:
    with pytest.raises(ValueError), without_collection():
        raise ValueError
    assert is_on()


def test_what_a_program_has_switched_off_stays_so() -> None:
    with without_collection():
        gc.disable()
    assert not gc.isenabled()
    gc.enable()
    gc.set_threshold(0)
    with without_collection():
        assert not is_on()
    assert not is_on()


def test_plans_are_made_without_a_collection() -> None:
    states = []

    class Watched(Things):
        def names_above(self, name: str) -> FrozenSet[str]:
            states.append(is_on())
            return super().names_above(name)

    def streams() -> Iterator[TaggedStream]:
        states.append(is_on())
        yield from ()

    planner = Planner(Watched())
    planner.know([make("camera", [], ["Image(a)"]), make("filter", ["Image(a)"], ["Image(b)"])])
    added = len(states)
    assert isinstance(planner.plan(demand("Image(b)"), streams()), Plan)
    assert planner.bindings(demand("Image(?x)"), streams()) == (
        [(("?x", "a"),), (("?x", "b"),)],
        True,
    )
    assert len(planner.parts(demand("Image(b)"), streams())) == 2
    assert len(states) >= added + 3 and added > 0 and not any(states)
    assert is_on()


def test_a_library_is_read_without_a_collection(tmp_path: Path) -> None:
    states = []

    class Watched(Store):
        def read(self, *arguments: Any) -> Any:
            states.append(is_on())
            return super().read(*arguments)

    library = Library(Watched(str(tmp_path / "state.db")))
    text = make("camera", [], ["Image(a)"]).to_xml()
    library.add(text, check=lambda transformations: states.append(is_on()))
    assert len(states) > 1 and not any(states)
    assert is_on()
