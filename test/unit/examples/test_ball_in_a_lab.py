# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The ball in a lab, planned: templates over an ontology, and a kind of position."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Demand, Plan
from dyknow.manager.specifications.ontology import load_ontology
from dyknow.manager.specifications.specification import parse_file
from dyknow.manager.specifications.tags import parse_tag

LAB = Path(__file__).resolve().parents[3] / "examples" / "ball_in_a_lab"
FILES = ("tracker.xml", "robot_cameras.xml", "fixed_cameras.xml")


@pytest.fixture(scope="module")
def ontology():
    return load_ontology([str(LAB / "lab.ttl")])


def test_each_concept_makes_a_transformation_for_each_individual(ontology):
    found = {name: parse_file(str(LAB / name), ontology).transformations for name in FILES}
    labels = [[each.label for each in found[name]] for name in FILES]
    assert labels == [["tracker"], ["camera(robot_camera)"], ["camera(ceiling_camera)"]]
    (camera,) = found["robot_cameras.xml"]
    assert [each.text for each in camera.parameters] == ["robot_camera"]
    assert [port.tags for port in camera.ports] == [("Image(robot_camera)",)]


@pytest.mark.parametrize("name", FILES)
def test_nothing_is_doubtful(name, ontology):
    assert not parse_file(str(LAB / name), ontology).warnings


def test_a_robot_s_camera_is_preferred_and_the_ceiling_s_will_do(ontology):
    planner = Planner(ontology)
    for name in FILES:
        planner.add(parse_file(str(LAB / name), ontology).transformations)
    asked = parse_tag("Position(ball, ?camera)")
    demand = Demand(frozenset([asked]), "geometry_msgs/PointStamped")
    answer = planner.plan(demand)
    assert isinstance(answer, Plan)
    assert [step.action.label for step in answer.steps] == ["camera(robot_camera)", "tracker"]
    assert answer.bindings == (("?camera", "robot_camera"),)
    answer = planner.plan(demand, exclude=frozenset(["camera(robot_camera)"]))
    assert isinstance(answer, Plan)
    assert [step.action.label for step in answer.steps] == ["camera(ceiling_camera)", "tracker"]
