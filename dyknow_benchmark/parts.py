# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The parts of a chain: a source that stamps messages, and hops that forward them.

The same code runs in every kind of chain, as nodelets or as nodes, so that only the transport
differs. Nothing is reported while messages flow. Times are those of the machine's clock, which all
processes of a machine share.

A part, here and in C++ (``cpp/chain.cpp``), receives on ``in`` and publishes on ``out``. Its
private parameters are ``~control``, a namespace, ``~payload``, which is ``time`` or a size of
images, and for a hop ``~hop``, its number, and ``~record``, whether it reports. In the namespace a
source listens to ``send`` (Float64MultiArray: count, frequency in Hz, start in s since the epoch),
and hop n offers ``report_n`` (Trigger, with JSON: stamps in s and latencies in us since the last
report).

``benchmark_node PART`` is a part as a rospy node.
"""

from __future__ import annotations

import contextlib
import json
import operator
import re
import threading
import time
from typing import Any, Callable, NamedTuple

import genpy
import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import Float64MultiArray, Time
from std_srvs.srv import Trigger, TriggerResponse

from dyknow.ros.process.signals import raise_interrupt, sigint

Publish = Callable[[Any], None]


class Payload(NamedTuple):
    """The messages of a chain."""

    datatype: Any
    make: Callable[[], Any]  # all but its stamp
    stamp_of: Callable[[Any], genpy.Time]  # to be read or written


def payload_of(name: str) -> Payload:
    """Return the payload ``time``, or images of a size such as ``640x480``; else ValueError."""
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
        self.stop = self._stopped.set

    def start(self, order: Float64MultiArray) -> None:
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
    """Compares the stamp of each message with the time at which it arrives, and forwards it.

    It keeps all arrivals for ``collect``, or else only the latest latency.
    """

    __slots__ = ("_arrivals", "_is_recorded", "_latency", "_publish", "_stamp_of")

    def __init__(self, is_recorded: bool, payload: Payload, publish: Publish) -> None:
        self._is_recorded = is_recorded
        self._stamp_of = payload.stamp_of
        self._publish = publish
        self._latency = 0
        self._arrivals: list[tuple[genpy.Time, int]] = []

    def receive(self, message: Any) -> None:
        now = time.time_ns()
        stamp = self._stamp_of(message)
        self._latency = latency = now - stamp.secs * 1_000_000_000 - stamp.nsecs
        if self._is_recorded:
            self._arrivals.append((stamp, latency))
        self._publish(message)

    def collect(self) -> list[tuple[float, float]]:
        """Return stamps (s) and latencies (us) since the last time."""
        arrivals = self._arrivals[:]  # more may come meanwhile
        del self._arrivals[: len(arrivals)]
        return [(stamp.to_sec(), took / 1000) for stamp, took in arrivals]


class Part:
    """Sets up a part of a chain."""

    def __init__(self, api: Any, topics: Any) -> None:
        """Prepare; ``api`` makes ports or topics, ``topics`` those of the control namespace."""
        self._api, self._topics = api, topics
        self._payload = payload_of(api.get_param("~payload", "time"))
        self._control = api.get_param("~control")

    def source(self) -> MessageSource:
        source = MessageSource(self._out(), self._payload)
        topic = f"{self._control}/send"
        self._topics.Subscriber(topic, Float64MultiArray, source.start, queue_size=10)
        return source

    def hop(self) -> None:
        is_recorded = self._api.get_param("~record")
        hop = Hop(is_recorded, self._payload, self._out())
        if is_recorded:
            number = self._api.get_param("~hop")
            offer_report(self._topics, f"{self._control}/report_{number}", hop.collect)
        datatype = self._payload.datatype
        self._api.Subscriber("in", datatype, hop.receive, queue_size=10, tcp_nodelay=True)

    def _out(self) -> Publish:
        publisher = self._api.Publisher(
            "out", self._payload.datatype, queue_size=10, tcp_nodelay=True
        )
        publish: Publish = publisher.publish
        return publish


def offer_report(api: Any, service: str, collect: Callable[[], Any]) -> None:
    """Offer a service that answers what ``collect`` returns, as JSON."""
    api.Service(service, Trigger, lambda request: TriggerResponse(True, json.dumps(collect())))


class SwitchWatch:
    """Finds lost and doubled messages by their numbers, at a port that is switched."""

    def __init__(self, clock: Callable[[], int] = time.time_ns) -> None:
        self._clock = clock
        self._changes: list[float] = []
        self._last = -1
        self.lost = 0  # did not come
        self.doubled = 0  # came again, or too late

    def changed(self) -> None:
        self._changes.append(self._clock() / 1e9)

    def collect(self) -> list[float]:
        """Return lost, doubled and the times (s) of the first messages of new topics."""
        return [self.lost, self.doubled, *self._changes]


class SwitchedIn(SwitchWatch):
    """An in-port that is switched between the topic of even and that of odd numbers.

    The numbers of one topic must follow each other without a gap until the switch, and those of
    the new topic begin where those of the old end.
    """

    def __init__(self, clock: Callable[[], int] = time.time_ns) -> None:
        super().__init__(clock)
        self._latest = [-2, -1]

    def receive(self, number: int) -> None:
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


class SwitchedOut(SwitchWatch):
    """Two in-ports, to one of which an out-port is connected: every number comes exactly once."""

    _side = ""

    def receive(self, side: str, number: int) -> None:
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
    """Run a part as a rospy node: a ``source`` or a ``hop``."""
    part = rospy.myargv()[1]
    with contextlib.suppress(KeyboardInterrupt), sigint(raise_interrupt):
        rospy.init_node(f"benchmark_{part}", anonymous=True)
        getattr(Part(rospy, rospy), part)()
        rospy.spin()


if __name__ == "__main__":
    main()
