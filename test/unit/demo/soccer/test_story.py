# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The study's story on the fake host: the robot's camera goes, another's footage takes its way."""

from __future__ import annotations

from pathlib import Path

import pytest
from clocks import HandClock

from dyknow.manager.claim import Claim
from dyknow.manager.claims.reconciler import open_reconciler
from dyknow.manager.library import Library
from dyknow.manager.specifications.ontology import load_ontology
from dyknow.manager.specifications.specification import parse_file
from dyknow.manager.store import Store
from dyknow.model.streams import ClaimState, StreamRequest
from dyknow.simulated.host import FakeHost

EXAMPLES = Path(__file__).parents[4] / "examples"
SOCCER = EXAMPLES / "transformations" / "soccer.xml"
TRACKING = {"/nao_body_1", "/image_subsampler_1", "/ball_detector_1"}
LOCALIZATION = "/localization_1"
CAMERA, CEILING = "/bottom_camera_1", "/ceiling_camera_1"
VERDICTS = "/charged_1"


class Field:
    """The soccer field's manager and reconciler; time is moved by hand."""

    def __init__(self) -> None:
        self.ontology = load_ontology([str(EXAMPLES / "ontologies" / "soccer.ttl")])
        made = parse_file(str(SOCCER), self.ontology).transformations
        self.clock = HandClock()
        self.host = FakeHost(
            {
                each.source: [(port.name, port.direction, port.datatype) for port in each.ports]
                for each in made
                if each.type == "nodelet"
            },
            clock=self.clock.now,
        )
        store = Store(":memory:")
        library = Library(store, self.ontology)
        self.reasons: list[str] = []
        self.reconciler = open_reconciler(
            self.host,
            store,
            library,
            clock=self.clock,
            sleep=self.sleep,
            on_event=lambda event: self.reasons.append(event.reason),
        )
        self.manager = self.reconciler.manager
        self.manager.start()
        self.manager.add_transformation(SOCCER.read_text())
        self.host.topics.add("/nao/battery")

    def battery(self, is_charged: bool) -> None:
        self.host.decide(f"{VERDICTS}/holds", is_charged)

    def claim(self, claim_id: str) -> Claim:
        return next(each for each in self.reconciler.claims() if each.claim_id == claim_id)

    def cheaper(self) -> list[str]:
        return [reason for reason in self.reasons if "cheaper" in reason]

    def sleep(self, seconds: float) -> None:
        self.clock.time += seconds
        self.host.flow()

    def settle(self, seconds: float = 2.0) -> None:
        for _ in range(int(seconds / 0.2)):
            self.sleep(0.2)
            self.manager.look()
            self.reconciler.reconcile()

    def feeds(self, camera: str, number: int = 1) -> None:
        """Both what the robot's vision takes from a camera comes from this one."""
        for nodelet, port, source in (
            (f"/image_subsampler_{number}", "yuv", "image"),
            (f"/ball_detector_{number}", "camera_info", "camera_info"),
        ):
            wired = self.host.nodelet(nodelet).ports[port].topic
            assert wired == self.host.nodelet(camera).ports[source].topic


@pytest.fixture
def field() -> Field:
    return Field()


def test_the_robots_tracking_is_kept_and_re_wired(field: Field) -> None:
    claim = field.reconciler.acquire(StreamRequest("FieldPosition(ball)", max_silence=2.0)).claim
    own = {*TRACKING, LOCALIZATION}
    assert set(field.host.running) == {CAMERA, *own}
    field.feeds(CAMERA)
    field.settle()
    field.battery(True)
    field.settle()

    # The battery runs low: the verdict that the camera requires falls.
    field.battery(False)
    field.settle()
    now = field.claim(claim.claim_id)
    assert (now.state, now.topic) == (ClaimState.ACTIVE, claim.topic)
    field.feeds(CEILING)
    joints = field.host.nodelet("/nao_body_1").ports["joint_states"].topic
    assert field.host.nodelet("/ball_detector_1").ports["joint_states"].topic == joints
    field.settle(10.0)
    assert set(field.host.running) == {CEILING, VERDICTS, *own}
    assert field.cheaper() == []

    # It is charged: reported once that has lasted, and taken up on request only.
    field.battery(True)
    field.settle(10.0)
    assert [each for each in field.cheaper() if "bottom_camera" in each] == field.cheaper()
    assert len(field.cheaper()) == 1
    field.feeds(CEILING)
    answer = field.reconciler.replan(claim.claim_id)
    assert len(answer.spawned) == 1
    field.settle(10.0)
    assert set(field.host.running) == {CAMERA, VERDICTS, *own}
    field.feeds(CAMERA)
    assert field.claim(claim.claim_id).topic == claim.topic
    assert len(field.cheaper()) == 1, "what is in use is no news"


def test_two_cameras_at_a_time_are_not_mixed_up(field: Field) -> None:
    field.reconciler.acquire(StreamRequest("FieldPosition(ball)"))
    other = field.reconciler.acquire(
        StreamRequest("FieldPosition(ball)", exclude=("bottom_camera",))
    )
    assert CEILING in other.spawned
    field.settle()
    field.feeds(CAMERA)
    field.feeds(CEILING, 2)
    balls = field.reconciler.acquire(StreamRequest("SubsampledYUV(bottom_camera, eighth)"))
    field.settle()
    assert balls.spawned == ()
    field.feeds(CAMERA)
    field.feeds(CEILING, 2)
