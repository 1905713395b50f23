# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A nodelet that was at work in two crashes is kept apart; its neighbours are left in peace."""

from __future__ import annotations

from pathlib import Path

import pytest
from unit.manager.field import LIBRARY as FIELD_LIBRARY
from unit.manager.field import Field, transformation
from unit.manager.world import World

from dyknow import names
from dyknow.errors import HostError, NoPlanFound
from dyknow.manager.host import Crash
from dyknow.manager.supervision.suspects import ENOUGH, MEMORY, Suspects
from dyknow.model.graph import State
from dyknow.model.streams import ClaimState

SHARED = "/fake_0"


@pytest.fixture
def world(tmp_path: Path) -> World:
    world = World(str(tmp_path / "state.db"))
    world.spawn("camera", "bad", config={"image": "/i"}, is_protected=True)
    world.spawn("relay", "good", config={"in": "/i"})
    return world


def crash(world: World, *running: str) -> None:
    """Crash the process of the nodelets that share one, and look."""
    world.host.crash(SHARED, running)
    world.manager.look()


def test_after_two_crashes_the_one_at_work_is_restored_alone(world: World) -> None:
    crash(world, "/bad")
    assert not world.manager.graph.get("/bad").isolated  # once may be chance
    crash(world, "/bad")
    bad, good = world.manager.graph.get("/bad"), world.manager.graph.get("/good")
    assert world.states() == {"/bad": "RUNNING", "/good": "RUNNING"}
    assert (bad.isolated, bad.is_protected, dict(bad.topics)) == (True, True, {"image": "/i"})
    assert bad.manager != SHARED
    assert (good.manager, good.isolated, good.detail) == (SHARED, False, "")
    assert "SIGSEGV" in bad.detail
    world.kill_manager()
    world.manager.look()
    assert world.manager.graph.get("/bad").detail == bad.detail
    loads = world.host.calls.count(("load", "/good"))
    for _ in range(3):
        world.host.crash(world.manager.graph.get("/bad").manager, ["/bad"])
        world.manager.look()
    assert world.host.calls.count(("load", "/good")) == loads
    world.manager.set_protection("/bad", False)
    world.manager.destroy("bad")
    assert not world.spawn("camera", "bad").isolated, "its code may have been mended"


def test_who_was_killed_is_no_suspect(world: World) -> None:
    for _ in range(5):
        world.host.kill(SHARED)
        world.manager.observer._backoff.forgive("/bad")
        world.manager.observer._backoff.forgive("/good")
        world.manager.look()
    assert world.states() == {"/bad": "RUNNING", "/good": "RUNNING"}
    assert not world.manager.graph.get("/bad").isolated


def test_where_nobody_can_tell_all_are_restored_alone(world: World) -> None:
    for _ in range(ENOUGH):
        world.host.crash(SHARED, None)
        world.manager.look()
    records = world.manager.graph.all()
    assert [each.isolated for each in records] == [True, True]
    assert len({each.manager for each in records}) == 2
    assert world.states() == {"/bad": "RUNNING", "/good": "RUNNING"}


def test_one_that_cannot_be_restored_alone_ends_nobody_else(world: World) -> None:
    def fail(operation: str, argument: str) -> None:
        if (operation, argument) in (("load", "/bad"), ("ensure", "/bad")):
            raise HostError("its process ends")

    crash(world, "/bad")
    world.host.fail = fail
    crash(world, "/bad")
    bad = world.manager.graph.get("/bad")
    assert bad.state is State.FAILED
    assert "its process ends" in bad.detail
    assert "SIGSEGV" in bad.detail
    assert world.host.running == ["/good"]
    world.manager.set_protection("/bad", False)
    world.manager.destroy("/bad")
    assert world.host.running == ["/good"]


# Nodelets that are made for claims


def crash_subsampler(field: Field, times: int = 1) -> None:
    for _ in range(times):
        field.settle()
        (each,) = (each for each in field.manager.graph.all() if each.label == "subsampler")
        field.host.crash(each.manager, [each.name])


def test_the_transformation_is_suspected_whatever_its_nodelets_are_called() -> None:
    field = Field()
    claim = field.acquire().claim
    crash_subsampler(field, ENOUGH)
    field.settle()
    field.tidy()
    (alone,) = (each for each in field.manager.graph.all() if each.isolated)
    assert alone.label == "subsampler"
    assert "2 crashes" in alone.detail and "SIGSEGV" in alone.detail
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert claim.topic in field.moving
    crash_subsampler(field)
    field.settle()
    field.tidy()
    assert [each.label for each in field.manager.graph.all() if each.isolated] == ["subsampler"]


def test_another_way_is_taken_than_one_that_crashes_before_its_stream_is_made() -> None:
    """A claim waits for a subsampler; each crashes its process when it is connected."""
    field = Field()

    def die(operation: str, argument: str) -> None:
        record = field.manager.graph.find(argument)
        if operation == "connect" and record is not None and record.label == "subsampler":
            field.host.crash(record.manager, [record.name])
            raise HostError("its process ended")

    field.host.fail = die
    field.manager.remove_transformation("subsampler")
    with pytest.raises(NoPlanFound):
        field.acquire()
    field.settle()
    field.manager.add_transformation(FIELD_LIBRARY)
    field.settle(2.0)
    field.host.sources["soccer/Spare"] = field.host.sources["soccer/Subsampler"]
    tags = "yuv YUV(?where);planes Planes(field)"
    spare = transformation("spare", "soccer/Spare", "in yuv,out planes", tags, 9)
    field.manager.add_transformation(spare)
    field.settle(60.0)
    field.tidy()
    (claim,) = field.living()
    assert claim.state is ClaimState.ACTIVE
    assert "spare" in field.labels()
    assert claim.topic in field.moving


def test_what_replaces_a_suspected_transformation_begins_anew() -> None:
    field = Field()
    field.acquire()
    crash_subsampler(field, ENOUGH)
    field.manager.look()
    field.manager.add_transformation(FIELD_LIBRARY)
    field.tidy()
    assert "subsampler" in field.labels()
    assert not [each for each in field.manager.graph.all() if each.isolated]


def test_accusations_are_forgotten_in_time() -> None:
    now = [0.0]
    suspects = Suspects(lambda: now[0])
    accusation = Crash("/m", "SIGBUS", frozenset({names.mark("/a")}))
    suspects.accuse(accusation, ())
    now[0] += MEMORY + 1
    suspects.accuse(accusation, ())
    assert not suspects.verdict("/a")
    suspects.accuse(accusation, ())
    assert suspects.verdict("/a")
    assert not suspects.verdict("/b")
