# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The ontology of a workshop means what the page on templates says."""

from __future__ import annotations

from pathlib import Path

from dyknow.manager.specifications.ontology import load_ontology

WORKSHOP = Path(__file__).resolve().parents[3] / "examples" / "ontologies" / "workshop.ttl"
URI = "http://dyknow.example.org/workshop#"


def test_expressions_imports_and_labels():
    found = load_ontology([str(WORKSHOP)])

    assert found.warnings == ()
    assert found.individuals(URI + "RobotCamera") == ("gripper camera",)
    assert found.individuals(URI + "Observer") == ("ceiling camera", "gripper camera")
    assert found.individuals(URI + "Bench") == ("bench_1", "bench_2")
    assert found.is_subsumed("RobotCamera", "Camera")
    assert found.is_subsumed("RobotCamera", "Observer")
    assert not found.is_subsumed("Camera", "RobotCamera")
    assert found.canonical("Greiferkamera") == found.canonical("gripper camera")
    assert found.canonical("gripper camera") == URI + "gripper_camera"


def test_labels_in_another_language():
    found = load_ontology([str(WORKSHOP)], language="de")

    assert found.individuals(URI + "Observer") == ("Deckenkamera", "Greiferkamera")
