# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The page on the architecture is true: its modules, its rooms, and each hop of its ways."""

from __future__ import annotations

import re
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any, Callable, List, Set

import pytest
from clocks import HandClock
from std_msgs.msg import Int32
from unit.manager.field import transformation

import dyknow
from dyknow.model.streams import StreamRequest
from dyknow.simulated import SimulatedManagerClient
from dyknow.testing import NodeletHarness

try:
    import tomllib
except ModuleNotFoundError:  # before Python 3.11
    import tomli as tomllib  # type: ignore[no-redef]

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "doc" / "architecture.rst").read_text()
MODULES = sorted(set(re.findall(r"\bdyknow(?:_[a-z]+)?(?:\.[a-z_]+)+", PAGE)))
#: Names on the page that are not modules: attributes of the package, which are loaded lazily.
ATTRIBUTES = ("dyknow.acquire",)


@pytest.mark.parametrize("module", [each for each in MODULES if each not in ATTRIBUTES])
def test_each_module_of_the_page_exists(module):
    path = ROOT / module.replace(".", "/")
    assert path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def layers() -> List[List[str]]:
    """The first contract's layers, without the small modules below all rooms."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    rows = [re.findall(r"[\w.]+", row) for row in contracts["contracts"][0]["layers"]]
    rooms = [[each for each in row if (ROOT / each.replace(".", "/")).is_dir()] for row in rows]
    return [sorted(row) for row in rooms if row]


def test_the_rooms_are_those_that_the_imports_are_held_to():
    drawing = PAGE.split(".. layers-begin")[1].split(".. layers-end")[0].split("text\n")[1]
    drawn = [sorted(line.split()) for line in drawing.splitlines() if line.strip()]
    assert drawn == layers()


def test_each_room_is_described():
    for package in (ROOT / "dyknow").iterdir():
        if (package / "__init__.py").is_file():
            assert f"dyknow.{package.name}" in PAGE


class Relay(dyknow.Nodelet):
    def on_init(self):
        nh = dyknow.NodeHandle(self.node_handle)
        self.out = nh.Publisher("out", Int32, queue_size=1)
        self.sub = nh.Subscriber("in", Int32, self.out.publish, queue_size=1)


LIBRARY = "<transformations>{}{}</transformations>".format(
    transformation("left", "pkg/Left", "out out", "out Image(room)", 1),
    transformation("right", "pkg/Right", "out out", "out Image(room)", 2),
)


def message() -> None:
    with NodeletHarness() as harness:
        harness.load(Relay, "/relay", {"in": "/a", "out": "/b"})
        heard = harness.listen("/b")
        harness.publish("/a", Int32(1))
        harness.drain()
        assert heard == [Int32(1)]


def spawn() -> None:
    client = SimulatedManagerClient()
    client.add_transformation(LIBRARY)
    client.spawn("left", "/left", {"out": "/images"})
    with NodeletHarness() as harness:
        harness.load(Relay, "/relay")


def switch() -> None:
    with NodeletHarness() as harness:
        relay = harness.load(Relay, "/relay", {"in": "/a"})
        harness.connect(relay, {"in": "/b"})


def repair() -> None:
    clock = HandClock()
    client = SimulatedManagerClient(clock=clock)
    client.add_transformation(LIBRARY)
    claim = client.acquire_stream(StreamRequest("Image(room)"))
    assert client.list_streams()[0].nodelets == ("/left_1",)
    client.remove_transformation("left")
    client.settle()
    assert client.list_streams()[0].nodelets == ("/right_1",)
    client.release_stream(claim.claim_id)
    client.settle()
    clock.time += 60.0
    client.settle()
    assert client.get_graph().nodelets == ()


@pytest.mark.parametrize("way", [message, spawn, switch, repair])
def test_each_hop_of_a_way_is_taken(way: Callable[[], None]) -> None:
    """Except for those within ROS, which the rostest suites take."""
    text = PAGE.split(f"The way of a {way.__name__}\n")[1].split(".. code-block:: text")[1]
    drawing = re.split(r"\n(?=\S)", text)[0]
    hops = {each for each in re.findall(r"\bdyknow(?:\.[a-z_]+)+", drawing) if ".ros" not in each}
    taken: Set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            taken.add(frame.f_globals.get("__name__", ""))

    sys.setprofile(note)
    threading.setprofile(note)
    try:
        way()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    assert hops and hops <= taken
