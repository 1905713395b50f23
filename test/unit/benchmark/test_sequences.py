# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

from __future__ import annotations

import pytest

from dyknow_benchmark.rewire import delays
from dyknow_benchmark.sequences import SwitchedIn, SwitchedOut


def ticking():
    ticks = iter(range(0, 10**12, 10**9))
    return lambda: next(ticks)


def taken_in(numbers):
    watch = SwitchedIn(ticking())
    for number in numbers:
        watch.receive(number)
    return watch


@pytest.mark.parametrize(
    ("numbers", "lost", "doubled", "changes"),
    [
        ([0, 2, 4, 6], 0, 0, 0),
        ([10, 12, 13, 15, 16, 18], 0, 0, 2),
        ([10, 12, 15, 17], 0, 0, 1),  # 13 came before the switch, on the topic that was not ours
        ([10, 12, 11, 13], 0, 0, 1),  # the new topic was collected before the old one was left
        ([10, 12, 17, 19], 1, 0, 1),
        ([0, 2, 8, 10], 2, 0, 0),
        ([0, 2, 2, 4], 0, 1, 0),
        ([10, 12, 13, 12, 15], 0, 1, 1),
        ([10, 13, 10, 12, 16], 1, 1, 2),
    ],
)
def test_an_in_port_that_is_switched(numbers, lost, doubled, changes):
    watch = taken_in(numbers)
    assert (watch.lost, watch.doubled) == (lost, doubled)
    assert watch.collect() == [lost, doubled, *map(float, range(changes))]


@pytest.mark.parametrize(
    ("arrivals", "lost", "doubled", "changes"),
    [
        ("l3 l4 l5", 0, 0, 0),
        ("l3 r4 r5 l6", 0, 0, 2),
        ("l3 r4 l4 r5", 0, 1, 1),
        ("l3 r6 r5 r7", 2, 1, 1),
    ],
)
def test_an_out_port_that_is_switched(arrivals, lost, doubled, changes):
    watch = SwitchedOut(ticking())
    for arrival in arrivals.split():
        watch.receive(arrival[0], int(arrival[1:]))
    assert watch.collect() == [lost, doubled, *map(float, range(changes))]


def test_each_request_is_paired_with_the_first_message_after_it():
    assert delays([1.0, 2.0, 3.0], [1.25, 2.5, 3.125]) == [250.0, 500.0, 125.0]


def test_a_request_whose_topic_was_never_seen_has_no_delay():
    assert delays([1.0, 2.0, 3.0], [0.5, 1.25, 3.5]) == [250.0, 500.0]
    assert delays([1.0], []) == []
