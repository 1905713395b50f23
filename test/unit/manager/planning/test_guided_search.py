# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What guides the search for the cheapest tree: costs in the abstract, and useful names."""

from __future__ import annotations

import pytest
from unit.manager.planning.random_problems import random_problem

from dyknow.manager.planning import refinement
from dyknow.manager.planning.costs import Costs
from dyknow.manager.planning.domains import useful_names
from dyknow.manager.planning.instances import Instances
from dyknow.manager.planning.knuth import cheapest
from dyknow.manager.planning.live_streams import LiveStreams
from dyknow.manager.planning.network import Network
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import NO_FREE, NO_LABELS, Plan
from dyknow.manager.planning.reach import Scope
from dyknow.manager.planning.refinement import Refinement
from dyknow.manager.planning.supply import Demand
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.transformation import IN, OUT, Port, Transformation
from dyknow_benchmark.planning_libraries import individuals


def wanted(tag: str) -> Demand:
    return Demand(frozenset([parse_tag(tag)]))


def made(label: str, needs: str, supplied: str, cost: int = 1) -> Transformation:
    ports = [Port(f"in{k}", IN, "", (each,)) for k, each in enumerate(needs.split())]
    return Transformation(
        label, "dyknow/Relay", cost=cost, ports=(*ports, Port("out", OUT, "", (supplied,)))
    )


@pytest.mark.parametrize("small", [0, refinement.SMALL])
def test_a_guided_search_finds_trees_that_cost_as_little_as_without_guidance(
    small: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refinement, "SMALL", small)
    met = guided = 0
    for seed in range(600):
        problem = random_problem(seed)
        network = Network(problem.ontology)
        network.add(problem.library)
        streams = LiveStreams(network.names)
        for stream, terms in problem.live:
            if stream.label not in problem.exclude:
                streams.add(stream, terms)
        goal = network.goal(problem.goal)
        scope = Scope(network, goal, streams, problem.exclude)
        reach = scope.everything(False)
        plainly = cheapest(Instances(network, reach, Costs(network, NO_FREE)))
        _, trees = Refinement(scope, NO_FREE, {}).trees()
        assert trees.value.get(goal) == plainly.value.get(goal), seed
        met += goal in trees.value
        guided += not network.joined.isdisjoint(reach.serves)
    assert met > 200
    assert guided > 200


def test_a_demand_for_one_robot_does_not_combine_the_cameras_of_others() -> None:
    network = Network()
    network.add(individuals(2_000).transformations)
    goal = network.goal(wanted("Fused(robot5)"))
    scope = Scope(network, goal, LiveStreams(network.names), NO_LABELS)
    reach = scope.everything(False)
    raw = [each for each in reach.above if network.patterns[each].atoms[0].functor == "Raw"]
    assert max(len(network.found[demand]) for demand in raw) > 1_000
    names = useful_names(network, reach)
    cameras = {f"cam{number}" for number in range(5, 2_000, 200)}
    for demand in raw:
        for domain in names[demand]:
            assert domain is not None
            assert domain == {"robot5"} or domain <= cameras
    _, trees = Refinement(scope, NO_FREE, {}).trees()
    assert goal in trees.value
    assert max(len(list(scope.sources(demand, True))) for demand in raw) <= len(cameras)


def test_names_that_grow_along_a_chain_are_given_up() -> None:
    """Which of them are useful takes as many rounds as the chain is long."""
    count = 300
    library = [made(f"link{k}", "", f"Link(n{k}, n{k + 1})") for k in range(count)]
    library.append(made("start", "", "Near(n0)"))
    library.append(made("next", "Near(?x) Link(?x,?y)", "Near(?y)"))
    planner = Planner()
    planner.add(library)
    plan = planner.plan(wanted(f"Near(n{count})"), budget=0.0)
    assert isinstance(plan, Plan)
    assert plan.cost == 2 * count + 1
