# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A message by reference and the same one from the wire have the same verdict, and reason."""

from __future__ import annotations

import io
from ctypes import c_float

import numpy
import pytest
from genpy.dynamic import generate_dynamic
from geometry_msgs.msg import Point, Point32, Polygon, PolygonStamped
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import BatteryState, LaserScan
from std_msgs.msg import Bool, Float32, Float64, Int8, Int64, UInt8, UInt64

from dyknow.formulas import Truth, parse
from dyknow.formulas.precision import Single, narrowed


def received(message):
    """The message as a subscriber in another process has it."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    return type(message)().deserialize(buffer.getvalue())


def judged(formula, message):
    """The verdict about a message, and about the same one from the wire."""
    found = []
    for each in (message, received(message)):
        monitor = parse(formula).monitor(period=1.0)
        (verdict, *_) = monitor.feed("m", each, 10.0) + monitor.advance(11.0)
        found.append((verdict.value, verdict.why))
    assert found[0] == found[1]
    return found[0]


BATTERY = BatteryState(percentage=0.2, cell_voltage=[3.7, 0.1])
SHAPE = PolygonStamped(polygon=Polygon([Point32(0.1, 0.7, -0.2)]))
FLAGS = generate_dynamic("far_msgs/Flags", "bool fill\nbool[] axes")["far_msgs/Flags"](1, [0])
SCAN = LaserScan(ranges=numpy.array([0.3], dtype=numpy.float32))


@pytest.mark.parametrize(
    ("formula", "message", "is_true", "value"),
    [
        ("m.percentage > 0.2", BATTERY, False, "m.percentage = 0.2"),
        ("m.percentage == 0.2", BATTERY, True, "m.percentage = 0.2"),
        ("m.percentage != 0.2", BATTERY, False, "m.percentage = 0.2"),
        ("0.2 >= m.percentage", BATTERY, True, "m.percentage = 0.2"),
        ("0.2 < m.percentage", BATTERY, False, "m.percentage = 0.2"),
        ("m.percentage > 0.19999998", BATTERY, True, "m.percentage = 0.2"),
        ("m.cell_voltage[1] <= 0.1", BATTERY, True, "m.cell_voltage[1] = 0.1"),
        ("abs(m.polygon.points[0].z) == 0.2", SHAPE, True, "m.polygon.points[0].z = -0.2"),
        ("-m.polygon.points[0].z == 0.2", SHAPE, True, "m.polygon.points[0].z = -0.2"),
        ("max(m.polygon.points[0].y, 0) <= 0.7", SHAPE, True, "m.polygon.points[0].y = 0.7"),
        ("norm(m.polygon.points[0]) < 1", SHAPE, True, "m.polygon.points[0] = <Point32>"),
        ("m.ranges[0] == 0.3", SCAN, True, "m.ranges[0] = 0.3"),
        ("m.data <= 0.2", Float32(0.2), True, "m.data = 0.2"),
        ("m.data == 16777217", Float32(16777216), True, "m.data = 16777216"),
        ("m.data < 1e300", Float32(1e38), True, "m.data = 1e+38"),
        ("m.data > 0.2", Float64(0.20000001), True, "m.data = 0.20000001"),
        ("m.data == 9007199254740993", Float32(2**53), True, "m.data = 9.007199e+15"),
        ("m.data == 9223372036854775807", Int64(2**63 - 1), True, f"m.data = {2**63 - 1}"),
        ("m.data == 18446744073709551615", UInt64(2**64 - 1), True, f"m.data = {2**64 - 1}"),
        ("m.data == -9007199254740993", Int64(-(2**53) - 1), True, f"m.data = {-(2**53) - 1}"),
        ("m.data", Bool(numpy.bool_(True)), True, "m.data = true"),
        ("m", Bool(numpy.bool_(False)), False, "m = false"),
        ("m", Bool(1), True, "m = true"),
        ("m.data", Bool(0), False, "m.data = false"),
        ("m.data", Bool(numpy.uint8(1)), True, "m.data = true"),
        ("m.data == true", Bool(2), True, "m.data = true"),
        ("m.fill and not m.axes[0]", FLAGS, True, "m.fill = true at 10, m.axes[0] = false"),
        ("-m.data < 0", UInt8(numpy.uint8(5)), True, "m.data = 5"),
        ("m.data * m.data > 999", UInt8(numpy.uint8(100)), True, "m.data = 100"),
        ("abs(m.data) == 128", Int8(numpy.int8(-128)), True, "m.data = -128"),
        ("norm(m) == 16", Point(numpy.int8(16), 0.0, 0.0), True, "m = <Point>"),
        ("1 / m.data > 0", Float64(numpy.float64(0.0)), None, "m.data = 0"),
    ],
)
def test_a_number_is_compared_in_its_precision(formula, message, is_true, value):
    expected = {True: Truth.TRUE, False: Truth.FALSE, None: Truth.UNKNOWN}[is_true]
    assert judged(formula, message) == (expected, f"{value} at 10")


@given(st.floats(width=32), st.floats(-10.0, 10.0), st.sampled_from(["<", "<=", ">", ">=", "=="]))
def test_by_reference_and_from_the_wire_there_is_one_verdict(value, constant, operator):
    judged(f"m.data {operator} {constant!r}", Float32(value))
    if abs(value) < 10.0:
        judged(f"m.data {operator} {value!r}", Float32(value * 1.00000001))


@given(st.floats(allow_nan=False, allow_infinity=False, width=32))
def test_the_digits_of_a_number_stand_for_it(value):
    assert c_float(float(str(Single(value)))).value == value


def test_an_array_has_its_numbers_and_a_message_without_such_fields_is_read_as_it_is():
    assert list(narrowed(BATTERY).cell_voltage) == [3.7, 0.1]
    message = Float64(0.2)
    assert narrowed(message) is message


@pytest.mark.parametrize("field", ["m.spot.x", "m.spots[0].x"])
def test_a_type_that_is_not_built_has_its_precision_too(field):
    """As those of a bag, which has the definitions of its types."""
    text = (
        "far_msgs/Spot spot\nfar_msgs/Spot[] spots\n"
        + "=" * 80
        + "\nMSG: far_msgs/Spot\nfloat32 x"
    )
    classes = generate_dynamic("far_msgs/Spots", text)
    x = classes["far_msgs/Spot"](0.2)
    message = classes["far_msgs/Spots"](x, [x])
    assert judged(f"{field} == 0.2", message) == (Truth.TRUE, f"{field} = 0.2 at 10")


def test_a_field_with_something_else_in_it_is_unknown():
    message = Float32()
    message.data = "text"
    monitor = parse("m.data > 0").monitor(period=1.0)
    (verdict, *_) = monitor.feed("m", message, 10.0) + monitor.advance(11.0)
    assert verdict.value is Truth.UNKNOWN
