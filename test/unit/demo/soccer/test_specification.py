# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The example's specifications: true to the nodelets, and a plan for either camera."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Demand, Live, NoPlan
from dyknow.manager.specifications.ontologies.ontology import Ontology
from dyknow.manager.specifications.specification import parse_file
from dyknow.manager.specifications.tags import parse_tag

ROOT = Path(__file__).parents[4]
EXAMPLES = ROOT / "examples"
OWN = [
    "bottom_camera",
    "nao_body",
    "image_subsampler",
    "ball_detector",
    "localization",
]
RE_WIRED = ["ceiling_camera", *OWN[1:]]
CEILING = ["ceiling_camera", "image_subsampler", "field_ball_detector", "localization"]


@pytest.fixture(scope="module")
def ontology():
    return Ontology([str(EXAMPLES / "ontologies" / "soccer.ttl")])


@pytest.fixture(scope="module")
def transformations(ontology):
    file = str(EXAMPLES / "transformations" / "soccer.xml")
    return parse_file(file, ontology).transformations


@pytest.fixture
def plan(ontology, transformations):
    planner = Planner(ontology)
    planner.know(transformations)

    def plan(tag="FieldPosition(ball)", datatype="geometry_msgs/PointStamped", **kwds):
        return planner.plan(Demand(frozenset([parse_tag(tag)]), datatype), **kwds)

    return plan


def labels(plan):
    return [step.instance.label for step in plan.steps]


@pytest.mark.parametrize(
    ("gone", "steps", "cost"),
    [
        ("", OWN, 8),
        ("bottom_camera", RE_WIRED, 26),
        ("nao_body", CEILING, 27),
        ("ball_detector", CEILING, 27),
    ],
)
def test_the_robots_own_camera_comes_first_and_then_the_one_at_the_ceiling(
    plan, gone, steps, cost
):
    found = plan(exclude=frozenset([gone]))
    assert sorted(labels(found)) == sorted(steps)
    assert (found.goal.label, found.cost) == ("localization", cost)


def test_without_either_camera_it_says_what_is_missing(plan):
    answer = plan(exclude=frozenset(["bottom_camera", "ceiling_camera"]))
    assert isinstance(answer, NoPlan)
    assert "bottom_camera, ceiling_camera are excluded" in str(answer)
    assert "RawYUV(?camera: FieldCamera)" in str(answer)


def test_a_camera_that_runs_is_used(plan):
    live = [
        (
            Live(f"/cam/{port}", port, "/cam", "bottom_camera", datatype),
            (parse_tag(f"{functor}(bottom_camera)"),),
        )
        for port, functor, datatype in (
            ("image", "RawYUV", "sensor_msgs/Image"),
            ("camera_info", "Intrinsics", "sensor_msgs/CameraInfo"),
        )
    ]
    found = plan(live=live)
    assert sorted(labels(found)) == sorted(set(OWN) - {"bottom_camera"})
    assert {each.topic for each in found.live} == {"/cam/image", "/cam/camera_info"}


def test_images_never_meet_the_intrinsics_of_another_camera(plan):
    image = Live("/image", "image", "/one", "driver", "sensor_msgs/Image")
    info = Live("/camera_info", "camera_info", "/other", "driver", "sensor_msgs/CameraInfo")
    live = [
        (image, (parse_tag("RawYUV(bottom_camera)"),)),
        (info, (parse_tag("Intrinsics(ceiling_camera)"),)),
    ]
    cameras = frozenset(["bottom_camera", "ceiling_camera"])
    assert isinstance(plan(live=live, exclude=cameras), NoPlan)
    found = plan(live=live)
    assert (found.cost, found.live) == (8, (image,))
    inputs = {port: source for step in found.steps for port, source in step.inputs}
    assert inputs["yuv"] == image
    assert inputs["camera_info"].label == "bottom_camera"


def test_joint_states_of_the_robots_driver_are_used(plan):
    joints = Live("/nao/joint_states", "", "", "driver(nao)", "sensor_msgs/JointState")
    found = plan(live=[(joints, (parse_tag("JointStates(nao)"),))])
    detector = next(
        step for step in found.steps if step.instance.label.startswith("ball_detector")
    )
    assert dict(detector.inputs)["joint_states"] == joints


def test_a_relative_ball_is_an_object_of_whoever_asks(plan):
    datatype = "geometry_msgs/PoseWithCovarianceStamped"
    assert plan("WorldObject(?who)", datatype).goal.label == "ball_detector"
    assert plan("BallObject(ceiling_camera)", datatype).cost == 26


def test_sources_are_declared_nodelets(transformations):
    tree = ElementTree.parse(ROOT / "dyknow_demo" / "nodelets.xml")
    declared = {each.get("name") for each in tree.iter("class")}
    sources = {each.source for each in transformations if each.type == "nodelet"}
    assert sources <= declared
