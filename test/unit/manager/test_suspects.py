"""Who was at work in two crashes is kept apart; who was not is left in peace."""

from __future__ import annotations

from pathlib import Path

import pytest
from unit.manager.world import World

from dyknow import names
from dyknow.errors import HostError, SpawnFailed
from dyknow.manager.host import Crash
from dyknow.manager.model import State
from dyknow.manager.suspects import ENOUGH, MEMORY, Suspects

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
    loads = world.host.calls.count(("load", "/good"))
    for _ in range(3):
        world.host.crash(world.manager.graph.get("/bad").manager, ["/bad"])
        world.manager.look()
    assert world.host.calls.count(("load", "/good")) == loads


def test_why_it_is_alone_is_still_shown_after_a_restart_of_the_manager(world: World) -> None:
    for _ in range(ENOUGH):
        crash(world, "/bad")
    detail = world.manager.graph.get("/bad").detail
    assert detail
    world.kill_manager()
    assert world.manager.graph.get("/bad").detail == detail
    world.manager.look({"/bad"})
    assert world.manager.graph.get("/bad").detail == detail


def test_who_was_killed_is_no_suspect(world: World) -> None:
    for _ in range(5):
        world.host.kill(SHARED)
        world.manager.observer._patience._pasts.clear()
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


def test_a_spawn_whose_process_crashes_again_and_again_is_made_alone(world: World) -> None:
    def die(operation: str, argument: str) -> None:
        if (operation, argument) == ("load", "/new"):
            if world.manager.graph.get("/new").manager == SHARED:
                world.host.crash(SHARED, ["/new"])
            raise HostError("its process ends")

    world.host.fail = die
    for _ in range(ENOUGH):
        with pytest.raises(SpawnFailed):
            world.spawn("camera", "new")
        world.manager.look()
    loads = world.host.calls.count(("load", "/good"))
    with pytest.raises(SpawnFailed):
        world.spawn("camera", "new")
    world.manager.look()
    assert world.host.calls.count(("load", "/good")) == loads


def test_what_died_while_it_was_unloaded_is_gone(world: World) -> None:
    world.host.crash(SHARED, ["/good"], unloading=["/good"])
    world.manager.look()
    assert world.states() == {"/bad": "RUNNING"}


def test_a_destroyed_nodelet_begins_anew(world: World) -> None:
    world.manager.set_protection("/bad", False)
    for _ in range(ENOUGH):
        crash(world, "/bad")
    world.manager.destroy("/bad")
    assert not world.spawn("camera", "bad").isolated


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
