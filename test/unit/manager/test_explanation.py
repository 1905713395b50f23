# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Plans, explained."""

from __future__ import annotations

import shutil
import subprocess

import pytest
from unit.manager.field import GOAL, Field
from unit.manager.planning.examples import demand

from dyknow.manager.planning.explanation import Entry, as_tree, read_tree, tree_as_dot
from dyknow.manager.planning.problem import Action, Live, New, NoPlan, Plan, PlanStep
from dyknow.model.streams import StreamRequest


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
    steps = [PlanStep(Action("level 0", 1), ())]
    for level in range(1, depth):
        below = New(f"level {level - 1}", "out")
        inputs = (("left", below), ("right", below))
        steps.append(PlanStep(Action(f"level {level}", 1), inputs))
    diamonds = Plan(demand("X"), New(f"level {depth - 1}", "out"), tuple(steps), depth)
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
        return PlanStep(Action("camera", 5), (), (("?c", name),))

    inputs = tuple(
        (port, New("camera", "image", (("?c", name),)))
        for port, name in (("l", "cam1"), ("r", "cam2"))
    )
    stereo = PlanStep(Action("stereo", 1), inputs, (("?a", "cam1"), ("?b", "cam2")))
    goal = New("stereo", "depth", stereo.bindings)
    answer = Plan(demand("X"), goal, (camera("cam1"), camera("cam2"), stereo), 11, 10)
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
    answer = Plan(demand("X"), running, (), 100, least, (), is_cut_short)
    assert as_tree(answer).split("\n")[0] == f"X: cost 100 ({title})"
