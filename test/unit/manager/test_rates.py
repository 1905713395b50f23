# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims that demand a rate: who is too slow is replaced, and nobody else."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Dict, List, Tuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from unit.manager.field import CHAIN, FIRST_MESSAGE, Field

from dyknow.errors import BadParameter, NoPlanFound
from dyknow.model.streams import ClaimState

#: Seconds between two messages of a source that is fast enough, and between two looks.
STEP = 0.05
RATE = 5.0
JOINTS = "/joint_states"


class FieldWithRates(Field):
    """Parts send each so many messages that they receive, or steps of time."""

    def __init__(self, path: str = ":memory:") -> None:
        super().__init__(path)
        self.host.dividers = self.dividers = {"soccer/Camera": 2, JOINTS: 1}

    def pass_time(self, seconds: float) -> None:
        """Let messages flow every 50 ms, and the reconciler work every half second."""
        for step in range(round(seconds / STEP)):
            self.sleep(STEP)
            if step % 10 == 9:
                self.manager.look()
                self.reconciler.reconcile()
        self.check()

    def mended(self) -> list[str]:
        return [each for each in self.reasons() if each.startswith("mended")]

    def parts(self) -> Dict[str, str]:
        return {record.label: record.name for record in self.manager.graph.all()}


@pytest.fixture
def field() -> FieldWithRates:
    return FieldWithRates()


def test_a_stream_that_is_fast_enough_is_left_alone(field: FieldWithRates) -> None:
    field.acquire(min_rate=10.0)
    field.pass_time(60.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]


def test_a_source_that_slows_down_is_replaced_once(field: FieldWithRates) -> None:
    claim = field.acquire(min_rate=RATE).claim
    field.pass_time(15.0)
    others = set(field.host.running) - {"/bottom_camera_1"}
    field.dividers["/bottom_camera_1"] = 10
    field.pass_time(60.0)
    (reason,) = field.mended()
    assert re.fullmatch(
        r"mended: nodelet /bottom_camera_1 is too slow: it sends ([2-4][.0-9]*) Hz; "
        r"the stream has \1 Hz, at least 5 Hz are demanded; /[a-z_]+_[0-9]+ is used now",
        reason,
    )
    assert others <= set(field.host.running)
    assert "/bottom_camera_1" not in field.host.running
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.claim(claim.claim_id).topic == claim.topic
    assert claim.topic in field.moving


@pytest.mark.parametrize("label", CHAIN)
def test_the_part_that_slows_the_stream_down_is_found(field: FieldWithRates, label: str) -> None:
    field.acquire(min_rate=RATE)
    field.pass_time(15.0)
    victim = field.parts()[label]
    others = set(field.host.running) - {victim}
    field.dividers[victim] = 8 if "camera" in victim else 4
    field.pass_time(60.0)
    assert len(field.mended()) == 1
    assert f"{victim} is too slow" in field.mended()[0]
    assert others <= set(field.host.running)


def test_a_part_that_sends_less_than_it_receives_is_not_to_blame(field: FieldWithRates) -> None:
    """The subsampler sends each second image; then the camera, still above 5 Hz, slows down."""
    field.dividers.update({"soccer/Camera": 1, "soccer/Subsampler": 3})
    field.acquire(min_rate=RATE)
    field.pass_time(15.0)
    field.dividers["/bottom_camera_1"] = 3
    field.pass_time(30.0)
    assert len(field.mended()) == 1
    assert "/bottom_camera_1 is too slow" in field.mended()[0]


def test_who_never_was_fast_enough_gives_way_to_another(field: FieldWithRates) -> None:
    field.dividers["soccer/Camera"] = 10
    claim = field.acquire(min_rate=RATE).claim
    field.pass_time(30.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert "ceiling camera" in field.labels()
    mended = len(field.mended())
    assert mended <= 2
    field.pass_time(60.0)
    assert len(field.mended()) == mended


def test_where_there_is_nothing_faster_it_is_degraded(field: FieldWithRates) -> None:
    field.manager.remove_transformation("ceiling camera")
    field.dividers["soccer/Camera"] = 10
    claim = field.acquire(min_rate=RATE).claim
    field.pass_time(120.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    assert "/bottom_camera_" in field.claim(claim.claim_id).detail
    assert claim.topic in field.moving
    assert len(field.mended()) <= 4
    field.dividers["soccer/Camera"] = 1
    field.pass_time(120.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.tidy()


def test_what_hovers_about_the_limit_makes_nothing_flap(field: FieldWithRates) -> None:
    field.manager.remove_transformation("ceiling camera")
    field.acquire(min_rate=RATE)
    field.pass_time(15.0)
    for turn in range(40):
        field.dividers["soccer/Camera"] = 4 + turn % 2
        field.pass_time(3.5)
    assert len(field.mended()) <= 5, field.mended()  # in 140 s: the pauses grow
    assert all("/bottom_camera_" in each for each in field.mended())


def test_who_has_other_wishes_goes_on_with_the_slow_part(field: FieldWithRates) -> None:
    easy = field.acquire("YUV(field)").claim
    keen = field.acquire(min_rate=RATE).claim
    assert "/bottom_camera_1" in keen.nodelets
    field.pass_time(15.0)
    events = len(field.events)
    field.dividers["/bottom_camera_1"] = 10
    field.pass_time(30.0)
    assert {each.after.claim_id for each in field.events[events:]} == {keen.claim_id}
    assert field.claim(easy.claim_id).nodelets == ("/bottom_camera_1",)
    assert "/bottom_camera_1" not in field.claim(keen.claim_id).nodelets
    assert len(field.mended()) == 1


def test_an_ordinary_topic_can_be_too_slow(field: FieldWithRates) -> None:
    claim = field.acquire(min_rate=RATE).claim
    field.pass_time(15.0)
    field.dividers[JOINTS] = 20
    field.pass_time(10.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    assert "topic /joint_states is too slow" in field.claim(claim.claim_id).detail
    assert field.labels() == CHAIN
    field.dividers[JOINTS] = 1
    field.pass_time(15.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert not field.mended()


def test_a_slow_nodelet_made_by_hand_is_passed_over(field: FieldWithRates) -> None:
    field.spawn("bottom camera", "/camera", config={"image": "/camera/image"})
    claim = field.acquire(min_rate=RATE).claim
    assert "/camera" in claim.nodelets
    field.dividers["/camera"] = 10
    field.pass_time(40.0)
    assert "/camera" not in field.claim(claim.claim_id).nodelets
    assert "/camera" in field.host.running
    assert len(field.mended()) == 1
    assert field.state(claim.claim_id) is ClaimState.ACTIVE


def test_a_slow_network_makes_nobody_slow(field: FieldWithRates) -> None:
    field.acquire(min_rate=RATE)
    field.pass_time(10.0)

    def take_long(operation: str, argument: str) -> None:
        if operation == "counts":
            for _ in range(4):
                field.sleep(STEP)

    field.host.fail = take_long
    field.pass_time(30.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]


def test_a_stated_rate_that_is_too_low_is_not_used_for_the_goal(field: FieldWithRates) -> None:
    camera = """<transformation cost="{}"><label>{}</label><source>soccer/Camera</source>
        <ports><port type="out" rate="{}">image</port></ports>
        <tags><tag port="image">Thermal(field)</tag></tags></transformation>"""
    for cost, label, rate in ((1, "slow", 5), (3, "fast", 30), (2, "medium", 10)):
        field.manager.add_transformation(camera.format(cost, label, rate))
    claim = field.acquire("Thermal(field)").claim
    assert claim.nodelets == ("/slow_1",)
    assert field.acquire("Thermal(field)", min_rate=10.0).claim.nodelets == ("/medium_1",)
    assert field.acquire("Thermal(field)", min_rate=10.5).claim.nodelets == ("/fast_1",)
    with pytest.raises(NoPlanFound, match="it is stated at 30 Hz, below 31 Hz"):
        field.acquire("Thermal(field)", min_rate=31.0)


def test_what_a_slow_part_feeds_is_slow_also_while_it_runs(field: FieldWithRates) -> None:
    field.manager.add_transformation(
        """<transformation><label>slow</label><source>soccer/Camera</source>
        <ports><port type="out" rate="5">image</port></ports>
        <tags><tag port="image">Thermal(field)</tag></tags></transformation>"""
    )
    field.manager.add_transformation(
        """<transformation><label>smoother</label><source>dyknow/Relay</source>
        <ports><port type="in">in</port><port type="out">out</port></ports>
        <tags><tag port="in">Thermal(field)</tag>
        <tag port="out">Smooth(field)</tag></tags></transformation>"""
    )
    field.acquire("Smooth(field)")
    with pytest.raises(NoPlanFound, match="it is stated at 5 Hz, below 10 Hz"):
        field.acquire("Smooth(field)", min_rate=10.0)


@settings(max_examples=10, deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(CHAIN), st.integers(1, 6), st.integers(2, 15)), max_size=5)
)
@example([("bottom camera", 6, 5), ("subsampler", 3, 3), ("subsampler", 2, 2)])
@example([("bottom camera", 4, 3), ("detector", 2, 3), ("bottom camera", 2, 3)])
def test_nobody_is_blamed_for_what_others_do(turns: List[Tuple[str, int, int]]) -> None:
    """Parts slow down and recover as they like: who is blamed was slow lately."""
    field = FieldWithRates()
    claim = field.acquire(min_rate=RATE).claim
    field.pass_time(10.0)
    slow_until: Dict[str, float] = {}

    def check(seconds: float) -> None:
        begin = len(field.events)
        field.pass_time(seconds)
        for event in field.events[begin:]:
            for name in re.findall(r"nodelet (\S+) is too slow", event.reason):
                assert field.now - slow_until.get(name, -100.0) < seconds + 10.0, name

    for label, divider, seconds in turns:
        name = field.parts().get(label)
        if name is None:
            continue  # another camera stands in for it
        field.dividers[name] = divider * (2 if label == "bottom camera" else 1)
        for each, present in field.dividers.items():
            if present > (2 if "bottom_camera" in each else 1):
                slow_until[each] = field.now + seconds
        check(seconds)
    for name in [name for name in field.dividers if name.startswith("/") and name != JOINTS]:
        del field.dividers[name]
    check(60.0)
    begin = len(field.events)
    field.pass_time(60.0)
    assert len(field.events) - begin <= 3, "it has come to rest"
    assert field.state(claim.claim_id) is ClaimState.ACTIVE


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("min_rate", -1.0),
        ("min_rate", float("nan")),
        ("min_rate", float("inf")),
        ("max_age", -0.1),
        ("max_silence", float("inf")),
        ("budget", -1.0),
        ("budget", 61.0),
        ("lease", -1.0),
    ],
)
def test_bad_values_are_refused(field: FieldWithRates, name: str, value: float) -> None:
    with pytest.raises(BadParameter, match=f"parameter '{name}' is {value}"):
        field.acquire("YUV(field)", **{name: value})
    assert not field.living()


def test_a_claim_keeps_what_it_demands_over_a_restart(tmp_path: Path) -> None:
    field = FieldWithRates(str(tmp_path / "state.db"))
    claim = field.acquire(min_rate=RATE, budget=1.5).claim
    field.pass_time(5.0)
    field.kill_manager()
    assert field.claim(claim.claim_id).request == claim.request
    field.pass_time(10.0)
    field.dividers["/bottom_camera_1"] = 10
    field.pass_time(15.0)
    assert len(field.mended()) == 1
