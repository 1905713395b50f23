# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Classes of messages: a name from outside imports no other module; ages, sizes, conversions."""

from __future__ import annotations

import io
import sys

import genpy
import numpy as np
import pytest
import rospy
from geometry_msgs.msg import Point32, PointStamped, TransformStamped
from rospy.numpy_msg import numpy_msg
from sensor_msgs.msg import Image, Imu, JointState, PointCloud, PointCloud2, PointField
from std_msgs.msg import Bool, Header, Int32MultiArray, String
from tf2_msgs.msg import TFMessage

from dyknow.manager.library import Library
from dyknow.manager.store import Store
from dyknow.nodelets.black_box import BlackBox
from dyknow.ros.formulas.message_types import message_type
from dyknow.ros.hosting.installed import _missing_types
from dyknow.ros.transport.conversions import TypedReceiver
from dyknow.ros.wire.ages_and_sizes import age_of, age_of_serialised, is_stamped, size_of
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
    message = f'class X:\n  _md5sum = "{32 * "1"}"\n  _type = "{BROKEN}/X"\n'
    fails = "raise RuntimeError('no camera attached')\n"
    for package, init, text in ((PLAIN, "", "X = 1\n"), (BROKEN, fails, message)):
        (tmp_path / package / "msg").mkdir(parents=True)
        (tmp_path / package / "__init__.py").write_text(init)
        (tmp_path / package / "msg" / "_X.py").write_text(text)
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


# Ages, by their headers, and sizes, against the serialised ones


NOW = 1000.25


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    monkeypatch.setattr(rospy, "get_rostime", lambda: genpy.Time.from_sec(NOW))


def serialised(message):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def received(message):
    """A message as a subscriber of any type receives it."""
    found = rospy.AnyMsg()
    found.deserialize(serialised(message))
    found._connection_header = {"message_definition": message._full_text}
    return found


@pytest.mark.parametrize("kind", [PointStamped, JointState, Imu])
@pytest.mark.parametrize(
    ("stamp", "age"), [(1000.0, 0.25), (999.5, 0.75), (1001.0, -0.75), (0, None)]
)
def test_the_age_of_stamped_messages(kind, stamp, age):
    message = kind(header=Header(seq=7, stamp=genpy.Time.from_sec(stamp)))
    assert age_of(message) == pytest.approx(age)
    assert age_of_serialised(received(message)) == pytest.approx(age)
    assert is_stamped(kind._type) is True


def test_messages_without_a_header_or_a_stamp_have_no_age():
    for message in (Header(stamp=genpy.Time(999)), String("a text of some length")):
        assert age_of(message) is None
        assert age_of_serialised(received(message)) is None
        assert is_stamped(message._type) is False
    assert age_of(PointStamped(header=Header(stamp=5.0))) is None
    assert age_of(PointStamped(header=None)) is None
    nothing = rospy.AnyMsg()
    nothing._connection_header = {}
    assert age_of_serialised(nothing) is None


@pytest.mark.parametrize(
    "message",
    [
        Bool(True),
        String("Grüße"),
        PointStamped(header=Header(frame_id="map")),
        Imu(),
        JointState(name=["knee", "heel"], position=[0.1, 0.2]),
        Image(height=2, width=3, encoding="bgr8", step=9, data=bytes(18)),
        PointCloud2(fields=[PointField(name="x"), PointField(name="y")], data=bytes(64)),
        PointCloud(points=[Point32()] * 1000),
        TFMessage([TransformStamped(child_frame_id="base")] * 7),
        TFMessage([]),
    ],
    ids=lambda message: message._type,
)
def test_the_size_of_a_message(message):
    assert size_of(message) == len(serialised(message))


def test_what_is_no_message_has_no_size():
    broken = PointStamped()
    broken.header = None
    for message in (broken, String(5), String("\ud83d"), object()):
        assert size_of(message) == 0


# Messages of one type in several classes


ARRAYS = numpy_msg(Int32MultiArray)


@pytest.mark.parametrize("wanted, other", [(ARRAYS, Int32MultiArray), (Int32MultiArray, ARRAYS)])
def test_the_first_subscriber_of_a_process_does_not_decide_about_the_class(wanted, other):
    received = []
    receiver = TypedReceiver("/numbers", wanted, received.append)
    own = wanted(data=np.array([3], np.int32))
    message = other(data=np.array([1, 2], np.int32))
    message._connection_header = {"callerid": "/camera"}
    receiver.push(own)
    receiver.push(message)
    assert received[0] is own
    assert (type(received[1]), list(received[1].data)) == (wanted, [1, 2])
    assert received[1]._connection_header == {"callerid": "/camera"}
