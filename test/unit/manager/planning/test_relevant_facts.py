# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What a search looks at: what the goal can use, however large the library is, up to a limit."""

from __future__ import annotations

import threading
from typing import List

import pytest

from dyknow.manager.planning import planner
from dyknow.manager.planning.library import OperatorIndex, Reader
from dyknow.manager.planning.patterns import Names
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Demand, NoPlan, Plan
from dyknow.manager.planning.reach import Reach
from dyknow.manager.planning.request import Request
from dyknow.manager.planning.search import Search
from dyknow.manager.specifications.tags import NO_ONTOLOGY, parse_tag
from dyknow.model.transformation import IN, OUT, Port, Transformation
from dyknow_benchmark.planning_libraries import PlanningLibrary, individuals, rooms

_MANY_STEPS = 10**9


def wanted(tag: str) -> Demand:
    return Demand(frozenset([parse_tag(tag)]))


def made(label: str, needs: str, supplied: str, cost: int = 1) -> Transformation:
    ports = [Port(f"in{k}", IN, "", (each,)) for k, each in enumerate(needs.split())]
    return Transformation(
        label, "dyknow/Relay", cost=cost, ports=(*ports, Port("out", OUT, "", (supplied,)))
    )


def indexed(large: PlanningLibrary) -> OperatorIndex:
    names = Names(NO_ONTOLOGY)
    actions = Reader(names).read(large.transformations)
    return OperatorIndex(names, {}, {}, {}).changed(set(), actions)


def looked_at(index: OperatorIndex, tag: str) -> int:
    """Return how many actions and instances it took to plan."""
    request = Request(index, wanted(tag), ())
    reach = Reach(request)
    search = Search(request, reach, reach.cheapest(reach.costs, use_sum=True)[0])
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


def test_names_that_grow_along_a_chain() -> None:
    count = 300
    links = [made(f"link{k}", "", f"Link(n{k}, n{k + 1})") for k in range(count)]
    links.append(made("start", "", "Near(n0)"))
    links.append(made("next", "Near(?x) Link(?x,?y)", "Near(?y)"))
    planner = Planner()
    planner.add(links)
    plan = planner.plan(wanted(f"Near(n{count})"), budget=0.0)
    assert isinstance(plan, Plan)
    assert plan.cost == 2 * count + 1


def test_a_search_that_reaches_its_limit_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planner, "_SEARCH", 20_000)
    links = [made(f"link{k}", "", f"Link(n{k}, n{k + 1})") for k in range(300)]
    links.append(made("start", "", "Near(n0)"))
    links.append(made("next", "Near(?x) Link(?x,?y)", "Near(?y)"))
    short = Planner()
    short.add(links)
    answer = short.plan(wanted("Near(n300)"), budget=0.0)
    assert isinstance(answer, NoPlan)
    assert answer.is_cut_short
    assert "the search reached its limit" in str(answer)
    assert not answer.missing and not answer.circular
    assert isinstance(short.plan(wanted("Near(n2)"), budget=0.0), Plan)


def test_a_plan_sees_the_library_as_it_was_when_it_began() -> None:
    """While one thread exchanges all transformations at once, others plan."""
    versions = [
        [made("camera", "", "Raw(a)", cost), made("filter", "Raw(?x)", "Goal(?x)", cost)]
        for cost in (1, 10)
    ]
    planner = Planner()
    planner.add(versions[0])
    costs: List[int] = []
    errors: List[BaseException] = []
    is_over = threading.Event()

    def plan() -> None:
        try:
            while not is_over.is_set():
                answer = planner.plan(wanted("Goal(?x)"))
                assert isinstance(answer, Plan)
                costs.append(answer.cost)
                assert planner.bindings(wanted("Goal(?x)")) == ([(("?x", "a"),)], True)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=plan) for _ in range(3)]
    for each in threads:
        each.start()
    changes = 0
    while changes < 200 or {2, 20} - {*costs}:
        changes += 1
        planner.add(versions[changes % 2])
        if errors:
            break
    is_over.set()
    for each in threads:
        each.join()
    assert not errors
    assert {*costs} == {2, 20}
