# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The parts of a chain: a source that stamps messages, and hops that forward them.

They know neither rospy nor nodelets: the same code runs in every kind of chain, so that only the
transport differs. Nothing is reported while messages flow; each hop keeps its records until they
are collected. Times are those of the machine's clock, which all processes of a machine share.

Below a control namespace there are three topics, the same for the parts in C++ (``cpp/chain.h``):
``send`` (Float64MultiArray: count, frequency in Hz, start in s since the epoch), ``collect``
(Empty) and ``report`` (Float64MultiArray: stamp in s, latency in us, …; ``layout.data_offset`` is
the hop).

``python3 -m dyknow_benchmark.parts`` runs the parts that are rospy nodes.
"""

from __future__ import annotations

import argparse
import operator
import re
import threading
import time
from typing import Any, Callable, NamedTuple

import genpy
import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import Empty, Float64MultiArray, Time

Publish = Callable[[Any], None]

#: Reports that may wait: all parts of a process report on one connection at the same time.
_REPORTS = 1000


class Payload(NamedTuple):
    """The messages of a chain.

    Attributes:
        datatype: message class.
        make: makes a message, all but its stamp.
        stamp_of: returns the stamp that a message has, to be read or written.
    """

    datatype: Any
    make: Callable[[], Any]
    stamp_of: Callable[[Any], genpy.Time]


def payload_of(name: str) -> Payload:
    """Return the payload of a name: ``time``, or images of a size such as ``640x480``.

    Raises:
        ValueError: it is neither.
    """
    if name == "time":
        return Payload(Time, Time, operator.attrgetter("data"))
    if re.fullmatch(r"[1-9]\d*x[1-9]\d*", name) is None:
        raise ValueError(f"expected time or a size such as 640x480, not {name!r}")
    width, height = map(int, name.split("x"))

    def make() -> Image:
        image = Image(width=width, height=height, encoding="rgb8", step=3 * width)
        image.header.frame_id = "camera"
        image.data = b"\x7f" * (image.step * image.height)
        return image

    return Payload(Image, make, operator.attrgetter("header.stamp"))


class MessageSource:
    """Publishes stamped messages at a fixed frequency, on a thread of its own."""

    def __init__(self, publish: Publish, payload: Payload) -> None:
        self._publish = publish
        self._payload = payload
        self._stopped = threading.Event()

    def listen(self, api: Any, control: str) -> None:
        """Send when the control topic says so; ``api`` is rospy or a NodeHandle."""
        api.Subscriber(f"{control}/send", Float64MultiArray, self._on_send, queue_size=10)

    def stop(self) -> None:
        """Publish no more."""
        self._stopped.set()

    def _on_send(self, order: Float64MultiArray) -> None:
        threading.Thread(target=self._send, args=order.data, name="source", daemon=True).start()

    def _send(self, count: float, frequency: float, start: float) -> None:
        payload = self._payload
        for sent in range(int(count)):
            time.sleep(max(0.0, start + sent / frequency - time.time()))
            if self._stopped.is_set():
                return
            message = payload.make()  # now, not while the message before is on its way
            stamp = payload.stamp_of(message)
            stamp.secs, stamp.nsecs = divmod(time.time_ns(), 1_000_000_000)
            self._publish(message)


class Hop:
    """Compares the stamp of each message with the time at which it arrives, and forwards it."""

    __slots__ = ("_arrivals", "_latency", "_publish", "_record", "_stamp_of", "hop")

    def __init__(self, hop: int, record: bool, publish: Publish, payload: Payload) -> None:
        """Prepare a hop.

        Args:
            hop: its number, from 1.
            record: whether to keep all arrivals for ``collect``; otherwise the latest latency.
            publish: forwards a message.
            payload: its messages.
        """
        self.hop = hop
        self._publish = publish
        self._stamp_of = payload.stamp_of
        self._record = record
        self._latency = 0
        self._arrivals: list[tuple[genpy.Time, int]] = []

    def receive(self, message: Any) -> None:
        """Take a message that arrives now and forward it."""
        now = time.time_ns()
        stamp = self._stamp_of(message)
        self._latency = latency = now - stamp.secs * 1_000_000_000 - stamp.nsecs
        if self._record:
            self._arrivals.append((stamp, latency))
        self._publish(message)

    def listen(self, api: Any, control: str) -> None:
        """Report the arrivals, if they are recorded, when the control topic asks for them."""
        if self._record:
            listen_collect(api, control, self.hop, self._collect)

    def _collect(self) -> list[float]:
        arrivals = self._arrivals[:]  # more may come meanwhile
        del self._arrivals[: len(arrivals)]
        return [each for stamp, took in arrivals for each in (stamp.to_sec(), took / 1000)]


def listen_collect(api: Any, control: str, hop: int, collect: Callable[[], list[float]]) -> None:
    """Report numbers as a hop when the control topic asks; ``api`` is rospy or a NodeHandle."""
    publisher = api.Publisher(f"{control}/report", Float64MultiArray, queue_size=_REPORTS)

    def on_collect(request: Empty) -> None:
        report = Float64MultiArray(data=collect())
        report.layout.data_offset = hop
        publisher.publish(report)

    api.Subscriber(f"{control}/collect", Empty, on_collect, queue_size=10)


class _SwitchWatch:
    """Finds lost and doubled messages by their numbers, at a port that is switched."""

    def __init__(self, clock: Callable[[], int] = time.time_ns) -> None:
        self._clock = clock
        self._changes: list[float] = []
        self._last = -1
        self.lost = 0
        self.doubled = 0

    def changed(self) -> None:
        """Note that this is the first message of the new topic."""
        self._changes.append(self._clock() / 1e9)

    def collect(self) -> list[float]:
        """Return lost, doubled and the times (s) of the first messages of new topics."""
        return [self.lost, self.doubled, *self._changes]


class SwitchedIn(_SwitchWatch):
    """An in-port that is switched between the topic of even and that of odd numbers.

    The numbers of one topic must follow each other without a gap until the switch, and those of
    the new topic begin where those of the old end.
    """

    def __init__(self, clock: Callable[[], int] = time.time_ns) -> None:
        super().__init__(clock)
        self._latest = [-2, -1]

    def receive(self, number: int) -> None:
        """Take the next number."""
        if number <= self._latest[number % 2]:
            self.doubled += 1
            return
        before, self._last = self._last, number
        self._latest[number % 2] = number
        if before < 0:
            return
        if number % 2 != before % 2:
            self.changed()
            # Where the old topic ends at n the new one may begin at n + 1, or at n + 3 if n + 1
            # came before the switch.
            self.lost += max(0, (number - before - 2) // 2)
        else:
            self.lost += (number - before) // 2 - 1


class SwitchedOut(_SwitchWatch):
    """Two in-ports, to one of which an out-port is connected: every number comes exactly once."""

    _side = ""

    def receive(self, side: str, number: int) -> None:
        """Take the next number, at the in-port ``side``."""
        if number <= self._last:
            self.doubled += 1
            return
        before, self._last = self._last, number
        if before >= 0:
            self.lost += number - before - 1
        if self._side and side != self._side:
            self.changed()
        self._side = side


def main() -> None:
    """Run a source, a hop, or a whole chain of hops that call each other, as a rospy node."""
    parser = argparse.ArgumentParser(description="One process of a chain that is measured.")
    parser.add_argument("part", choices=["function", "source", "hop"])
    parser.add_argument("--control", required=True, help="namespace of the control topics")
    parser.add_argument("--payload", default="time", help="time or WIDTHxHEIGHT")
    parser.add_argument("--hop", type=int, default=1, help="number of the hop, or of hops")
    parser.add_argument("--record", type=int, nargs="*", default=[], help="hops that report")
    arguments = parser.parse_args(rospy.myargv()[1:])
    rospy.init_node(f"benchmark_{arguments.part}", anonymous=True)
    control, payload = arguments.control, payload_of(arguments.payload)

    def publish_as(number: int) -> Publish:
        topic, datatype = f"{control}/hop_{number}", payload.datatype
        publisher = rospy.Publisher(topic, datatype, queue_size=10, tcp_nodelay=True)
        publish: Publish = publisher.publish
        return publish

    def make_hop(number: int, publish: Publish) -> Publish:
        hop = Hop(number, number in arguments.record, publish, payload)
        hop.listen(rospy, control)
        return hop.receive

    if arguments.part == "hop":
        receive = make_hop(arguments.hop, publish_as(arguments.hop))
        topic, datatype = f"{control}/hop_{arguments.hop - 1}", payload.datatype
        rospy.Subscriber(topic, datatype, receive, queue_size=10, tcp_nodelay=True)
    else:
        first: Publish = lambda message: None  # noqa: E731
        for number in range(arguments.hop, 0, -1) if arguments.part == "function" else ():
            first = make_hop(number, first)
        source = first if arguments.part == "function" else publish_as(0)
        MessageSource(source, payload).listen(rospy, control)
    rospy.spin()


if __name__ == "__main__":
    main()
