# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The parts of a chain: a source that stamps messages and hops that forward them.

They know neither rospy nor nodelets: the same code runs in every kind of chain, so that only the
transport differs. Nothing is reported while messages flow; each hop keeps its records until they
are collected. Times are those of the machine's clock, which all processes of a machine share.
"""

from __future__ import annotations

import operator
import re
import threading
import time
from dataclasses import dataclass
from typing import Any, Callable, List, Tuple

import genpy
from sensor_msgs.msg import Image
from std_msgs.msg import Time

Publish = Callable[[Any], None]


@dataclass(frozen=True)
class Payload:
    """What a chain carries.

    Attributes:
        datatype: message class.
        make: makes a message, all but its stamp.
        stamp: writes seconds and nanoseconds into the stamp that a message has.
        stamp_of: reads it.
    """

    datatype: Any
    make: Callable[[], Any]
    stamp: Callable[[Any, int, int], None]
    stamp_of: Callable[[Any], genpy.Time]


def _stamp_time(message: Time, seconds: int, nanoseconds: int) -> None:
    message.data.secs, message.data.nsecs = seconds, nanoseconds


def _make_image(width: int, height: int) -> Image:
    image = Image(width=width, height=height, encoding="rgb8", step=3 * width)
    image.header.frame_id = "camera"
    image.data = b"\x7f" * (image.step * image.height)
    return image


def _stamp_image(message: Image, seconds: int, nanoseconds: int) -> None:
    stamp = message.header.stamp
    stamp.secs, stamp.nsecs = seconds, nanoseconds


def payload_of(name: str) -> Payload:
    """Say what a chain carries: ``time``, or images of a size such as ``640x480``.

    Raises:
        ValueError: it is neither.
    """
    if name == "time":
        return Payload(Time, Time, _stamp_time, operator.attrgetter("data"))
    if re.fullmatch(r"[1-9]\d*x[1-9]\d*", name) is None:
        raise ValueError(f"expected time or a size such as 640x480, not {name!r}")
    width, height = map(int, name.split("x"))
    return Payload(
        Image,
        lambda: _make_image(width, height),
        _stamp_image,
        operator.attrgetter("header.stamp"),
    )


class MessageSource:
    """Publishes stamped messages at a fixed frequency, on a thread of its own."""

    def __init__(self, publish: Publish, payload: Payload) -> None:
        self._publish = publish
        self._payload = payload
        self._stopped = threading.Event()

    def send(self, count: int, frequency: float, start: float) -> None:
        """Publish ``count`` messages, the first at ``start`` (s since the epoch)."""
        threading.Thread(
            target=self._send, args=(count, frequency, start), name="source", daemon=True
        ).start()

    def stop(self) -> None:
        """Publish no more."""
        self._stopped.set()

    def _send(self, count: int, frequency: float, start: float) -> None:
        payload = self._payload
        for sent in range(count):
            time.sleep(max(0.0, start + sent / frequency - time.time()))
            if self._stopped.is_set():
                return
            message = payload.make()  # now, not while the message before is on its way
            payload.stamp(message, *divmod(time.time_ns(), 1_000_000_000))
            self._publish(message)


class Ring:
    """Closes a chain: publishes what arrives at its end at its beginning."""

    def __init__(self, publish: Publish, payload: Payload) -> None:
        self._publish = publish
        self._payload = payload
        self._end = 0.0
        self._rounds = 0
        self._returned = 0

    def send(self, count: int, seconds: float, start: float) -> None:
        """Let ``count`` messages go round for ``seconds`` from ``start`` (s since the epoch)."""
        self._rounds = self._returned = 0
        self._end = start + seconds
        threading.Thread(target=self._send, args=(count, start), name="ring", daemon=True).start()

    def receive(self, message: Any) -> None:
        """Take a message that came round."""
        if time.time() < self._end:
            self._rounds += 1
            self._publish(message)
        else:
            self._returned += 1

    def collect(self) -> List[float]:
        """Return the rounds until the time was over, and the messages that returned after it."""
        return [self._rounds, self._returned]

    def _send(self, count: int, start: float) -> None:
        messages = [self._payload.make() for _ in range(count)]
        time.sleep(max(0.0, start - time.time()))
        for message in messages:
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
            payload: what it carries.
        """
        self.hop = hop
        self._publish = publish
        self._stamp_of = payload.stamp_of
        self._record = record
        self._latency = 0
        self._arrivals: List[Tuple[genpy.Time, int]] = []

    def receive(self, message: Any) -> None:
        """Take a message that arrives now and forward it."""
        now = time.time_ns()
        stamp = self._stamp_of(message)
        self._latency = latency = now - stamp.secs * 1_000_000_000 - stamp.nsecs
        if self._record:
            self._arrivals.append((stamp, latency))
        self._publish(message)

    def collect(self) -> List[float]:
        """Return stamp (s) and latency (us) of each arrival since the last time, flattened."""
        arrivals = self._arrivals[:]  # more may come meanwhile
        del self._arrivals[: len(arrivals)]
        flat: List[float] = []
        for stamp, latency in arrivals:
            flat += [stamp.to_sec(), latency / 1000]
        return flat
