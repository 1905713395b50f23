# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Spawn, destroy and connect: all or nothing."""

from __future__ import annotations

import threading
from typing import Callable, Mapping

import pytest
from clocks import HandClock, SteppedClock, in_thread, join
from unit.manager.world import World

from dyknow.errors import (
    Denied,
    DyKnowError,
    FixedTopics,
    HostError,
    HostTimeout,
    InvalidConfiguration,
    InvalidName,
    LimitExceeded,
    NotSpawnable,
    Protected,
    SpawnFailed,
    UnknownNodelet,
    UnknownTransformation,
)
from dyknow.guards import Guards
from dyknow.manager.manager import Manager
from dyknow.model.graph import NodeletKind, Restarted, State
from dyknow.model.transformation import Parameter


@pytest.fixture
def world() -> World:
    return World(clock=HandClock())


def nothing_left(world: World, name: str) -> bool:
    return (
        name not in world.host.running
        and name not in world.states()
        and not any(each.startswith(name + "/") for each in world.host.parameters)
        and name not in world.store.read("nodelets", lambda key, text: text)
        and not world.manager.graph.is_busy(name)
        and not any(state.isolated_for == name for state in world.host.states().values())
    )


def test_a_spawned_nodelet_runs_connected_with_its_parameters(world: World) -> None:
    world.spawn("camera", "front", config={"image": "pictures"})
    record = world.manager.graph.get("/front")
    assert record.state is State.RUNNING
    assert [(p.name, p.topic, p.tags) for p in record.ports] == [
        ("image", "/pictures", ("Raw(camera)",))
    ]
    assert world.host.parameters == {"/front/rate": 30.0}
    assert world.host.nodelet("/front").ports["image"].topic == "/pictures"
    record = world.spawn("relay", "robot/relay", config={"in": "pictures", "out": "~out"})
    assert dict(record.topics) == {"in": "/robot/pictures", "out": "/robot/relay/out"}


@pytest.mark.parametrize(
    ("label", "config", "error", "words"),
    [
        ("kamera", {}, UnknownTransformation, ["'kamera'", "camera"]),
        ("joints", {}, NotSpawnable, ["joints", "/joint_states"]),
        ("relay", {"inn": "/a"}, InvalidConfiguration, ["'inn'", "in, out"]),
        ("relay", {"inn": "/a", "out": "a b"}, InvalidConfiguration, ["'inn'", "'a b'"]),
        ("wrong ports", {}, SpawnFailed, ["'missing'", "in, out", "says out"]),
        ("wrong type", {}, SpawnFailed, ["sensor_msgs/Image", "std_msgs/Header"]),
        ("stranger", {}, HostError, ["pkg/Stranger"]),
    ],
)
def test_what_is_wrong_is_named_and_leaves_nothing(
    world: World, label: str, config: dict[str, str], error: type, words: list[str]
) -> None:
    with pytest.raises(error) as raised:
        world.spawn(label, "x", config=config)
    for word in words:
        assert word in str(raised.value)
    assert nothing_left(world, "/x")


@pytest.mark.parametrize("step", ["ensure", "load", "loaded", "ports", "connect"])
@pytest.mark.parametrize("isolated", [False, True])
def test_a_failure_at_any_step_leaves_nothing(world: World, step: str, isolated: bool) -> None:
    world.host.fail_at(step, error="went wrong")
    with pytest.raises((SpawnFailed, HostError), match="went wrong"):
        world.spawn("camera", "x", config={"image": "/i"}, isolated=isolated)
    world.host.recover()
    assert nothing_left(world, "/x")
    world.spawn("camera", "x", isolated=isolated)
    assert world.states() == {"/x": "RUNNING"}


@pytest.mark.parametrize("name", ["", "a b", "1x", "a//b", "~"])
def test_a_bad_name_is_refused(world: World, name: str) -> None:
    with pytest.raises(InvalidName):
        world.spawn("camera", name)


def test_destroy_unloads_and_deletes_the_parameters_it_set(world: World) -> None:
    world.spawn("camera", "a", is_protected=True)
    world.host.parameters["/a/by_somebody_else"] = 1
    with pytest.raises(Protected, match="dyknow unprotect"):
        world.manager.destroy("a")
    world.manager.set_protection("a", False)
    world.host.fail_at("unload", error="not now")
    with pytest.raises(HostError, match="not now"):
        world.manager.destroy("a")
    assert world.states() == {"/a": "RUNNING"}
    world.host.recover()
    world.manager.destroy("a")
    assert world.host.running == []
    assert world.host.parameters == {"/a/by_somebody_else": 1}
    with pytest.raises(UnknownNodelet):
        world.manager.destroy("a")


def test_an_isolated_nodelet_has_a_process_that_ends_with_it(world: World) -> None:
    own = world.spawn("camera", "alone", isolated=True).manager
    shared = world.spawn("camera", "shared").manager
    assert own != shared
    with pytest.raises(HostError, match=f"'/x' cannot be isolated in .*'{shared}'"):
        world.spawn("camera", "x", isolated=True, manager=shared)
    with pytest.raises(HostError, match=f"'{own}' is there for '/alone' alone"):
        world.spawn("camera", "x", manager=own)
    assert nothing_left(world, "/x")
    world.manager.destroy("alone")
    assert list(world.host.processes) == [shared]


def world_after(act: Callable[[Manager], object], is_protected: bool = False) -> World:
    """Act on a nodelet from another thread while its nodelet manager is being started."""
    clock = SteppedClock()
    world = World(clock=clock)
    acting: list[threading.Thread] = []

    def begin(what: str, argument: str) -> None:
        if what == "ensure" and not acting:
            acting.append(in_thread(lambda: act(world.manager)))
            clock.settle()

    world.host.fail = begin
    world.spawn("camera", "front", isolated=True, is_protected=is_protected)
    join(*acting)
    return world


def test_a_nodelet_that_is_being_made_is_destroyed_once_it_is_there() -> None:
    """So a client that was interrupted can take its spawn back."""

    def take_back(manager: Manager) -> None:
        manager.set_protection("front", False)
        manager.destroy("front")

    assert nothing_left(world_after(take_back, is_protected=True), "/front")


def test_a_nodelet_that_is_being_made_is_connected_once_it_is_there() -> None:
    world = world_after(lambda manager: manager.connect([("front", {"image": "/pictures"})]))
    assert world.manager.graph.get("/front").status.connections == {"image": "/pictures"}


def test_a_nodelet_that_is_being_made_is_restarted_once_it_is_there() -> None:
    restarted: list[Restarted] = []
    world = world_after(lambda manager: restarted.append(manager.restart("front")))
    assert restarted == [Restarted(("/front",))]
    assert world.manager.graph.get("/front").state is State.RUNNING


def test_a_nodelet_goes_to_its_neighbours_else_to_the_emptiest(world: World) -> None:
    first = world.host.ensure(NodeletKind.PYTHON)
    second = world.host._start("/second", NodeletKind.PYTHON, "")
    assert world.spawn("camera", "a", config={"image": "/i"}, manager=first).manager == first
    assert world.spawn("relay", "b", config={"in": "/i"}).manager == first
    assert world.spawn("relay", "c").manager == second
    with pytest.raises(HostError, match="'/nowhere'.*known"):
        world.spawn("relay", "d", manager="/nowhere")
    with pytest.raises(
        HostError, match=r"hosts no C\+\+ nodelets: it is there for a Python nodelet"
    ):
        world.spawn("native", "d", manager=first)


def test_a_nodelet_in_a_stock_manager_keeps_its_topics(world: World) -> None:
    record = world.spawn("native", "robot/n", config={"image": "/cam/image", "~out": "/small"})
    assert record.is_fixed and record.status.is_fixed
    assert world.host.nodelet("/robot/n").request.remappings == {
        "/robot/image": "/cam/image",
        "/robot/n/out": "/small",
    }
    assert [(p.name, p.topic) for p in record.ports] == [
        ("image", "/cam/image"),
        ("~out", "/small"),
    ]
    with pytest.raises(FixedTopics, match="launch-prefix 'rosrun dyknow rewirable'"):
        world.manager.connect([("robot/n", {"image": "/other"})])
    world.manager.look()
    assert world.manager.graph.get("/robot/n").topics == {"image": "/cam/image", "~out": "/small"}
    world.host.kill(record.manager)
    world.manager.look()
    assert world.manager.graph.get("/robot/n").is_fixed
    assert world.host.nodelet("/robot/n").request.remappings["/robot/image"] == "/cam/image"


@pytest.fixture
def live(world: World) -> World:
    """A world in which C++ nodelets are re-wired while they run."""
    world.host.stock = False
    world.host.sources["pkg/Native"] = [
        ("image", "in", "sensor_msgs/Image"),
        ("~out", "out", "sensor_msgs/Image"),
        ("/tf", "in", "tf2_msgs/TFMessage"),
    ]
    return world


def test_a_manager_without_live_ports_is_used_only_if_it_is_asked_for(live: World) -> None:
    live.host.stock = True
    live.host.add(stock := "/stock", NodeletKind.CPP)
    live.host.stock = False
    assert live.spawn("native", "a").manager != stock
    assert not live.manager.graph.get("/a").is_fixed
    assert live.spawn("native", "b", manager=stock).is_fixed


def test_a_cpp_nodelet_is_wired_by_remapping_and_rewired_live(live: World) -> None:
    record = live.spawn("native", "robot/n", config={"image": "/cam/image"})
    assert (record.kind, record.is_fixed) == (NodeletKind.CPP, False)
    assert live.host.nodelet("/robot/n").request.remappings == {
        "/robot/image": "/cam/image",
        "/robot/n/out": "/robot/n/disconnected/out",
    }
    topics = [(port.name, port.topic) for port in record.ports]
    assert topics == [("image", "/cam/image"), ("~out", ""), ("/tf", "")]
    live.host.connect("/robot/n", {"~out": "/small", "/tf": "/other/tf"})
    live.manager.look()
    moved = {"image": "/cam/image", "~out": "/small", "/tf": "/other/tf"}
    assert live.manager.graph.get("/robot/n").topics == moved
    live.host.kill(record.manager)
    live.manager.look()
    assert live.manager.graph.get("/robot/n").state is State.RUNNING
    assert {port.name: port.topic for port in live.host.ports("/robot/n")} == moved


def test_a_lazy_cpp_nodelet_shows_its_declared_ports(live: World) -> None:
    live.host.lazy["pkg/Native"] = ("image",)
    live.spawn("native", "n", config={"image": "/cam/image"})
    for _ in range(2):
        ports = live.manager.graph.get("/n").ports
        shown = {port.name: (port.direction, port.topic) for port in ports}
        assert shown["image"] == ("in", "/cam/image")
        live.manager.look()


@pytest.mark.parametrize(
    ("port", "words"),
    [
        (("out", "out", "sensor_msgs/Image"), "no port '~out'; did you mean 'out'?"),
        (("image", "in", "std_msgs/String"), "'image' carries std_msgs/String"),
    ],
)
def test_a_cpp_nodelet_with_other_ports_than_declared_is_refused(
    live: World, port: tuple[str, str, str], words: str
) -> None:
    live.host.sources["pkg/Native"] = [port]
    with pytest.raises(SpawnFailed, match=words.replace("?", r"\?")):
        live.spawn("native", "n")
    assert live.host.running == []


def test_guards_refuse_topics_numbers_and_every_change_in_read_only_mode() -> None:
    world = World(guards=Guards(denied_topics=("*/cmd_vel", "/estop"), nodelets=1))
    with pytest.raises(InvalidConfiguration, match="cmd_vel.*deny list"):
        world.spawn("relay", "a", config={"out": "/robot/cmd_vel"})
    world.spawn("relay", "a", config={"out": "/fine"})
    with pytest.raises(LimitExceeded, match="2, at most 1"):
        world.spawn("relay", "b")
    frozen = World(guards=Guards(read_only=True))
    for change in (
        lambda: frozen.spawn("relay", "a"),
        lambda: frozen.manager.destroy("a"),
        lambda: frozen.manager.set_protection("a", True),
        lambda: frozen.manager.add_transformation("<x/>"),
        lambda: frozen.manager.remove_transformation("a"),
        lambda: frozen.manager.connect([("a", {})]),
        lambda: frozen.manager.restart("a"),
        lambda: frozen.manager.set_parameter("a", Parameter("rate", "", "5")),
    ):
        with pytest.raises(Denied, match="read_only"):
            change()


def test_ports_of_several_nodelets_are_connected_as_one(world: World) -> None:
    world.spawn("camera", "cam")
    world.spawn("relay", "relay")
    world.manager.connect([("relay", {"in": "/raw"}), ("cam", {"image": "/raw"})])
    shown = {each.name: dict(each.topics) for each in world.manager.graph.all()}
    assert shown == {"/cam": {"image": "/raw"}, "/relay": {"in": "/raw"}}
    world.host.calls.clear()
    for moves, error in (
        ([("relay", {"in": "/other"}), ("nix", {"image": "/other"})], UnknownNodelet),
        ([("relay", {"in": "/other"}), ("cam", {"image": "no name"})], InvalidName),
    ):
        with pytest.raises(error):
            world.manager.connect(moves)
    assert not [call for call in world.host.calls if call[0] == "connect"]
    with pytest.raises(HostError, match="unknown port 'nix'"):
        world.manager.connect([("relay", {"in": "/other"}), ("cam", {"nix": "/other"})])
    assert world.host.nodelet("/relay").ports["in"].topic == "/raw"


def test_a_move_that_cannot_be_taken_back_is_reported(world: World) -> None:
    world.spawn("camera", "cam")
    world.spawn("relay", "relay")
    connected = []

    def fail(operation: str, argument: str) -> None:
        if operation == "connect":
            connected.append(argument)
            if connected != ["/relay"]:
                raise HostTimeout(f"{argument} does not answer")

    world.host.fail = fail
    with pytest.raises(
        DyKnowError,
        match="/cam does not answer; connecting '/relay' could not be taken back: /relay does not",
    ):
        world.manager.connect([("relay", {"in": "/raw"}), ("cam", {"image": "/raw"})])
    assert connected == ["/relay", "/cam", "/relay"]
    assert world.manager.graph.get("/relay").topics == {"in": "/raw"}, "the model is true"


def test_ports_that_were_given_by_their_global_names_are_moved_back(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As scripts and C++ nodelets take them."""
    world.spawn("camera", "a", config={"image": "/one"})
    world.spawn("relay", "b")
    connect = world.host.connect

    def by_global_name(name: str, config: Mapping[str, str]) -> None:
        ports = world.host.nodelet(name).ports
        connect(name, {p.lstrip("/") if p not in ports else p: t for p, t in config.items()})

    monkeypatch.setattr(world.host, "connect", by_global_name)
    for port in ("image", "/image"):
        with pytest.raises(DyKnowError, match="nonsense"):
            world.manager.connect([("/a", {port: "/two"}), ("/b", {"nonsense": "/x"})])
        assert world.host.nodelet("/a").ports["image"].topic == "/one"


@pytest.mark.parametrize("operation", ["restart", "move"])
def test_no_connection_is_made_to_a_nodelet_that_is_about_to_go(operation: str) -> None:
    """It waits for the restart, which ends with the topics from before; then it is made."""
    clock = SteppedClock()
    world = World(clock=clock)
    world.spawn("camera", "front", config={"image": "/old"})
    world.host.add("/other")
    connecting: list[threading.Thread] = []

    def fail(what: str, argument: str) -> None:
        if what in ("unload", "give") and not connecting:
            move = [("front", {"image": "/new"})]
            connecting.append(in_thread(lambda: world.manager.connect(move)))
            clock.settle()

    world.host.fail = fail
    if operation == "restart":
        world.manager.restart("front")
    else:
        world.manager.move("/front", "/other")
    join(*connecting)
    assert world.host.nodelet("/front").ports["image"].topic == "/new"
    world.manager.look()
    assert world.manager.graph.get("/front").topics == {"image": "/new"}


def test_a_nodelet_that_is_restarted_later_is_connected_as_was_requested_last(
    world: World,
) -> None:
    world.spawn("camera", "front", config={"image": "/old"})
    world.host.slow.add("/front")
    with pytest.raises(HostTimeout):
        world.manager.restart("front")
    world.host.slow.clear()
    world.manager.connect([("front", {"image": "/new"})])
    world.host.arrive()
    world.manager.look()
    assert world.states() == {"/front": "RUNNING"}
    assert world.host.nodelet("/front").ports["image"].topic == "/new"
