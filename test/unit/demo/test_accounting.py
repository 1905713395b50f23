# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The books of the demonstration: whatever goes wrong in a chain must show in them."""

from __future__ import annotations

import pytest

from dyknow_demo.accounting import FrameRecord, Switch, account

PERIOD = 0.03
SIZE = (304, 400)


def published(camera, count, phase=0.0):
    """Frames of a camera; each is routed within 0.2 ms after its stamp."""
    stamps = (phase + PERIOD * number for number in range(count))
    return [FrameRecord(camera, stamp, stamp + 2e-4, *SIZE) for stamp in stamps]


def arrival(each, latency=0.001):
    return each._replace(arrived=each.stamp + latency)


#: Camera a from 0 s, b from 1 s, a again from 2 s, nothing from 3 s; a call takes 4 ms, and no
#: frame is published during one.
SWITCHES = [
    Switch("a", "first", -0.01, -0.001),
    Switch("b", "second", 1.004, 1.008),
    Switch("a", "third", 2.004, 2.008),
    Switch("", "end", 3.004, 3.008),
]
CAMERAS = published("a", 120) + published("b", 120, phase=0.01)
MOMENTS = [-0.002, 1.006, 2.006, 3.006]


def delivered(moments=MOMENTS):
    """What a chain without faults delivers, if the switches come into force at these moments."""
    frames = []
    for index, camera in enumerate("aba"):
        begin, end = moments[index], moments[index + 1]
        frames += [each for each in CAMERAS if each.camera == camera and begin <= each.stamp < end]
    return [arrival(each) for each in frames]


def totals(arrivals, cameras=CAMERAS):
    accounts = account(cameras, arrivals, SWITCHES).values()
    return tuple(
        sum(getattr(each, name) for each in accounts) for name in ("lost", "doubled", "reordered")
    )


@pytest.mark.parametrize("offset", [0.0, 0.001, 0.002, 0.004])
def test_a_chain_without_faults_balances_whenever_in_the_call_it_switched(offset):
    moments = [-0.002, *(switch.called + offset for switch in SWITCHES[1:])]
    assert totals(delivered(moments)) == (0, 0, 0)


def test_stages_are_told_apart():
    accounts = account(CAMERAS, delivered(), SWITCHES)
    assert list(accounts) == ["first", "second", "third"]
    assert [len(each.arrivals) for each in accounts.values()] == [34, 33, 34]
    assert accounts["second"].rate == pytest.approx(1 / PERIOD)
    assert accounts["second"].latencies == pytest.approx([0.001] * 33)


def test_every_single_lost_frame_is_found():
    good = delivered()
    for index in range(len(good)):
        assert totals(good[:index] + good[index + 1 :]) == (1, 0, 0), good[index]


def test_every_doubled_frame_is_found():
    good = delivered()
    for index in range(len(good)):
        assert totals([*good[: index + 1], *good[index:]]) == (0, 1, 0), good[index]


def test_every_frame_from_a_camera_that_is_not_connected_counts_as_doubled():
    good = delivered()
    known = {each.frame for each in good}
    strays = [each for each in CAMERAS if each.frame not in known and each.stamp > 0]
    assert strays
    for each in strays:
        assert totals([*good, arrival(each)])[1] == 1, each


def test_frames_that_change_places_are_found():
    good = delivered()
    for index in range(len(good) - 1):
        swapped = [*good]
        swapped[index : index + 2] = [good[index + 1], good[index]]
        assert totals(swapped) == (0, 0, 1), good[index]


def test_during_a_switch_either_camera_may_be_heard_but_not_the_old_one_after_the_new():
    cameras = [
        FrameRecord("a", 0.0, 0.0001, *SIZE),
        FrameRecord("b", 1.005, 1.0051, *SIZE),
        FrameRecord("a", 1.007, 1.0071, *SIZE),
    ]
    switches = [SWITCHES[0], SWITCHES[1], Switch("", "end", 2.0, 2.004)]
    for kept in ((), (1,), (2,), (1, 2)):
        arrivals = [arrival(cameras[0]), *(arrival(cameras[each]) for each in kept)]
        accounts = account(cameras, arrivals, switches).values()
        assert sum(each.lost + each.doubled for each in accounts) == 0
        assert sum(each.reordered for each in accounts) == (len(kept) == 2)


def test_the_same_camera_goes_on_over_a_switch():
    switches = [SWITCHES[0], Switch("a", "second", 1.0, 1.004), Switch("", "end", 2.0, 2.004)]
    good = [arrival(each) for each in CAMERAS if each.camera == "a" and each.stamp < 2.0]
    for index in range(len(good)):
        accounts = account(CAMERAS, good[:index] + good[index + 1 :], switches).values()
        assert sum(each.lost for each in accounts) == 1, good[index]


def test_a_stage_that_is_not_over_is_left_out():
    accounts = account(CAMERAS, delivered(), SWITCHES[:2])
    assert list(accounts) == ["first"]
    assert accounts["first"].lost == 0


def test_a_frame_that_no_witness_saw_counts_as_doubled():
    assert totals([*delivered(), FrameRecord("a", 1.5, 1.5, *SIZE)]) == (0, 1, 0)


def test_nothing_at_all():
    accounts = account([], [], SWITCHES)
    assert [(each.rate, each.latencies) for each in accounts.values()] == [(0.0, [0.0])] * 3
