# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Leases of a process to publish on topics of claims, on clocks that the test steps."""

from __future__ import annotations

from random import Random
from typing import Any, Dict, List, Mapping, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow.names import FORMS, below
from dyknow.nodelet.leases import DURATION, EXTENSIONS, Leases, Sight
from dyknow.nodelet.streams.endpoints import Fence
from dyknow.ros.hosting.grants import PARTING, YOUTH, Lease, PeerContext
from dyknow.ros.wire.master import Master

MANAGER, URI = "/dyknow_manager", "http://robot:1/"
TOPIC = "/claims/ball"


class Process:
    """One process with leases."""

    def __init__(self) -> None:
        self.now = 100.0
        self.publishing: Dict[str, List[str]] = {TOPIC: ["/old"]}
        self.fences: Mapping[str, Fence] = {}
        self.sight = Sight.SILENT
        self.looks = 0
        self.leases = Leases(
            lambda topic: self.publishing.get(topic, ()),
            lambda fences: self.take(fences),
            lambda: self.now,
        )

    def take(self, fences: Mapping[str, Fence]) -> None:
        self.fences = fences

    def renew(self, confirmed: float, producer: str = "/old") -> float:
        return self.leases.renew(MANAGER, URI, confirmed, DURATION, {TOPIC: producer})

    def watch(self) -> None:
        def look(uri: str) -> Sight:
            assert uri == URI
            self.looks += 1
            return self.sight

        self.leases.watch(look)

    def may(self, nodelet: str = "/old", topic: str = TOPIC) -> bool:
        return topic not in self.fences or self.fences[topic](nodelet)


@pytest.fixture
def process() -> Process:
    process = Process()
    process.renew(process.renew(0.0))
    return process


def test_a_lease_begins_with_a_confirmed_moment_and_a_late_renewal_revives_nothing() -> None:
    process = Process()
    clock = process.renew(0.0)
    assert process.may() and not process.fences
    process.now += 1.5
    process.renew(clock)
    process.now += 0.4
    assert process.may()
    process.now += 0.2  # two seconds after the confirmed moment, whenever the renewal came
    assert not process.may()
    process.renew(clock)
    assert not process.may()


def test_after_a_pause_only_the_nodelets_that_the_manager_names_publish(process: Process) -> None:
    process.now += 10.0
    assert not process.may()
    process.renew(process.renew(0.0, "/new"), "/new")
    assert not process.may("/old")  # it was replaced
    process.now += 1.0
    process.renew(process.now, "/new")
    assert process.may("/new")
    process.publishing[TOPIC] = ["/old", "/next"]
    process.renew(process.now, "/new")
    assert process.may("/next"), "it came later"
    assert not process.may("/old")
    process.renew(process.now, "/old")
    assert process.may("/old")


def test_a_part_that_publishes_another_form_alone_is_replaced_with_it(process: Process) -> None:
    compressed = below(TOPIC, FORMS[0])
    process.publishing = {compressed: ["/old"]}
    process.now += 10.0
    process.renew(process.renew(0.0, "/new"), "/new")
    process.now += 1.0
    process.renew(process.now, "/new")
    assert not process.may("/old", compressed)
    assert process.may("/new", compressed)


def test_topics_of_no_claim_are_open_to_all(process: Process) -> None:
    process.now += 10.0
    assert process.may("/old", "/elsewhere")
    process.leases.renew(MANAGER, URI, process.now, DURATION, {"/another": "/x"})
    assert process.may("/old")  # the claim is gone
    process.leases.renew(MANAGER, URI, 0.0, DURATION, {})
    process.now += 10.0
    assert process.may("/x", "/another")  # and now the manager


@pytest.mark.parametrize("sight", Sight)
def test_a_lease_is_extended_only_while_no_manager_is_at_work(
    process: Process, sight: Sight
) -> None:
    process.sight = sight
    for _ in range(100):
        process.now += 0.2
        process.watch()
    assert process.may() is (sight in EXTENSIONS)
    process.now += max(EXTENSIONS.values()) + 0.1
    process.watch()
    assert not process.may(), "one that has run out is not extended"


def test_a_process_that_is_held_up_while_the_manager_is_away_goes_on(process: Process) -> None:
    process.sight = Sight.GONE
    for _ in range(100):
        process.now += 0.2
        process.watch()
    process.now += 7.0
    assert process.may()
    process.watch()
    process.now += 7.0
    assert process.may()


def test_a_manager_that_ends_on_purpose_grants_a_longer_lease_unless_it_comes_late(
    process: Process,
) -> None:
    clock = process.renew(process.now)
    process.now += 1.0
    process.leases.renew(MANAGER, URI, clock, PARTING, {TOPIC: "/old"})
    process.now += 1.5
    assert not process.may()
    clock = process.renew(process.now)
    process.leases.renew(MANAGER, URI, clock, PARTING, {TOPIC: "/old"})
    process.now += 7.0
    assert process.may()


def test_the_next_manager_counts_from_its_first_answer(process: Process) -> None:
    process.sight = Sight.GONE
    process.now += 1.5
    process.watch()
    process.leases.renew(MANAGER, "http://robot:2/", 0.0, DURATION, {TOPIC: "/old"})
    process.now += DURATION - 0.1
    assert process.may()
    process.now += 0.2
    assert not process.may()


def test_no_host_is_probed_while_renewals_come(process: Process) -> None:
    for _ in range(20):
        process.now += 0.25
        process.renew(process.now)
        process.watch()
    assert process.looks == 0


def test_two_managers_have_a_lease_each(process: Process) -> None:
    other = "/claims/robot"
    process.leases.renew("/other", URI, process.now, DURATION, {other: "/their"})
    process.now += 1.5
    process.renew(process.now)
    process.now += 1.0
    assert process.may("/old", TOPIC)
    assert not process.may("/their", other)


def test_renewals_at_the_same_moment_leave_the_fences_of_both(process: Process) -> None:
    other, take = "/claims/robot", process.take

    def take_late(fences: Mapping[str, Fence]) -> None:
        process.take = take  # type: ignore[method-assign]
        process.renew(process.now)
        take(fences)

    process.leases.renew(MANAGER, URI, process.now, DURATION, {})
    process.take = take_late  # type: ignore[method-assign]
    process.leases.renew("/other", URI, process.now, DURATION, {other: "/their"})
    assert {TOPIC, other} <= set(process.fences)
    process.now += 10.0
    assert not process.may("/old", TOPIC) and not process.may("/their", other)


class World:
    """A process and the managers of one name, one after the other, in steps of 0.1 s.

    Faults begin by chance and last for a time that is drawn. A manager is stopped only while it is
    answered: an extension allows for one period without an answer before the stop.
    """

    def __init__(self, random: Random) -> None:
        self.random = random
        self.process = Process()
        self.running = self.heard = 0.0  # of managers
        self.lives = 0
        self.ends = dict.fromkeys(("death", "pause", "stop", "loss"), 0.0)
        self.requests: List[Tuple[float, int, Dict[str, Any]]] = []
        self.answers: List[Tuple[float, int, float]] = []
        self.is_there = False
        self.be_born()

    def is_within(self, what: str, rate: float, longest: float) -> bool:
        """Whether something is going on that begins by chance, so many times a second."""
        if self.process.now >= self.ends[what] and self.random.random() < 0.1 * rate:
            self.ends[what] = self.process.now + self.random.uniform(0.0, longest)
        return self.process.now < self.ends[what]

    def be_born(self) -> None:
        self.lives += 1
        self.is_there, self.is_reached, self.born = True, False, self.running
        self.lease = Lease(
            PeerContext(
                Master(MANAGER),
                uri=f"http://robot:{self.lives}/",
                running=lambda: self.running,
                producers={TOPIC: "/old"},
            )
        )
        self.lease.grant()

    def step(self) -> None:
        now = self.process.now = self.process.now + 0.1
        is_there = not self.is_within("death", 0.03, 15.0)
        if is_there and not self.is_there:
            self.be_born()
        if self.is_there and not is_there and self.random.random() < 0.5:  # on purpose
            self.lease.part()
            self.requests.append((now, self.lives, self.lease.renewal()))
        self.is_there = is_there
        is_answered = self.running - self.heard < 0.25
        is_stopped = self.is_within("stop", 0.03 * is_answered, 12.0)
        is_held_up = self.is_within("pause", 0.05, 12.0)
        is_lossy = self.is_within("loss", 0.05, 4.0)
        if is_there and not is_stopped:
            self.running += 0.1
            while self.answers and self.answers[0][0] <= now:
                _, life, clock = self.answers.pop(0)
                if life == self.lives:
                    self.lease.answered(clock)
                    self.heard = self.running
            late = self.random.choice((0.0, 0.1, 0.3, 1.0))
            self.requests.append((now + late, self.lives, self.lease.renewal()))
        if is_held_up:
            return
        while self.requests and self.requests[0][0] <= now:
            _, life, asked = self.requests.pop(0)
            clock = self.process.leases.renew(
                MANAGER, asked["uri"], asked["confirmed"], asked["duration"], {TOPIC: "/old"}
            )
            self.is_reached = self.is_reached or life == self.lives
            if not is_lossy:
                self.answers.append((now + self.random.choice((0.0, 0.1, 0.5)), life, clock))

        def probe(uri: str) -> Sight:
            if not is_there or uri != f"http://robot:{self.lives}/":
                return Sight.GONE
            return Sight.STOPPED if is_stopped else Sight.AT_WORK

        # A manager whose host can be reached has reached the process soon after its start.
        if not is_there or self.is_reached or self.running - self.born < 2.0:
            self.process.leases.watch(probe)


@given(st.integers(0, 2**32))
def test_no_manager_thinks_a_lease_over_while_it_holds(seed: int) -> None:
    """Despite delays, losses, stops and ends: it counts from the last answer that it received."""
    world = World(Random(seed))
    for _ in range(1000):
        world.step()
        if world.is_there and not world.lease.may_be_held:
            assert not world.process.may() or not world.process.fences


def test_an_extension_ends_before_a_manager_may_judge() -> None:
    # One that goes on judges when it has run for DURATION since the last answer, at most a period
    # before. The next one judges after its YOUTH, and the process may see its end later than it
    # begins.
    assert EXTENSIONS[Sight.STOPPED] <= DURATION - 0.25
    assert EXTENSIONS[Sight.GONE] <= YOUTH - 2.0
    assert PARTING <= YOUTH
