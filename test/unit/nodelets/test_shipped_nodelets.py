# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The shipped nodelets, without a roscore."""

from __future__ import annotations

import pytest
import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import Header, String, Time

from dyknow.errors import LoadFailed
from dyknow.nodelets.relay import Relay
from dyknow.nodelets.sink import Sink
from dyknow.nodelets.source import Source
from dyknow.nodelets.throttle import Throttle
from dyknow.testing import LogEntry

ALL = (Source, Relay, Throttle, Sink)
ONE = rospy.Time(1)
IN, OUT = {"in": "/in"}, {"out": "/out"}
BOTH = {**IN, **OUT}


@pytest.mark.parametrize("nodelet_class", ALL)
@pytest.mark.parametrize(
    "datatype", ["std_msgs/Nope", "nowhere/Image", "Header", "a/b/c", "", 5, "std_msgs/"]
)
def test_a_bad_datatype_is_an_error_at_the_load(nodelet_harness, nodelet_class, datatype):
    with pytest.raises(LoadFailed) as failure:
        nodelet_harness.load(nodelet_class, parameters={"datatype": datatype})
    assert f"parameter '/nodelet/datatype' is {datatype!r}" in str(failure.value)
    assert "expected a message type of a built package, such as" in str(failure.value)


@pytest.mark.parametrize(
    ("nodelet_class", "name"), [(Source, "rate"), (Throttle, "rate"), (Sink, "period")]
)
@pytest.mark.parametrize("value", [0, -1.0, "fast", True, float("nan")])
def test_a_bad_number_is_an_error_at_the_load(nodelet_harness, nodelet_class, name, value):
    with pytest.raises(LoadFailed, match=f"'/nodelet/{name}' is .*: expected a number above 0"):
        nodelet_harness.load(nodelet_class, parameters={name: value})


def test_source_counts_and_stamps_headers(nodelet_harness):
    got = nodelet_harness.listen("/out")
    nodelet_harness.load(Source, ports=OUT, parameters={"rate": 4.0})
    nodelet_harness.advance(0.75)
    assert [(each.seq, each.frame_id) for each in got] == [(0, "0"), (1, "1"), (2, "2")]
    assert [each.stamp.to_sec() for each in got] == [0.25, 0.5, 0.75]


@pytest.mark.parametrize(
    ("datatype", "expected"),
    [
        (Image, Image(header=Header(stamp=ONE, frame_id="0"))),
        (Time, Time(data=ONE)),
        (String, String("")),  # it has no stamp
    ],
)
def test_source_stamps_whatever_has_a_stamp(nodelet_harness, datatype, expected):
    got = nodelet_harness.listen("/out")
    nodelet_harness.load(Source, ports=OUT, parameters={"datatype": datatype._type, "rate": 1})
    nodelet_harness.advance(1.0)
    assert got == [expected]


def test_relay_hands_on_the_very_same_message(nodelet_harness):
    got = nodelet_harness.listen("/out")
    nodelet_harness.load(Relay, ports=BOTH, parameters={"datatype": "sensor_msgs/Image"})
    sent = [Image(), Image()]
    for image in sent:
        nodelet_harness.publish("/in", image)
    nodelet_harness.drain()
    assert [id(each) for each in got] == [id(each) for each in sent]


def throttled(harness, moments, rate):
    """Moments at which a throttle hands on messages that come at the given moments."""
    got = harness.listen("/out")
    harness.load(Throttle, ports=BOTH, parameters={"rate": rate})
    for number, moment in enumerate(moments):
        harness.advance(moment - harness.time)
        harness.publish("/in", Header(seq=number))
        harness.drain()
    return [moments[message.seq] for message in got]


def test_throttle_keeps_its_rate_on_messages_that_come_a_little_late(nodelet_harness):
    moments = [100.0 + number / 30 + (number % 3) * 0.002 for number in range(3000)]
    kept = throttled(nodelet_harness, moments, rate=10.0)
    assert len(kept) == pytest.approx(1000, abs=1)


@pytest.mark.parametrize("rate", [0.3, 7.0, 10.0, 29.0])
def test_throttle_is_never_faster_than_its_rate_over_a_while(nodelet_harness, rate):
    moments = [5.0 + number * 0.0333 + (number % 7) * 0.004 for number in range(900)]
    kept = throttled(nodelet_harness, moments, rate)
    for index, begin in enumerate(kept):
        for count, end in enumerate(kept[index:]):
            assert count <= rate * (end - begin) + 1.0001


@pytest.mark.parametrize(
    ("moments", "kept"),
    [
        ([3.0, 4.5, 5.6, 60.0, 61.1], [3.0, 4.5, 5.6, 60.0, 61.1]),  # all is slower
        ([1000.0, 1000.2, 5.0, 5.2, 6.1], [1000.0, 5.0, 6.1]),  # time is set back
    ],
)
def test_throttle_passes_what_is_slower_and_begins_again(nodelet_harness, moments, kept):
    assert throttled(nodelet_harness, moments, rate=1.0) == kept


@pytest.mark.parametrize(
    ("parameters", "message", "latency"),
    [
        (
            {},
            Header(stamp=rospy.Time(0, 1)),
            ", latency 250.000 ms on average, 500.000 ms at most",
        ),
        ({}, Header(), ""),
        ({"datatype": "std_msgs/String"}, String("it has no stamp"), ""),
    ],
)
def test_sink_logs_rate_and_latency(nodelet_harness, parameters, message, latency):
    nodelet_harness.load(Sink, ports=IN, parameters={"period": 2.0, **parameters})
    for seconds in (0.5, 3.5):
        nodelet_harness.publish("/in", message)
        nodelet_harness.advance(seconds)
    assert nodelet_harness.log == [
        LogEntry("info", f"/nodelet: 2 messages, 1.0 Hz{latency}"),
        LogEntry("info", "/nodelet: 0 messages, 0.0 Hz"),
    ]
