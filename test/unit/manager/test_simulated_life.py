# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Whole lives of a manager with its control loop, in simulated time: each run is the same."""

from __future__ import annotations

from typing import List, Tuple

import pytest
from unit.manager.field import library, specification

from dyknow.errors import HostError
from dyknow.manager.supervision.observer import PERIOD
from dyknow.model.graph import NodeletKind, SpawnRequest, State
from dyknow.model.streams import NO_MESSAGE, ClaimState, StreamRequest
from dyknow.periodic import PAUSE
from dyknow.simulated import SimulatedClock, SimulatedManagerClient

PORTS = {"image": ("out", ["Image(left)"])}
LIBRARY = library(
    specification("camera", "pkg/Camera", PORTS, 1, "test/Image"),
    specification("spare", "pkg/Spare", PORTS, 3, "test/Image"),
)


class Life:
    """A manager with a claim, and when the states of the claim came."""

    def __init__(self, **request: float) -> None:
        self.clock = SimulatedClock()
        self.client = SimulatedManagerClient(clock=self.clock)
        self.client.add_transformation(LIBRARY)
        self.events: List[Tuple[float, ClaimState]] = []
        self.client.on_event = lambda event: self.events.append(
            (self.clock.time, event.after.state)
        )
        acquired = self.client.acquire_stream(StreamRequest("Image(left)", **request))  # type: ignore[arg-type]
        self.claim_id = acquired.claim_id


def test_a_silent_part_is_replaced_as_soon_as_its_claim_says() -> None:
    life = Life(max_silence=0.4)
    life.client.advance(10.0)
    assert life.client.get_statistics("/camera_1").uptime == 10.0
    life.client.host.silent.add("pkg/Camera")
    silent = life.clock.time
    life.client.advance(3.0)
    active = [when - silent for when, state in life.events if state is ClaimState.ACTIVE]
    assert any(0.0 <= each <= 1.0 for each in active)
    assert {each.transformation for each in life.client.get_graph().nodelets} >= {"spare"}


def test_a_replacement_that_sends_nothing_takes_over_after_a_while() -> None:
    life = Life()
    life.client.advance(2.0)
    life.client.host.silent.add("pkg/Spare")
    life.client.remove_transformation("camera")
    life.client.advance(10.0)
    (claim,) = life.client.list_streams()
    assert (claim.state, claim.detail) == (ClaimState.ACTIVE, NO_MESSAGE)
    assert life.clock.time == pytest.approx(12.0, abs=0.1)


def test_each_nodelet_manager_that_dies_comes_back() -> None:
    client = SimulatedManagerClient(clock=SimulatedClock())
    client.add_transformation(LIBRARY)
    client.spawn_nodelet(SpawnRequest("camera", "/mine"))
    client.host.widen(NodeletKind.PYTHON)
    client.host.kill(client.get_graph().nodelets[0].manager)
    client.advance(1.0)
    (nodelet,) = client.get_graph().nodelets
    assert (nodelet.state, nodelet.detail) == (State.RUNNING, "")


def test_after_the_last_claim_its_nodelets_go_and_the_loop_sleeps() -> None:
    life = Life()
    life.client.advance(2.0)
    life.client.release_stream(life.claim_id)
    life.client.advance(10.0)
    assert not life.client.get_graph().nodelets
    assert life.client.reconciler.work() is None


def test_a_nodelet_that_dies_again_and_again_comes_back_ever_more_slowly() -> None:
    life = Life()
    host = life.client.host
    life.client.spawn_nodelet(SpawnRequest("camera", "/mine"))
    attempts: List[float] = []

    def fail(operation: str, argument: str) -> None:
        if (operation, argument) == ("load", "/mine"):
            attempts.append(life.clock.time)
            host.crash(life.client.core.graph.get("/mine").manager, ["/mine"])

    host.fail = fail
    host.kill(life.client.core.graph.get("/mine").manager)
    life.client.advance(60.0)
    pauses = [later - earlier for earlier, later in zip(attempts, attempts[1:])]
    assert len(attempts) < 20
    assert pauses[-1] > 4 * pauses[0]


def test_a_stream_is_made_again_as_soon_as_a_pause_is_over() -> None:
    life = Life()
    host = life.client.host
    life.client.advance(20.0)
    loads: List[float] = []

    def fail(operation: str, argument: str) -> None:
        if operation == "load":
            if "camera" in argument:
                loads.append(life.clock.time)
            raise HostError("out of memory")

    host.fail = fail
    host.kill(next(iter(host.processes)))
    other = "<transformation><label>other</label><source>x/Other</source></transformation>"
    for _ in range(30):
        life.client.advance(PERIOD + 0.21)
        life.client.add_transformation(other)  # a change, from which rounds are counted
    pauses = [later - earlier for earlier, later in zip(loads, loads[1:])]
    assert pauses[-4:] == pytest.approx([1.0, 2.0, 4.0, 8.0], abs=PAUSE / 2)


def test_no_process_takes_the_name_of_another() -> None:
    client = Life().client
    for name in ("/a", "/b"):
        client.spawn_nodelet(SpawnRequest("camera", name, isolated=True))
    client.destroy("/a")
    client.spawn_nodelet(SpawnRequest("camera", "/c", isolated=True))
    assert client.core.graph.get("/b").manager != client.core.graph.get("/c").manager


@pytest.mark.parametrize("seconds", [0.0, 7.3])
def test_a_life_is_the_same_each_time(seconds: float) -> None:
    def live() -> List[Tuple[float, ClaimState]]:
        life = Life(max_silence=1.0)
        for _ in range(5):
            life.client.advance(seconds)
            life.client.host.kill(next(iter(life.client.host.processes)))
            life.client.advance(1.7)
        return life.events

    assert live() == live()
