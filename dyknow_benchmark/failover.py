# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark failover``: from the failure of a part of a claimed stream to its replacement.

The time is counted from the failure to the replacement's first message on the client's topic, less
the silence that the claim allows.
"""

from __future__ import annotations

import argparse
import os
import signal
import time
from typing import Callable, Dict, List, NamedTuple

import rospy
from nodelet.srv import NodeletUnload
from std_msgs.msg import Empty, Header

import dyknow
from dyknow.locks import state_lock
from dyknow.ros.acquiring import AcquiredStream
from dyknow_benchmark import machine, options, progress, system
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session, wait_until
from dyknow_benchmark.targets import Verdict

HEADER = ("failure", "failures", "min_s", "median_s", "max_s")
_GOAL = "Signed(x)"
_SOURCE = "/source"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--failures", type=options.positive, default=5, help="of each kind")


class _Listener:
    """Which life of the part was heard last, and when each was heard first and last."""

    def __init__(self, topic: str) -> None:
        self._lock = state_lock("messages of a stream")
        self._first: Dict[str, float] = {}
        self._last: Dict[str, float] = {}
        self.life = ""
        self._subscriber = rospy.Subscriber(topic, Header, self._hear, tcp_nodelay=True)

    def _hear(self, message: Header) -> None:
        now = time.monotonic()
        with self._lock:
            self.life = message.frame_id
            self._first.setdefault(message.frame_id, now)
            self._last[message.frame_id] = now

    def first(self, life: str) -> float:
        """When a life was heard first."""
        with self._lock:
            return self._first[life]

    def last(self, life: str) -> float:
        """When a life was heard last."""
        with self._lock:
            return self._last[life]


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    rows = []
    verdicts = []
    with Session() as session:
        client = system.start(session)
        client.add_transformation(_library(3 * arguments.failures + 2))
        # What feeds the stream survives, in a process of its own.
        client.spawn("signed source", _SOURCE, {"out": "/raw"}, isolated=True)
        load = machine.Load()
        for failure in _FAILURES:
            times = _measure(failure, arguments.failures)
            rows.append((failure.kind, len(times), *system.spread(times)))
            what = f"{failure.kind}: replaced, median in s"
            verdicts.append(Verdict(what, system.spread(times)[1], failure.target))
    results = Results(load.rows(), verdicts)
    results.table("failover", "failover of a claimed stream", HEADER, rows)
    return results


class _Failure(NamedTuple):
    """A way to fail.

    Attributes:
        kind: what it is called.
        fail: does it to a nodelet.
        target: seconds to reach.
        silence: seconds of silence that the claim allows; 0: it does not care.
        rest: seconds between two, so that they are not taken for a crash in a loop.
    """

    kind: str
    fail: Callable[[str], None]
    target: float = 1.0
    silence: float = 0.0
    rest: float = 0.3


def _measure(failure: _Failure, count: int) -> List[float]:
    """Let the part fail again and again; returns how long (s) the client was without it."""
    times = []
    with dyknow.acquire(_GOAL, Header, max_silence=failure.silence) as stream:
        listener = _Listener(stream.topic)
        for _ in progress.steps(range(count), failure.kind, count):
            wait_until(lambda: bool(listener.life), "the stream")
            wait_until(lambda: stream.wait_until_active(0.0), "the stream to be whole")
            time.sleep(failure.rest)
            life = listener.life
            failure.fail(_part(stream))
            failed = time.monotonic()
            wait_until(lambda life=life: listener.life != life, "the replacement")  # type: ignore[misc]
            begin = min(failed, listener.last(life))
            times.append(listener.first(listener.life) - begin - failure.silence)
    return times


def _part(stream: AcquiredStream) -> str:
    """Name of the nodelet that is to fail: the only one that was made for the claim."""
    (name,) = set(stream.nodelets) - {_SOURCE}
    return name


def _unload(nodelet: str) -> None:
    rospy.ServiceProxy(f"{system.NODELET_MANAGER}/unload_nodelet", NodeletUnload)(nodelet)


def _kill(nodelet: str) -> None:
    os.kill(system.pid(system.NODELET_MANAGER), signal.SIGKILL)


def _fall_silent(nodelet: str) -> None:
    publisher = rospy.Publisher(f"{nodelet}/fall_silent", Empty, queue_size=1)
    wait_until(lambda: publisher.get_num_connections() > 0, f"{nodelet} to listen")
    publisher.publish(Empty())
    time.sleep(0.05)  # unregistering drops what is not sent yet
    publisher.unregister()


#: What is done to the part. Where a process has to be started first, the target is ``recover``'s.
_FAILURES = (
    _Failure("unloaded by others", _unload),
    _Failure("silent", _fall_silent, silence=0.4),
    _Failure("kill -9 of its nodelet manager", _kill, target=3.0, rest=11.0),
)


def _library(count: int) -> str:
    """As many ways as there are failures: what failed is left alone for a while."""
    parts: List[str] = [
        "<transformations><transformation><label>signed source</label>"
        '<source>dyknow/Source</source><params><param name="rate" type="double">100</param>'
        '</params><ports><port type="out" datatype="std_msgs/Header">out</port></ports>'
        '<tags><tag port="out">Unsigned(x)</tag></tags></transformation>'
    ]
    parts += [
        f"<transformation><label>way {number}</label><source>dyknow_benchmark/SignedRelay</source>"
        '<ports><port type="in">in</port><port type="out">out</port></ports>'
        f'<tags><tag port="in">Unsigned(x)</tag><tag port="out">{_GOAL}</tag></tags>'
        "</transformation>"
        for number in range(count)
    ]
    return "".join([*parts, "</transformations>"])
