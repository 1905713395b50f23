# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The DyKnow manager: many nodelets, large libraries, failures."""

from __future__ import annotations

import argparse
import os
import time
from functools import partial
from statistics import median
from typing import Callable, NamedTuple, Sequence

import rospy
from dyknow_msgs.msg import Model
from dyknow_msgs.srv import GetModel
from nodelet.srv import NodeletUnload
from std_msgs.msg import Empty, Header

import dyknow
from dyknow.manager.planning.planner import Planner
from dyknow.manager.planning.problem import Demand, Plan
from dyknow.manager.specifications.tags import parse_tag
from dyknow.model.client import BaseManagerClient
from dyknow_benchmark.options import measurement
from dyknow_benchmark.planning_libraries import LIBRARIES
from dyknow_benchmark.results import Results, Row, Summary, spread
from dyknow_benchmark.session import (
    MANAGER,
    NODELET_MANAGER,
    Session,
    kill,
    say,
    seconds,
    steps,
    wait_until,
)

#: Seconds in which nothing changes, and questions.
_QUIET, _QUESTIONS = 5.0, 50
#: Seconds that a plan may take, and one over more transformations than `_LARGE`; those to load.
_PLAN, _LARGE_PLAN, _LOAD = 0.1, 3.0, 2.0
_LARGE = 10_000
_GOAL, _SOURCE = "Signed(x)", "/source"
_SIGNED = """
<transformations>
  <transformation><label>signed source</label><source>dyknow/Source</source>
    <params><param name="rate" type="double">100</param></params>
    <ports><port type="out" datatype="std_msgs/Header">out</port></ports>
    <tags><tag port="out">Unsigned(x)</tag></tags></transformation>
  <transformation><label>way ${N}</label><source>dyknow_benchmark/SignedRelay</source>
    <args><arg label="N">{WAYS}</arg></args>
    <ports><port type="in">in</port><port type="out">out</port></ports>
    <tags><tag port="in">Unsigned(x)</tag><tag port="out">Signed(x)</tag></tags></transformation>
</transformations>
"""


@measurement(nodelets=500)
def model(arguments: argparse.Namespace, results: Results) -> None:
    """Spawn many nodelets, request the model, and check that it is quiet."""
    heard: list[Model] = []
    with Session() as session:
        client = session.dyknow_manager()
        numbers = steps(range(arguments.nodelets), "spawning", "nodelet")
        spawns = [1e3 * seconds(partial(spawn_relay, client, number)) for number in numbers]
        get_model = rospy.ServiceProxy(f"{MANAGER}/get_model", GetModel, persistent=True)
        answers = [1e3 * seconds(get_model) for _ in range(_QUESTIONS)]
        nodelets = len(get_model().model.nodelets)
        subscriber = rospy.Subscriber(f"{MANAGER}/model", Model, heard.append)
        wait_until(lambda: bool(heard), "the model, which is latched")
        heard.clear()
        say(f"listening for {_QUIET:g} s while nothing changes")
        time.sleep(_QUIET)
        subscriber.unregister()
    found = {"spawn": spawns, "GetModel": answers}
    rows: list[Row] = [
        (what, len(times), *Summary.of(times).spread) for what, times in found.items()
    ]
    title = f"{arguments.nodelets} nodelets in one nodelet manager"
    results.table("model", title, ("what", "count", *spread("ms")), rows)
    results.verdict("spawn, median in ms", median(spawns), 30.0)
    results.verdict("GetModel, median in ms", median(answers), 50.0)
    results.verdict("~model published while nothing changed", float(len(heard)), 0.0)
    results.verdict("nodelets in the model", float(nodelets), arguments.nodelets, at_least=True)


def spawn_relay(client: BaseManagerClient, number: int) -> None:
    """Spawn a relay behind the one before."""
    client.spawn("relay", f"/n{number}", {"in": f"/t{number}", "out": f"/t{number + 1}"})


@measurement(transformations=[10_000, 100_000])
def plan(arguments: argparse.Namespace, results: Results) -> None:
    """Load many transformations into a planner, and plan over them.

    It needs no ROS master. A small library may have no plan; to find that out is measured too.
    """
    rows = []
    for count in arguments.transformations:
        slowest, loadings = [], []
        for name, make in LIBRARIES.items():
            say(f"library '{name}' of {count} transformations")
            library = make(count)
            planner = Planner(library.ontology)
            loadings.append(seconds(partial(planner.know, library.transformations)))
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


class _Listener:
    """Hears headers on topics, in this process: when each topic and text was heard last."""

    def __init__(self, topics: Sequence[str]) -> None:
        self.first: dict[str, float] = {}
        self.last: dict[str, float] = {}
        self.latest = ""
        self._topics = topics
        for topic in topics:
            rospy.Subscriber(topic, Header, self._hear, callback_args=topic, tcp_nodelay=True)

    def _hear(self, message: Header, topic: str) -> None:
        now, text = time.monotonic(), message.frame_id
        self.first.setdefault(text, now)
        self.last[text] = self.last[topic] = now
        self.latest = text

    def is_after(self, text: str) -> bool:
        return self.latest != text

    def heard_all_since(self, moment: float) -> bool:
        return all(self.last.get(topic, 0.0) > moment for topic in self._topics)


@measurement(nodelets=20, kills=5)
def recover(arguments: argparse.Namespace, results: Results) -> None:
    """Time from kill -9 of the nodelet manager until every stream is back.

    Each kill follows as soon as the streams are back from the last, so the times include the
    pauses before a nodelet manager that dies repeatedly is restarted.
    """
    times: list[float] = []
    with Session() as session:
        client = session.dyknow_manager()
        client.spawn("source", "/source", {"out": "/t0"})
        for number in range(arguments.nodelets - 1):
            spawn_relay(client, number)
        streams = _Listener([f"/t{number}" for number in range(arguments.nodelets)])
        wait_until(partial(streams.heard_all_since, 0.0), "every stream to flow")
        for number in range(arguments.kills):
            say(f"kill -9 of the nodelet manager, {number + 1} of {arguments.kills}")
            killed = time.monotonic()
            kill(NODELET_MANAGER)
            # Messages that are still in sockets are not of the new nodelets.
            wait_until(partial(streams.heard_all_since, killed + 0.3), "the streams")
            times.append(time.monotonic() - killed)
            say(f"all streams back after {times[-1]:.2f} s")
    header = ("nodelets", "kills", *spread("s"))
    row = (arguments.nodelets, arguments.kills, *Summary.of(times).spread)
    results.table("recover", "recovery of a killed nodelet manager", header, [row])
    results.verdict("all streams back, longest in s", max(times), 3.0)


def _unload(nodelet: str) -> None:
    rospy.ServiceProxy(f"{NODELET_MANAGER}/unload_nodelet", NodeletUnload)(nodelet)


def _fall_silent(nodelet: str) -> None:
    publisher = rospy.Publisher(f"{nodelet}/fall_silent", Empty, queue_size=1)
    wait_until(lambda: publisher.get_num_connections() > 0, f"{nodelet} to listen")
    publisher.publish(Empty())
    time.sleep(0.05)  # unregistering drops messages that are not sent yet
    publisher.unregister()


class _Failure(NamedTuple):
    """A way to let a nodelet fail, with times in s."""

    fail: Callable[[str], None]
    target: float = 1.0  # more where a process has to be started first
    silence: float = 0.0  # that the claim allows; 0: it does not care
    rest: float = 0.3  # between two, so that they are not taken for a crash in a loop


_FAILURES = {
    "unloaded by others": _Failure(_unload),
    "silent": _Failure(_fall_silent, silence=0.4),
    "kill -9 of its nodelet manager": _Failure(
        lambda nodelet: kill(NODELET_MANAGER), target=3.0, rest=11.0
    ),
}


@measurement(failures=5)
def failover(arguments: argparse.Namespace, results: Results) -> None:
    """From the failure of a part of a claimed stream to its replacement.

    The time is counted from the failure to the replacement's first message on the client's topic,
    less the silence that the claim allows.
    """
    rows, count = [], arguments.failures
    with Session() as session:
        client = session.dyknow_manager()
        # As many ways as there are failures: a failed one is left alone for a while.
        ways = ";".join(map(str, range(3 * count + 2)))
        client.add_transformation(_SIGNED.replace("WAYS", ways))
        # The source of the stream survives, in a process of its own.
        client.spawn("signed source", _SOURCE, {"out": "/raw"}, isolated=True)
        for kind, failure in _FAILURES.items():
            times = _fail(kind, failure, count)
            rows.append((kind, count, *Summary.of(times).spread))
            results.verdict(f"{kind}: replaced, median in s", median(times), failure.target)
    header = ("failure", "failures", *spread("s"))
    results.table("failover", "failover of a claimed stream", header, rows)


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
            wait_until(partial(listener.is_after, life), "the replacement")
            begin = min(failed, listener.last[life])
            times.append(listener.first[listener.latest] - begin - failure.silence)
    return times


@measurement(nodelets=500)
def window(arguments: argparse.Namespace, results: Results) -> None:
    """How long the window keeps hands waiting, with many nodelets.

    The window runs without a screen, in this process. It is opened, its nodelets come back after
    kill -9 of their nodelet manager, and of the DyKnow manager too, and it is zoomed and moved. A
    gap is the time between two turns of the window's event loop, or two frames; it is judged by
    the processor's time of the window's thread, which does not depend on what else runs.
    """
    os.environ["QT_QPA_PLATFORM"] = "offscreen"
    from dyknow_benchmark import window_hands  # only here: not every robot has Qt

    count = arguments.nodelets
    rows = window_hands.use(count)
    header = window_hands.Row._fields
    results.table("window", "gaps between two turns of the window", header, rows)
    what = f"{count} nodelets, real manager"
    longest = max(row.longest_cpu_ms for row in rows)
    slowest = min(row.frames_per_cpu_s for row in rows if row.is_moved)
    results.verdict(f"{what}: longest gap in ms of the processor", longest, 200.0)
    results.verdict(
        f"{what}: fewest frames a second of the processor", slowest, 30.0, at_least=True
    )
    (load,) = (row.load_percent for row in rows if row.what == window_hands.IDLE)
    if count <= 50:
        results.verdict(f"{what}: load while idle in %", load, 6.0)
