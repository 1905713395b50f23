# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Types are compared by checksum, as ROS compares them, wherever streams are connected."""

from __future__ import annotations

from pathlib import Path
from typing import Iterator

import pytest
from unit.manager.field import Field
from unit.manager.world import SOURCES, World
from unit.proxy.test_configuration import Bench

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


@pytest.mark.parametrize(("stated", "is_right"), [("new/Transform", True), ("new/Frame", False)])
def test_a_nodelet_has_the_port_that_is_declared(stated: str, is_right: bool) -> None:
    world = World()
    world.host.sources = {**SOURCES, "pkg/Relay": [("in", "in", "old/Frame")]}
    world.manager.add_transformation(
        "<transformation><label>tf</label><source>pkg/Relay</source>"
        f'<ports><port type="in" datatype="{stated}">in</port></ports></transformation>'
    )
    try:
        world.spawn("tf", "/tf")
    except DyKnowError:
        assert not is_right
    else:
        assert is_right


@pytest.mark.parametrize(("wanted", "is_right"), [("new/Transform", True), ("new/Frame", False)])
def test_a_stream_of_the_other_name_is_planned_and_connected(wanted: str, is_right: bool) -> None:
    field = Field()
    field.host.sources["pkg/Frames"] = [("out", "out", "old/Frame")]
    field.host.sources["pkg/Reader"] = [("in", "in", wanted), ("out", "out", wanted)]
    field.manager.add_transformation(
        "<transformations><transformation><label>frames</label><source>pkg/Frames</source>"
        '<ports><port type="out" datatype="old/Frame">out</port></ports>'
        '<tags><tag port="out">Frames</tag></tags></transformation>'
        "<transformation><label>reader</label><source>pkg/Reader</source><ports>"
        f'<port type="in" datatype="{wanted}">in</port><port type="out">out</port></ports>'
        '<tags><tag port="in">Frames</tag><tag port="out">Read</tag></tags></transformation>'
        "</transformations>"
    )
    for request in (StreamRequest("Read"), StreamRequest("Frames", datatype=wanted)):
        try:
            assert field.reconciler.acquire(request).claim.topic
        except DyKnowError:
            assert not is_right
        else:
            assert is_right
