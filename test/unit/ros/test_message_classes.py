# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A name from outside imports a message, and no other module."""

from __future__ import annotations

import sys

import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import String

from dyknow.manager.library import Library
from dyknow.manager.store import Store
from dyknow.nodelets.black_box import BlackBox
from dyknow.ros.formulas.message_types import message_type
from dyknow.ros.hosting.installed import _missing_types
from dyknow.ros.wire.ages_and_sizes import is_stamped
from dyknow.ros.wire.message_classes import message_class
from dyknow.testing.fixtures import nodelet_harness

__all__ = ["nodelet_harness"]

PLAIN, BROKEN = "plain_package_of_test", "broken_messages_of_test"
FORMULA = """<transformation type="formula"><label>f</label>
  <ports><port type="in" datatype="{}">a</port><port type="out">h</port></ports>
  <formula>a.x > 1</formula></transformation>"""


@pytest.fixture(autouse=True)
def _packages(tmp_path, monkeypatch):
    """A package without messages, and one of a message that cannot be imported."""
    for package in (PLAIN, BROKEN):
        (tmp_path / package / "msg").mkdir(parents=True)
    (tmp_path / PLAIN / "msg" / "_X.py").write_text("X = 1\n", encoding="utf-8")
    (tmp_path / PLAIN / "__init__.py").write_text("", encoding="utf-8")
    checksum = 32 * "1"
    text = f'class X:\n  _md5sum = "{checksum}"\n  _type = "{BROKEN}/X"\n'
    (tmp_path / BROKEN / "msg" / "_X.py").write_text(text, encoding="utf-8")
    text = "raise RuntimeError('no camera attached')\n"
    (tmp_path / BROKEN / "__init__.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    yield
    is_stamped.cache_clear()


@pytest.mark.parametrize(
    "name",
    [
        *("", "*", "Image", "sensor_msgs/Nothing", "sensor_msgs/image", "sensor_msgs/msg/Image"),
        *("sensor_msgs.msg/Image", "../sensor_msgs/Image", "sensor_msgs/Image\n"),
        *(f"{PLAIN}/X", f"{BROKEN}/X"),
    ],
)
def test_what_is_no_message_that_is_built_has_no_class(name):
    assert message_class(name) is None
    assert message_type(name) is None
    assert is_stamped(name) is None
    assert PLAIN not in sys.modules


def test_a_message_that_is_built_has_its_class():
    assert message_class("sensor_msgs/Image") is Image


@pytest.mark.parametrize("package", [PLAIN, BROKEN])
def test_a_specification_is_read_whatever_its_types(package):
    library = Library(Store(), types=message_type)
    added = library.add(FORMULA.format(f"{package}/X"))
    assert [each.label for each in added.transformations] == ["f"]
    assert f"{package}/X" in _missing_types({f"{package}/X"})
    assert PLAIN not in sys.modules


def test_the_black_box_keeps_a_topic_whose_package_is_broken(nodelet_harness, monkeypatch):
    types = {"/a": f"{BROKEN}/X", "/b": "std_msgs/String"}
    monkeypatch.setattr(BlackBox, "published", lambda self: types)
    box = nodelet_harness.load(BlackBox, parameters={"topics": ["/*"]})
    nodelet_harness.publish("/b", String("x"))
    nodelet_harness.drain()
    assert [each.topic for each in box.recording.taken()] == ["/b"]
