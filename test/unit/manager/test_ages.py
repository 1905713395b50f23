# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims with a ``max_age``: who delays a stream is replaced, and nobody else."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Dict, List, Tuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unit.manager.field import CHAIN, FIRST_MESSAGE, IMAGE, POINT, transformation
from unit.manager.test_rates import JOINTS, FieldWithRates

from dyknow.errors import StreamTypeMismatch
from dyknow.model.streams import UNKNOWN_AGE, ClaimState, StreamRequest

LIMIT = 0.1


@pytest.fixture
def field() -> FieldWithRates:
    return field_with_ages()


def field_with_ages(path: str = ":memory:") -> FieldWithRates:
    """Each part adds 10 ms."""
    field = FieldWithRates(path)
    field.host.delays.update(dict.fromkeys(field.host.sources, 0.01))
    return field


def test_a_stream_that_is_young_enough_is_left_alone(field: FieldWithRates) -> None:
    field.acquire(max_age=LIMIT)
    field.host.delays["soccer/Camera"] = 0.05
    field.pass_time(60.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]


@pytest.mark.parametrize("label", CHAIN)
def test_the_part_that_delays_the_stream_is_replaced_once(
    field: FieldWithRates, label: str
) -> None:
    claim = field.acquire(max_age=LIMIT).claim
    field.pass_time(10.0)
    victim = field.parts()[label]
    others = set(field.host.running) - {victim}
    field.host.delays[victim] = 0.28
    field.pass_time(60.0)
    (reason,) = field.mended()
    assert reason == (
        f"mended: nodelet {victim} delays the stream by 0.28 s: "
        f"it is 0.31 s old, at most 0.1 s was asked for; {victim[:-1]}2 is used now"
    )
    assert others <= set(field.host.running)
    assert victim not in field.host.running
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.claim(claim.claim_id).topic == claim.topic


def test_who_delays_as_much_as_stated_is_not_to_blame(field: FieldWithRates) -> None:
    """The detector states that it takes long; the camera does not."""
    for label, latency in (("detector", 0.3), ("bottom camera", 0.0)):
        known = field.manager.library.get(label)
        ports = tuple(
            port._replace(latency=latency if port.direction == "out" else 0.0)
            for port in known.ports
        )
        field.manager.add_transformation(known._replace(ports=ports).to_xml())
    field.acquire(max_age=0.4)
    field.pass_time(10.0)
    field.host.delays[field.parts()["detector"]] = 0.3
    field.host.delays["/bottom_camera_1"] = 0.2
    field.pass_time(30.0)
    (reason,) = field.mended()
    assert "/bottom_camera_1 delays the stream by 0.2 s" in reason


def test_an_input_that_is_older_than_what_is_made_of_it_is_not_to_blame(
    field: FieldWithRates,
) -> None:
    """What the detector sends bears the stamp of its images, not that of its joints."""
    field.acquire(max_age=LIMIT)
    field.pass_time(10.0)
    field.host.delays["/bottom_camera_1"] = 0.2
    field.host.delays[JOINTS] = 5.0
    field.host.delays[field.parts()["detector"]] = -4.78  # added to the age of its oldest input
    field.pass_time(8.0)
    (reason,) = field.mended()
    assert "nodelet /bottom_camera_1 delays the stream by 0.2 s" in reason


def test_hiccups_are_no_delay(field: FieldWithRates) -> None:
    field.acquire(max_age=LIMIT)
    field.pass_time(10.0)
    for _ in range(10):
        field.host.delays["/bottom_camera_1"] = 1.0
        field.pass_time(1.0)
        field.host.delays["/bottom_camera_1"] = 0.01
        field.pass_time(4.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]


def test_where_there_is_nothing_younger_it_is_degraded(field: FieldWithRates) -> None:
    field.manager.remove_transformation("ceiling camera")
    field.host.delays["soccer/Camera"] = 0.3
    claim = field.acquire(max_age=LIMIT).claim
    field.pass_time(120.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    assert "at most 0.1 s was asked for" in field.claim(claim.claim_id).detail
    assert claim.topic in field.moving
    assert len(field.mended()) <= 4
    field.host.delays["soccer/Camera"] = 0.01
    field.pass_time(120.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.tidy()


def test_another_way_is_found_where_one_is_always_late(field: FieldWithRates) -> None:
    field.host.delays["soccer/Camera"] = 0.3
    claim = field.acquire(max_age=LIMIT).claim
    field.pass_time(30.0)
    assert "ceiling camera" in field.labels()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    mended = len(field.mended())
    assert mended <= 2
    field.pass_time(60.0)
    assert len(field.mended()) == mended


def test_an_ordinary_topic_can_be_late(field: FieldWithRates) -> None:
    text = transformation("scan", "/scan", "out scan", "scan Scan(here)")
    text = text.replace('<transformation cost="1"', '<transformation type="topic"')
    field.manager.add_transformation(text)
    field.host.topics.add("/scan")
    claim = field.acquire("Scan(here)", max_age=LIMIT).claim
    field.pass_time(10.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.host.delays["/scan"] = 0.3
    field.pass_time(10.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    assert "topic /scan delays the stream by 0.3 s" in field.claim(claim.claim_id).detail
    field.host.delays["/scan"] = 0.0
    field.pass_time(15.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE


def test_others_go_on_with_the_late_part(field: FieldWithRates) -> None:
    easy = field.acquire("YUV(field)").claim
    keen = field.acquire(max_age=LIMIT).claim
    field.pass_time(10.0)
    field.host.delays["/bottom_camera_1"] = 0.3
    field.pass_time(20.0)
    assert field.claim(easy.claim_id).nodelets == ("/bottom_camera_1",)
    assert "/bottom_camera_1" not in field.claim(keen.claim_id).nodelets
    assert len(field.mended()) == 1


def test_clients_share_a_topic_only_if_the_newcomer_allows_as_much_age(
    field: FieldWithRates,
) -> None:
    first = field.acquire(max_age=LIMIT).claim
    assert field.acquire(max_age=2 * LIMIT).claim.topic == first.topic
    assert field.acquire().claim.topic == first.topic
    assert field.acquire(max_age=LIMIT / 2).claim.topic != first.topic


def test_it_is_said_where_nobody_can_know(field: FieldWithRates) -> None:
    field.host.delays["soccer/Localization"] = None
    claim = field.acquire(max_age=LIMIT).claim
    field.pass_time(10.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE, UNKNOWN_AGE]
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.claim(claim.claim_id).detail == UNKNOWN_AGE
    field.host.delays["soccer/Localization"] = 0.01
    field.pass_time(5.0)
    assert field.claim(claim.claim_id).detail == ""
    assert not field.mended()


def test_what_bears_no_stamp_on_the_way_is_passed_over(field: FieldWithRates) -> None:
    """The detector is fed by images without stamps, and by joints that are late."""
    claim = field.acquire(max_age=LIMIT).claim
    field.host.delays[JOINTS] = 0.3
    for kind in ("soccer/Camera", "soccer/Subsampler"):
        field.host.delays[kind] = None
    field.pass_time(10.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    assert "topic /joint_states delays the stream by 0.3 s" in field.claim(claim.claim_id).detail


@pytest.mark.parametrize("dry_run", [False, True])
@pytest.mark.parametrize("datatype", ["", IMAGE])
def test_types_without_a_header_are_refused(
    field: FieldWithRates, dry_run: bool, datatype: str
) -> None:
    field.host.unstamped.add(IMAGE)
    known = field.manager.library.get("bottom camera")
    port = known.ports[0]._replace(datatype=IMAGE)
    field.manager.add_transformation(known._replace(ports=(port,)).to_xml())
    field.manager.remove_transformation("ceiling camera")
    request = StreamRequest("YUV(field)", datatype, max_age=LIMIT)
    expected = f"carries {IMAGE}, but a type that begins with a header .* was asked for"
    with pytest.raises(StreamTypeMismatch, match=expected):
        field.reconciler.acquire(request, dry_run)
    assert not field.living()
    assert ("load", "/bottom_camera_1") not in field.host.calls


def test_a_type_that_is_known_only_after_the_spawn_is_refused_then(field: FieldWithRates) -> None:
    field.host.unstamped.add(IMAGE)
    with pytest.raises(StreamTypeMismatch, match="begins with a header"):
        field.acquire("YUV(field)", max_age=LIMIT)
    assert not field.living()
    assert not field.host.running


def test_of_two_ways_the_one_with_a_header_is_taken(field: FieldWithRates) -> None:
    field.host.unstamped.add(IMAGE)
    field.host.sources["soccer/Ceiling"] = [("image", "out", POINT)]
    claim = field.acquire("YUV(field)", max_age=LIMIT).claim
    assert claim.nodelets == ("/ceiling_camera_1",)
    assert claim.datatype == POINT


def test_a_claim_keeps_its_age_over_a_restart(tmp_path: Path) -> None:
    field = field_with_ages(str(tmp_path / "state.db"))
    field.acquire(max_age=LIMIT)
    field.pass_time(5.0)
    field.kill_manager()
    field.pass_time(10.0)
    field.host.delays["/bottom_camera_1"] = 0.3
    field.pass_time(15.0)
    assert len(field.mended()) == 1


@settings(max_examples=10, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(CHAIN), st.sampled_from([0.0, 0.02, 0.2, 2.0]), st.integers(2, 15)
        ),
        max_size=5,
    )
)
def test_nobody_is_blamed_for_what_others_add(turns: List[Tuple[str, float, int]]) -> None:
    """Parts become late and recover as they like: who is blamed was late lately."""
    field = field_with_ages()
    claim = field.acquire(max_age=LIMIT).claim
    field.pass_time(10.0)
    late_until: Dict[str, float] = {}

    def check(seconds: float) -> None:
        begin = len(field.events)
        field.pass_time(seconds)
        for event in field.events[begin:]:
            for name in re.findall(r"nodelet (\S+) delays", event.reason):
                assert field.now - late_until.get(name, -100.0) < seconds + 10.0, name

    for label, delay, seconds in turns:
        name = field.parts().get(label)
        if name is None:
            continue  # another camera stands in for it
        field.host.delays[name] = delay
        for each, present in field.host.delays.items():
            if present is not None and present > 0.01:
                late_until[each] = field.now + seconds
        check(seconds)
    for name in [name for name in field.host.delays if name.startswith("/")]:
        del field.host.delays[name]
    check(60.0)
    begin = len(field.events)
    field.pass_time(60.0)
    assert len(field.events) - begin <= 3, "it has come to rest"
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
