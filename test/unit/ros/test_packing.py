# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What is packed for shared memory is the message, for every class of it that may receive it."""

from __future__ import annotations

import io

import genpy.dynamic
import numpy as np
import pytest
import rospy
import rospy.msg
from hypothesis import given
from hypothesis import strategies as st
from rospy.numpy_msg import numpy_msg
from sensor_msgs.msg import CompressedImage, Image, LaserScan, PointCloud2
from std_msgs.msg import ByteMultiArray, Float64MultiArray, Header, String

from dyknow.ros.transport import packing
from dyknow.ros.transport.arena import Arena, ArenaReader
from dyknow.ros.transport.packing import FRAME, LARGE, Packed, assembled, largest_field

PAIR = genpy.dynamic.generate_dynamic(
    "test/Pair",
    f"sensor_msgs/Image left\nsensor_msgs/Image right\nuint8[] more\n{'=' * 80}\n"
    f"MSG: sensor_msgs/Image\n{Image._full_text}",
)["test/Pair"]
ARENA = Arena()
READER = ArenaReader(ARENA.address)


def ordinary(message, number=7):
    """The frame that rospy would send."""
    buffer = io.BytesIO()
    rospy.msg.serialize_message(buffer, number, message)
    return buffer.getvalue()


def through_memory(message, datatype=None):
    """The message as a subscriber receives it."""
    packed = Packed(message, 7)
    region = ARENA.write(packed.content)
    assert region is not None
    frame = packed.frame(region)
    _, length, place, number, *where = FRAME.unpack_from(frame)
    text = frame[FRAME.size :]
    assert len(text) == length
    content = READER.read(*where)
    assert content is not None
    return assembled(datatype or type(message), text, place, number, content)


def image(size=LARGE, fill=b"\7"):
    header = Header(frame_id="camera", stamp=rospy.Time(3, 5))
    return Image(header=header, height=3, encoding="rgb8", step=9, data=fill * size)


LARGE_ONES = [
    image(),
    image(10 * LARGE, b"\xff"),
    Image(data=bytearray(2 * LARGE)),
    CompressedImage(format="jpeg", data=bytes(range(256)) * (LARGE // 256)),
    PointCloud2(width=5, data=b"point" * LARGE, is_dense=True),
    Float64MultiArray(data=list(range(LARGE))),
    ByteMultiArray(data=[1] * LARGE),
    LaserScan(ranges=[1.5] * LARGE),
    String("word" * LARGE),
    PAIR(left=image(100), right=image(2 * LARGE), more=b"m" * LARGE),
    PAIR(left=image(2 * LARGE), more=b"m"),
]


@pytest.mark.parametrize("message", LARGE_ONES, ids=lambda each: type(each).__name__)
def test_the_message_arrives_as_over_tcpros(message):
    expected = ordinary(message)
    received = through_memory(message)
    assert ordinary(received) == expected
    assert type(received) is type(message)
    packed = Packed(message, 7)
    assert packed.plain() == expected
    assert packed.size == len(expected) - 4


@pytest.mark.parametrize("message", LARGE_ONES, ids=lambda each: type(each).__name__)
def test_the_original_keeps_its_fields(message):
    before = [getattr(message, slot) for slot in message.__slots__]
    Packed(message, 7)
    assert all(getattr(message, slot) is each for slot, each in zip(message.__slots__, before))


def test_the_type_of_a_field_is_what_rospy_makes_of_it():
    received = through_memory(image())
    again = Image().deserialize(ordinary(image())[4:])
    assert type(received.data) is type(again.data) is bytes
    assert received == again


@pytest.mark.parametrize("message", LARGE_ONES[:5], ids=lambda each: type(each).__name__)
def test_subscribers_of_any_type_get_the_same_bytes(message):
    assert through_memory(message, rospy.AnyMsg)._buff == ordinary(message)[4:]


def test_subscribers_with_arrays_of_numpy_get_what_rospy_makes():
    for message in (image(), Float64MultiArray(data=[2.5] * LARGE)):
        datatype = numpy_msg(type(message))
        received = through_memory(message, datatype)
        again = datatype().deserialize(ordinary(message)[4:])
        assert type(received.data) is type(again.data)
        assert np.array_equal(received.data, again.data)
    published = numpy_msg(Float64MultiArray)(data=np.full(LARGE, 2.5))
    assert through_memory(published, Float64MultiArray).data == (2.5,) * LARGE


def test_messages_of_any_type_are_passed_on():
    message = rospy.AnyMsg()
    message._buff = ordinary(image())[4:]
    assert ordinary(through_memory(message, Image)) == ordinary(image())


def test_only_the_largest_field_is_left_out():
    packed = Packed(PAIR(left=image(LARGE), right=image(3 * LARGE), more=b"m" * LARGE), 7)
    assert len(packed.content) == 3 * LARGE


@pytest.mark.parametrize(
    ("message", "is_large"),
    [(image(), True), (image(LARGE - 1), False), (Float64MultiArray(), False), (String(), False)],
)
def test_fields_that_are_worth_a_region(message, is_large):
    assert bool(largest_field(message)[2]) is is_large


def test_a_message_with_wrong_content_is_refused_as_ever():
    for wrong in (Image(height="three", data=bytes(LARGE)), Image(data=[300] * LARGE)):
        with pytest.raises(genpy.SerializationError):
            ordinary(wrong)
        with pytest.raises(genpy.SerializationError):
            Packed(wrong, 7)


@given(
    st.text(max_size=20),
    st.binary(max_size=600),
    st.binary(max_size=600),
    st.binary(max_size=600),
)
def test_any_content_arrives(text, left, right, more):
    message = PAIR(left=Image(data=left, encoding=text), right=Image(data=right), more=more)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(packing, "LARGE", 100)
        assert ordinary(through_memory(message)) == ordinary(message)
        assert Packed(message, 7).plain() == ordinary(message)
