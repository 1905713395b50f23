# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Costs: wishes, cheaper plans, and the nodelets that a plan uses again."""

from __future__ import annotations

import contextlib
import itertools
import random
from typing import Any, List, Optional

import pytest
from unit.manager.field import IMAGE, LIBRARY, POINT, RELAY, Field, counted_ids, transformation
from unit.manager.planning.random_problems import Kinds

from dyknow.errors import BadParameter, InvalidParameters, NoPlanFound, UnknownTransformation
from dyknow.manager.claims.claim_planner import OwnNodelet, assigned
from dyknow.manager.planning.problem import Demand, Instance, New, Plan, PlanStep
from dyknow.manager.specifications.tags import Bindings, parse_tag
from dyknow.model.streams import StreamRequest

# A plan is cheaper only if all claims together cost less


@pytest.fixture
def field() -> Field:
    field = Field()
    field.host.sources["soccer/Alone"] = [("ball", "out", POINT)]
    return field


def total(field: Field) -> int:
    return sum(
        record.transformation.cost
        for record in field.manager.graph.all()
        if record.claimed and record.transformation is not None
    )


def news(field: Field) -> List[str]:
    return [reason for reason in field.reasons() if "cheaper" in reason]


ALONE = transformation("alone", "soccer/Alone", "out ball", "ball RelativePosition(ball)", 2)


def test_what_others_need_anyway_is_not_saved(field: Field) -> None:
    """A detector of cost 2 is cheaper than three parts, but two of them stay for the other."""
    whole = field.acquire("RelativePosition(ball)").claim
    planes = field.acquire("Planes(field)").claim
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert news(field) == []
    before = total(field)
    field.reconciler.replan(whole.claim_id)
    field.tidy()
    assert total(field) == before
    field.reconciler.release(planes.claim_id)
    field.manager.add_transformation(LIBRARY)  # something new: they are compared again
    field.settle(10.0)
    assert len(news(field)) == 1
    assert field.reconciler.replan(whole.claim_id).cost == 2
    field.tidy()
    assert total(field) == 2 < before


@pytest.mark.parametrize("which", [0, 1])
def test_what_all_clients_of_a_stream_share_is_saved_without_a_gap(
    field: Field, which: int
) -> None:
    with counted_ids():
        claims = [field.acquire("RelativePosition(ball)").claim for _ in range(2)]
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert len(news(field)) == 2, "each of them is told"
    field.reconciler.replan(claims[which].claim_id)
    assert field.host.publishers(claims[0].topic) == ["/alone_1"]
    field.tidy()
    field.check_flows(*claims)
    assert {field.claim(each.claim_id).goal[0] for each in claims} == {"/alone_1"}
    assert total(field) == 2


def test_what_only_others_needed_is_saved_once_they_have_gone(field: Field) -> None:
    for label, cost in (("dear", 9), ("cheap", 1)):
        text = transformation(label, "soccer/Camera", "out image", "image Eye(field)", cost)
        field.manager.add_transformation(text)
    other = field.acquire("Eye(field)", exclude=("cheap",)).claim
    claim = field.acquire("Eye(field)").claim
    assert set(other.nodelets) < set(claim.nodelets)
    field.settle(10.0)
    assert news(field) == []
    field.reconciler.release(other.claim_id)
    field.settle(10.0)
    assert news(field) == ["a cheaper way has appeared, with cheap; replanning takes it"]


def test_what_is_protected_is_not_saved(field: Field) -> None:
    field.acquire("RelativePosition(ball)")
    for name in ("/bottom_camera_1", "/subsampler_1"):
        field.manager.set_protection(name, True)
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert news(field) == []


@pytest.mark.parametrize("seed", [0, 2, 7, 8, 9, 10, 11])
def test_an_offer_that_is_taken_never_raises_the_total(seed: int) -> None:
    choice = random.Random(seed)
    tags = [f"Tag{number}(x)" for number in range(6)]
    field = Field(":memory:", RELAY, "")

    def add(number: int) -> None:
        ports = {
            f"in{each}": ("in", [choice.choice(tags[:3])])
            for each in range(choice.choice([0, 0, 1, 2]))
        }
        ports["out"] = ("out", [choice.choice(tags)])
        field.add(f"part {number}", ports, choice.randrange(6))

    for number in range(6):
        add(number)
    with counted_ids():
        for _ in range(5):
            with contextlib.suppress(NoPlanFound):
                field.acquire(choice.choice(tags))
    offers = 0
    for number in range(6, 12):
        add(number)
        field.tidy()
        offered = [event.after.claim_id for event in field.events if "cheaper" in event.reason]
        field.events.clear()
        offers += len(offered)
        for claim_id in offered[:1]:
            before = total(field)
            field.reconciler.replan(claim_id)
            field.tidy()
            assert total(field) <= before
    assert offers, "else nothing is shown"


def test_a_way_that_comes_and_goes_is_not_reported(field: Field) -> None:
    claim = field.acquire("RelativePosition(ball)").claim
    for _ in range(12):
        field.manager.add_transformation(ALONE)
        field.settle(1.5)
        field.manager.remove_transformation("alone")
        field.settle(1.5)
    assert news(field) == []
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert len(news(field)) == 1
    field.manager.remove_transformation("alone")
    field.settle(1.5)
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert len(news(field)) == 1, "it is reported once"
    assert field.reconciler.replan(claim.claim_id).cost == 2
    field.settle()
    field.manager.remove_transformation("alone")
    field.settle(10.0)
    field.manager.add_transformation(ALONE)
    field.settle(10.0)
    assert len(news(field)) == 2, "after a repair it is news again"


# Claims that prefer or avoid something


def test_what_is_avoided_is_used_while_there_is_nothing_else(field: Field) -> None:
    claim = field.acquire(avoid=("bottom camera",)).claim
    assert "/ceiling_camera_1" in claim.nodelets
    field.manager.remove_transformation("ceiling camera")
    field.settle(5.0)
    field.check_flows(claim)
    assert "/bottom_camera_1" in field.claim(claim.claim_id).nodelets

    spare = transformation("spare camera", "soccer/Camera", "out image", "image YUV(field)", 9)
    field.manager.add_transformation(spare)
    field.settle(5.0)
    assert len(news(field)) == 1
    field.reconciler.replan(claim.claim_id)
    assert "/spare_camera_1" in field.claim(claim.claim_id).nodelets
    field.settle(20.0)
    assert len(news(field)) == 1


def test_what_runs_for_others_does_not_stand_in_for_what_is_preferred(field: Field) -> None:
    other = field.acquire().claim
    assert "/bottom_camera_1" in other.nodelets
    claim = field.acquire(prefer=("ceiling camera",)).claim
    assert "/ceiling_camera_1" in claim.nodelets
    assert claim.topic != other.topic
    field.settle(5.0)
    assert field.claim(other.claim_id).wiring == other.wiring, "it is left alone"
    assert "/ceiling_camera_1" in field.claim(claim.claim_id).nodelets


@pytest.mark.parametrize("is_shared", [False, True])
def test_a_part_that_runs_on_what_is_avoided_is_charged_for_that_once(is_shared: bool) -> None:
    """Its tags bear the name for which its camera is charged."""
    field = Field(":memory:", RELAY, "")
    field.add("robot camera", {"image": ("out", ["Image(robot_camera)"])})
    field.add("tracker", {"image": ("in", ["Image(?c)"]), "position": ("out", ["Position(?c)"])})
    if is_shared:
        field.acquire("Position(robot_camera)")
        field.settle(2.0)
    field.acquire("Position(?c)", avoid=("robot_camera",))
    field.settle(10.0)
    field.add("unrelated", {"other": ("out", ["Other"])})
    field.settle(10.0)
    assert news(field) == []
    assert field.labels().count("tracker") == 1


def test_a_relay_is_not_charged_for_the_stream_that_it_forwards() -> None:
    field = Field(":memory:", RELAY, "")
    field.add("robot camera", {"image": ("out", ["Image(robot_camera)"])})
    field.acquire("Image(robot_camera)")
    field.settle(2.0)
    field.acquire("Image(robot_camera)", avoid=("robot_camera",))
    field.settle(10.0)
    assert len(field.labels()) == 2, "a camera and a relay"
    assert news(field) == []


def test_what_is_both_preferred_and_avoided_is_refused(field: Field) -> None:
    with pytest.raises(BadParameter, match="'avoid' is 'x': expected a name that is not in pref"):
        field.acquire(prefer=("x", "y"), avoid=("x",))


# Which nodelet is used for which step of a plan


LEFT: Bindings = (("?c", "left"),)
RIGHT: Bindings = (("?c", "right"),)


def plan(*instances: Instance) -> Plan:
    steps = [PlanStep(Instance(*each), (), 1) for each in instances]
    demand = Demand(frozenset((parse_tag("Ball(?c)"),)))
    return Plan(demand, New(steps[-1].instance, "out"), tuple(steps))


FREE = [OwnNodelet("/b", "t"), OwnNodelet("/a", "t"), OwnNodelet("/u", "u")]
BOUND = [OwnNodelet("/r", "t", RIGHT, RIGHT), OwnNodelet("/l", "t", LEFT, LEFT)]
KEPT = [OwnNodelet("/r", "t", (), RIGHT), OwnNodelet("/new", "t")]
RENAMED = [OwnNodelet("/a", "t", (("?c", "urn:a"),))]
MOVED = [OwnNodelet("/any", "t", (), LEFT), OwnNodelet("/l", "t", LEFT, LEFT)]


@pytest.mark.parametrize(
    ("own", "needed", "expected"),
    [
        # Each is used once, the preferred one first.
        (FREE, [("t", LEFT)], ["/b"]),
        (FREE, [("t", LEFT), ("t", RIGHT), ("v", ())], ["/b", "/a", None]),
        # Names that a nodelet keeps have to be those of the plan.
        (BOUND, [("t", LEFT)], ["/l"]),
        (BOUND, [("t", (("?c", "up"),))], [None]),
        # One that need not change is not taken for another step.
        (KEPT, [("t", LEFT), ("t", RIGHT)], ["/new", "/r"]),
        # But it is taken rather than that a new one is made.
        (MOVED, [("t", LEFT), ("t", RIGHT)], ["/l", "/any"]),
        (MOVED, [("t", RIGHT), ("t", LEFT)], ["/any", "/l"]),
        # Names of one individual are the same.
        (RENAMED, [("t", (("?c", "a"),))], ["/a"]),
    ],
)
def test_nodelets_are_used_again(
    own: List[OwnNodelet], needed: List[Instance], expected: List[Optional[str]]
) -> None:
    found = assigned(plan(*needed), own, Kinds())
    assert [found.get(each) for each in needed] == expected
    assert set(found) <= set(needed)


# Several nodelets of one transformation, each for one camera

SIDES = ("left", "right")
SIDE = '<params><param name="side" type="string">${?c}</param></params>'
RECTIFY = transformation(
    "rectify", "test/Rectify", "in raw,out rect", "raw Raw(?c);rect Rect(?c)", 10
).replace("<ports>", f"{SIDE}<ports>")


def camera(side: str) -> str:
    return transformation(f"camera {side}", "test/Camera", "out image", f"image Raw({side})")


def other(side: str) -> str:
    """A transformation for rectified images that costs less than ``RECTIFY``."""
    return transformation(f"other {side}", "test/Camera", "out image", f"image Rect({side})", 7)


STEREO = transformation(
    "stereo",
    "test/Stereo",
    "in left,in right,out out",
    "left Rect(left);right Rect(right);out Depth(field)",
)


@pytest.fixture
def cameras(field: Field) -> Field:
    field.host.sources["test/Camera"] = [("image", "out", IMAGE)]
    field.host.sources["test/Rectify"] = [("raw", "in", IMAGE), ("rect", "out", IMAGE)]
    sides = [("left", "in", IMAGE), ("right", "in", IMAGE)]
    field.host.sources["test/Stereo"] = [*sides, ("out", "out", IMAGE)]
    for text in (RECTIFY, STEREO, *map(camera, SIDES)):
        field.manager.add_transformation(text)
    return field


def test_whichever_of_the_idle_nodelets_fits_costs_nothing(cameras: Field) -> None:
    claims = [cameras.acquire(f"Rect({side})").claim for side in SIDES]
    cameras.settle()
    for side, claim in zip(SIDES, claims):
        cameras.manager.add_transformation(other(side))
        cameras.reconciler.release(claim.claim_id)
    cameras.tick()
    for side, claim in zip(SIDES, claims):
        got = cameras.reconciler.acquire(StreamRequest(f"Rect({side})"), dry_run=True)
        assert got.plan is not None
        assert (got.plan.cost, got.plan.least_cost, got.spawned) == (0, 0, ())
        assert got.reused == claim.nodelets


@pytest.mark.parametrize("side", SIDES)
def test_what_is_healthy_on_the_other_side_stays(cameras: Field, side: str) -> None:
    claim = cameras.flowing("Depth(field)")
    for each in SIDES:
        cameras.manager.add_transformation(other(each))
    cameras.manager.destroy(f"/camera_{side}_1")
    cameras.settle(5.0)
    cameras.check_flows(claim)
    kept = set(claim.nodelets) - {f"/camera_{side}_1"}
    assert set(cameras.claim(claim.claim_id).nodelets) == kept | {f"/camera_{side}_2"}


# The library changes while a plan is made: another client has no part in the lock of the claims


@pytest.mark.parametrize("label", ["bottom camera", "detector", "localization"])
@pytest.mark.parametrize("read", ["own", "_saved", "situation", "_searched", "transformations"])
def test_what_is_removed_while_plans_are_compared(
    field: Field, monkeypatch: pytest.MonkeyPatch, read: str, label: str
) -> None:
    claim = field.flowing()
    planner = field.reconciler._planner
    method = getattr(planner, read)

    def removing(*args: Any, **kwds: Any) -> Any:
        found = method(*args, **kwds)
        if label in field.manager.library:
            field.manager.remove_transformation(label)
        return found

    monkeypatch.setattr(planner, read, removing)
    with contextlib.suppress(NoPlanFound):
        field.reconciler.replan(claim.claim_id, dry_run=True)
    assert label not in field.manager.library
    field.manager.add_transformation(LIBRARY)
    field.settle()
    assert label not in field.manager.library, "a round compares too"
    monkeypatch.undo()
    field.manager.add_transformation(LIBRARY)
    field.settle(10.0)
    field.check_flows(claim)


def test_what_is_replaced_each_time_before_a_plan_is_used(
    cameras: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third plan is used as it is, with a variable that is gone."""
    planner = cameras.reconciler._planner
    searched, texts = planner._searched, itertools.cycle([RECTIFY.replace("?c", "?d"), RECTIFY])

    def replacing(situation: Any) -> Any:
        found = searched(situation)
        cameras.manager.add_transformation(next(texts))
        return found

    monkeypatch.setattr(planner, "_searched", replacing)
    with pytest.raises(InvalidParameters, match="nothing says what"):
        cameras.acquire("Rect(left)")
    cameras.tidy()
    assert cameras.labels() == [], "nothing is left of it"


def test_a_topic_that_is_no_topic_any_more_when_the_plan_is_used(
    field: Field, monkeypatch: pytest.MonkeyPatch
) -> None:
    repair = field.reconciler._repair
    make = repair.make

    def replacing(*args: Any, **kwds: Any) -> Any:
        field.manager.add_transformation(
            "<transformation><label>joints</label><source>soccer/Camera</source></transformation>"
        )
        return make(*args, **kwds)

    monkeypatch.setattr(repair, "make", replacing)
    with pytest.raises(UnknownTransformation, match="joints"):
        field.acquire()
    field.tidy()
    assert field.labels() == [], "nothing is left of it"
