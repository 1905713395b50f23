# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A variable is one thing throughout a transformation: its life in claims."""

from __future__ import annotations

from pathlib import Path
from typing import List

import pytest
from unit.manager.field import IMAGE, RELAY, Field, Ports
from unit.manager.witness import Concepts, Witness

from dyknow.errors import InvalidTag, NoPlanFound
from dyknow.manager.claim import Claim
from dyknow.manager.claims.answers import StreamAnswers
from dyknow.manager.record import Record
from dyknow.model.graph import NodeletKind
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import Parameter
from dyknow.simulated.host import FakeNodelet

FRAME = '<params><param name="frame" type="string">${?c}_link</param></params>'
CONCEPTS = Concepts({"left": "Camera", "right": "Camera"})


def camera(name: str) -> Ports:
    return {"out": ("out", [f"Image({name})"]), "info": ("out", [f"Info({name})"])}


class Lab(Field):
    """Two cameras, each with its pose, and parts that work on the images of one camera."""

    def __init__(self, path: str) -> None:
        super().__init__(path, RELAY, "", CONCEPTS)
        self.witness = Witness(self.host, CONCEPTS)
        self.witness.claims = lambda: self.reconciler.claims()
        self.witness.given = lambda name: self.manager.graph.get(name).given
        for name, cost in (("left", 1), ("right", 5)):
            self.add(f"camera {name}", camera(name), cost)
            self.add(f"pose {name}", {"out": ("out", [f"Pose({name})"])})

    def add(self, label: str, ports: Ports, cost: int = 1, params: str = "") -> str:
        source = super().add(label, ports, cost, params)
        self.witness.signed[source] = {name: tuple(tags) for name, (_, tags) in ports.items()}
        return source

    def add_detector(self, params: str = "") -> None:
        ports: Ports = {
            "image": ("in", ["Image(?c: Camera)"]),
            "pose": ("in", ["Pose(?c)"]),
            "ball": ("out", ["Ball(?c)"]),
        }
        self.add("detector", ports, 1, params)

    def settle(self, seconds: float = 3.0) -> None:
        super().settle(seconds)
        assert self.witness.guilt == []
        assert self.witness.lasting() == set()

    def made_from(self, label: str) -> List[str]:
        return [each.name for each in self.manager.graph.all() if each.label == label]

    def reads(self, name: str) -> List[str]:
        """Labels of the nodelets that feed a nodelet."""
        topics = self.host.nodelet(name).topics("in")
        publishers = [each for topic in topics for each in self.host.publishers(topic)]
        return sorted(self.manager.graph.get(each).label for each in publishers)

    def only(self, label: str) -> FakeNodelet:
        """The nodelet that was made from a transformation."""
        (name,) = self.made_from(label)
        return self.host.nodelet(name)

    def check_bound(self, claim: Claim, name: str) -> None:
        """A claim is whole, on its topic, and its variable stands for a name."""
        now = self.claim(claim.claim_id)
        assert (now.state, now.topic) == (ClaimState.ACTIVE, claim.topic)
        assert now.bindings == (("?c", name),)

    def lose(self, name: str) -> None:
        """Remove a camera and its transformation."""
        self.manager.remove_transformation(f"camera {name}")
        (made,) = self.made_from(f"camera {name}")
        self.host.vanish(made)
        self.witness.excuse()


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    return Lab(str(tmp_path / "state.db"))


def test_in_ports_that_share_a_variable_get_streams_of_one_individual(lab: Lab) -> None:
    lab.add_detector()
    got = lab.acquire("Ball(?which)")
    assert got.claim.bindings == (("?which", "left"),)
    assert lab.reads(got.claim.goal[0]) == ["camera left", "pose left"]
    answer = StreamAnswers(lambda: 0.0).acquisition(got, ())
    assert (answer.bindings, answer.cost, answer.least_cost) == (("?which=left",), 3.0, 3.0)
    other = lab.acquire("Ball(right)")
    assert lab.reads(other.claim.goal[0]) == ["camera right", "pose right"]
    assert other.claim.goal[0] != got.claim.goal[0]
    lab.settle()


def test_a_filled_nodelet_is_replaced_for_another_binding_and_the_event_says_so(lab: Lab) -> None:
    lab.add_detector(FRAME)
    claim = lab.acquire("Ball(?c)").claim
    given = (Parameter("?c", "string", "left"),)
    assert lab.host.parameters == {f"{claim.goal[0]}/frame": "left_link"}
    lab.kill_manager()
    lab.settle()
    assert lab.claim(claim.claim_id).goal == claim.goal
    assert lab.manager.graph.get(claim.goal[0]).status.parameters == given
    lab.manager.remove_transformation("camera left")
    lab.settle(20.0)
    lab.check_bound(claim, "right")
    (detector,) = lab.made_from("detector")
    assert detector == lab.claim(claim.claim_id).goal[0] != claim.goal[0]
    assert lab.host.parameters == {f"{detector}/frame": "right_link"}
    assert any("?c=right from now on" in each for each in lab.reasons())
    lab.tidy()


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
    lab.manager.remove_transformation("camera left")
    claim = lab.acquire("View(?thing)").claim
    lab.settle()
    lab.add("camera left", {"out": ("out", ["Image(left)"])})
    lab.settle()
    answer = lab.reconciler.replan(claim.claim_id)
    assert answer.spawned == ("/camera_left_1", "/pose_left_1")
    lab.settle()
    now = lab.claim(claim.claim_id)
    assert (now.state, now.goal, now.topic) == (ClaimState.ACTIVE, claim.goal, claim.topic)


def test_what_was_meant_is_suggested_with_the_names_that_were_asked_for(lab: Lab) -> None:
    lab.add("planes", {"in": ("in", ["Image(?c)"]), "out": ("out", ["Planes(?c, half)"])})
    with pytest.raises(NoPlanFound, match=r"did you mean Planes\(left, half\)"):
        lab.acquire("Plnes(left, haf)")
    with pytest.raises(NoPlanFound, match=r"did you mean Planes\(\?camera, half\)"):
        lab.acquire("Planse(?camera, half)")


def test_what_variables_can_stand_for_is_found_in_what_runs_and_what_could(lab: Lab) -> None:
    lab.add_detector()
    found = lab.reconciler.find_bindings
    assert found("Ball(?x: Camera)") == ([(("?x", "left"),), (("?x", "right"),)], True)
    claim = lab.acquire("Ball(left)").claim
    lab.manager.remove_transformation("camera right")
    assert found("Ball(?x)") == ([(("?x", "left"),)], True)
    lab.manager.remove_transformation("detector")
    assert found("Ball(?x)") == ([], True)
    lab.spawn("camera left", "/mine", config={"out": "/mine/out"})
    lab.manager.remove_transformation("camera left")
    assert found("Image(?x)") == ([(("?x", "left"),)], True)
    assert found("Image(left)") == ([()], True)
    assert found("Image(right)") == ([], True)
    with pytest.raises(InvalidTag):
        found("Image(")
    assert lab.claim(claim.claim_id).state is ClaimState.ACTIVE


def test_a_nodelet_made_by_hand_supplies_what_its_inputs_say(lab: Lab) -> None:
    lab.add_detector()
    for name in ("left", "right"):
        lab.spawn(f"camera {name}", f"/camera_{name}", config={"out": f"/{name}"})
        lab.spawn(f"pose {name}", f"/pose_{name}", config={"out": f"/pose_{name}"})
    config = {"image": "/right", "pose": "/pose_right", "ball": "/ball"}
    lab.witness.by_hand.update(["/hand"])
    lab.spawn("detector", "/hand", config=config)
    assert lab.acquire("Ball(right)").reused[-1:] == ("/pose_right",)
    assert lab.acquire("Ball(right)").claim.goal == ("/hand", "ball")
    assert lab.acquire("Ball(left)").claim.goal[0] != "/hand"
    lab.settle()


def test_a_claim_follows_when_people_connect_its_source_elsewhere(lab: Lab) -> None:
    lab.add("detector", {"image": ("in", ["Image(?c)"]), "ball": ("out", ["Ball(?c)"])})
    for name in ("left", "right"):
        lab.spawn(f"camera {name}", f"/camera_{name}", config={"out": f"/{name}"})
    lab.spawn("detector", "/hand", config={"image": "/left", "ball": "/ball"})
    lab.witness.by_hand.update(["/hand"])
    claim = lab.acquire("Ball(?c)").claim
    assert (claim.goal[0], claim.bindings) == ("/hand", (("?c", "left"),))
    lab.host.connect("/hand", {"image": "/right"})
    lab.manager.look()
    lab.settle()
    lab.check_bound(claim, "right")
    assert any("?c=right from now on" in each for each in lab.reasons())


# Whenever another individual is received, every port of its variable is reconfigured before


RECT: Ports = {"out": ("out", ["Rect(?c)"])}
RECTIFIER: Ports = {"image": ("in", ["Image(?c)"]), "info": ("in", ["Info(?c)"]), **RECT}


@pytest.mark.parametrize(
    ("other", "source"), [("info", "/camera_right_1/info"), ("pose", "/pose_right_1/out")]
)
def test_ports_change_as_one_before_another_is_heard(lab: Lab, other: str, source: str) -> None:
    """Whether the camera sent both, or the source of the poses is still there."""
    tag = f"{other.title()}(?c)"
    lab.add("rectifier", {"image": ("in", ["Image(?c)"]), other: ("in", [tag]), **RECT})
    image = lab.acquire("Image(?c)").claim
    rect = lab.acquire("Rect(?c)").claim
    (name,) = lab.made_from("rectifier")
    assert lab.host.nodelet(name).ports["image"].topic == image.topic
    lab.settle()
    told = lab.host.nodelet(name).reconfigurations
    lab.lose("left")
    lab.settle()
    lab.check_bound(rect, "right")
    lab.check_bound(image, "right")
    assert lab.made_from("rectifier") == [name]
    assert lab.only("rectifier").topics("in") == [image.topic, source]
    assert lab.only("rectifier").reconfigurations == told + 2, "disconnected, and connected"


FOLLOWER = "/robot/follower"


def describe_follower(lab: Lab, sent: str) -> None:
    """Describe a node of users that receives the images of one camera."""
    lab.host.sources[FOLLOWER] = [("image", "in", IMAGE), ("out", "out", IMAGE)]
    lab.witness.signed[FOLLOWER] = {"image": ("Image(?c)",), "out": (sent,)}
    lab.witness.given = lambda name: {}
    lab.manager.add_transformation(
        f'<transformation type="node" node="{FOLLOWER}"><label>follower</label>'
        '<ports><port type="in">image</port><port type="out">out</port></ports><tags>'
        f'<tag port="image">Image(?c)</tag><tag port="out">{sent}</tag></tags></transformation>'
    )


def run_follower(lab: Lab, **config: str) -> None:
    lab.host.run_node(FOLLOWER, FOLLOWER, config, NodeletKind.CPP_NODE)
    lab.by_hand[FOLLOWER] = True


@pytest.mark.parametrize("is_other", [False, True])
def test_an_external_node_is_known_over_a_restart_until_it_ends(lab: Lab, is_other: bool) -> None:
    """The manager restarts between the loss of one camera and its replacement."""
    describe_follower(lab, "Track(thing)")
    run_follower(lab)
    lab.manager.look()
    track = lab.acquire("Track(thing)").claim
    lab.settle()
    heard = lab.manager.graph.get(FOLLOWER).heard
    assert heard.ways == ((("?c", "left"),),)
    lab.manager.remove_transformation("camera right")
    lab.lose("left")
    lab.settle(20.0)
    assert lab.state(track.claim_id) is ClaimState.PENDING
    if is_other:  # another process of that name, which has received nothing
        run_follower(lab)
        lab.kill_manager()
        assert lab.manager.graph.get(FOLLOWER).heard.ways == ()
        assert lab.store.read("nodelets", Record.from_body) == {}
        return
    lab.kill_manager()
    assert lab.manager.graph.get(FOLLOWER).heard == heard
    told = lab.host.nodelet(FOLLOWER).reconfigurations
    lab.add("camera right", camera("right"))
    lab.settle()
    assert lab.state(track.claim_id) is ClaimState.ACTIVE
    assert lab.host.nodelet(FOLLOWER).reconfigurations > told


@pytest.mark.parametrize("is_lost", [True, False])
def test_what_people_connect_to_a_claim_is_reconfigured_and_stays(lab: Lab, is_lost: bool) -> None:
    lab.add("rectifier", RECTIFIER)
    image = lab.acquire("Image(?c)").claim
    config = {"image": image.topic, "info": "/camera_left_1/info"}
    lab.host.connect("/camera_left_1", {"info": "/camera_left_1/info"})
    lab.manager.look()
    lab.spawn("rectifier", "/mine", config=config)
    lab.manager.look()
    lab.reconciler.reconcile()
    told = lab.host.nodelet("/mine").reconfigurations
    if is_lost:
        lab.lose("left")
    else:
        lab.host.connect("/camera_left_1", {"info": ""})
        lab.manager.remove_transformation("camera left")
        lab.manager.look()
    lab.settle()
    lab.check_bound(image, "right")
    mine = lab.host.nodelet("/mine")
    assert {name: port.topic for name, port in mine.ports.items() if name in config} == config
    assert mine.reconfigurations == told + 2


def test_users_of_what_people_exchange_are_reconfigured(lab: Lab) -> None:
    lab.add("rectifier", RECTIFIER)
    config = {"out": "/image", "info": "/info"}
    lab.spawn("camera left", "/mine", config=config)
    lab.manager.remove_transformation("camera left")
    lab.manager.remove_transformation("camera right")
    rect = lab.acquire("Rect(?c)").claim
    lab.settle()
    told = lab.only("rectifier").reconfigurations
    lab.add("camera right", camera("right"))
    lab.manager.destroy("/mine")
    lab.by_hand.clear()
    lab.spawn("camera right", "/mine", config=config)
    lab.witness.guilt.clear()
    lab.witness.excuse()
    assert lab.witness.confused == {"/rectifier_1"}
    lab.settle()
    assert lab.only("rectifier").reconfigurations > told
    lab.check_bound(rect, "right")
    assert lab.only("rectifier").topics("in") == ["/image", "/info"]


def test_one_that_does_not_answer_holds_up_no_repair_and_is_reconfigured_later(lab: Lab) -> None:
    lab.add("rectifier", RECTIFIER)
    image = lab.acquire("Image(?c)").claim
    lab.host.add("/far")
    lab.host.connect("/camera_left_1", {"info": "/camera_left_1/info"})
    lab.manager.look()
    config = {"image": image.topic, "info": "/camera_left_1/info"}
    lab.spawn("rectifier", "/mine", config=config, manager="/far")
    lab.settle()
    lab.host.cut("/far")
    lab.lose("left")
    lab.tick(3.0)
    lab.tick(3.0)
    lab.check_bound(image, "right")
    told = lab.host.nodelet("/mine").reconfigurations
    lab.host.mend("/far")
    lab.witness.guilt.clear()
    lab.settle()
    assert lab.host.nodelet("/mine").reconfigurations > told


@pytest.mark.parametrize("is_relayed", [False, True])
def test_two_individuals_never_send_on_one_topic(lab: Lab, is_relayed: bool) -> None:
    claim = lab.acquire("Image(?c)").claim
    if is_relayed:
        lab.spawn("camera right", "/mine", config={"out": "/mine/out"})
    lab.settle()
    seen: List[List[str]] = []
    watch = lab.host.on_change

    def look() -> None:
        watch()
        seen.append(lab.host.publishers(claim.topic))

    lab.host.on_change = look
    lab.manager.remove_transformation("camera left")
    lab.settle()
    lab.check_bound(claim, "right")
    assert max(map(len, seen)) == 1


@pytest.mark.parametrize("tag", ["Ball", "Track"])
def test_a_nodelet_is_replaced_beside_another_of_its_transformation(lab: Lab, tag: str) -> None:
    lab.add_detector()
    lab.add("tracker", {"in": ("in", ["Ball(?c)"]), "out": ("out", ["Track(?c)"])})
    pair: Ports = {"one": ("in", [f"{tag}(left)"]), "other": ("in", [f"{tag}(right)"])}
    lab.add("stereo", {**pair, "out": ("out", ["Stereo(ball)"])})
    claim = lab.acquire("Stereo(ball)").claim
    lab.settle()
    first, second = lab.made_from("detector")
    trackers = lab.made_from("tracker")
    told = lab.host.nodelet(first).reconfigurations
    for name in (second, *trackers[1:]):
        lab.destroy_by_hand(name)
    lab.settle()
    assert lab.state(claim.claim_id) is ClaimState.ACTIVE
    assert first in lab.made_from("detector")
    assert lab.host.nodelet(first).reconfigurations == told


def test_an_external_node_that_a_stream_needs_twice_leaves_its_claim_pending(lab: Lab) -> None:
    describe_follower(lab, "Track(?c)")
    pair: Ports = {"one": ("in", ["Track(left)"]), "other": ("in", ["Track(right)"])}
    lab.add("stereo", {**pair, "out": ("out", ["Stereo(ball)"])})
    lab.spawn("camera left", "/left", config={"out": "/left/image"})
    run_follower(lab, image="/left/image", out="/track")
    lab.manager.look()
    with pytest.raises(NoPlanFound) as refusal:
        lab.acquire("Stereo(ball)")
    assert lab.state(refusal.value.claim_id) is ClaimState.PENDING
