# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Producers and consumers of each topic, at one moment."""

from __future__ import annotations

from typing import Any, Dict, List

import pytest
from unit.manager.field import Field

from dyknow.manager.claims import world
from dyknow.manager.claims.ends import Ends, ends_of, relay
from dyknow.manager.claims.world import World
from dyknow.manager.record import Record
from dyknow.manager.specifications.tags import NO_ONTOLOGY
from dyknow.model.transformation import IN, OUT, Port, Transformation

IMAGE = "sensor_msgs/Image"


def camera(name: str, tag: str, topic: str) -> Record:
    ports = (Port("out", OUT, IMAGE, (tag,)),)
    return Record(
        name, Transformation(name, "pkg/Camera", ports=ports), "/m", topics={"out": topic}
    )


def viewer(name: str, tag: str, topic: str) -> Record:
    ports = (Port("in", IN, IMAGE, (tag,)),)
    return Record(
        name, Transformation(name, "pkg/Viewer", ports=ports), "/m", topics={"in": topic}
    )


def relay_between(name: str, topics: Dict[str, str]) -> Record:
    return Record(name, relay("/left", IMAGE, ("Raw(left)",)), "/m", topics=topics)


def mismatches(*records: Record) -> List[str]:
    found = World(NO_ONTOLOGY, {}).with_records(records).all_mismatches
    return sorted(f"{producer.nodelet} {consumer.nodelet}" for _, producer, consumer in found)


def test_a_relay_is_believed_while_it_hears_what_it_says() -> None:
    first = relay_between("/first", {"in": "/left", "out": "/a"})
    second = relay_between("/second", {"in": "/a", "out": "/b"})
    left, eye = camera("/left_camera", "Raw(left)", "/left"), viewer("/eye", "Raw(left)", "/b")
    assert mismatches(left, first, second, eye) == []


def test_what_a_relay_hears_wrongly_goes_through_all_relays_behind_it() -> None:
    first = relay_between("/first", {"in": "/right", "out": "/a"})
    second = relay_between("/second", {"in": "/a", "out": "/b"})
    right, eye = camera("/right_camera", "Raw(right)", "/right"), viewer("/eye", "Raw(left)", "/b")
    wrong = ["/first /second", "/right_camera /first", "/second /eye"]
    for records in ([right, first, second, eye], [eye, second, first, right]):
        assert mismatches(*records) == wrong


def test_a_record_is_read_again_only_when_it_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    read: List[str] = []

    def counted(record: Record, *args: Any) -> Ends:
        read.append(record.name)
        return ends_of(record, *args)

    monkeypatch.setattr(world, "ends_of", counted)
    field = Field()
    claim = field.acquire("YUV(field)").claim
    look = field.reconciler._context.connector.world
    look()
    del read[:]
    assert [each.nodelet for each in look().producers(claim.topic)] == [claim.goal[0]]
    assert read == []
    field.spawn("bottom camera", "/by_hand", config={"image": claim.topic})
    del read[:]
    assert {each.nodelet for each in look().producers(claim.topic)} == {claim.goal[0], "/by_hand"}
    assert read == ["/by_hand"]
