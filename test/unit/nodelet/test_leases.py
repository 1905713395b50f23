# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Leases of a process to publish on topics of claims, on clocks that the test steps."""

from __future__ import annotations

from typing import Dict, List, Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow.names import FORMS, below
from dyknow.nodelet.endpoints import Fence
from dyknow.nodelet.leases import EXTENSION, Leases, Sight

MANAGER, URI, DURATION = "/dyknow_manager", "http://robot:1/", 2.0
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
    assert process.may() is (sight is Sight.NOT_AT_WORK)
    process.now += DURATION + 0.1
    process.watch()
    assert not process.may(), "one that has run out is not extended"


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


step = st.sampled_from(["ask", "arrive", "answer", "send", "stop", "look", "kill"])


@given(st.lists(st.tuples(step, st.floats(0.0, 1.5)), max_size=60))
def test_the_manager_never_thinks_a_lease_over_while_it_holds(steps: List) -> None:
    """Despite delays, losses and stops: it counts from the last answer that it received."""
    process = Process()
    requests: List[float] = []
    answers: List[float] = []
    confirmed = 0.0
    heard = process.now
    for name, seconds in steps:
        process.now += seconds
        if name == "ask":
            requests.append(confirmed)
        elif name == "arrive" and requests:
            answers.append(process.renew(requests.pop(0)))
        elif name == "answer" and answers:
            confirmed, heard = answers.pop(0), process.now
        elif name == "stop":
            process.now += 10.0
        elif name == "look":
            process.watch()
        if process.fences and process.now > heard + DURATION:
            assert not process.may()


def test_an_extension_ends_before_a_manager_that_goes_on_may_judge() -> None:
    # It judges when it has run for DURATION since the last answer, at most a period before.
    assert EXTENSION <= DURATION - 0.25
