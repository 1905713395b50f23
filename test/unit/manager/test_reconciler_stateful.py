# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Claims under random events in any order: the invariants hold after every step."""

from __future__ import annotations

from typing import Set, Tuple

from charged_robot import CHARGED, FORMULAS
from hypothesis import HealthCheck
from hypothesis import strategies as st
from hypothesis.stateful import invariant, precondition, rule
from property_tests import examples
from unit.manager.faulty_lives import NUMBERS, FaultyLife
from unit.manager.field import Field, library, transformation
from unit.manager.test_requirements import requiring

from dyknow.errors import DyKnowError, NoPlanFound
from dyknow.model.streams import ClaimState

OTHERS = library(
    transformation(
        "other localization",
        "soccer/Localization",
        "in ball, out position",
        "ball RelativePosition(?what); position FieldPosition(ball)",
        cost=3,
    ),
    transformation("stereo", "soccer/Camera", "out image", "image RelativePosition(goal)"),
)
GUARDED = requiring("bottom camera", CHARGED)
TAGS = st.sampled_from(
    ["FieldPosition(ball)", "RelativePosition(?what)", "RelativePosition(ball)", "Planes(field)"]
)
LABELS = st.sampled_from(
    ["bottom camera", "subsampler", "detector", "localization", "other localization", "stereo"]
)
TYPES = st.sampled_from(["soccer/Camera", "soccer/Detector", "/joint_states"])


class Claims(FaultyLife):
    """One field with clients, users and accidents."""

    def __init__(self) -> None:
        super().__init__()
        self.field.manager.add_transformation(OTHERS)
        self.field.host.topics.add("/battery")
        self.field.manager.add_transformation(FORMULAS)
        self.field.manager.add_transformation(GUARDED)
        self.hand = 0
        self.protected: Set[str] = set()

    def make_field(self, path: str) -> Field:
        return Field(path)

    def teardown(self) -> None:
        self.end_faults()
        field = self.field
        field.host.topics.add("/joint_states")
        field.manager.add_transformation(GUARDED)
        field.manager.add_transformation(OTHERS)
        for topic in field.host.followed:
            field.host.decide(topic, True)
        field.settle(100.0)
        for claim in field.living():
            assert claim.state is ClaimState.ACTIVE, claim.detail
            assert claim.topic in field.moving
        for name in self.protected & set(field.host.running):
            field.manager.set_protection(name, False)
        field.tidy()
        self.close()

    # Clients

    @rule(
        tag=TAGS,
        exclude=st.sampled_from([(), (), ("bottom camera",)]),
        silence=st.sampled_from([0.0, 0.0, 1.0]),
        require=st.sampled_from(["", "", "present(it)"]),
    )
    def acquire(self, tag: str, exclude: Tuple[str, ...], silence: float, require: str) -> None:
        before = self.field.host.running
        try:
            self.field.acquire(tag, exclude=exclude, max_silence=silence, require=require)
        except NoPlanFound:
            return
        except DyKnowError:
            assert self.field.host.running == before

    # Users

    @rule(label=st.sampled_from(["bottom camera", "subsampler", "detector"]))
    def spawn(self, label: str) -> None:
        self.hand += 1
        config = {"image": "/by_hand/image"} if label == "bottom camera" else {}
        self.asked(lambda: self.field.spawn(label, f"/by_hand_{self.hand}", config=config))

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS)
    def destroy(self, number: int) -> None:
        self.asked(lambda: self.field.destroy_by_hand(self.any_nodelet(number)))

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS)
    def protect(self, number: int) -> None:
        name = self.any_nodelet(number)
        self.protected.add(name)
        self.asked(lambda: self.field.manager.set_protection(name, True))

    @rule(label=LABELS)
    def remove_transformation(self, label: str) -> None:
        self.asked(lambda: self.field.manager.remove_transformation(label))

    @rule()
    def add_transformations(self) -> None:
        self.field.manager.add_transformation(GUARDED)

    # Accidents

    @precondition(lambda self: self.field.host.followed)
    @rule(number=NUMBERS, is_true=st.booleans())
    def decide(self, number: int, is_true: bool) -> None:
        self.field.host.decide(self.any_of(sorted(self.field.host.followed), number), is_true)

    @rule(kind=TYPES, silent=st.booleans())
    def silence(self, kind: str, silent: bool) -> None:
        (self.field.host.silent.add if silent else self.field.host.silent.discard)(kind)

    @rule(there=st.booleans())
    def sensor(self, there: bool) -> None:
        topics = self.field.host.topics
        (topics.add if there else topics.discard)("/joint_states")

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS)
    def restart(self, number: int) -> None:
        self.asked(lambda: self.field.manager.restart(self.any_nodelet(number)))

    @rule(seconds=st.sampled_from([1.0, 10.0, 100.0]))
    def wait(self, seconds: float) -> None:
        self.field.settle(seconds)

    @invariant()
    def holds(self) -> None:
        self.field.settle(1.0)


Claims.TestCase.settings = examples(
    30, stateful_step_count=15, suppress_health_check=list(HealthCheck)
)
TestClaims = Claims.TestCase


def test_a_request_that_fails_leaves_nothing_of_the_name_of_a_dead_part() -> None:
    """A claim waits for a part that died; the plan of another request made one of its name."""
    Claims().relive(
        ("acquire", "RelativePosition(?what)", (), 1.0, ""),
        ("kill", 22),
        ("acquire", "FieldPosition(ball)", ("bottom camera",), 1.0, ""),
        ("silence", "/joint_states", True),
        ("kill", 24),
        ("acquire", "FieldPosition(ball)", ("bottom camera",), 0.0, "present(it)"),
    )


def test_a_replaced_part_that_is_to_be_destroyed_goes_as_soon_as_its_process_answers() -> None:
    """Attempts on a hung nodelet manager do not count as failures, which pauses would follow."""
    Claims().relive(
        ("acquire", "RelativePosition(ball)", (), 0.0, ""),
        ("hang", 0, True),
        ("destroy", 4),
        ("wait", 1.0),
        ("hang", 0, False),
    )
