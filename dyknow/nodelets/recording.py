# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The last messages of some topics, within a time and a size, and bags of them."""

from __future__ import annotations

import collections
import io
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, Sequence

import genpy
import rosbag
import rospy

from dyknow.locks import state_lock
from dyknow.nodelet.streams.parked import latching

#: Bytes that a message takes besides its content, and that a number takes.
OVERHEAD, _NUMBER = 1000, 32
_SAMPLE = 16  # entries of a list that are looked at
#: Seconds: a shorter step back is one of a clock that is set right, not simulated time again.
_SET_BACK = 1.0
_HEADER = ("type", "md5sum", "message_definition")
_ENDING = ".bag"


class KeptMessage(NamedTuple):
    """A message: its topic, itself, when it was received (s, ROS time), and its size in bytes."""

    topic: str
    message: Any
    received: float
    size: int


class Recording:
    """Messages of the last seconds, as references; safe from any thread.

    Beyond ``size`` bytes, as estimated, the oldest go. Of each publisher that latches the message
    before them is kept, too, so that the state of its topic is known; these states take half of
    the size at most. A message of this process does not tell whether its publisher latches.
    """

    def __init__(self, seconds: float, size: float) -> None:
        self._seconds = seconds
        self._most = size
        self._lock = state_lock("recording")
        self._kept: collections.deque[KeptMessage] = collections.deque()
        self._latched: set[str] = set()
        #: By topic and publisher, the latest last.
        self._before: dict[tuple[str, str], KeptMessage] = {}
        self.size = self._size_before = 0  # bytes of all messages, and of these, as estimated

    def add(self, topic: str, message: Any, now: float, is_state: bool = False) -> None:
        """Keep a message; ``is_state``: the topic is latched, by one publisher."""
        with self._lock:
            kept = self._kept
            while kept and now < kept[-1].received - _SET_BACK:  # simulated time
                self._drop_oldest()
            new = KeptMessage(topic, message, now, memory_of(message) + OVERHEAD)
            kept.append(new)
            self.size += new.size
            if is_state:
                self._latched.add(topic)
            while kept and (kept[0].received < now - self._seconds or self.size > self._most):
                self._drop_oldest()

    def taken(self) -> list[KeptMessage]:
        """Return the messages in the order of their receipt."""
        with self._lock:
            if not self._kept:
                return []
            begin = self._kept[0].received
            states = [each._replace(received=begin) for each in self._before.values()]
            return [*states, *self._kept]

    def _drop_oldest(self) -> None:
        """Drop the oldest message, unless it is a state; the lock is held."""
        gone = self._kept.popleft()
        self.size -= gone.size
        publisher = "?" if gone.topic in self._latched else latching(gone.message)
        if publisher:
            self._forget((gone.topic, publisher))
            self._before[gone.topic, publisher] = gone
            self.size += gone.size
            self._size_before += gone.size
            while self._size_before > self._most / 2:
                self._forget(next(iter(self._before)))

    def _forget(self, state: tuple[str, str]) -> None:
        forgotten = self._before.pop(state, None)
        if forgotten is not None:
            self.size -= forgotten.size
            self._size_before -= forgotten.size


def memory_of(value: Any) -> int:
    """Estimate the bytes of memory of a message: of a long list from its first entries."""
    if isinstance(value, (bytes, str)):
        return len(value)
    if isinstance(value, rospy.AnyMsg):
        return len(value._buff)
    if isinstance(value, genpy.Message):
        return sum(memory_of(getattr(value, slot)) for slot in value.__slots__)
    if isinstance(value, (list, tuple)):
        some = value[:_SAMPLE]
        return sum(map(memory_of, some)) * len(value) // max(1, len(some))
    return getattr(value, "nbytes", _NUMBER)  # an array of numpy, or a number or time


def write_bag(path: str, kept: Sequence[KeptMessage]) -> int:
    """Write messages into a bag, which has its name once it is complete.

    Returns how many are left out, since they cannot be serialised.

    Raises:
        OSError: it cannot be written.
    """
    unfinished, left_out = f"{path}.active", 0
    try:
        with rosbag.Bag(unfinished, "w") as bag:
            for topic, message, received, _ in kept:
                when = genpy.Time.from_sec(max(received, 1e-9))
                try:
                    raw = _raw(message)
                except Exception:  # whatever its author put into its fields
                    left_out += 1
                else:
                    bag.write(topic, raw, when, raw=True)
        os.replace(unfinished, path)
        return left_out
    except BaseException:
        Path(unfinished).unlink(missing_ok=True)
        raise


def _raw(message: Any) -> tuple[str, bytes, str, Any]:
    """Return a message as bags have it; rosbag would index one that cannot be serialised."""
    if isinstance(message, rospy.AnyMsg):
        kind, md5sum, text = (message._connection_header[key] for key in _HEADER)
        return kind, message._buff, md5sum, SimpleNamespace(_md5sum=md5sum, _full_text=text)
    buffer = io.BytesIO()
    message.serialize(buffer)
    return message._type, buffer.getvalue(), message._md5sum, type(message)


def remove_all_but(folder: str, prefix: str, count: int, own: Sequence[str]) -> None:
    """Remove the oldest bags of a folder whose names are so and a time.

    ``own`` are the newest ones, in the order written: the clock may have been set back since
    others were.
    """
    paths = Path(folder).glob(f"{prefix}[0-9][0-9][0-9][0-9]-[0-9][0-9]-*{_ENDING}")
    order = {Path(path).name: number for number, path in enumerate(own)}
    found = sorted(paths, key=lambda path: (order.get(path.name, -1), path))
    for path in found[: max(0, len(found) - count)]:
        path.unlink()
