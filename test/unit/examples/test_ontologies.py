# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The ontologies agree with the page on templates, and the files that use them are clean."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow.manager.specifications.ontologies.ontology import Ontology
from dyknow.manager.specifications.specification import parse_file

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
WORKSHOP = EXAMPLES / "ontologies" / "workshop.ttl"
URI = "http://dyknow.example.org/workshop#"


def test_expressions_imports_and_labels():
    found = Ontology([str(WORKSHOP)])
    assert found.warnings == ()
    assert found.individuals(URI + "RobotCamera") == ("gripper camera",)
    assert found.individuals(URI + "Observer") == ("ceiling camera", "gripper camera")
    assert found.individuals(URI + "Bench") == ("bench_1", "bench_2")
    assert "Camera" in found.names_above("RobotCamera")
    assert "Observer" in found.names_above("RobotCamera")
    assert "RobotCamera" not in found.names_above("Camera")
    assert found.canonical("Greiferkamera") == found.canonical("gripper camera")
    assert found.canonical("gripper camera") == URI + "gripper_camera"
    german = Ontology([str(WORKSHOP)], language="de")
    assert german.individuals(URI + "Observer") == ("Deckenkamera", "Greiferkamera")


@pytest.mark.parametrize(
    ("ontology", "file", "count"),
    [
        ("ontologies/soccer.ttl", "transformations/soccer.xml", 10),
        ("ball_in_a_lab/lab.ttl", "ball_in_a_lab/tracker.xml", 1),
        ("ball_in_a_lab/lab.ttl", "ball_in_a_lab/robot_cameras.xml", 1),
        ("ball_in_a_lab/lab.ttl", "ball_in_a_lab/fixed_cameras.xml", 1),
    ],
)
def test_nothing_is_doubtful(ontology, file, count):
    found = parse_file(str(EXAMPLES / file), Ontology([str(EXAMPLES / ontology)]))
    assert (found.warnings, len(found.transformations)) == ((), count)
