# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A variable is one thing throughout a transformation: its life in claims."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, List, Sequence, Tuple

import pytest
from unit.manager.field import IMAGE, Field, specification
from unit.manager.witness import Concepts, Witness

from dyknow.errors import InvalidTag, NoPlanFound
from dyknow.manager.claims.answers import StreamAnswers
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import Parameter

Ports = Dict[str, Tuple[str, Sequence[str]]]
FRAME = '<params><param name="frame" type="string">${?c}_link</param></params>'
CONCEPTS = Concepts({"left": "Camera", "right": "Camera"})


class Lab:
    """Two cameras, each with its pose, and parts that work on the images of one camera."""

    def __init__(self, path: str) -> None:
        self.field = Field(path, {"dyknow/Relay": [("in", "in", "*"), ("out", "out", "*")]}, "")
        self.field.ontology = CONCEPTS
        self.field.kill_manager()
        self.witness = Witness(self.field.host, CONCEPTS)
        self.witness.claims = lambda: self.field.reconciler.claims()
        self.witness.given = lambda name: self.field.manager.graph.get(name).given
        for name, cost in (("left", 1), ("right", 5)):
            self.add(f"camera {name}", {"out": ("out", [f"Image({name})"])}, cost)
            self.add(f"pose {name}", {"out": ("out", [f"Pose({name})"])})

    def add(self, label: str, ports: Ports, cost: int = 1, params: str = "") -> None:
        source = "lab/" + label.replace(" ", "_")
        self.field.host.sources[source] = [(name, way, IMAGE) for name, (way, _) in ports.items()]
        self.witness.signed[source] = {name: tuple(tags) for name, (_, tags) in ports.items()}
        text = specification(label, source, ports, cost, IMAGE)
        self.field.manager.add_transformation(text.replace("<ports>", params + "<ports>"))

    def add_detector(self, params: str = "") -> None:
        ports: Ports = {
            "image": ("in", ["Image(?c: Camera)"]),
            "pose": ("in", ["Pose(?c)"]),
            "ball": ("out", ["Ball(?c)"]),
        }
        self.add("detector", ports, 1, params)

    def settle(self, seconds: float = 3.0) -> None:
        self.field.settle(seconds)
        assert self.witness.guilt == []
        assert self.witness.lasting() == set()

    def made_from(self, label: str) -> List[str]:
        return [each.name for each in self.field.manager.graph.all() if each.label == label]

    def reads(self, name: str) -> List[str]:
        """Labels of the nodelets that feed a nodelet."""
        topics = self.field.host.nodelet(name).topics("in")
        publishers = [each for topic in topics for each in self.field.host.publishers(topic)]
        return sorted(self.field.manager.graph.get(each).label for each in publishers)


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(str(tmp_path / "state.db"))


def test_in_ports_that_share_a_variable_get_streams_of_one_individual(lab: Lab) -> None:
    lab.add_detector()
    got = lab.field.acquire("Ball(?which)")
    assert got.claim.bindings == (("?which", "left"),)
    assert lab.reads(got.claim.goal[0]) == ["camera left", "pose left"]
    answer = StreamAnswers(lambda: 0.0).acquisition(got, ())
    assert (answer.bindings, answer.cost, answer.least_cost) == (("?which=left",), 3.0, 3.0)
    other = lab.field.acquire("Ball(right)")
    assert lab.reads(other.claim.goal[0]) == ["camera right", "pose right"]
    assert other.claim.goal[0] != got.claim.goal[0]
    lab.settle()


def test_parameters_are_filled_and_kept_over_a_restart(lab: Lab) -> None:
    lab.add_detector(FRAME)
    claim = lab.field.acquire("Ball(right)").claim
    name = claim.goal[0]
    assert lab.field.host.parameters == {f"{name}/frame": "right_link"}
    given = (Parameter("?c", "string", "right"),)
    assert lab.field.manager.graph.get(name).status.parameters == given
    lab.field.kill_manager()
    lab.settle()
    assert lab.field.claim(claim.claim_id).goal == claim.goal
    assert lab.field.manager.graph.get(name).status.parameters == given


def test_a_filled_nodelet_is_replaced_for_another_binding_and_the_event_says_so(lab: Lab) -> None:
    lab.add_detector(FRAME)
    claim = lab.field.acquire("Ball(?c)").claim
    lab.settle()
    lab.field.manager.remove_transformation("camera left")
    lab.settle(20.0)
    now = lab.field.claim(claim.claim_id)
    assert (now.state, now.bindings, now.topic) == (
        ClaimState.ACTIVE,
        (("?c", "right"),),
        claim.topic,
    )
    assert now.goal[0] != claim.goal[0]
    assert lab.made_from("detector") == [now.goal[0]]
    assert lab.field.host.parameters == {f"{now.goal[0]}/frame": "right_link"}
    assert any("?c=right from now on" in each for each in lab.field.reasons())
    lab.field.tidy()


def test_one_without_filled_parameters_is_connected_elsewhere(lab: Lab) -> None:
    lab.add_detector()
    lab.add("view", {"in": ("in", ["Ball(?x)"]), "out": ("out", ["View(?x)"])})
    claim = lab.field.acquire("View(?c)").claim
    lab.settle()
    before = set(claim.nodelets)
    lab.field.manager.remove_transformation("camera left")
    lab.settle()
    now = lab.field.claim(claim.claim_id)
    assert (now.state, now.bindings) == (ClaimState.ACTIVE, (("?c", "right"),))
    assert len(before & set(now.nodelets)) == 2
    assert claim.topic in lab.field.moving


def test_what_is_behind_those_that_are_cut_off_stays_where_it_is(lab: Lab) -> None:
    """While the detector is connected elsewhere, its in-ports do not contradict each other."""
    lab.add("planes", {"in": ("in", ["Image(?c)"]), "out": ("out", ["Planes(?c)"])})
    detector: Ports = {
        "planes": ("in", ["Planes(?c)"]),
        "pose": ("in", ["Pose(?c)"]),
        "wish": ("in", ["Wish(?thing)"]),
        "ball": ("out", ["Found(?thing)"]),
    }
    lab.add("wish", {"out": ("out", ["Wish(ball)"])})
    lab.add("detector", detector)
    lab.add("view", {"in": ("in", ["Found(?thing)"]), "out": ("out", ["View(?thing)"])})
    lab.field.manager.remove_transformation("camera left")
    claim = lab.field.acquire("View(?thing)").claim
    lab.settle()
    lab.add("camera left", {"out": ("out", ["Image(left)"])})
    lab.settle()
    answer = lab.field.reconciler.replan(claim.claim_id)
    assert answer.spawned == ("/camera_left_1", "/pose_left_1")
    lab.settle()
    now = lab.field.claim(claim.claim_id)
    assert (now.state, now.goal, now.topic) == (ClaimState.ACTIVE, claim.goal, claim.topic)


def test_a_plan_may_need_a_transformation_several_times(lab: Lab) -> None:
    lab.add_detector(FRAME)
    stereo: Ports = {
        "one": ("in", ["Ball(left)"]),
        "two": ("in", ["Ball(right)"]),
        "out": ("out", ["Depth(ball)"]),
    }
    lab.add("stereo", stereo)
    planned = lab.field.reconciler.acquire(
        lab.field.acquire("Depth(ball)").claim.request, dry_run=True
    )
    assert planned.spawned == ()
    lab.settle()
    assert len(lab.made_from("detector")) == 2
    assert sorted(lab.field.host.parameters.values(), key=str) == ["left_link", "right_link"]


def test_what_was_meant_is_suggested_with_the_names_that_were_asked_for(lab: Lab) -> None:
    lab.add("planes", {"in": ("in", ["Image(?c)"]), "out": ("out", ["Planes(?c, half)"])})
    with pytest.raises(NoPlanFound, match=r"did you mean Planes\(left, half\)"):
        lab.field.acquire("Plnes(left, haf)")
    with pytest.raises(NoPlanFound, match=r"did you mean Planes\(\?camera, half\)"):
        lab.field.acquire("Planse(?camera, half)")


def test_what_variables_can_stand_for_is_found_in_what_runs_and_what_could(lab: Lab) -> None:
    lab.add_detector()
    found = lab.field.reconciler.find_bindings
    assert found("Ball(?x: Camera)") == ([(("?x", "left"),), (("?x", "right"),)], True)
    claim = lab.field.acquire("Ball(left)").claim
    lab.field.manager.remove_transformation("camera right")
    assert found("Ball(?x)") == ([(("?x", "left"),)], True)
    lab.field.manager.remove_transformation("detector")
    assert found("Ball(?x)") == ([], True)
    lab.field.spawn("camera left", "/mine", config={"out": "/mine/out"})
    lab.field.manager.remove_transformation("camera left")
    assert found("Image(?x)") == ([(("?x", "left"),)], True)
    assert found("Image(left)") == ([()], True)
    assert found("Image(right)") == ([], True)
    with pytest.raises(InvalidTag):
        found("Image(")
    assert lab.field.claim(claim.claim_id).state is ClaimState.ACTIVE


def test_a_nodelet_made_by_hand_supplies_what_its_inputs_say(lab: Lab) -> None:
    lab.add_detector()
    field = lab.field
    for name in ("left", "right"):
        field.spawn(f"camera {name}", f"/camera_{name}", config={"out": f"/{name}"})
        field.spawn(f"pose {name}", f"/pose_{name}", config={"out": f"/pose_{name}"})
    config = {"image": "/right", "pose": "/pose_right", "ball": "/ball"}
    lab.witness.by_hand.update(["/hand"])
    field.spawn("detector", "/hand", config=config)
    assert field.acquire("Ball(right)").reused[-1:] == ("/pose_right",)
    assert field.acquire("Ball(right)").claim.goal == ("/hand", "ball")
    assert field.acquire("Ball(left)").claim.goal[0] != "/hand"
    lab.settle()


def test_a_claim_follows_when_people_connect_its_source_elsewhere(lab: Lab) -> None:
    lab.add("detector", {"image": ("in", ["Image(?c)"]), "ball": ("out", ["Ball(?c)"])})
    field = lab.field
    for name in ("left", "right"):
        field.spawn(f"camera {name}", f"/camera_{name}", config={"out": f"/{name}"})
    field.spawn("detector", "/hand", config={"image": "/left", "ball": "/ball"})
    lab.witness.by_hand.update(["/hand"])
    claim = field.acquire("Ball(?c)").claim
    assert (claim.goal[0], claim.bindings) == ("/hand", (("?c", "left"),))
    field.host.connect("/hand", {"image": "/right"})
    field.manager.look()
    lab.settle()
    now = field.claim(claim.claim_id)
    assert (now.state, now.bindings) == (ClaimState.ACTIVE, (("?c", "right"),))
    assert any("?c=right from now on" in each for each in field.reasons())


def test_what_comes_back_does_not_change_what_others_receive(lab: Lab) -> None:
    lab.add("detector", {"image": ("in", ["Image(?c)"]), "ball": ("out", ["Ball(?c)"])})
    field = lab.field
    field.spawn("camera right", "/right", config={"out": "/shared"}, isolated=True)

    field.host.fail_at("load", "/right", "not yet")
    field.host.kill(field.manager.graph.get("/right").manager)
    field.settle()
    field.spawn("camera left", "/left", config={"out": "/shared"})
    claim = field.acquire("Ball(left)").claim
    assert field.host.publishers("/shared") == ["/left"]
    assert field.host.nodelet(claim.goal[0]).topics("in") == ["/shared"]
    field.host.recover()
    lab.settle(60.0)
    assert field.host.nodelet("/right").topics("out") == []
    now = field.claim(claim.claim_id)
    assert (now.state, now.goal, now.bindings) == (ClaimState.ACTIVE, claim.goal, ())
