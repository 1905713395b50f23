# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Plans and refusals, explained.

Refusals name causes that hold: each is checked against all instances, and by examples.
"""

from __future__ import annotations

import random
import re
import shutil
import subprocess
from typing import Sequence, Set

import pytest
from unit.manager.field import GOAL, Field
from unit.manager.planning.brute_force import supplied, supplies
from unit.manager.planning.examples import demand, make, planner_with
from unit.manager.planning.random_problems import look_up_by_name, random_problem, with_limits
from unit.manager.witness import Concepts

from dyknow.manager.planning.explanation import Entry, as_tree, read_tree, tree_as_dot
from dyknow.manager.planning.problem import Instance, Live, New, NoPlan, Plan, PlanStep, Verdicts
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.streams import StreamRequest
from dyknow.model.transformation import Requirement, Transformation


@pytest.fixture
def plan() -> Plan:
    field = Field()
    field.spawn("subsampler", "/mine", config={"yuv": "/a", "planes": "/b"})
    answer = field.reconciler.acquire(StreamRequest(GOAL), dry_run=True)
    assert answer.plan is not None
    return answer.plan


def test_a_plan_is_a_tree_that_a_person_can_read(plan: Plan) -> None:
    assert as_tree(plan) == (
        "FieldPosition(ball): cost 4 (proven least)\n"
        "└─ localization.position (new, cost 1)\n"
        "   └─ ball ← detector.ball [?robot=nao] (new, cost 1)\n"
        "      ├─ planes ← subsampler.planes [?where=field] (new, cost 1)\n"
        "      │  └─ yuv ← bottom camera.image (new, cost 1)\n"
        "      └─ joints ← /joint_states (topic)"
    )


def test_shared_parts_are_told_once_and_depth_does_not_matter() -> None:
    depth = 300
    steps = [PlanStep(Instance("level 0"), (), 1)]
    for level in range(1, depth):
        below = New(Instance(f"level {level - 1}"), "out")
        inputs = (("left", below), ("right", below))
        steps.append(PlanStep(Instance(f"level {level}"), inputs, 1))
    diamonds = Plan(demand("X"), New(Instance(f"level {depth - 1}"), "out"), tuple(steps))
    text = as_tree(diamonds)
    assert len(text.split("\n")) == 2 * depth
    assert text.count("shared, see above") == depth - 1
    assert text.count("(new, cost 1)") == depth
    assert tree_as_dot(text).count(" -> ") == 2 * depth - 1


def test_without_a_plan_the_missing_tags_are_named() -> None:
    missing = NoPlan(demand("A"), (demand("B(x)", datatype="pkg/T"), demand("C")), False)
    assert as_tree(missing) == (
        "A: no plan\n├─ nothing supplies B(x) [pkg/T]\n└─ nothing supplies C"
    )
    assert "everything that supplies it needs it first" in as_tree(NoPlan(demand("A"), (), True))


def test_a_tree_can_be_read_back(plan: Plan) -> None:
    title, entries = read_tree(as_tree(plan))
    assert title == "FieldPosition(ball): cost 4 (proven least)"
    assert entries[3:] == [
        Entry(3, "yuv", "bottom camera.image", "new, cost 1"),
        Entry(2, "joints", "/joint_states", "topic"),
    ]
    with pytest.raises(ValueError, match="not a line of a plan: 'nonsense'"):
        read_tree("title\nnonsense")


def test_a_drawing_is_one_that_graphviz_understands(plan: Plan) -> None:
    drawing = tree_as_dot(as_tree(plan))
    assert (
        '"bottom camera" -> "subsampler [?where=field]" [taillabel="image", headlabel="yuv"];'
        in drawing
    )
    assert '"/joint_states" [shape=box, style=solid' in drawing
    assert '"localization" -> "FieldPosition(ball): cost 4 (proven least)"' in drawing
    if shutil.which("dot"):
        done = subprocess.run(
            ["dot", "-Tplain"], input=drawing.encode(), capture_output=True, timeout=60
        )
        assert (done.returncode, done.stderr) == (0, b"")


def test_instances_of_one_transformation_are_told_apart() -> None:
    def camera(name: str) -> PlanStep:
        return PlanStep(Instance("camera", (("?c", name),)), (), 5)

    inputs = tuple(
        (port, New(Instance("camera", (("?c", name),)), "image"))
        for port, name in (("l", "cam1"), ("r", "cam2"))
    )
    stereo = PlanStep(Instance("stereo", (("?a", "cam1"), ("?b", "cam2"))), inputs, 1)
    goal = New(stereo.instance, "depth")
    answer = Plan(demand("X"), goal, (camera("cam1"), camera("cam2"), stereo), 10)
    text = as_tree(answer)
    assert text == (
        "X: cost 11 (at most 10 % above the least possible)\n"
        "└─ stereo.depth [?a=cam1, ?b=cam2] (new, cost 1)\n"
        "   ├─ l ← camera.image [?c=cam1] (new, cost 5)\n"
        "   └─ r ← camera.image [?c=cam2] (new, cost 5)"
    )
    assert read_tree(text)[1][1] == Entry(1, "l", "camera.image [?c=cam1]", "new, cost 5")
    drawing = tree_as_dot(text)
    assert drawing.count('"camera [?c=cam1]" -> "stereo [?a=cam1, ?b=cam2]"') == 1
    assert 'taillabel="depth", headlabel=""' in drawing


def test_running_nodelets_of_one_transformation_are_told_apart() -> None:
    left, right = [Live(f"/{at}", "rect", f"/rect_{at}", "rect", "") for at in (1, 2)]
    inputs = (("left", left), ("again", left), ("right", right))
    stereo = PlanStep(Instance("stereo"), inputs, 1)
    answer = Plan(demand("X"), New(stereo.instance, "depth"), (stereo,), charges=(("/rect_1", 9),))
    drawing = tree_as_dot(as_tree(answer))
    for at, port in ((1, "left"), (1, "again"), (2, "right")):
        arrow = f'"runs as /rect_{at}" -> "stereo" [taillabel="rect", headlabel="{port}"];'
        assert arrow in drawing
    assert 'label="rect\\nruns as /rect_1, charged 9"' in drawing
    assert 'label="rect\\nruns as /rect_2"' in drawing


def test_names_may_have_brackets_and_dots() -> None:
    steps = [f"─ i ← rect.out [?c={name}] (new, cost 1)" for name in ("cam[1]", "cam[2]", "v1.5")]
    drawing = tree_as_dot(
        "\n".join(["X", "└─ all.out (new, cost 1)", *[f"   ├{e}" for e in steps]])
    )
    for name in ("cam[1]", "cam[2]", "v1.5"):
        assert f'"rect [?c={name}]" -> "all" [taillabel="out", headlabel="i"];' in drawing


@pytest.mark.parametrize(
    ("least", "is_cut_short", "title"),
    [
        (100, False, "proven least"),
        (99, False, "at most 2 % above the least possible"),
        (50, True, "at most 100 % above the least possible; its time was over"),
        (0, False, "perhaps not the least"),
    ],
)
def test_the_title_tells_how_good_a_plan_is(least: int, is_cut_short: bool, title: str) -> None:
    running = Live("/b", "planes", "/mine", "subsampler", "")
    answer = Plan(demand("X"), running, (), least, (), is_cut_short, (("/mine", 100),))
    assert as_tree(answer).split("\n")[0] == f"X: cost 100 ({title})"


# Refusals


def named(cause: str) -> Set[str]:
    """Return the labels that are named as excluded."""
    listed = cause.rpartition(" is ")[0] or cause.rpartition(" are ")[0]
    return {*re.sub(r" and \d+ more$", "", listed).split(", ")}


#: Problems whose refusals were wrong once.
ONCE_WRONG = (2253, 2681, 3615, 9732)


@pytest.mark.parametrize(
    "seeds",
    [(*range(600), *ONCE_WRONG), pytest.param(range(20_000), marks=pytest.mark.long)],
    ids=("some", "many"),
)
def test_refusals_state_no_falsehood(
    monkeypatch: pytest.MonkeyPatch, seeds: Sequence[int]
) -> None:
    missing = excluded = typed = of_datatypes = slow = 0
    for seed in seeds:
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
                    assert not (is_written and supplies(fast, wanted, problem)), (seed, cause)
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


def test_another_name_in_one_of_several_tags_is_named() -> None:
    camera = make("camera", [], ["Image(nose)"])
    detector = make("detector", ["Image(?c)"], ["Object(?c)&About(ball)"])
    tracker = make("tracker", ["Object(?by)&About(?it)"], ["Position(?it)"])
    missing = "nothing supplies About(bell) & Object(?by)"
    assert refused("Position(bell)", camera, detector, tracker) == missing


def test_what_must_not_be_used_is_named() -> None:
    camera = make("camera", [], ["Image(nose)"])
    excluded = refused("Image(nose)", camera, exclude=frozenset(("camera",)))
    assert excluded == "Image(nose) cannot be used: camera is excluded"
    paused = refused("Image(nose)", camera, paused=frozenset(("camera",)))
    assert (
        paused == "Image(nose) cannot be used: no nodelet of camera is free, and none is made now"
    )
    stream = Live("/image", "out", "/camera_1", "camera", "")
    live = [(stream, (parse_tag("Image(nose)"),))]
    excluded = refused("Image(nose)", live=live, exclude=frozenset(("camera",)))
    assert excluded == "Image(nose) cannot be used: camera is excluded"


def test_a_verdict_that_is_not_true_is_named() -> None:
    def requiring(made: Transformation, tag: str) -> Transformation:
        return made._replace(requires=(Requirement(tag, False),))

    why = "cannot be used: a verdict that detector requires is not TRUE"
    detector = requiring(make("detector", ["Image(nose)"], ["Ball"]), "Bright")
    assert refused("Ball", detector) == f"Ball {why}"
    camera, microphone = make("camera", [], ["Image(nose)"]), make("ear", [], ["Sound(ear)"])
    detector = requiring(make("detector", ["Image(?c)"], ["Seen(?c)"]), "Bright(?c)")
    tracker = make("tracker", ["Seen(?c)", "Sound(?c)"], ["Position"])
    assert refused("Seen(nose)", camera, detector) == f"Seen(nose) {why}"
    assert refused("Position", camera, microphone, detector, tracker) == f"Seen(?c) {why}"
    assert refused("Seen(nose)", detector) == "nothing supplies Image(nose)"
    verdicts = Verdicts(frozenset([parse_tag("Bright(nose)")]))
    answer = refused("Position", camera, microphone, detector, tracker, verdicts=verdicts)
    assert answer == "nothing supplies Sound(nose)"


def test_a_rate_and_a_ros_type_are_named() -> None:
    camera = make("camera", [], ["Image(nose)"], datatype="t/One", rate=5.0)
    slow = refused("Image(nose)", camera, min_rate=10.0)
    assert slow == (
        "Image(nose) [at least 10 Hz] cannot be used: it is stated at 5 Hz, below 10 Hz"
    )
    near = refused("Image(nose)", camera, min_rate=5.000001)
    assert near.endswith("it is stated at 5 Hz, below 5.000001 Hz")
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
