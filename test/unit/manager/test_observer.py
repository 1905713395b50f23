# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A true picture: changes by others are followed, dead nodelets are brought back."""

from __future__ import annotations

from typing import Dict, Tuple

import pytest
from unit.manager.world import World

from dyknow.errors import HostError, NameTaken
from dyknow.manager.host import HostReport, LoadRequest
from dyknow.manager.observer import PERIOD
from dyknow.model.graph import NodeletKind, State
from dyknow.periodic import PAUSE


def test_nodelets_of_a_nodelet_manager_that_exists_no_more_are_placed_again(world: World) -> None:
    world.spawn("relay", "a")
    world.host.hang("/fake_0")
    world.spawn("relay", "b", config={"in": "/i"})
    world.host.wake("/fake_0")
    assert world.manager.graph.get("/b").manager == "/fake_1"
    del world.host.processes["/fake_1"]  # fewer of them are wanted by the next life
    world.kill_manager()
    found = world.manager.graph.get("/b")
    assert (found.state, found.manager) == (State.RUNNING, "/fake_0")
    assert world.host.nodelet("/b").ports["in"].topic == "/i"


def test_what_came_back_during_a_look_is_not_lost_by_it(world: World) -> None:
    world.spawn("camera", "a")
    world.host.kill("/fake_0")
    real = world.host.poll

    def poll() -> HostReport:
        world.host.poll = real  # type: ignore[method-assign]
        report = real()
        with world.manager.graph.changing("/a") as record:
            assert record is not None
            world.manager.lifecycle.restore(record)
        return report

    world.host.poll = poll  # type: ignore[method-assign]
    seen: list[str] = []
    world.manager.graph.on_change = lambda: seen.append(world.states()["/a"])
    world.manager.look()
    assert set(seen) == {"STARTING", "RUNNING"}
    assert world.states() == {"/a": "RUNNING"}


@pytest.mark.parametrize("fault", ["hang", "kill"])
def test_what_a_nodelet_manager_hosts_is_lost_in_one_step(world: World, fault: str) -> None:
    for name in ("a", "b", "c"):
        world.spawn("camera", name)
    seen: list[set[str]] = []
    world.manager.graph.on_change = lambda: seen.append(set(world.states().values()))
    before = world.manager.graph.revision
    getattr(world.host, fault)("/fake_0")
    world.manager.look()
    assert seen[0] == {"LOST"}
    if fault == "hang":
        assert (len(seen), world.manager.graph.revision) == (1, before + 1)


@pytest.mark.parametrize("goes_on", [False, True])
def test_what_may_still_publish_is_not_taken_for_lost(world: World, goes_on: bool) -> None:
    world.spawn("camera", "a")
    world.host.leased.add("/fake_0")
    world.host.hang("/fake_0")
    world.manager.look()
    assert world.states() == {"/a": "RUNNING"}
    if goes_on:
        world.host.wake("/fake_0")
    world.host.leased.clear()
    world.manager.look()
    assert world.states() == {"/a": "RUNNING" if goes_on else "LOST"}


def test_ports_of_a_busy_nodelet_are_followed_by_the_next_look_which_comes_soon(
    world: World,
) -> None:
    world.spawn("relay", "b", config={"in": "/i"})
    world.host.connect("/b", {"in": "/elsewhere"})
    with world.manager.graph.changing("/b"):
        assert world.manager.look() == PAUSE
    assert dict(world.manager.graph.get("/b").topics) == {"in": "/i"}
    assert world.manager.look() == PERIOD
    assert dict(world.manager.graph.get("/b").topics) == {"in": "/elsewhere"}


def test_a_deliberate_unload_by_others_is_followed(world: World) -> None:
    world.spawn("camera", "a")
    world.spawn("camera", "b")
    world.host.vanish("/a")
    world.manager.look()
    assert world.states() == {"/b": "RUNNING"}
    world.kill_manager()
    assert world.states() == {"/b": "RUNNING"}
    assert world.host.running == ["/b"]


def test_what_a_process_unloads_as_it_ends_is_brought_back(world: World) -> None:
    world.spawn("camera", "a")
    real, answers = world.host.list, [[]]

    def ending(manager: str) -> list[str]:
        if answers:
            return answers.pop()
        raise HostError("the nodelet manager ends")

    world.host.list = ending  # type: ignore[method-assign, assignment]
    world.manager.look()
    world.manager.look()
    assert world.states() == {"/a": "LOST"}
    world.host.list = real  # type: ignore[method-assign]
    world.host.kill("/fake_0")
    world.manager.look()
    assert world.states() == {"/a": "RUNNING"}


def test_the_list_of_another_process_says_nothing(world: World) -> None:
    world.spawn("camera", "a", is_protected=True)
    real = world.host.list

    def restarted(manager: str) -> list[str]:
        world.host.list = real  # type: ignore[method-assign]
        world.host.kill(manager)
        world.host.ensure(NodeletKind.PYTHON)
        return real(manager)

    world.host.list = restarted  # type: ignore[method-assign, assignment]
    world.manager.look()
    world.manager.look()
    assert world.states() == {"/a": "RUNNING"}
    assert world.manager.graph.get("/a").is_protected


def test_a_nodelet_that_others_loaded_appears_without_a_transformation(world: World) -> None:
    world.spawn("camera", "a")
    world.host.load("/fake_0", LoadRequest("/guest", "pkg/Relay"), 1.0)
    world.manager.look()
    guest = world.manager.graph.get("/guest")
    assert (guest.label, guest.state, len(guest.ports)) == ("", State.RUNNING, 2)
    world.host.kill("/fake_0")
    world.manager.look()
    assert world.states() == {"/a": "RUNNING"}


def test_a_crash_is_remembered_while_its_nodelet_is_busy(world: World) -> None:
    world.spawn("camera", "a")
    world.host.crash("/fake_0", unloading=["/a"])  # which a third party had requested
    with world.manager.graph.changing("/a"):
        world.manager.look()
    world.manager.look()
    assert world.states() == {}


def test_one_that_cannot_come_back_says_why_and_is_tried_again(world: World) -> None:
    world.spawn("camera", "a")

    world.host.fail_at("load", error="the camera is unplugged")
    world.host.kill("/fake_0")
    world.manager.look()
    record = world.manager.graph.get("/a")
    assert record.state is State.FAILED
    assert "unplugged" in record.detail
    world.host.recover()
    world.manager.look()
    assert world.states() == {"/a": "RUNNING"}


class Killed(BaseException):
    """The manager is killed."""


def test_whatever_is_starting_says_why(world: World) -> None:
    """The cause is in the model for as long as a nodelet is not up, whoever asks, and when."""
    told = []

    def tell(operation: str, argument: str) -> None:
        record = world.manager.graph.find("/a")
        if record is not None and record.state is State.STARTING:
            told.append((operation, record.detail))
        if operation in troubles:
            raise troubles[operation]

    troubles: Dict[str, BaseException] = {}
    world.host.fail = tell
    world.spawn("camera", "a", config={"image": "/i"})
    assert set(told) == {
        (each, "it is being started in /fake_0") for each in ("load", "loaded", "ports", "connect")
    }

    told.clear()
    troubles["ensure"] = HostError("another node has that name")
    world.host.kill("/fake_0")
    world.manager.look()
    world.manager.look()
    assert [why for operation, why in told if operation == "ensure"] == [
        "its nodelet manager has died",
        "another node has that name",
    ]


def test_what_cannot_come_back_since_its_name_is_taken_says_so(world: World) -> None:
    world.spawn("camera", "a")

    world.host.fail_at("load", error=NameTaken("/a", "running", "another node"))
    world.host.kill("/fake_0")
    world.manager.look()
    assert detail(world) == (State.STARTING, "another node named '/a' is running")


def test_what_a_killed_manager_was_bringing_back_says_why_it_is_not_up(world: World) -> None:
    world.spawn("camera", "a", config={"image": "/i"})

    world.host.fail_at("loaded", error=Killed())
    world.host.kill("/fake_0")
    with pytest.raises(Killed):
        world.manager.look()

    world.host.fail_at("connect", error="the type differs")
    world.kill_manager()
    assert detail(world) == (State.STARTING, "the type differs")
    world.host.hang("/fake_0")
    world.manager.look()
    assert detail(world) == (State.STARTING, "nodelet manager /fake_0 does not answer")
    world.host.wake("/fake_0")
    world.host.recover()
    world.manager.look()
    assert detail(world) == (State.RUNNING, "")
    assert world.host.nodelet("/a").ports["image"].topic == "/i"


def detail(world: World) -> Tuple[State, str]:
    record = world.manager.graph.get("/a")
    return record.state, record.detail


def test_a_manager_that_was_killed_adopts_what_runs_and_restores_what_does_not(
    world: World,
) -> None:
    world.spawn("camera", "a", config={"image": "/i"})
    world.spawn("relay", "b", config={"in": "/i"})
    calls = len(world.host.calls)
    revision = world.manager.graph.revision
    world.kill_manager()
    changing = {"load", "unload", "connect", "retire"}
    assert not [call for call in world.host.calls[calls:] if call[0] in changing]
    assert world.states() == {"/a": "RUNNING", "/b": "RUNNING"}
    assert world.manager.graph.revision > revision
    world.store.close()
    world.host.kill("/fake_0")
    world.open()
    assert world.states() == {"/a": "RUNNING", "/b": "RUNNING"}
    assert world.host.nodelet("/b").ports["in"].topic == "/i"


def test_ending_on_purpose_forgets_nodelets_and_keeps_transformations(world: World) -> None:
    world.spawn("camera", "a", is_protected=True)
    world.spawn("camera", "alone", isolated=True)
    world.manager.end()
    assert world.host.running == []
    world.kill_manager()
    assert world.states() == {}
    assert len(world.manager.library) == 7


def test_an_unchanged_picture_is_no_new_revision(world: World) -> None:
    world.spawn("camera", "a")
    changes = []
    world.manager.graph.on_change = lambda: changes.append(1)
    revision = world.manager.graph.revision
    for _ in range(5):
        world.manager.look()
    assert (world.manager.graph.revision, changes) == (revision, [])


def test_a_nodelet_that_is_lost_is_logged_once(
    world: World, caplog: pytest.LogCaptureFixture
) -> None:
    world.spawn("camera", "a")

    def said() -> int:
        return sum("/a is lost" in each.getMessage() for each in caplog.records)

    for times in (1, 2):
        world.host.hang("/fake_0")
        for _ in range(20):
            world.manager.look()
        assert said() == times
        world.host.wake("/fake_0")
        world.manager.look()
    assert all(each.getMessage().count("/fake_0") <= 1 for each in caplog.records)


def test_what_ails_a_nodelet_is_shown_until_it_is_over(world: World) -> None:
    world.spawn("camera", "a")
    world.host.details["/a"] = "a callback has been running for 12 s"
    world.manager.look()
    assert world.manager.get_model().nodelets[0].detail == "a callback has been running for 12 s"
    world.manager.look()
    assert world.manager.get_model().nodelets[0].detail == "a callback has been running for 12 s"
    world.host.details.clear()
    world.manager.look()
    assert world.manager.get_model().nodelets[0].detail == ""
