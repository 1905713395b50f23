# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A true picture: changes by third parties are followed, dead nodelets are brought back."""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Dict, List, Tuple

import pytest
from unit.manager.world import Killed, World

from dyknow.errors import HostError, HostTimeout, NameTaken
from dyknow.manager.host import HostReport, LoadRequest
from dyknow.manager.record import Record
from dyknow.manager.supervision.observer import PERIOD
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
def test_what_a_nodelet_manager_hosts_is_lost_in_one_step(
    world: World, fault: str, caplog: pytest.LogCaptureFixture
) -> None:
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
    for _ in range(20):
        world.manager.look()
    assert sum("/a is lost" in each.getMessage() for each in caplog.records) == 1


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


def test_ports_of_a_busy_nodelet_are_followed_by_the_next_look_which_is_soon(world: World) -> None:
    world.spawn("relay", "b", config={"in": "/i"})
    world.host.connect("/b", {"in": "/elsewhere"})
    with world.manager.graph.changing("/b"):
        assert world.manager.look() == PAUSE
    assert dict(world.manager.graph.get("/b").topics) == {"in": "/i"}
    assert world.manager.look() == PERIOD
    assert dict(world.manager.graph.get("/b").topics) == {"in": "/elsewhere"}


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


@pytest.mark.parametrize(
    ("error", "state", "words"),
    [
        (HostError("the camera is unplugged"), State.FAILED, "unplugged"),
        (NameTaken("/a", "running", "another node"), State.STARTING, "named '/a' is running"),
    ],
)
def test_one_that_cannot_come_back_says_why_and_is_tried_again(
    world: World, error: HostError, state: State, words: str
) -> None:
    world.spawn("camera", "a")
    world.host.fail_at("load", error=error)
    world.host.kill("/fake_0")
    world.manager.look()
    assert detail(world)[0] is state
    assert words in detail(world)[1]
    world.host.recover()
    world.manager.look()
    assert world.states() == {"/a": "RUNNING"}


def test_the_next_nodelet_of_a_name_does_not_wait_for_failures_of_the_last(world: World) -> None:
    for _ in range(2):
        world.spawn("camera", "a")
        for _ in range(2):  # as often it is brought back at once
            world.host.kill(world.manager.graph.get("/a").manager)
            world.manager.look()
            assert world.states() == {"/a": "RUNNING"}
        world.manager.destroy("a")


def test_whatever_is_starting_says_why(world: World) -> None:
    """The cause is in the model at any moment until a nodelet is up."""
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


def test_ending_on_purpose_forgets_nodelets_and_keeps_transformations(world: World) -> None:
    world.spawn("camera", "a", is_protected=True)
    world.spawn("camera", "alone", isolated=True)
    world.manager.end()
    assert world.host.running == []
    world.kill_manager()
    assert world.states() == {}
    assert len(world.manager.library) == 7


def test_a_model_never_has_a_revision_that_is_newer_than_its_nodelets(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.spawn("camera", "a")
    graph = world.manager.graph
    records = graph.all()

    def late() -> List[Record]:
        monkeypatch.undo()
        graph.put(replace(graph.get("/a"), detail="new"))
        return records

    monkeypatch.setattr(graph, "all", late)
    model = world.manager.get_model()
    assert model.nodelets[0].detail == ""
    assert model.revision < world.manager.get_model().revision


def test_what_ails_a_nodelet_is_shown_until_it_is_over(world: World) -> None:
    world.spawn("camera", "a")
    world.host.details["/a"] = "a callback has been running for 12 s"
    for _ in range(2):
        world.manager.look()
        assert world.manager.get_model().nodelets[0].detail == world.host.details["/a"]
    world.host.details.clear()
    world.manager.look()
    assert world.manager.get_model().nodelets[0].detail == ""


# Nodelet managers on unreachable hosts: nothing unknown is stated, and work is done later

FAR = "/far"


@pytest.fixture
def far(world: World) -> World:
    world.host.add(FAR)
    world.spawn("camera", "/a", manager=FAR)
    return world


def kill_manager(far: World) -> None:
    far.host.cut(FAR, known=False)
    far.kill_manager()


def kill_process(far: World) -> None:
    far.host.kill(FAR)
    far.host.add(FAR)
    far.host.cut(FAR)


def refuse(far: World) -> None:
    far.host.mend(FAR)
    far.host.fail_at("unload", error="not now")
    far.manager.look()
    far.host.recover()
    far.host.cut(FAR)


@pytest.mark.parametrize(
    "happens",
    [World.states, World.open, kill_manager, kill_process, refuse],
    ids=lambda f: f.__name__,
)
def test_a_destroy_that_nobody_can_verify_is_refused_and_made_good(
    far: World, happens: Callable[[World], object]
) -> None:
    far.host.cut(FAR)
    with pytest.raises(HostTimeout, match="'/a' is not destroyed yet: .* as soon as /far answers"):
        far.manager.destroy("/a")
    far.manager.look()
    happens(far)
    assert far.states() == {"/a": "LOST"}
    assert "as soon as /far answers" in far.manager.graph.get("/a").detail
    far.host.mend(FAR)
    before = len(far.host.calls)
    for _ in range(2):
        far.manager.look()
        assert (far.states(), far.host.running) == ({}, [])
    calls = far.host.calls[before:]
    assert [call for call in calls if call[0] in ("load", "unload")] == [("unload", "/a")]


def test_what_is_certainly_gone_is_destroyed_at_once(far: World) -> None:
    far.host.kill(FAR)
    far.manager.destroy("/a")
    assert far.states() == {}


def test_what_nobody_has_looked_for_yet_is_taken_to_be_as_it_was(far: World) -> None:
    far.host.cut(FAR, known=False, unseen=True)
    far.kill_manager()
    assert far.states() == {"/a": "RUNNING"}
    far.host.cut(FAR, known=False)
    far.manager.look()
    assert far.manager.graph.get("/a").state is State.LOST
    far.host.mend(FAR)
    far.manager.look()
    assert far.states() == {"/a": "RUNNING"}


def test_a_nodelet_manager_that_is_away_is_said_to_be(far: World) -> None:
    far.host.cut(FAR, known=False)
    with pytest.raises(HostError, match="'/far' does not answer"):
        far.spawn("camera", "/b", manager=FAR)


def test_what_others_loaded_is_destroyed_as_soon_as_its_process_answers(world: World) -> None:
    world.spawn("camera", "/a")
    host = world.manager.graph.get("/a").manager
    world.host.load(host, LoadRequest("/x", "pkg/Camera"), 1.0)
    world.manager.look()
    world.host.hang(host)
    with pytest.raises(HostTimeout, match="it is destroyed as soon as"):
        world.manager.destroy("/x")
    world.manager.look()
    assert world.states()["/x"] == "LOST"
    world.host.wake(host)
    for _ in range(3):
        world.manager.look()
    assert world.host.running == ["/a"] and set(world.states()) == {"/a"}
