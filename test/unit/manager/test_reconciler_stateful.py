"""Claims under anything that may happen, in any order: what must hold, holds after every step."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Set, Tuple

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from unit.manager.field import LIBRARY, Field, counted_ids, transformation

from dyknow.errors import DyKnowError, NoPlanFound
from dyknow.model.streams import ClaimState

OTHERS = "".join(
    [
        "<transformations>",
        transformation(
            "other localization",
            "soccer/Localization",
            "in ball, out position",
            "ball RelativePosition(?what); position FieldPosition(ball)",
            cost=3,
        ),
        transformation("stereo", "soccer/Camera", "out image", "image RelativePosition(goal)"),
        "</transformations>",
    ]
)
TAGS = st.sampled_from(
    ["FieldPosition(ball)", "RelativePosition(?what)", "RelativePosition(ball)", "Planes(field)"]
)
LABELS = st.sampled_from(
    ["bottom camera", "subsampler", "detector", "localization", "other localization", "stereo"]
)
TYPES = st.sampled_from(["soccer/Camera", "soccer/Detector", "/joint_states"])
NUMBERS = st.integers(0, 20)


class Claims(RuleBasedStateMachine):
    """One field with clients, users and accidents."""

    def __init__(self) -> None:
        super().__init__()
        self.ids = counted_ids()
        self.ids.start()
        self.folder = tempfile.TemporaryDirectory()
        self.field = Field(str(Path(self.folder.name) / "state.db"))
        self.field.manager.add_transformation(OTHERS)
        self.hand = 0
        self.protected: Set[str] = set()

    def teardown(self) -> None:
        self.ids.stop()
        field = self.field
        field.host.silent.clear()
        field.host.topics.add("/joint_states")
        for manager in list(field.host.processes):
            field.host.wake(manager)
        field.manager.add_transformation(LIBRARY)
        field.manager.add_transformation(OTHERS)
        field.settle(100.0)
        for claim in field.living():
            assert claim.state is ClaimState.ACTIVE, claim.detail
            assert claim.topic in field.moving
        for name in self.protected & set(field.host.running):
            field.manager.set_protection(name, False)
        field.tidy()
        field.store.close()
        self.folder.cleanup()

    # Clients

    @rule(
        tag=TAGS,
        exclude=st.sampled_from([(), (), ("bottom camera",)]),
        silence=st.sampled_from([0.0, 0.0, 1.0]),
    )
    def acquire(self, tag: str, exclude: Tuple[str, ...], silence: float) -> None:
        before = self.field.host.running
        try:
            self.field.acquire(tag, exclude=exclude, max_silence=silence)
        except NoPlanFound:
            return
        except DyKnowError:
            assert self.field.host.running == before

    @precondition(lambda self: self.field.living())
    @rule(number=NUMBERS)
    def release(self, number: int) -> None:
        living = self.field.living()
        self.field.reconciler.release(living[number % len(living)].claim_id)

    @precondition(lambda self: self.field.living())
    @rule(number=NUMBERS)
    def replan(self, number: int) -> None:
        living = self.field.living()
        try:
            self.field.reconciler.replan(living[number % len(living)].claim_id)
        except DyKnowError:
            return

    # Users

    @rule(label=st.sampled_from(["bottom camera", "subsampler", "detector"]))
    def spawn(self, label: str) -> None:
        self.hand += 1
        ports = {"bottom camera": {"image": "/by_hand/image"}, "subsampler": {}, "detector": {}}
        try:
            self.field.spawn(label, f"/by_hand_{self.hand}", config=ports[label])
        except DyKnowError:
            return

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS)
    def destroy(self, number: int) -> None:
        name = self.field.host.running[number % len(self.field.host.running)]
        try:
            self.field.destroy_by_hand(name)
        except DyKnowError:
            return

    @precondition(lambda self: self.field.host.running)
    @rule(number=NUMBERS)
    def protect(self, number: int) -> None:
        name = self.field.host.running[number % len(self.field.host.running)]
        try:
            self.field.manager.set_protection(name, True)
            self.protected.add(name)
        except DyKnowError:
            return

    @rule(label=LABELS)
    def remove_transformation(self, label: str) -> None:
        try:
            self.field.manager.remove_transformation(label)
        except DyKnowError:
            return

    @rule()
    def add_transformations(self) -> None:
        self.field.manager.add_transformation(LIBRARY)

    # Accidents

    @rule(number=NUMBERS)
    def kill(self, number: int) -> None:
        processes = sorted(self.field.host.processes)
        if processes:
            self.field.host.kill(processes[number % len(processes)])

    @rule(number=NUMBERS, hang=st.booleans())
    def hang(self, number: int, hang: bool) -> None:
        host = self.field.host
        processes = [name for name in sorted(host.processes) if host.processes[name].state.alive]
        if processes:
            (host.hang if hang else host.wake)(processes[number % len(processes)])

    @rule(kind=TYPES, silent=st.booleans())
    def silence(self, kind: str, silent: bool) -> None:
        (self.field.host.silent.add if silent else self.field.host.silent.discard)(kind)

    @rule(there=st.booleans())
    def sensor(self, there: bool) -> None:
        topics = self.field.host.topics
        (topics.add if there else topics.discard)("/joint_states")

    @rule()
    def kill_dyknow(self) -> None:
        self.field.kill_manager()

    @rule(seconds=st.sampled_from([1.0, 10.0, 100.0]))
    def wait(self, seconds: float) -> None:
        self.field.settle(seconds)

    @invariant()
    def holds(self) -> None:
        self.field.settle(1.0)


Claims.TestCase.settings = settings(
    max_examples=30,
    stateful_step_count=15,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
TestClaims = Claims.TestCase
