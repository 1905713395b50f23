# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims with limits (a silence, a rate, an age): the part at fault is replaced, and no other."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Set, Tuple
from unittest import mock

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from property_tests import examples
from unit.manager.field import CHAIN, FIRST_MESSAGE, IMAGE, POINT, Field, topic, transformation

from dyknow.errors import BadParameter, NoPlanFound, StreamTypeMismatch
from dyknow.formulas.types import MessageType
from dyknow.manager.claims.requirements import topic_of_verdicts
from dyknow.manager.planning.planner import Planner
from dyknow.model.graph import State
from dyknow.model.streams import UNKNOWN_AGE, ClaimState, StreamRequest
from dyknow.model.transformation import Port, Transformation

#: Seconds between two messages of a source that is fast enough, and between two looks.
STEP = 0.05
RATE, AGE = 5.0, 0.1
JOINTS = "/joint_states"


class LimitField(Field):
    """Parts send each so many messages that they receive, or steps of time, and add 10 ms."""

    def __init__(self, path: str = ":memory:") -> None:
        super().__init__(path)
        self.host.dividers = self.dividers = {"soccer/Camera": 2, JOINTS: 1}
        self.delays = self.host.delays
        self.delays.update(dict.fromkeys(self.host.sources, 0.01))

    def settle(self, seconds: float = 10.0) -> None:
        """Let messages flow every 50 ms, and the reconciler work every half second."""
        for step in range(round(seconds / STEP)):
            self.sleep(STEP)
            if step % 10 == 9:
                self.manager.look()
                self.reconciler.reconcile()
        self.check()

    def parts(self) -> Dict[str, str]:
        return {record.label: record.name for record in self.manager.graph.all()}


@dataclass(frozen=True)
class Limit:
    """A limit, and the faults that exceed it; a fault has a degree from 0 (none) to 5."""

    request: Dict[str, Any]
    spoil: Callable[[LimitField, str, int], None]
    reason: str

    def heal(self, field: LimitField, name: str) -> None:
        self.spoil(field, name, 0)


def slow_down(field: LimitField, name: str, degree: int) -> None:
    field.dividers[name] = (degree + 1) * (2 if "camera" in name.lower() else 1)


def delay(field: LimitField, name: str, degree: int) -> None:
    field.delays[name] = (0.01, 0.02, 0.02, 0.2, 0.2, 2.0)[degree]


def hush(field: LimitField, name: str, degree: int) -> None:
    (field.host.silent.add if degree else field.host.silent.discard)(name)


LIMITS = {
    "silence": Limit({"max_silence": 1.0}, hush, "{} was silent for longer than 1 s"),
    "rate": Limit(
        {"min_rate": RATE},
        slow_down,
        r"{} is too slow: it sends ([0-4][.0-9]*) Hz; "
        r"the stream has [0-4][.0-9]* Hz, at least 5 Hz are demanded",
    ),
    "age": Limit(
        {"max_age": AGE},
        delay,
        r"{} delays the stream by 2 s: it is 2[.0-9]* s old, at most 0.1 s is demanded",
    ),
}


#: Limits that a stream may exceed while messages come.
OF_FLOWS = ("age", "rate")


@pytest.fixture(params=LIMITS)
def limit(request: pytest.FixtureRequest) -> Limit:
    return LIMITS[request.param]


@pytest.fixture
def field() -> LimitField:
    return LimitField()


# All limits


@pytest.mark.parametrize("label", CHAIN)
def test_the_part_at_fault_is_replaced_once(field: LimitField, limit: Limit, label: str) -> None:
    claim = field.flowing(**limit.request)
    victim = field.parts()[label]
    others = set(field.host.running) - {victim}
    limit.spoil(field, victim, 5)
    field.settle(60.0)
    (reason,) = field.mended()
    what = "mended: nodelet " + limit.reason.format(victim)
    assert re.fullmatch(what + f"; {victim[:-1]}2 is used now", reason)
    assert others <= set(field.host.running)
    assert victim not in field.host.running
    field.check_flows(claim)


def test_without_another_way_it_is_degraded_until_the_part_recovers(
    field: LimitField, limit: Limit
) -> None:
    field.manager.remove_transformation("ceiling camera")
    limit.spoil(field, "soccer/Camera", 4)
    claim = field.acquire(**limit.request).claim
    field.settle(120.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    assert "nodelet /bottom_camera_" in field.claim(claim.claim_id).detail
    assert (claim.topic in field.moving) is (limit is not LIMITS["silence"])
    assert len(field.mended()) <= (10 if limit is LIMITS["silence"] else 4), "the pauses grow"
    limit.heal(field, "soccer/Camera")
    field.settle(120.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    field.tidy()


def test_a_transformation_that_never_is_good_enough_gives_way(
    field: LimitField, limit: Limit
) -> None:
    limit.spoil(field, "soccer/Camera", 5)
    claim = field.acquire(**limit.request).claim
    field.settle(30.0)
    assert "ceiling camera" in field.labels()
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    mended = len(field.mended())
    assert mended <= 2
    field.settle(60.0)
    assert len(field.mended()) == mended


def test_an_ordinary_topic_can_be_at_fault(field: LimitField, limit: Limit) -> None:
    field.manager.add_transformation(topic("scan", "/scan", "Scan(here)"))
    field.host.topics.add("/scan")
    claim = field.flowing("Scan(here)", **limit.request)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    limit.spoil(field, "/scan", 5)
    field.settle(15.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    detail = field.claim(claim.claim_id).detail
    assert re.match("topic " + limit.reason.format("/scan"), detail)
    limit.heal(field, "/scan")
    field.settle(15.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert not field.mended()


def test_the_part_at_fault_is_replaced_while_other_clients_come_and_go(
    field: LimitField, limit: Limit
) -> None:
    claim = field.flowing(**limit.request)
    limit.spoil(field, field.parts()["detector"], 5)
    for _ in range(30):
        other = field.acquire("RelativePosition(ball)").claim
        field.settle(0.5)
        field.reconciler.release(other.claim_id)
    assert field.parts()["detector"] == "/detector_2"
    field.check_flows(claim)


@pytest.mark.parametrize("limit", OF_FLOWS, indirect=True)
@pytest.mark.parametrize("is_by_hand", [False, True])
def test_clients_without_the_limit_go_on_with_the_part(
    field: LimitField, limit: Limit, is_by_hand: bool
) -> None:
    if is_by_hand:
        field.spawn("bottom camera", "/camera", config={"image": "/camera/image"})
    easy = field.acquire("YUV(field)").claim
    keen = field.flowing(**limit.request)
    limit.spoil(field, easy.nodelets[0], 5)
    field.settle(30.0)
    assert len(field.mended()) == 1
    assert field.claim(easy.claim_id).nodelets == easy.nodelets
    assert not {*easy.nodelets} & {*field.claim(keen.claim_id).nodelets}
    assert field.state(keen.claim_id) is ClaimState.ACTIVE


TURNS = st.tuples(st.sampled_from(CHAIN), st.integers(0, 5), st.integers(2, 15))


@examples(40)
@given(st.sampled_from(OF_FLOWS), st.lists(TURNS, max_size=5))
@example("rate", [("bottom camera", 5, 5), ("subsampler", 2, 3), ("subsampler", 1, 2)])
@example("rate", [("bottom camera", 3, 3), ("detector", 1, 3), ("bottom camera", 1, 3)])
@example("age", [("bottom camera", 3, 4), ("detector", 5, 3), ("localization", 4, 9)])
def test_only_a_part_that_was_at_fault_lately_is_blamed(
    name_of_limit: str, turns: List[Tuple[str, int, int]]
) -> None:
    limit, field = LIMITS[name_of_limit], LimitField()
    claim = field.flowing(**limit.request)
    bad: Set[str] = set()
    bad_until: Dict[str, float] = {}

    def check(seconds: float) -> None:
        begin = len(field.events)
        field.settle(seconds)
        for event in field.events[begin:]:
            for name in re.findall(r"nodelet (\S+) (?:is too slow|delays)", event.reason):
                assert field.now - bad_until.get(name, -100.0) < seconds + 10.0, name

    for label, degree, seconds in turns:
        name = field.parts().get(label)
        if name is None:
            continue  # another camera stands in for it
        limit.spoil(field, name, degree)
        (bad.add if degree else bad.discard)(name)
        bad_until.update(dict.fromkeys(bad, field.now + seconds))
        check(seconds)
    for name in set(field.host.running):
        limit.heal(field, name)
    check(60.0)
    begin = len(field.events)
    field.settle(60.0)
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
def test_bad_values_are_refused(field: LimitField, name: str, value: float) -> None:
    with pytest.raises(BadParameter, match=f"parameter '{name}' is {value}"):
        field.acquire("YUV(field)", **{name: value})
    assert not field.living()


# Claims with different limits that share a part


RAW, SEEN = "Raw(field)", "Seen(field)"


@pytest.fixture
def two_cameras(field: LimitField) -> LimitField:
    """Two cameras, the second of which is slow, for one filter, which a viewer needs."""
    field.add("fast", {"out": ("out", [RAW])}, 3)
    field.add("slow", {"out": ("out", [RAW])}, 4)
    field.add("filter", {"in": ("in", [RAW]), "out": ("out", [SEEN])}, 2)
    field.add("viewer", {"in": ("in", [SEEN]), "out": ("out", ["View(field)"])}, 2)
    field.delays.update(dict.fromkeys(field.host.sources, 0.01))
    field.dividers["lab/slow"] = 4
    return field


def state(field: LimitField, label: str, **stated: Any) -> None:
    """Let the out-ports of a transformation state something."""
    known = field.manager.library.get(label)
    ports = tuple(
        port._replace(**stated) if port.direction == "out" else port for port in known.ports
    )
    field.manager.add_transformation(known._replace(ports=ports).to_xml())


@pytest.mark.parametrize("is_stated", [False, True])
def test_two_claims_do_not_take_a_part_from_each_other(
    two_cameras: LimitField, is_stated: bool
) -> None:
    """One camera is too slow for the first claim, and the other gets too old for the second."""
    field = two_cameras
    if is_stated:
        state(field, "fast", rate=20.0)
        state(field, "slow", rate=5.0)
    first = field.acquire(SEEN, min_rate=15.0).claim
    second = field.acquire("View(field)", max_age=0.2).claim
    assert set(first.nodelets) < set(second.nodelets)
    field.settle(8.0)
    field.delays["lab/fast"] = 1.0
    field.settle(30.0)
    events, calls = len(field.events), len(field.host.calls)
    field.settle(60.0)
    assert field.events[events:] == []
    assert {"connect", "load"}.isdisjoint(name for name, _ in field.host.calls[calls:])
    assert {each.state for each in field.living()} == {ClaimState.ACTIVE}
    assert field.parts()["fast"] in field.claim(first.claim_id).nodelets


def test_two_claims_with_formulas_do_not_take_a_part_from_each_other(
    two_cameras: LimitField,
) -> None:
    """Each formula is FALSE with another one of the two cameras."""
    field = two_cameras
    first = field.acquire(SEEN, require="present(it)").claim
    second = field.acquire("View(field)", require="present(it)").claim

    def judge(seconds: float) -> None:
        for _ in range(round(2 * seconds)):
            for each, bad in ((first, "/slow_1"), (second, "/fast_1")):
                claim = field.claim(each.claim_id)
                field.host.decide(topic_of_verdicts(claim), bad not in claim.nodelets)
            field.settle(0.5)

    field.settle(5.0)
    judge(30.0)
    events = len(field.events)
    judge(60.0)
    assert field.events[events:] == []
    assert {each.state for each in field.living()} == {ClaimState.ACTIVE}


# Rates


def test_a_part_that_sends_less_than_it_receives_is_not_blamed(field: LimitField) -> None:
    """The subsampler sends each third image; then the camera, still above 5 Hz, slows down."""
    field.dividers.update({"soccer/Camera": 1, "soccer/Subsampler": 3})
    field.acquire(min_rate=RATE)
    field.settle()
    field.dividers["/bottom_camera_1"] = 3
    field.settle(30.0)
    assert len(field.mended()) == 1
    assert "/bottom_camera_1 is too slow" in field.mended()[0]


def test_a_rate_about_the_limit_makes_nothing_flap(field: LimitField) -> None:
    field.manager.remove_transformation("ceiling camera")
    field.flowing(min_rate=RATE)
    for turn in range(40):
        field.dividers["soccer/Camera"] = 4 + turn % 2
        field.settle(3.5)
    assert len(field.mended()) <= 5, field.mended()  # in 140 s: the pauses grow
    assert all("/bottom_camera_" in each for each in field.mended())


def test_a_replaced_transformation_is_tried_at_once(two_cameras: LimitField) -> None:
    field = two_cameras
    field.manager.remove_transformation("fast")
    field.dividers["lab/slow"] = 10
    claim = field.acquire(RAW, min_rate=RATE).claim
    field.settle(100.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    text = transformation("slow", "lab/fast", "out out", f"out {RAW}", 4)
    field.manager.add_transformation(text)
    field.settle(5.0)
    assert field.state(claim.claim_id) is ClaimState.ACTIVE


def test_a_slow_network_makes_no_part_slow(field: LimitField) -> None:
    field.flowing(min_rate=RATE)

    def take_long(operation: str, argument: str) -> None:
        if operation == "counts":
            for _ in range(4):
                field.sleep(STEP)

    field.host.fail = take_long
    field.settle(30.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]


def test_a_lost_nodelet_that_was_too_slow_leaves_other_streams_to_be_repaired(
    field: LimitField,
) -> None:
    field.host.add("/robot")
    field.manager.look()
    field.spawn("bottom camera", "/eye", manager="/robot", config={"image": "/eye/image"})
    lidar = transformation("lidar", "soccer/Ceiling", "out image", "image Scan(here)")
    alone = lidar.replace("<transformation", '<transformation isolated="true"')
    field.manager.add_transformation(alone)
    slow = field.acquire("YUV(field)", exclude=("ceiling camera",), min_rate=20.0).claim
    field.manager.remove_transformation("bottom camera")
    other = field.flowing("Scan(here)")
    assert "/eye is too slow" in field.claim(slow.claim_id).detail
    field.host.kill("/robot")
    field.settle(5.0)
    assert field.manager.graph.get("/eye").state is State.LOST
    field.host.vanish(other.goal[0])
    field.settle(5.0)
    field.check_flows(other)
    assert field.state(slow.claim_id) is ClaimState.PENDING


def test_a_stated_rate_holds_for_the_goal_and_for_all_that_it_feeds(field: LimitField) -> None:
    state(field, "bottom camera", rate=5.0)
    field.acquire(min_rate=10.0)
    assert "ceiling camera" in field.labels()
    field.manager.remove_transformation("ceiling camera")
    field.tidy()
    for tag in ("YUV(field)", "Planes(field)"):
        with pytest.raises(NoPlanFound, match="it is stated at 5 Hz, below 10 Hz"):
            field.acquire(tag, min_rate=10.0)


# Ages


def test_a_delay_that_is_stated_is_not_blamed(field: LimitField) -> None:
    """The detector states that it takes long; the camera does not."""
    state(field, "detector", latency=0.3)
    field.flowing(max_age=0.4)
    field.delays.update({field.parts()["detector"]: 0.3, "/bottom_camera_1": 0.2})
    field.settle(30.0)
    (reason,) = field.mended()
    assert "/bottom_camera_1 delays the stream by 0.2 s" in reason


def test_an_input_that_is_older_than_the_output_is_not_blamed(field: LimitField) -> None:
    """Messages of the detector bear the stamp of its images, not that of its joints."""
    field.flowing(max_age=AGE)
    detector = field.parts()["detector"]  # its delay adds to the age of its oldest input
    field.delays.update({"/bottom_camera_1": 0.2, JOINTS: 5.0, detector: -4.78})
    field.settle(8.0)
    (reason,) = field.mended()
    assert "nodelet /bottom_camera_1 delays the stream by 0.2 s" in reason


def test_inputs_without_stamps_are_passed_over(field: LimitField) -> None:
    """The detector is fed by images without stamps, and by joints that are late."""
    claim = field.acquire(max_age=AGE).claim
    field.delays.update({JOINTS: 0.3, "soccer/Camera": None, "soccer/Subsampler": None})
    field.settle(10.0)
    assert field.state(claim.claim_id) is ClaimState.DEGRADED
    assert "topic /joint_states delays the stream by 0.3 s" in field.claim(claim.claim_id).detail


def test_hiccups_are_no_delay(field: LimitField) -> None:
    field.flowing(max_age=AGE)
    for _ in range(10):
        field.delays["/bottom_camera_1"] = 1.0
        field.settle(1.0)
        field.delays["/bottom_camera_1"] = 0.01
        field.settle(4.0)
    assert field.reasons() == ["requested", FIRST_MESSAGE]


def test_clients_share_a_topic_only_if_the_newcomer_allows_as_much_age(field: LimitField) -> None:
    first = field.acquire(max_age=AGE).claim
    assert field.acquire(max_age=2 * AGE).claim.topic == first.topic
    assert field.acquire().claim.topic == first.topic
    assert field.acquire(max_age=AGE / 2).claim.topic != first.topic


def test_the_claim_says_that_an_age_is_not_known(field: LimitField) -> None:
    field.delays["soccer/Localization"] = None
    claim = field.flowing(max_age=AGE)
    assert field.reasons() == ["requested", FIRST_MESSAGE, UNKNOWN_AGE]
    assert field.state(claim.claim_id) is ClaimState.ACTIVE
    assert field.claim(claim.claim_id).detail == UNKNOWN_AGE
    field.delays["soccer/Localization"] = 0.01
    field.settle(5.0)
    assert field.claim(claim.claim_id).detail == ""
    assert not field.mended()


@pytest.mark.parametrize(("dry_run", "datatype"), [(True, ""), (False, ""), (False, IMAGE)])
def test_types_without_a_header_are_refused(
    field: LimitField, dry_run: bool, datatype: str
) -> None:
    field.host.unstamped.add(IMAGE)
    state(field, "bottom camera", datatype=IMAGE)
    field.manager.remove_transformation("ceiling camera")
    expected = f"carries {IMAGE}, but a type that begins with a header .* was requested"
    with pytest.raises(StreamTypeMismatch, match=expected):
        field.reconciler.acquire(StreamRequest("YUV(field)", datatype, max_age=AGE), dry_run)
    assert not field.living()
    assert ("load", "/bottom_camera_1") not in field.host.calls


def test_a_type_that_the_spawn_shows_is_checked_too(field: LimitField) -> None:
    field.host.unstamped.add(IMAGE)
    with pytest.raises(StreamTypeMismatch, match="begins with a header"):
        field.acquire("YUV(field)", max_age=AGE)
    assert (field.living(), field.host.running) == ([], [])
    field.host.sources["soccer/Ceiling"] = [("image", "out", POINT)]
    claim = field.acquire("YUV(field)", max_age=AGE).claim
    assert (claim.nodelets, claim.datatype) == (("/ceiling_camera_1",), POINT)


POSE = "geometry_msgs/Pose"


def provide(field: LimitField, label: str, *ports: Port) -> None:
    """Add a transformation, whose ports state their types, and its nodelet type."""
    field.host.sources[f"lab/{label}"] = [port[:3] for port in ports]
    field.manager.add_transformation(Transformation(label, f"lab/{label}", ports=ports).to_xml())


@pytest.mark.parametrize(
    ("needed", "why"),
    [
        ({"max_age": AGE}, "a type that begins with a header"),
        ({"require": "it.x > 0"}, f"{POSE} has no field 'x'"),
    ],
)
def test_a_waiting_claim_starts_no_source_of_a_wrong_type(
    field: LimitField, needed: Dict[str, Any], why: str
) -> None:
    field.host.unstamped.add(POSE)
    field.manager.library.types = {POSE: MessageType(POSE, {}, frozenset())}.get
    with pytest.raises(NoPlanFound) as refused:
        field.acquire("Pose(robot)", **needed)
    provide(field, "robot", Port("pose", "out", POSE, ("Pose(robot)",)))
    field.settle()
    assert ("load", "/robot_1") not in field.host.calls
    claim = field.claim(refused.value.claim_id)
    assert claim.state is ClaimState.PENDING and why in claim.detail
    provide(field, "head", Port("pose", "out", POINT, ("Pose(robot)",)))
    field.settle()
    field.check_flows(field.claim(claim.claim_id))


def test_a_stamped_port_is_found_beside_one_without_a_stamp(field: LimitField) -> None:
    field.host.unstamped.add(POSE)
    tags = ("Pose(robot)",)
    provide(field, "robot", Port("pose", "out", POSE, tags), Port("stamped", "out", POINT, tags))
    claim = field.acquire("Pose(robot)", max_age=AGE).claim
    assert (claim.datatype, claim.goal[1]) == (POINT, "stamped")


def test_a_stream_without_a_stamp_may_feed_the_part_that_stamps_it(field: LimitField) -> None:
    field.host.unstamped.add(POSE)
    provide(field, "robot", Port("pose", "out", POSE, ("Pose(robot)",)))
    tags = ("Pose(?x)",)
    provide(field, "stamp", Port("in", "in", POSE, tags), Port("out", "out", POINT, tags))
    assert field.acquire("Pose(robot)", max_age=AGE).spawned == ("/robot_1", "/stamp_1")


def test_very_many_streams_without_a_stamp_are_refused_at_once(field: LimitField) -> None:
    field.host.unstamped.add(POSE)
    for number in range(50):
        provide(field, f"robot{number}", Port("pose", "out", POSE, (f"Pose(robot{number})",)))
    plan = mock.patch.object(Planner, "plan", autospec=True, side_effect=Planner.plan)
    with plan as counted, pytest.raises(StreamTypeMismatch, match="begins with a header"):
        field.acquire("Pose(?robot)", max_age=AGE)
    assert counted.call_count <= 4
