# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Sections without a collection of garbage, and the work that is done in them."""

from __future__ import annotations

import gc
import threading
from pathlib import Path
from typing import Any, FrozenSet, Iterator

import pytest
from clocks import in_thread, join
from unit.manager.planning.examples import demand, make

from dyknow.garbage import enabling, without_collection
from dyknow.manager.library import Library
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Plan, TaggedStream
from dyknow.manager.store import Store
from dyknow.periodic import current_frames
from dyknow_benchmark.planning_libraries import Things


@pytest.fixture(autouse=True)
def enabled() -> Iterator[None]:
    assert gc.isenabled()
    yield
    gc.enable()


def test_the_collector_has_its_turn_when_the_first_of_several_sections_ends() -> None:
    first, second = without_collection(), without_collection()
    first.__enter__()
    second.__enter__()
    assert not gc.isenabled()
    first.__exit__(None, None, None)
    assert gc.isenabled()
    second.__exit__(None, None, None)
    assert gc.isenabled()


def test_a_section_does_not_end_while_the_collector_must_be_off() -> None:
    section, ended = without_collection(), threading.Event()
    section.__enter__()

    def end() -> None:
        section.__exit__(None, None, None)
        ended.set()

    with enabling:
        thread = in_thread(end)
        assert not ended.wait(0.05)
        assert not gc.isenabled()
    join(thread)
    assert gc.isenabled()


def test_frames_are_looked_at_in_a_section() -> None:
    with without_collection():
        assert current_frames()
        assert not gc.isenabled()
    assert current_frames()
    assert gc.isenabled()


def test_an_error_ends_a_section() -> None:
    with pytest.raises(ValueError), without_collection():
        raise ValueError
    assert gc.isenabled()


def test_a_program_that_has_disabled_it_finds_it_so() -> None:
    gc.disable()
    with without_collection():
        assert not gc.isenabled()
    assert not gc.isenabled()


def test_plans_are_made_without_a_collection() -> None:
    states = []

    class Watched(Things):
        def names_above(self, name: str) -> FrozenSet[str]:
            states.append(gc.isenabled())
            return super().names_above(name)

    def streams() -> Iterator[TaggedStream]:
        states.append(gc.isenabled())
        yield from ()

    planner = Planner(Watched())
    planner.add([make("camera", [], ["Image(a)"]), make("filter", ["Image(a)"], ["Image(b)"])])
    added = len(states)
    assert isinstance(planner.plan(demand("Image(b)"), streams()), Plan)
    assert planner.bindings(demand("Image(?x)"), streams()) == (
        [(("?x", "a"),), (("?x", "b"),)],
        True,
    )
    assert len(planner.parts(demand("Image(b)"), streams())) == 2
    assert len(states) >= added + 3 and added > 0 and not any(states)
    assert gc.isenabled()


def test_a_library_is_read_without_a_collection(tmp_path: Path) -> None:
    states = []

    class Watched(Store):
        def read(self, *arguments: Any) -> Any:
            states.append(gc.isenabled())
            return super().read(*arguments)

    library = Library(Watched(str(tmp_path / "state.db")))
    text = make("camera", [], ["Image(a)"]).to_xml()
    library.add(text, check=lambda transformations: states.append(gc.isenabled()))
    assert len(states) > 1 and not any(states)
    assert gc.isenabled()
