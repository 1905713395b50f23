# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Types are compared by checksum, as ROS compares them, wherever streams are connected."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import ContextManager, Iterator

import pytest
from unit.manager.field import Field, specification
from unit.manager.world import SOURCES, World
from unit.proxy.bench import Bench

from dyknow import datatypes
from dyknow.errors import DyKnowError, InvalidConfiguration
from dyknow.manager.claim import StreamRequest
from dyknow.model.graph import PortState
from dyknow.wiring.ports import CannotConnect, check_ends

#: A module of a message, of which only the checksum may matter.
MODULE = """class {name}(object):
  _md5sum = "{checksum}"
  _type = "{package}/{name}"
raise AssertionError("it is executed")
"""
ONE, OTHER = 32 * "1", 32 * "2"


@pytest.fixture(autouse=True)
def _installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    types = (("old", "Frame", ONE), ("new", "Transform", ONE), ("new", "Frame", OTHER))
    for package, name, checksum in types:
        module = tmp_path / package / "msg" / f"_{name}.py"
        module.parent.mkdir(parents=True, exist_ok=True)
        text = MODULE.format(package=package, name=name, checksum=checksum)
        module.write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    datatypes.canonical.cache_clear()
    yield
    datatypes.canonical.cache_clear()


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ("old/Frame", "new/Transform", True),
        ("old/Frame", "new/Frame", False),
        ("old/Frame", "none/Frame", False),
        ("none/Frame", "none/Frame", True),
        ("none/Frame", "none/Other", False),
        ("../old/Frame", "new/Transform", False),
        ("old/msg/Frame", "new/Transform", False),
        ("Frame", "Transform", False),
    ],
)
def test_types_with_equal_checksums_are_one(one: str, other: str, expected: bool) -> None:
    assert datatypes.same_type(one, other) is expected
    assert datatypes.types_fit(other, one) is expected


@pytest.mark.parametrize("datatype", ["", "*"])
def test_any_type_fits(datatype: str) -> None:
    assert datatypes.types_fit("old/Frame", datatype)
    assert datatypes.types_fit(datatype, "old/Frame")
    assert not datatypes.same_type(datatype, "old/Frame")


class OldFrame:
    _type, _md5sum = "old/Frame", ONE


def test_a_port_is_connected_to_a_topic_of_the_other_name() -> None:
    bench = Bench()
    bench.nh.Subscriber("in", OldFrame, lambda message: None)
    bench.world.transport.types.update({"/a": "new/Transform", "/b": "new/Frame"})
    bench.proxy.set_config([("in", "/a")])
    assert bench.topics() == {"in": "/a"}
    with pytest.raises(InvalidConfiguration, match="'/b' carries new/Frame, but old/Frame"):
        bench.proxy.set_config([("in", "/b")])


def test_two_ports_of_the_two_names_are_connected() -> None:
    out = PortState("out", "out", "old/Frame", "")
    check_ends("/a:out", out, "/b:in", PortState("in", "in", "new/Transform", ""))
    with pytest.raises(CannotConnect):
        check_ends("/a:out", out, "/b:in", PortState("in", "in", "new/Frame", ""))


def fits(is_right: bool) -> ContextManager[object]:
    return contextlib.nullcontext() if is_right else pytest.raises(DyKnowError)


OTHER_NAMES = pytest.mark.parametrize(
    ("name", "is_right"), [("new/Transform", True), ("new/Frame", False)]
)


@OTHER_NAMES
def test_a_nodelet_has_the_port_that_is_declared(name: str, is_right: bool) -> None:
    world = World()
    world.host.sources = {**SOURCES, "pkg/Relay": [("in", "in", "old/Frame")]}
    world.manager.add_transformation(specification("tf", "pkg/Relay", {"in": ("in", ())}, 1, name))
    with fits(is_right):
        world.spawn("tf", "/tf")


@OTHER_NAMES
def test_a_stream_of_the_other_name_is_planned_and_connected(name: str, is_right: bool) -> None:
    field = Field()
    field.host.sources["pkg/Frames"] = [("out", "out", "old/Frame")]
    field.host.sources["pkg/Reader"] = [("in", "in", name), ("out", "out", name)]
    ports = {"in": ("in", ("Frames",)), "out": ("out", ("Read",))}
    for text in (
        specification("frames", "pkg/Frames", {"out": ("out", ("Frames",))}, 1, "old/Frame"),
        specification("reader", "pkg/Reader", ports, 1, name),
    ):
        field.manager.add_transformation(text)
    for request in (StreamRequest("Read"), StreamRequest("Frames", datatype=name)):
        with fits(is_right):
            assert field.reconciler.acquire(request).claim.topic
