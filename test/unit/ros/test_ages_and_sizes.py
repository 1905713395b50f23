# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Ages of messages, by their headers, and sizes, against the serialised ones."""

from __future__ import annotations

import io

import genpy
import pytest
import rospy
from geometry_msgs.msg import Point32, PointStamped, TransformStamped
from sensor_msgs.msg import Image, Imu, JointState, PointCloud, PointCloud2, PointField
from std_msgs.msg import Bool, Header, String
from tf2_msgs.msg import TFMessage

from dyknow.ros.wire.ages_and_sizes import age_of, age_of_serialised, is_stamped, size_of

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
def test_of_stamped_messages(kind, stamp, age):
    message = kind(header=Header(seq=7, stamp=genpy.Time.from_sec(stamp)))
    assert age_of(message) == pytest.approx(age)
    assert age_of_serialised(received(message)) == pytest.approx(age)
    assert is_stamped(kind._type) is True


@pytest.mark.parametrize(
    "message", [Header(stamp=genpy.Time(999)), String("a text of some length")]
)
def test_of_messages_without_a_header(message):
    assert age_of(message) is None
    assert age_of_serialised(received(message)) is None
    assert is_stamped(message._type) is False


def test_of_what_is_not_known_or_not_a_stamp():
    for unknown in ("", "*", "nowhere/Nothing", "a/b/c"):
        assert is_stamped(unknown) is None
    assert age_of(PointStamped(header=Header(stamp=5.0))) is None
    assert age_of(PointStamped(header=None)) is None
    nothing = rospy.AnyMsg()
    nothing._connection_header = {}
    assert age_of_serialised(nothing) is None


# How large they are


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


def test_of_what_is_no_message():
    broken = PointStamped()
    broken.header = None
    assert size_of(broken) == size_of(String(5)) == size_of(object()) == 0
