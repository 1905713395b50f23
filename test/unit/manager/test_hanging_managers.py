# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A nodelet manager that does not answer makes no request fail that can do without it."""

from __future__ import annotations

from unit.manager.field import GOAL, Field

from dyknow.model.streams import ClaimState


def hang(field: Field, manager: str) -> None:
    """Stop a nodelet manager; that shows when it is called."""
    field.host.hang(manager)
    field.host.unnoticed.add(manager)


def managers(field: Field) -> set[str]:
    return {record.manager for record in field.manager.graph.all()}


def test_a_stream_is_made_elsewhere(field: Field) -> None:
    field.host.add("/a_first")
    hang(field, "/a_first")
    got = field.acquire(GOAL)
    assert got.claim.state is ClaimState.ACTIVE
    assert "/a_first" not in managers(field)
    field.settle()


def test_a_stream_is_made_without_parts_that_do_not_answer(field: Field) -> None:
    camera = field.acquire("YUV(field)").claim
    place = field.manager.graph.get(camera.goal[0]).manager
    hang(field, place)
    got = field.acquire(GOAL)
    assert got.claim.state is ClaimState.ACTIVE
    assert camera.goal[0] not in got.claim.nodelets
    assert place not in {field.manager.graph.get(name).manager for name in got.claim.nodelets}


def test_a_stream_is_made_without_a_nodelet_that_does_not_answer(field: Field) -> None:
    field.spawn("bottom camera", "/mine")
    field.host.slow.add("/mine")
    got = field.acquire("YUV(field)")
    assert got.claim.state is ClaimState.ACTIVE
    assert got.claim.goal[0] != "/mine"


def test_the_transformation_is_not_blamed(field: Field) -> None:
    for name in ("/a", "/b", "/c"):
        field.host.add(name)
        hang(field, name)
    got = field.acquire("YUV(field)")
    assert got.claim.state is ClaimState.ACTIVE
    assert "bottom camera" not in field.reconciler._monitor.paused(())


def test_the_loss_of_a_manager_that_shows_at_one_nodelet_is_one_repair(field: Field) -> None:
    """Only the goal is counted, until its first message has come."""
    field.host.add("/far")
    field.spawn("bottom camera", "/camera", manager="/far", config={"image": "/camera/image"})
    config = {"yuv": "/camera/image", "planes": "/planes/planes"}
    field.spawn("subsampler", "/planes", manager="/far", config=config)
    claim = field.acquire("Planes(field)").claim
    assert claim.nodelets == ("/camera", "/planes")
    looking = field.manager.look
    field.manager.look = lambda changed=None: None  # type: ignore[method-assign]
    hang(field, "/far")
    for _ in range(15):
        field.tick()
    field.manager.look = looking  # type: ignore[method-assign]
    field.settle(5.0)
    assert [reason for reason in field.reasons() if reason.startswith("mended")] == [
        "mended: nodelet /camera does not answer; /bottom_camera_1, /subsampler_1 are used now"
    ]
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
