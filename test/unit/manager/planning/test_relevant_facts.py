# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A search looks only at facts that the goal can use, in a library of any size, up to a limit."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Set

import pytest
from unit.manager.planning.examples import demand, make, planner_with

from dyknow.manager.planning import planner
from dyknow.manager.planning.and_or_graph import Reach
from dyknow.manager.planning.library import OperatorIndex, Reader
from dyknow.manager.planning.patterns import Names
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import NoPlan, Plan
from dyknow.manager.planning.request import Request
from dyknow.manager.planning.search import Search
from dyknow.manager.specifications.tags import NO_ONTOLOGY
from dyknow_benchmark.planning_libraries import PlanningLibrary, individuals, rooms

_MANY_STEPS = 10**9


def indexed(large: PlanningLibrary) -> OperatorIndex:
    names = Names(NO_ONTOLOGY)
    actions = [*map(Reader(names).read, large.transformations)]
    return OperatorIndex(names, {}, {}).changed(set(), actions)


def looked_at(index: OperatorIndex, tag: str) -> int:
    """Return how many actions and instances it took to plan."""
    request = Request(index, demand(tag), ())
    reach = Reach(request)
    search = Search(reach)
    left = search.run(_MANY_STEPS)
    assert search.goal.answers
    return reach.size + (_MANY_STEPS - left) // 200


@pytest.mark.parametrize("needs_power", [False, True])
def test_a_room_costs_as_much_among_many_rooms(needs_power: bool) -> None:
    few, many = (indexed(rooms(count, needs_power)) for count in (2_000, 10_000))
    for tag in ("Surveyed(room0)", "Joined(room0)"):
        assert looked_at(many, tag) <= 1.2 * looked_at(few, tag) < 2_000


def test_a_demand_for_one_robot_does_not_combine_the_cameras_of_others() -> None:
    assert looked_at(indexed(individuals(2_000)), "Fused(robot5)") < 1_000


def growing(count: int) -> Planner:
    """Make a planner whose names grow along a chain of links."""
    links = [make(f"link{k}", [], [f"Link(n{k}, n{k + 1})"]) for k in range(count)]
    links.append(make("start", [], ["Near(n0)"]))
    links.append(make("next", ["Near(?x)", "Link(?x,?y)"], ["Near(?y)"]))
    return planner_with(links)


def test_names_that_grow_along_a_chain() -> None:
    plan = growing(300).plan(demand("Near(n300)"), budget=0.0)
    assert isinstance(plan, Plan)
    assert plan.cost == 2 * 300 + 1


def test_a_search_that_reaches_its_limit_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner, "_SEARCH", 20_000)
    short = growing(300)
    answer = short.plan(demand("Near(n300)"), budget=0.0)
    assert isinstance(answer, NoPlan)
    assert answer.is_cut_short
    assert "the search reached its limit" in str(answer)
    assert not answer.missing and not answer.circular
    assert isinstance(short.plan(demand("Near(n2)"), budget=0.0), Plan)


def test_a_plan_sees_the_library_as_it_was_when_it_began() -> None:
    """While one thread exchanges all transformations at once, three threads plan."""
    versions = [
        [make("camera", [], ["Raw(a)"], cost), make("filter", ["Raw(?x)"], ["Goal(?x)"], cost)]
        for cost in (1, 10)
    ]
    planner = planner_with(versions[0])
    costs: Set[int] = set()
    is_over = threading.Event()

    def plan() -> None:
        while not is_over.is_set():
            answer = planner.plan(demand("Goal(?x)"))
            assert isinstance(answer, Plan)
            costs.add(answer.cost)
            assert planner.bindings(demand("Goal(?x)")) == ([(("?x", "a"),)], True)

    with ThreadPoolExecutor() as pool:
        threads = [pool.submit(plan) for _ in range(3)]
        changes = 0
        try:
            while not any(each.done() for each in threads) and (changes < 200 or len(costs) < 2):
                changes += 1
                planner.know(versions[changes % 2])
        finally:
            is_over.set()
    assert [each.exception() for each in threads] == [None] * 3
    assert costs == {2, 20}
