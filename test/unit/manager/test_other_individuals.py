# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Whenever another individual is received, every port of its variable is reconfigured before."""

from __future__ import annotations

from pathlib import Path
from typing import List

import pytest
from unit.manager.field import IMAGE
from unit.manager.test_shared_variables import Lab, Ports

from dyknow.manager.record import Record
from dyknow.model.graph import NodeletKind
from dyknow.model.streams import ClaimState


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    lab = Lab(str(tmp_path / "state.db"))
    for name in ("left", "right"):
        cost = 1 if name == "left" else 5
        lab.add(f"camera {name}", camera(name), cost)
    return lab


def camera(name: str) -> Ports:
    return {"out": ("out", [f"Image({name})"]), "info": ("out", [f"Info({name})"])}


RECT: Ports = {"out": ("out", ["Rect(?c)"])}
RECTIFIER: Ports = {"image": ("in", ["Image(?c)"]), "info": ("in", ["Info(?c)"]), **RECT}


def lose(lab: Lab, name: str) -> None:
    """Remove what makes a camera, and the camera."""
    lab.field.manager.remove_transformation(f"camera {name}")
    (made,) = lab.made_from(f"camera {name}")
    lab.field.host.vanish(made)
    lab.witness.excuse()


def test_a_nodelet_is_reconfigured_before_it_hears_another_camera(lab: Lab) -> None:
    lab.add("rectifier", RECTIFIER)
    image = lab.field.acquire("Image(?c)").claim
    rect = lab.field.acquire("Rect(?c)").claim
    (name,) = lab.made_from("rectifier")
    assert lab.field.host.nodelet(name).ports["image"].topic == image.topic
    lab.settle()
    lose(lab, "left")
    lab.settle()
    assert lab.field.claim(rect.claim_id).bindings == (("?c", "right"),)
    assert lab.field.claim(image.claim_id).bindings == (("?c", "right"),)
    assert lab.made_from("rectifier") == [name]
    assert lab.field.host.nodelet(name).ports["image"].topic == image.topic


def test_its_ports_change_as_one_though_one_source_is_still_there(lab: Lab) -> None:
    lab.add("pair", {"image": ("in", ["Image(?c)"]), "pose": ("in", ["Pose(?c)"]), **RECT})
    image = lab.field.acquire("Image(?c)").claim
    rect = lab.field.acquire("Rect(?c)").claim
    lab.settle()
    told = reconfigurations(lab, "pair")
    lose(lab, "left")
    lab.settle()
    assert lab.field.claim(rect.claim_id).bindings == (("?c", "right"),)
    assert reconfigurations(lab, "pair") == told + 2  # disconnected, and connected, as one
    assert topics(lab, "pair") == [image.topic, "/pose_right_1/out"]


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_nodelet_with_one_port_is_reconfigured_too(lab: Lab, is_restarted: bool) -> None:
    lab.add("tracker", {"image": ("in", ["Image(?c)"]), "out": ("out", ["Track(thing)"])})
    lab.field.acquire("Image(?c)")
    track = lab.field.acquire("Track(thing)").claim
    lab.settle()
    told = reconfigurations(lab, "tracker")
    lab.field.manager.remove_transformation("camera right")
    lose(lab, "left")
    lab.settle(20.0)
    assert lab.field.state(track.claim_id) is ClaimState.PENDING
    if is_restarted:
        lab.field.kill_manager()
    lab.add("camera right", camera("right"))
    lab.settle()
    assert lab.field.state(track.claim_id) is ClaimState.ACTIVE
    assert reconfigurations(lab, "tracker") > told


def test_what_is_lost_is_remembered_over_a_restart_of_the_manager(lab: Lab) -> None:
    lab.add("rectifier", RECTIFIER)
    lab.field.acquire("Image(?c)")
    rect = lab.field.acquire("Rect(?c)").claim
    lab.settle()
    lose(lab, "left")
    lab.field.kill_manager()
    lab.settle()
    assert lab.field.claim(rect.claim_id).bindings == (("?c", "right"),)
    assert lab.field.state(rect.claim_id) is ClaimState.ACTIVE


FOLLOWER = """<transformation type="node" node="/robot/follower"><label>follower</label>
  <ports><port type="in">image</port><port type="out">out</port></ports>
  <tags><tag port="image">Image(?c)</tag><tag port="out">Track(thing)</tag></tags>
</transformation>"""


@pytest.mark.parametrize("is_other", [False, True])
def test_an_external_node_is_remembered_over_a_restart_until_it_ends(
    lab: Lab, is_other: bool
) -> None:
    """The manager restarts between the loss of one camera and its replacement."""
    host = lab.field.host
    host.sources["robot/follower"] = [("image", "in", IMAGE), ("out", "out", IMAGE)]
    lab.witness.signed["robot/follower"] = {"image": ("Image(?c)",), "out": ("Track(thing)",)}
    lab.witness.given = lambda name: {}
    lab.field.manager.add_transformation(FOLLOWER)

    def run() -> None:
        host.run_node("/robot/follower", "robot/follower", {}, NodeletKind.CPP_NODE)
        lab.field.by_hand["/robot/follower"] = True

    run()
    lab.field.manager.look()
    track = lab.field.acquire("Track(thing)").claim
    lab.settle()
    heard = lab.field.manager.graph.get("/robot/follower").heard
    assert heard.ways == ((("?c", "left"),),)
    lab.field.manager.remove_transformation("camera right")
    lose(lab, "left")
    lab.settle(20.0)
    assert lab.field.state(track.claim_id) is ClaimState.PENDING
    if is_other:  # another process of that name, which has received nothing
        run()
        lab.field.kill_manager()
        assert lab.field.manager.graph.get("/robot/follower").heard.ways == ()
        assert lab.field.store.read("nodelets", Record.from_body) == {}
        return
    lab.field.kill_manager()
    assert lab.field.manager.graph.get("/robot/follower").heard == heard
    told = host.nodelet("/robot/follower").reconfigurations
    lab.add("camera right", camera("right"))
    lab.settle()
    assert lab.field.state(track.claim_id) is ClaimState.ACTIVE
    assert host.nodelet("/robot/follower").reconfigurations > told


@pytest.mark.parametrize("is_lost", [True, False])
def test_what_people_connected_to_a_claim_is_reconfigured_and_stays(
    lab: Lab, is_lost: bool
) -> None:
    lab.add("rectifier", RECTIFIER)
    image = lab.field.acquire("Image(?c)").claim
    config = {"image": image.topic, "info": "/camera_left_1/info"}
    lab.field.host.connect("/camera_left_1", {"info": "/camera_left_1/info"})
    lab.field.manager.look()
    lab.field.spawn("rectifier", "/mine", config=config)
    lab.field.manager.look()
    lab.field.reconciler.reconcile()
    told = lab.field.host.nodelet("/mine").reconfigurations
    if is_lost:
        lose(lab, "left")
    else:
        lab.field.host.connect("/camera_left_1", {"info": ""})
        lab.field.manager.remove_transformation("camera left")
        lab.field.manager.look()
    lab.settle()
    assert lab.field.claim(image.claim_id).bindings == (("?c", "right"),)
    mine = lab.field.host.nodelet("/mine")
    assert {name: port.topic for name, port in mine.ports.items() if name in config} == config
    assert mine.reconfigurations == told + 2


def test_users_of_what_people_exchange_are_reconfigured(lab: Lab) -> None:
    lab.add("rectifier", RECTIFIER)
    config = {"out": "/image", "info": "/info"}
    lab.field.spawn("camera left", "/mine", config=config)
    lab.field.manager.remove_transformation("camera left")
    lab.field.manager.remove_transformation("camera right")
    rect = lab.field.acquire("Rect(?c)").claim
    lab.settle()
    told = reconfigurations(lab, "rectifier")
    lab.add("camera right", camera("right"))
    lab.field.manager.destroy("/mine")
    lab.field.by_hand.clear()
    lab.field.spawn("camera right", "/mine", config=config)
    lab.witness.guilt.clear()
    lab.witness.excuse()
    assert lab.witness.confused == {"/rectifier_1"}
    lab.settle()
    assert reconfigurations(lab, "rectifier") > told
    now = lab.field.claim(rect.claim_id)
    assert (now.state, now.bindings) == (ClaimState.ACTIVE, (("?c", "right"),))
    assert topics(lab, "rectifier") == ["/image", "/info"]


def test_one_that_does_not_answer_holds_up_no_repair_and_is_reconfigured_later(lab: Lab) -> None:
    lab.add("rectifier", RECTIFIER)
    image = lab.field.acquire("Image(?c)").claim
    lab.field.host.add("/far")
    lab.field.host.connect("/camera_left_1", {"info": "/camera_left_1/info"})
    lab.field.manager.look()
    config = {"image": image.topic, "info": "/camera_left_1/info"}
    lab.field.spawn("rectifier", "/mine", config=config, manager="/far")
    lab.settle()
    lab.field.host.cut("/far")
    lose(lab, "left")
    lab.field.tick(3.0)
    lab.field.tick(3.0)
    assert lab.field.claim(image.claim_id).bindings == (("?c", "right"),)
    told = lab.field.host.nodelet("/mine").reconfigurations
    lab.field.host.mend("/far")
    lab.witness.guilt.clear()
    lab.settle()
    assert lab.field.host.nodelet("/mine").reconfigurations > told


@pytest.mark.parametrize("is_relayed", [False, True])
def test_two_individuals_never_send_on_one_topic(lab: Lab, is_relayed: bool) -> None:
    claim = lab.field.acquire("Image(?c)").claim
    if is_relayed:
        lab.field.spawn("camera right", "/mine", config={"out": "/mine/out"})
    lab.settle()
    seen: List[List[str]] = []
    watch = lab.field.host.on_change

    def look() -> None:
        watch()
        seen.append(lab.field.host.publishers(claim.topic))

    lab.field.host.on_change = look
    lab.field.manager.remove_transformation("camera left")
    lab.settle()
    assert lab.field.claim(claim.claim_id).bindings == (("?c", "right"),)
    assert max(map(len, seen)) == 1


def reconfigurations(lab: Lab, label: str) -> int:
    (name,) = lab.made_from(label)
    return lab.field.host.nodelet(name).reconfigurations


def topics(lab: Lab, label: str) -> List[str]:
    (name,) = lab.made_from(label)
    return lab.field.host.nodelet(name).topics("in")
