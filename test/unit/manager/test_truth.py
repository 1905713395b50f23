# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""No in-port receives a stream that it does not demand: all ways in which it could, one by one."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, List, Tuple

import pytest
from unit.manager.field import CHAIN, IMAGE, RELAY, Field, specification, topic

from dyknow.errors import NoPlanFound, SpawnFailed
from dyknow.manager.claim import ClaimEvent
from dyknow.model.streams import ClaimState


@pytest.fixture
def lab(tmp_path: Path) -> Field:
    """Two cameras and a converter that wants one of them."""
    lab = Field(str(tmp_path / "state.db"), RELAY, "")
    lab.add("ceiling", {"image": ("out", ["RawYUV(ceiling)"])})
    lab.add("bottom", {"image": ("out", ["RawYUV(bottom)"])}, 5)
    lab.add("convert", {"raw": ("in", ["RawYUV(ceiling)"]), "bgr": ("out", ["BGR(ceiling)"])})
    return lab


def connected(field: Field, name: str) -> Dict[str, str]:
    ports = field.host.nodelet(name).ports.values()
    return {port.name: port.topic for port in ports if port.topic}


def test_clients_share_a_topic_only_if_they_ask_for_the_same(lab: Field) -> None:
    first = lab.acquire("RawYUV(?camera)").claim
    same = lab.acquire("RawYUV( ?camera )")
    other = lab.acquire("RawYUV(ceiling)")
    assert same.claim.topic == first.topic != other.claim.topic
    assert (same.spawned, other.spawned) == ((), ("/relay_of_ceiling_1_image_1",))
    lab.settle(1.0)
    assert {first.topic, other.claim.topic} <= lab.moving
    lab.reconciler.release(other.claim.claim_id)
    lab.tidy()
    assert lab.host.running == ["/ceiling_1"]


def test_names_of_relays_do_not_grow(lab: Field) -> None:
    """A camera that takes the place of a relay has its topic, which other clients do not share."""
    claim, relays = lab.acquire("RawYUV(?camera)").claim, []
    for tag in ("RawYUV(ceiling)", "RawYUV(?camera)", "RawYUV(ceiling)"):
        other = lab.acquire(tag)
        relays += other.spawned
        lab.reconciler.release(claim.claim_id)
        lab.manager.destroy(other.spawned[0])
        lab.settle()
        claim = other.claim
        assert lab.host.publishers(claim.topic) == ["/ceiling_1"]
    assert relays == [f"/relay_of_ceiling_1_image_{number}" for number in (1, 2, 1)]


# Claims that wait, claims that ended


def test_a_claim_that_waits_delivers_nothing_and_says_so_after_that(field: Field) -> None:
    claim = field.acquire().claim
    field.settle()
    told: List[Tuple[ClaimState, List[str]]] = []

    def listen(event: ClaimEvent) -> None:
        told.append((event.after.state, field.host.publishers(claim.topic)))

    field.on_event = listen
    field.host.topics.clear()
    field.settle()
    assert told == [(ClaimState.PENDING, [])]
    assert {name: connected(field, name) for name in field.host.running} == {
        name: {} for name in claim.nodelets
    }
    field.host.topics.add("/joint_states")
    field.settle()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.labels() == CHAIN, "what was kept for it is used again"
    assert claim.topic in field.moving


def test_what_lingers_keeps_no_wires_and_is_used_again(field: Field) -> None:
    claim = field.acquire().claim
    field.reconciler.release(claim.claim_id)
    field.tick()
    running = field.host.running
    assert [connected(field, name) for name in running] == [{}] * 4
    again = field.acquire()
    assert (again.spawned, list(again.reused)) == ((), ["/joint_states", *running][1:])
    field.settle()
    assert again.claim.topic in field.moving
    assert field.host.running == running


# Actions of people


def test_what_died_comes_back_without_what_does_not_fit_any_more(lab: Field) -> None:
    any_camera = lab.acquire("RawYUV(?camera)").claim
    lab.spawn("convert", "/mine", config={"raw": any_camera.topic}, isolated=True)
    manager = lab.manager.graph.get("/mine").manager
    lab.settle()

    lab.host.fail_at("load", "/mine", "not yet")
    lab.host.kill(manager)
    lab.tick()
    lab.manager.remove_transformation("ceiling")
    lab.settle()
    assert lab.host.publishers(any_camera.topic) == ["/bottom_1"]
    lab.host.recover()
    lab.settle(60.0)
    assert "/mine" in lab.host.running
    assert connected(lab, "/mine") == {}


def test_a_relay_asks_for_what_all_senders_on_a_topic_have_in_common(lab: Field) -> None:
    other = {"image": ("out", ["RawYUV(bottom)"])}
    for label in ("other", "mine"):
        lab.manager.add_transformation(specification(label, "lab/ceiling", other, 1, IMAGE))
    claim = lab.acquire("RawYUV(bottom)", exclude=("bottom",)).claim
    lab.spawn("mine", "/mine", config={"image": "/image"})
    front = topic("front", "/image", "RawYUV(front)", "RawYUV(bottom)", datatype=IMAGE)
    lab.manager.add_transformation(front)
    lab.host.topics.add("/image")
    for label in ("other", "mine"):
        lab.manager.remove_transformation(label)
    lab.settle(3.0)
    assert lab.state(claim.claim_id) is ClaimState.ACTIVE
    assert lab.host.publishers(claim.topic) == ["/relay_of_image_1"]
    assert claim.topic in lab.moving


def test_what_is_excluded_has_no_part_in_a_described_topic_either(lab: Field) -> None:
    lab.spawn("bottom", "/mine", config={"image": "/image"})
    seen = topic("seen", "/image", "RawYUV(bottom)", datatype=IMAGE)
    lab.manager.add_transformation(seen)
    lab.host.topics.add("/image")
    assert lab.acquire("RawYUV(bottom)").claim.state is ClaimState.ACTIVE
    with pytest.raises(NoPlanFound):
        lab.acquire("RawYUV(bottom)", exclude=("bottom",))
    assert lab.acquire("RawYUV(bottom)", exclude=("ceiling",)).claim.state is ClaimState.ACTIVE


# Plain nodelets, which come up again when they are connected elsewhere


def test_claims_are_made_of_nodelets_with_live_ports(lab: Field) -> None:
    lab.host.cpp.add(lab.add("plain", {"one": ("out", ["Sum(all)"])}))
    lab.host.stock = True
    with pytest.raises(SpawnFailed, match="the topics of '/plain_1' are fixed"):
        lab.acquire("Sum(all)")
    assert lab.host.running == []
    lab.host.stock = False
    lab.host.processes.clear()  # a nodelet manager with our library is there by now
    assert lab.acquire("Sum(all)").claim.state is ClaimState.ACTIVE
