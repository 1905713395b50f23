# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Restarts keep wiring, claims, protection and neighbours, and pick up changes."""

from __future__ import annotations

import itertools
from typing import Any, Callable, List

import pytest
from clocks import HandClock
from unit.manager.field import CHAIN, IMAGE, Field
from unit.manager.world import CAMERA, RELAY, TRACKER, Killed, World

from dyknow.errors import (
    CannotMove,
    HostError,
    HostTimeout,
    InvalidParameters,
    NameTaken,
    RestartFailed,
    SpawnFailed,
    UnknownNodelet,
)
from dyknow.manager.host import LoadRequest
from dyknow.model.graph import NodeletKind
from dyknow.model.streams import ClaimState
from dyknow.model.transformation import Parameter


@pytest.fixture
def world(tmp_path: Any) -> World:
    return World(str(tmp_path / "state"), clock=HandClock())


@pytest.fixture
def front(world: World) -> World:
    """A world with a camera."""
    world.spawn("camera", "front", config={"image": "/a"})
    return world


def check_front(world: World) -> None:
    """The camera, and nothing else, runs on the topic to which it was connected."""
    assert world.states() == {"/front": "RUNNING"}
    assert world.host.nodelet("/front").ports["image"].topic == "/a"


def loads(world: World) -> List[str]:
    return [name for operation, name in world.host.calls if operation in ("unload", "load")]


def test_a_restart_keeps_what_users_have_changed(world: World) -> None:
    given = (Parameter("rate", "", "5"),)
    world.spawn("camera", "front", config={"image": "/a"}, is_protected=True, parameters=given)
    world.spawn("relay", "other", config={"in": "/a"})
    world.manager.connect([("/front", {"image": "/moved"})])
    before, other = world.manager.graph.get("/front"), world.host.nodelet("/other")
    world.host.calls.clear()
    done = world.manager.restart("front")
    assert (done.names, done.remarks) == (("/front",), "")
    assert loads(world) == ["/front", "/front"]
    after = world.manager.graph.get("/front")
    assert after.status == before.status
    assert world.host.nodelet("/front").ports["image"].topic == "/moved"
    assert world.host.parameters["/front/rate"] == 5.0
    assert world.host.nodelet("/other") is other
    world.manager.look()
    assert world.manager.graph.get("/front").status == before.status


def test_a_new_specification_and_new_code_are_shown_and_taken(world: World) -> None:
    """What is shown lasts longer than the manager."""

    def shown() -> str:
        world.manager.look()
        return world.manager.graph.get("/front").status.outdated

    world.host.code["pkg/Camera"] = "old"
    world.spawn("camera", "front", config={"image": "/a"})
    assert shown() == ""
    world.host.code["pkg/Camera"] = "new"
    world.kill_manager()
    assert shown() == "its code changed since it was loaded"
    new = CAMERA.replace(">30<", ">10<").replace("Raw(camera)", "Raw(front)")
    world.manager.add_transformation(new)
    assert shown() == "its specification and its code changed since it was loaded"
    assert world.states() == {"/front": "RUNNING"}
    world.kill_manager()
    assert world.manager.graph.get("/front").status.outdated
    world.manager.restart("/front")
    assert shown() == world.manager.graph.get("/front").detail == ""
    (port,) = world.manager.graph.get("/front").ports
    assert (port.topic, port.tags) == ("/a", ("Raw(front)",))
    assert world.host.parameters == {"/front/rate": 10.0}


def test_a_library_in_cpp_is_loaded_again_by_a_new_process_alone(world: World) -> None:
    world.host.stock = False
    world.host.sources["pkg/Native"] = [("image", "in", IMAGE), ("~out", "out", IMAGE)]
    world.host.code["pkg/Native"] = "old"
    world.spawn("native", "one")
    world.host.code["pkg/Native"] = "new"
    manager = world.manager.graph.get("/one").manager
    done = world.manager.restart("/one")
    assert f"is loaded by a restart of {manager}" in done.remarks
    world.spawn("native", "two")
    world.manager.look()
    assert all(each.status.outdated for each in world.manager.graph.all())
    for name in ("one", "two"):
        world.manager.destroy(name)
    for name in ("one", "two"):  # by the library that is loaded
        world.spawn("native", name)
    world.manager.look()
    assert all(each.status.outdated for each in world.manager.graph.all())
    done = world.manager.restart(manager)
    assert (done.names, done.remarks) == (("/one", "/two"), "")
    world.manager.look()
    assert not any(each.status.outdated for each in world.manager.graph.all())


def test_ports_that_are_gone_are_told(world: World) -> None:
    world.spawn("relay", "slow", config={"in": "/a", "out": "/b"})
    world.manager.add_transformation(RELAY.replace('<port type="in">in</port>', ""))
    world.host.sources["pkg/Relay"] = [("out", "out", IMAGE)]
    done = world.manager.restart("slow")
    assert done.remarks == "port 'in' of /slow is gone, and its connection to /a with it"
    assert dict(world.manager.graph.get("/slow").topics) == {"out": "/b"}


def test_what_cannot_run_is_refused_and_runs_on(world: World) -> None:
    world.spawn("camera", "front")
    world.host.calls.clear()
    world.host.broken.add("pkg/Camera")
    with pytest.raises(HostError, match="invalid syntax"):
        world.manager.restart("front")
    world.spawn("relay", "track")
    world.host.calls.clear()
    world.manager.add_transformation(TRACKER.replace(">tracker", ">relay"))
    with pytest.raises(InvalidParameters, match=r"\?camera"):
        world.manager.restart("track")
    assert loads(world) == []
    assert world.states() == {"/front": "RUNNING", "/track": "RUNNING"}
    with pytest.raises(UnknownNodelet, match="/frond"):
        world.manager.restart("frond")


def test_what_others_made_is_not_restarted(front: World) -> None:
    front.host.add("/external")
    front.host.run_node("/driver", "pkg/Camera", {}, NodeletKind.NODE)
    manager = front.manager.graph.get("/front").manager
    front.host.load(manager, LoadRequest("/theirs", "pkg/Relay"), 1.0)
    front.manager.look()
    before = front.host.running
    for name, why in (
        ("/external", "where it was started"),
        ("/driver", "where it was started"),
        (manager, "runs /theirs, which this manager did not make"),
    ):
        with pytest.raises(HostError, match=why):
            front.manager.restart(name)
    assert front.host.running == before


def test_a_specification_that_does_not_work_gives_way_to_the_former_one(front: World) -> None:
    new = CAMERA.replace(">30<", ">10<").replace("<port ", '<port type="in">more</port><port ')
    front.manager.add_transformation(new)
    with pytest.raises(
        RestartFailed, match="no port 'more'.*as its former specification"
    ) as raised:
        front.manager.restart("front")
    assert raised.value.is_back
    check_front(front)
    assert front.host.parameters == {"/front/rate": 30.0}
    front.manager.look()
    assert front.manager.graph.get("/front").status.outdated


def test_code_that_does_not_start_is_tried_as_soon_as_it_changes(world: World) -> None:
    world.host.code["pkg/Camera"] = "old"
    world.spawn("camera", "front", config={"image": "/a"})
    world.host.code["pkg/Camera"] = "bad"
    world.host.fail_at("load", "/front", "AttributeError: imag")
    with pytest.raises(RestartFailed, match="AttributeError: imag; it is tried again"):
        world.manager.restart("front")
    assert world.states() == {"/front": "FAILED"}
    for _ in range(5):  # the pauses grow
        world.manager.look()
    world.host.recover()
    world.manager.look()
    assert world.states() == {"/front": "FAILED"}
    world.host.code["pkg/Camera"] = "good"
    world.manager.look()
    check_front(world)


def test_a_process_that_does_not_answer_restarts_its_nodelet_later(front: World) -> None:
    manager = front.manager.graph.get("/front").manager
    front.host.hang(manager)
    with pytest.raises(HostTimeout):
        front.manager.restart("front")
    front.host.wake(manager)
    front.host.vanish("/front")  # the answer to the question that hung
    front.manager.look()
    check_front(front)


def pass_time(world: World, seconds: float = 40.0, looks: int = 5) -> None:
    """Look after each pause, so that whatever failed is tried again."""
    assert isinstance(world.clock, HandClock)
    for _ in range(looks):
        world.clock.time += seconds
        world.manager.look()


def answer(world: World) -> None:
    """Let late calls arrive, and look when the pause after a failure is over."""
    world.host.recover()
    world.host.slow.clear()
    world.host.arrive()
    pass_time(world, 1.0, 1)


LATE = [
    pytest.param(lambda world: world.manager.restart("front"), id="restart"),
    pytest.param(lambda world: world.manager.move("/front", "/other"), id="move"),
]


@pytest.mark.parametrize("dies", [False, True])
@pytest.mark.parametrize("change", LATE)
def test_a_nodelet_comes_back_however_late_its_unload_is(
    world: World, change: Callable[[World], Any], dies: bool
) -> None:
    """Its process lists it meanwhile; an unload by another client looks the same."""
    world.host.code["pkg/Camera"] = "old"
    world.spawn("camera", "front", config={"image": "/a"})
    world.host.add("/other")
    before = world.host.nodelet("/front")
    world.host.slow.add("/front")
    world.host.code["pkg/Camera"] = "new"
    if dies:
        world.host.fail_at("unload", error=KeyboardInterrupt())
    with pytest.raises((HostTimeout, KeyboardInterrupt)):
        change(world)
    world.host.recover()
    if dies:
        world.kill_manager()
    world.manager.look()
    assert world.host.nodelet("/front") is before
    assert world.states() != {"/front": "RUNNING"}
    answer(world)
    check_front(world)
    assert world.manager.graph.get("/front").status.outdated == ""
    world.host.vanish("/front")
    world.manager.look()
    assert world.states() == {}, "the next unload is another client's"


def test_a_nodelet_whose_load_ends_after_all_is_connected(front: World) -> None:
    """A manager was killed during the load; that of its next life finds the name taken."""
    front.host.vanish("/front")
    request = LoadRequest("/front", "pkg/Camera")
    front.host.fail_at("load", error="it is being loaded")
    with pytest.raises(RestartFailed):
        front.manager.restart("front")
    front.host.recover()
    front.host.load(front.manager.graph.get("/front").manager, request, 1.0)
    front.manager.look()
    check_front(front)
    assert front.manager.graph.get("/front").topics == {"image": "/a"}


def test_nothing_is_left_of_a_spawn_whose_undoing_is_late(world: World) -> None:
    world.host.slow.add("/front")
    with pytest.raises(SpawnFailed, match="did not answer in time"):
        world.spawn("camera", "front", config={"image": "/a"})
    world.manager.look()
    with pytest.raises(NameTaken):
        world.spawn("camera", "front")
    world.host.slow.clear()
    world.manager.look()
    assert (world.states(), world.host.running, world.host.parameters) == ({}, [], {})


def test_a_repair_whose_undoing_is_late_is_repeated(front: World) -> None:
    front.host.kill(front.manager.graph.get("/front").manager)
    front.host.slow.add("/front")
    for _ in range(2):
        front.manager.look()
        assert front.states() == {"/front": "FAILED"}
    answer(front)
    check_front(front)


def test_a_name_that_is_taken_meanwhile_is_no_success(front: World) -> None:
    """Another client loads a nodelet of that name as soon as the former one is gone."""
    manager = front.manager.graph.get("/front").manager

    def fail(operation: str, argument: str) -> None:
        if operation == "load":
            front.host.recover()
            front.host.load(manager, LoadRequest("/front", "pkg/Camera"), 1.0)

    front.host.fail = fail
    with pytest.raises(RestartFailed, match="a nodelet named '/front' is already loaded"):
        front.manager.restart("front")
    front.manager.look()
    assert front.states() == {"/front": "RUNNING"}


@pytest.mark.parametrize("is_seen_late", [True, False])
def test_a_late_load_of_a_new_specification_gives_way_to_the_former_one(
    front: World, is_seen_late: bool
) -> None:
    front.host.sources["pkg/New"] = front.host.sources["pkg/Camera"]
    new = CAMERA.replace("pkg/Camera", "pkg/New").replace('name="rate"', 'name="hz"')
    front.manager.add_transformation(new)

    def fail(operation: str, argument: str) -> None:
        if operation == "loaded":  # it is up, and the answer is late
            front.host.slow.add("/front")
            raise HostTimeout("it was not up in time")

    front.host.fail = fail
    with pytest.raises(RestartFailed, match="not up in time; it is tried again"):
        front.manager.restart("front")
    front.host.recover()
    if is_seen_late:
        front.manager.look()
        assert front.states() != {"/front": "RUNNING"}
    answer(front)
    check_front(front)
    assert front.host.nodelet("/front").request.source == "pkg/Camera"
    assert front.host.parameters == {"/front/rate": 30.0}
    front.manager.look()
    assert front.manager.graph.get("/front").status.outdated, "its specification is the former"
    front.manager.destroy("front")
    assert front.host.parameters == {}


def test_a_late_unload_leaves_no_parameters_of_the_former_specification(front: World) -> None:
    front.manager.add_transformation(CAMERA.replace('name="rate"', 'name="hz"'))
    front.host.slow.add("/front")
    with pytest.raises(HostTimeout):
        front.manager.restart("front")
    answer(front)
    check_front(front)
    assert front.host.parameters == {"/front/hz": 30.0}
    front.manager.destroy("front")
    assert front.host.parameters == {}


def test_a_nodelet_that_may_still_run_keeps_its_parameters(front: World) -> None:
    """The manager is killed before it notes that undoing a load was late."""
    front.host.kill(front.manager.graph.get("/front").manager)
    front.host.slow.add("/front")
    put, killed = front.manager.graph.put, []

    def fail(operation: str, argument: str) -> None:
        if operation == "loaded":
            raise HostTimeout("it was not up in time")
        if operation == "unload":
            killed.append(argument)

    def no_more(*records: Any, **kwds: Any) -> None:
        if killed:
            raise Killed
        put(*records, **kwds)

    front.host.fail, front.manager.graph.put = fail, no_more  # type: ignore[method-assign]
    with pytest.raises(Killed):
        front.manager.look()
    front.host.recover()
    front.host.slow.clear()
    front.kill_manager()
    front.manager.look()
    assert front.states() == {"/front": "RUNNING"}
    assert front.host.parameters == {"/front/rate": 30.0}


def test_a_spawn_that_never_returned_is_undone_when_its_process_answers(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The manager was killed amid it; its next life has heard nothing of the process."""

    def kill(operation: str, argument: str) -> None:
        if operation in ("loaded", "unload"):
            raise Killed

    world.host.fail = kill
    with pytest.raises(Killed):
        world.spawn("camera", "front", config={"image": "/a"})
    world.host.recover()
    manager = world.manager.graph.get("/front").manager
    world.host.hang(manager)
    reported = world.host.reported
    monkeypatch.setattr(
        world.host,
        "reported",
        lambda host, name: None if world.host.is_hung(manager) else reported(host, name),
    )
    world.kill_manager()
    world.host.wake(manager)
    pass_time(world, 1.0, 1)
    assert (world.states(), world.host.running, world.host.parameters) == ({}, [], {})


def test_a_nodelet_manager_is_restarted_with_all_its_nodelets(world: World) -> None:
    world.spawn("camera", "front", config={"image": "/a"}, is_protected=True)
    world.spawn("relay", "slow", config={"in": "/a"})
    world.spawn("relay", "alone", isolated=True)
    manager, alone = world.manager.graph.get("/slow").manager, world.host.nodelet("/alone")
    before = [each.status for each in world.manager.graph.all()]
    old = world.host.states()[manager].incarnation
    assert world.manager.restart(manager).names == ("/front", "/slow")
    assert world.host.states()[manager].incarnation != old
    assert [each.status for each in world.manager.graph.all()] == before
    assert world.host.nodelet("/alone") is alone
    world.manager.look()
    assert world.manager.lifecycle.suspects.verdict("/front") == ""


# Parameters


def test_a_parameter_is_set_for_life(world: World) -> None:
    world.spawn("camera", "front")
    done = world.manager.set_parameter("front", Parameter("rate", "", "5"))
    assert not done.is_read and done.remarks == ""
    assert world.host.parameters["/front/rate"] == 5.0
    assert world.manager.graph.get("/front").status.parameters == (
        Parameter("rate", "double", "5"),
    )
    world.kill_manager()
    world.host.kill(world.manager.graph.get("/front").manager)
    world.manager.look()
    assert world.states() == {"/front": "RUNNING"}
    assert world.host.parameters["/front/rate"] == 5.0
    world.host.reconfigurable.add("/front")
    assert world.manager.set_parameter("front", Parameter("rate", "int", "6")).is_read
    world.manager.destroy("front")
    assert world.host.parameters == {}


def test_a_parameter_that_cannot_be_set_changes_nothing(world: World) -> None:
    world.spawn("camera", "front")
    with pytest.raises(InvalidParameters, match="rate"):
        world.manager.set_parameter("front", Parameter("rate", "", "fast"))
    assert (
        "declares no parameter 'rat'"
        in world.manager.set_parameter("front", Parameter("rat", "", "5")).remarks
    )
    world.host.fail_at("set_parameter")
    with pytest.raises(HostError):
        world.manager.set_parameter("front", Parameter("rate", "", "5"))
    assert [each.name for each in world.manager.graph.get("/front").parameters] == ["rat"]
    world.host.recover()
    world.manager.add_transformation(TRACKER)
    world.spawn("tracker", "track", parameters=[Parameter("?camera", "", "cam1")])
    with pytest.raises(InvalidParameters, match=r"\?camera for life"):
        world.manager.set_parameter("track", Parameter("?camera", "", "cam2"))


# Claims wait


def restart(field: Field, name: str) -> None:
    """Restart, and let rounds pass while the nodelet is away: no claim changes."""
    events: List[str] = []
    field.on_event = lambda event: events.append(event.reason)

    def pass_time(operation: str, argument: str) -> None:
        if operation == "load":
            field.host.recover()
            for _ in range(20):
                field.tick()
            assert name in field.manager.graph.restarting
            field.host.fail = pass_time

    field.host.fail = pass_time
    field.manager.restart(name)
    field.host.recover()
    assert events == []


def move(field: Field, name: str) -> None:
    before = field.manager.graph.get(name).manager
    field.host.widen(NodeletKind.PYTHON)
    (target,) = set(field.host.processes) - {before}
    field.manager.move(name, target)
    assert field.manager.graph.get(name).manager == target


def restart_all(field: Field, name: str) -> None:
    field.manager.restart(field.manager.graph.get(name).manager)


@pytest.mark.parametrize(
    ("change", "label"),
    [*itertools.product((restart, move), CHAIN), (restart_all, "detector")],
)
def test_claims_wait(field: Field, change: Callable[[Field, str], None], label: str) -> None:
    claim = field.acquire(max_silence=0.5).claim
    field.settle(5.0)
    before = {name: field.host.nodelet(name) for name in field.host.running}
    name = f"/{label.replace(' ', '_')}_1"
    topics = field.manager.graph.get(name).topics
    change(field, name)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.settle(5.0)
    changed = {each for each in before if field.host.nodelet(each) is not before[each]}
    assert changed == (set(before) if change is restart_all else {name})
    assert field.host.running == sorted(before), "nothing was replaced"
    assert not any("lost" in each or "mended" in each for each in field.reasons())
    assert field.manager.graph.get(name).topics == topics
    field.check_flows(claim)
    field.tidy()


def test_only_what_runs_in_a_nodelet_manager_can_move(world: World) -> None:
    world.spawn("camera", "alone", isolated=True)
    world.spawn("native", "native")
    world.spawn("camera", "front")
    here = world.manager.graph.get("/front").manager
    world.host.widen(NodeletKind.PYTHON)
    for name, target in (("/alone", here), ("/native", here), ("/front", here)):
        with pytest.raises(CannotMove):
            world.manager.move(name, target)
    with pytest.raises(UnknownNodelet):
        world.manager.move("/absent", here)
    assert set(world.states().values()) == {"RUNNING"}


def test_a_part_that_does_not_come_up_again_is_replaced(field: Field) -> None:
    claim = field.acquire().claim
    field.settle(5.0)
    field.host.fail_at("load", "bottom_camera", "it is broken")
    with pytest.raises(RestartFailed):
        field.manager.restart("/bottom_camera_1")
    field.settle(5.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert "ceiling camera" in field.labels()
    field.tidy()


def test_no_repair_is_taken_for_a_spawn_that_never_returned(world: World) -> None:
    """Where the repair before it may have loaded the nodelet, and the manager is killed."""
    world.spawn("camera", "front", config={"image": "/a"}, is_protected=True)
    world.host.kill(world.manager.graph.get("/front").manager)
    world.host.slow.add("/front")  # its load fails, and undoing that is late
    world.manager.look()
    world.host.slow.clear()
    world.host.arrive()
    world.host.fail_at("load", error=Killed())
    with pytest.raises(Killed):
        pass_time(world)
    world.host.recover()
    world.kill_manager()
    pass_time(world)
    check_front(world)


def test_a_process_that_dies_of_the_unload_of_a_restart_is_no_end(world: World) -> None:
    world.spawn("camera", "front", config={"image": "/a"}, is_protected=True)
    manager = world.manager.graph.get("/front").manager

    def fail(operation: str, argument: str) -> None:
        if operation == "unload":
            world.host.crash(manager, ["/front"], unloading=["/front"])
            raise HostError("the process ended")
        if operation == "load":
            raise HostError("no camera")

    world.host.fail = fail
    with pytest.raises(RestartFailed, match="no camera"):
        world.manager.restart("front")
    world.manager.look()
    assert world.states() == {"/front": "FAILED"}
    world.host.recover()
    pass_time(world)
    assert world.states() == {"/front": "RUNNING"}
