# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Refusals name causes that hold: each is checked against all instances, and by examples."""

from __future__ import annotations

import random
import re
from typing import Set

import pytest
from unit.manager.planning.brute_force import supplied, supplies
from unit.manager.planning.examples import demand, make, planner_with
from unit.manager.planning.random_problems import look_up_by_name, random_problem, with_limits
from unit.manager.witness import Concepts

from dyknow.manager.planning.explanation import as_tree
from dyknow.manager.planning.problem import Live, NoPlan
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.transformation import Transformation


def named(cause: str) -> Set[str]:
    """Return the labels that are named as excluded."""
    listed = cause.rpartition(" is ")[0] or cause.rpartition(" are ")[0]
    return {*re.sub(r" and \d+ more$", "", listed).split(", ")}


def test_refusals_of_random_problems_state_no_falsehood(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = excluded = typed = of_datatypes = slow = 0
    for seed in range(1_500):
        look_up_by_name(monkeypatch, seed)
        problem = with_limits(random_problem(seed), seed)
        labels = [each.label for each in problem.library]
        excluded_too = random.Random(seed).sample(labels, len(labels) // 3)
        problem = problem._replace(
            exclude=problem.exclude | {*excluded_too}, goal=problem.goal._replace(max_age=0.0)
        )
        planner = planner_with(problem.library, problem.ontology)
        answer = planner.plan(problem.goal, problem.live, problem.exclude)
        if not isinstance(answer, NoPlan):
            continue
        assert answer.missing or answer.obstacles or answer.circular, seed
        streams = supplied(problem._replace(exclude=frozenset()))
        for wanted in answer.missing:
            missing += 1
            assert not supplies(streams, wanted, problem), (seed, str(wanted))
        for wanted, causes in answer.obstacles:
            usable = [each for each in streams if each.label not in problem.exclude]
            # Types of variables that have names are not written.
            of_types = ("has to be", ", not a", "not known")
            is_written = not any(said in cause for said in of_types for cause in causes)
            assert not (is_written and supplies(usable, wanted, problem)), (seed, str(wanted))
            fast = [each for each in streams if not 0 < each.rate < wanted.min_rate]
            for cause in causes:
                if "excluded" in cause:
                    excluded += 1
                    assert named(cause) <= problem.exclude, (seed, cause)
                elif "Hz" in cause:
                    slow += 1
                    assert not supplies(fast, wanted, problem), (seed, cause)
                elif "has to be" in cause:
                    assert " and a " in cause
                elif "it is a " in cause:
                    of_datatypes += 1
                    assert wanted.datatype not in ("", "*")
                else:
                    typed += 1
                    for said in cause.split("; "):
                        name, _, kinds = said.partition(" is ")
                        for kind in kinds.rpartition(" a ")[2].split(" and "):
                            assert kind not in problem.ontology.names_above(name), (seed, cause)
            if len(causes) == 1 and "excluded" in causes[0]:
                # One with in-ports would supply it for an individual that may not exist.
                those = [each for each in problem.library if each.label in named(causes[0])]
                is_needy = any(port.direction == "in" for each in those for port in each.ports)
                assert is_needy or supplies(streams, wanted, problem), (seed, causes)
    assert min(missing, excluded, typed, of_datatypes, slow) > 10


CAMERAS = Concepts({"nose": "RobotCamera", "RobotCamera": "Camera"})


def refused(tag: str, *transformations: Transformation, **kwds) -> str:  # type: ignore[no-untyped-def]
    limits = {each: kwds.pop(each) for each in ("datatype", "min_rate") if each in kwds}
    answer = planner_with(transformations, CAMERAS).plan(demand(tag, **limits), **kwds)
    assert isinstance(answer, NoPlan)
    assert all(str(each) in as_tree(answer) for each in answer.obstacles)
    return str(answer).partition(": ")[2]


def test_an_individual_of_another_type_is_named_with_its_own() -> None:
    detector = make("detector", ["Image(?c: FieldCamera)"], ["Ball(?c)"])
    why = "cannot be used: nose is a RobotCamera, not a FieldCamera"
    camera = make("camera", [], ["Image(nose)"])
    assert refused("Ball(nose)", camera, detector) == f"Image(nose) {why}"
    assert refused("Ball(?which)", camera, detector) == f"Image(?c: FieldCamera) {why}"
    unknown = refused("Ball(ear)", make("camera", [], ["Image(ear)"]), detector)
    assert unknown == "Image(ear) cannot be used: ear is not known to be a FieldCamera"
    assert refused("Ball(ear)", camera, detector) == "nothing supplies Image(ear)"


def test_what_must_not_be_used_is_named() -> None:
    camera = make("camera", [], ["Image(nose)"])
    excluded = refused("Image(nose)", camera, exclude=frozenset(("camera",)))
    assert excluded == "Image(nose) cannot be used: camera is excluded"
    paused = refused("Image(nose)", camera, paused=frozenset(("camera",)))
    assert paused == "Image(nose) cannot be used: no new nodelet of camera is made now"
    stream = Live("/image", "out", "/camera_1", "camera", "")
    live = [(stream, (parse_tag("Image(nose)"),))]
    excluded = refused("Image(nose)", live=live, exclude=frozenset(("camera",)))
    assert excluded == "Image(nose) cannot be used: camera is excluded"


def test_a_rate_and_a_ros_type_are_named() -> None:
    camera = make("camera", [], ["Image(nose)"], datatype="t/One", rate=5.0)
    slow = refused("Image(nose)", camera, min_rate=10.0)
    assert slow == (
        "Image(nose) [at least 10 Hz] cannot be used: it is stated at 5 Hz, below 10 Hz"
    )
    other = refused("Image(nose)", camera, datatype="t/Two")
    assert other == "Image(nose) [t/Two] cannot be used: it is a t/One, not a t/Two"


def test_what_is_missing_comes_before_what_cannot_be_used() -> None:
    detector = make("detector", ["Image(?c: FieldCamera)", "Lamps"], ["Ball(?c)"])
    text = refused("Ball(nose)", make("camera", [], ["Image(nose)"]), detector)
    why = "Image(nose) cannot be used: nose is a RobotCamera, not a FieldCamera"
    assert text == f"nothing supplies Lamps; {why}"
    lamps = make("lamps", ["Power"], ["Lamps"])
    text = refused("Ball(nose)", make("camera", [], ["Image(nose)"]), detector, lamps)
    assert text == f"nothing supplies Power; {why}"
