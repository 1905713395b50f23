# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager: many nodelets, large libraries, failures."""

from __future__ import annotations

import argparse
import time
from statistics import median
from typing import Callable, NamedTuple, Sequence

import rospy
from dyknow_msgs.msg import Model
from dyknow_msgs.srv import GetModel
from nodelet.srv import NodeletUnload
from std_msgs.msg import Empty, Header

import dyknow
from dyknow.locks import state_lock
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Demand, Plan
from dyknow.manager.specifications.tags import parse_tag
from dyknow_benchmark.chains import load_hop
from dyknow_benchmark.options import measurement, rate
from dyknow_benchmark.planning_libraries import LIBRARIES
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import (
    MANAGER,
    NODELET_MANAGER,
    Session,
    kill,
    say,
    steps,
    wait_until,
)

#: Seconds for the manager to come to rest, those in which nothing changes, and questions.
_REST, _QUIET, _QUESTIONS = 2.0, 5.0, 50
#: Seconds that a plan may take, and one over more transformations than `_LARGE`; those to load.
_PLAN, _LARGE_PLAN, _LOAD = 0.1, 3.0, 2.0
_LARGE = 10_000
_GOAL, _SOURCE = "Signed(x)", "/source"


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    """Minimum, median and maximum."""
    return min(values), median(values), max(values)


@measurement(nodelets=50, seconds={"type": rate, "default": 30.0, "help": "default: %(default)g"})
def idle(arguments: argparse.Namespace) -> Results:
    """CPU time of a nodelet manager whose nodelets have nothing to do."""
    with Session() as session:
        for hop in range(arguments.nodelets, 0, -1):
            manager = load_hop(session, "dyknow", "/benchmark/idle", hop, False)
        time.sleep(_REST)
        results = Results()
        say(f"watching {arguments.nodelets} nodelets for {arguments.seconds:g} s")
        begin, before = time.monotonic(), manager.process.cpu_times()
        time.sleep(arguments.seconds)
        seconds, after = time.monotonic() - begin, manager.process.cpu_times()
    used = after.user + after.system - before.user - before.system
    header = ("nodelets", "seconds", "cpu_seconds", "cpu_percent")
    row = (arguments.nodelets, seconds, used, 100.0 * used / seconds)
    results.table("idle", "an idle nodelet manager", header, [row])
    return results


@measurement(nodelets=500)
def model(arguments: argparse.Namespace) -> Results:
    """Spawn many nodelets, request the model, and check that it is quiet."""
    spawns: list[float] = []
    answers: list[float] = []
    heard: list[Model] = []
    with Session() as session:
        client = session.dyknow_manager()
        results = Results()
        for number in steps(range(arguments.nodelets), "spawning", "nodelet"):
            begin = time.monotonic()
            client.spawn("relay", f"/n{number}", {"in": f"/t{number}", "out": f"/t{number + 1}"})
            spawns.append(1e3 * (time.monotonic() - begin))
        get_model = rospy.ServiceProxy(f"{MANAGER}/get_model", GetModel, persistent=True)
        for _ in range(_QUESTIONS):
            begin = time.monotonic()
            nodelets = len(get_model().model.nodelets)
            answers.append(1e3 * (time.monotonic() - begin))
        subscriber = rospy.Subscriber(f"{MANAGER}/model", Model, heard.append)
        wait_until(lambda: bool(heard), "the model, which is latched")
        heard.clear()
        say(f"listening for {_QUIET:g} s while nothing changes")
        time.sleep(_QUIET)
        subscriber.unregister()
    header = ("what", "count", "min_ms", "median_ms", "max_ms")
    found = {"spawn": spawns, "GetModel": answers}
    rows = [(what, len(times), *_spread(times)) for what, times in found.items()]
    results.table("model", f"{arguments.nodelets} nodelets in one nodelet manager", header, rows)
    results.verdict("spawn, median in ms", median(spawns), 30.0)
    results.verdict("GetModel, median in ms", median(answers), 50.0)
    results.verdict("~model published while nothing changed", float(len(heard)), 0.0)
    results.verdict("nodelets in the model", float(nodelets), arguments.nodelets, at_least=True)
    return results


@measurement(transformations=[10_000, 100_000])
def plan(arguments: argparse.Namespace) -> Results:
    """Load many transformations into a planner, and plan over them.

    It needs no ROS master. A small library may have no plan; to find that out is measured too.
    """
    results, rows = Results(), []
    for count in arguments.transformations:
        slowest, loadings = [], []
        for name, make in LIBRARIES.items():
            say(f"library '{name}' of {count} transformations")
            library = make(count)
            begin = time.monotonic()
            planner = Planner(library.ontology)
            planner.add(library.transformations)
            loadings.append(time.monotonic() - begin)
            for sort, tags in library.demands.items():
                times, found = [], 0
                for tag in tags:
                    begin = time.monotonic()
                    answer = planner.plan(Demand(frozenset([parse_tag(tag)])))
                    times.append(time.monotonic() - begin)
                    found = len(answer.steps) if isinstance(answer, Plan) else 0
                slowest.append(median(times))
                row = (name, sort, count, found, loadings[-1], times[0], slowest[-1], max(times))
                rows.append(row)
        limit = _PLAN if count <= _LARGE else _LARGE_PLAN
        results.verdict(f"{count} transformations: slowest demand, s", max(slowest), limit)
        results.verdict(f"{count} transformations: slowest to load, s", max(loadings), _LOAD)
    header = ("library", "demand", "transformations", "steps")
    times_header = ("load_s", "first_s", "median_s", "max_s")
    results.table("plan", "plans over large libraries", (*header, *times_header), rows)
    return results


class _Listener:
    """When each text of a stream's headers was heard first and last, in this process."""

    def __init__(self, topics: Sequence[str]) -> None:
        self._lock = state_lock("messages of streams")
        self._first: dict[str, float] = {}
        self._last: dict[str, float] = dict.fromkeys(topics, 0.0)
        self.latest = ""
        for topic in topics:
            rospy.Subscriber(topic, Header, self._hear, callback_args=topic, tcp_nodelay=True)

    def _hear(self, message: Header, topic: str) -> None:
        with self._lock:
            self.latest = message.frame_id
            for name in (message.frame_id, topic):
                self._last[name] = time.monotonic()
                self._first.setdefault(name, self._last[name])

    def span(self, name: str) -> tuple[float, float]:
        """When a topic, or a text, was heard first and last."""
        with self._lock:
            return self._first[name], self._last[name]

    def all_since(self, moment: float) -> bool:
        """Whether every topic was heard after a moment."""
        with self._lock:
            return all(last > moment for name, last in self._last.items() if name[:1] == "/")


@measurement(nodelets=20, kills=5)
def recover(arguments: argparse.Namespace) -> Results:
    """Time from kill -9 of the nodelet manager until every stream is back.

    Each kill follows as soon as the streams are back from the last, so the times include the
    pauses before a nodelet manager that dies repeatedly is restarted.
    """
    times: list[float] = []
    with Session() as session:
        client = session.dyknow_manager()
        client.spawn("source", "/source", {"out": "/t0"})
        for number in range(arguments.nodelets - 1):
            client.spawn("relay", f"/n{number}", {"in": f"/t{number}", "out": f"/t{number + 1}"})
        streams = _Listener([f"/t{number}" for number in range(arguments.nodelets)])
        wait_until(lambda: streams.all_since(0.1), "every stream to flow")
        results = Results()
        for number in range(arguments.kills):
            say(f"kill -9 of the nodelet manager, {number + 1} of {arguments.kills}")
            killed = time.monotonic()
            kill(NODELET_MANAGER)
            # Messages that are still in sockets are not of the new nodelets.
            since = killed + 0.3
            wait_until(lambda since=since: streams.all_since(since), "the streams")  # type: ignore[misc]
            times.append(time.monotonic() - killed)
            say(f"all streams back after {times[-1]:.2f} s")
    header = ("nodelets", "kills", "min_s", "median_s", "max_s")
    row = (arguments.nodelets, arguments.kills, *_spread(times))
    results.table("recover", "recovery of a killed nodelet manager", header, [row])
    results.verdict("all streams back, longest in s", max(times), 3.0)
    return results


def _unload(nodelet: str) -> None:
    rospy.ServiceProxy(f"{NODELET_MANAGER}/unload_nodelet", NodeletUnload)(nodelet)


def _fall_silent(nodelet: str) -> None:
    publisher = rospy.Publisher(f"{nodelet}/fall_silent", Empty, queue_size=1)
    wait_until(lambda: publisher.get_num_connections() > 0, f"{nodelet} to listen")
    publisher.publish(Empty())
    time.sleep(0.05)  # unregistering drops messages that are not sent yet
    publisher.unregister()


class _Failure(NamedTuple):
    """A way to fail.

    Attributes:
        fail: does it to a nodelet.
        target: seconds to reach; more where a process has to be started first.
        silence: seconds of silence that the claim allows; 0: it does not care.
        rest: seconds between two, so that they are not taken for a crash in a loop.
    """

    fail: Callable[[str], None]
    target: float = 1.0
    silence: float = 0.0
    rest: float = 0.3


_FAILURES = {
    "unloaded by others": _Failure(_unload),
    "silent": _Failure(_fall_silent, silence=0.4),
    "kill -9 of its nodelet manager": _Failure(
        lambda nodelet: kill(NODELET_MANAGER), target=3.0, rest=11.0
    ),
}


@measurement(failures=5)
def failover(arguments: argparse.Namespace) -> Results:
    """From the failure of a part of a claimed stream to its replacement.

    The time is counted from the failure to the replacement's first message on the client's topic,
    less the silence that the claim allows.
    """
    rows, count = [], arguments.failures
    with Session() as session:
        client = session.dyknow_manager()
        client.add_transformation(_ways(3 * count + 2))
        # The source of the stream survives, in a process of its own.
        client.spawn("signed source", _SOURCE, {"out": "/raw"}, isolated=True)
        results = Results()
        for kind, failure in _FAILURES.items():
            times = _fail(kind, failure, count)
            rows.append((kind, count, *_spread(times)))
            results.verdict(f"{kind}: replaced, median in s", median(times), failure.target)
    header = ("failure", "failures", "min_s", "median_s", "max_s")
    results.table("failover", "failover of a claimed stream", header, rows)
    return results


def _fail(kind: str, failure: _Failure, count: int) -> list[float]:
    """Let the part fail again and again; returns how long (s) the client was without it."""
    times = []
    with dyknow.acquire(_GOAL, Header, max_silence=failure.silence) as stream:
        listener = _Listener([stream.topic])
        for _ in steps(range(count), kind, "failure"):
            wait_until(lambda: bool(listener.latest), "the stream")
            wait_until(lambda: stream.wait_until_active(0.0), "the stream to be whole")
            time.sleep(failure.rest)
            life = listener.latest
            # The only nodelet that was made for the claim.
            (part,) = set(stream.nodelets) - {_SOURCE}
            failure.fail(part)
            failed = time.monotonic()
            wait_until(lambda life=life: listener.latest != life, "the replacement")  # type: ignore[misc]
            begin = min(failed, listener.span(life)[1])
            times.append(listener.span(listener.latest)[0] - begin - failure.silence)
    return times


def _ways(count: int) -> str:
    """As many ways as there are failures: a failed one is left alone for a while."""
    ways = "".join(
        f"<transformation><label>way {number}</label><source>dyknow_benchmark/SignedRelay</source>"
        '<ports><port type="in">in</port><port type="out">out</port></ports>'
        f'<tags><tag port="in">Unsigned(x)</tag><tag port="out">{_GOAL}</tag></tags>'
        "</transformation>"
        for number in range(count)
    )
    return (
        "<transformations><transformation><label>signed source</label>"
        '<source>dyknow/Source</source><params><param name="rate" type="double">100</param>'
        '</params><ports><port type="out" datatype="std_msgs/Header">out</port></ports>'
        f'<tags><tag port="out">Unsigned(x)</tag></tags></transformation>{ways}</transformations>'
    )
