# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Formulas over streams: states a second beside other monitors, many formulas, and latencies."""

from __future__ import annotations

import argparse
import contextlib
import gc
import random
import time
import tracemalloc
from statistics import median
from types import SimpleNamespace
from typing import Any, Callable, Iterator, Sequence, Tuple

import rospy
from dyknow_msgs.msg import Verdict
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Header

import dyknow
from dyknow.formulas import Monitor, parse
from dyknow.formulas.compiler import Evaluator
from dyknow.formulas.tree import SECOND, Binary, Node, Unary, children
from dyknow_benchmark.options import measurement
from dyknow_benchmark.results import Results, Row, Summary, spread
from dyknow_benchmark.session import MANAGER, Session, say, steps, wait_until

#: Properties in the style of Ulus' *timescales*: patterns of p, q and r with one bound, in states.
PROPERTIES = {
    "absent after q": "historically (once[0, {}] q implies (not p since q))",
    "absent before r": "historically (r implies historically[0, {}] not p)",
    "absent between q and r": "historically (r and not q and once q implies not p since[0, {}] q)",
    "always after q": "historically (once[0, {}] q implies (p since q))",
    "always before r": "historically (r implies historically[0, {}] p)",
    "always between q and r": "historically (r and not q and once q implies p since[0, {}] q)",
    "recurs": "historically (once[0, {}] p)",
    "recurs between": "historically (r and not q and once q implies once[0, {}](p or q) since q)",
    "responds": "historically (q implies once[0, {}] p)",
    "responds between": "historically (r and not q and once q "
    "implies (q implies once[0, {}] p) since q)",
}
BOUNDS = (10, 100, 1000)
#: How much faster than the fastest other monitor, and how far the largest bound may slow it down.
_FASTER, _SLOWER = 1.5, 1.2
_MANY, _SHARE, _BYTES = 1000, 0.15, 4096.0
_LATENCY = 0.15  # ms
_REACTION = 1.0  # s
_SPARE = "/spare_1"
#: A source that requires a verdict, another one, and the battery that the verdict is about.
_GUARDED = """
<transformations>
  <transformation type="topic"><label>battery</label><source>/battery</source>
    <ports><port type="out" datatype="sensor_msgs/BatteryState">out</port></ports>
    <tags><tag port="out">Battery(robot)</tag></tags></transformation>
  <transformation type="formula"><label>charged</label>
    <formula>battery.percentage &gt; 0.2</formula>
    <ports><port type="in" datatype="sensor_msgs/BatteryState">battery</port>
      <port type="out">holds</port></ports>
    <tags><tag port="battery">Battery(?robot)</tag>
      <tag port="holds">Holds(charged, ?robot)</tag></tags></transformation>
  <transformation><label>guarded</label><source>dyknow/Source</source>
    <params><param name="rate" type="double">50</param></params>
    <ports><port type="out" datatype="std_msgs/Header">out</port></ports>
    <tags><tag port="out">Beat(robot)</tag></tags>
    <requires>Holds(charged, robot)</requires></transformation>
  <transformation cost="2"><label>spare</label><source>dyknow/Source</source>
    <params><param name="rate" type="double">50</param></params>
    <ports><port type="out" datatype="std_msgs/Header">out</port></ports>
    <tags><tag port="out">Beat(robot)</tag></tags></transformation>
</transformations>
"""

State = Tuple[bool, bool, bool]
Step = Callable[[Sequence[State]], float]
"""Monitors some states; returns the seconds of processor time that it takes."""


@measurement(states=100_000, messages=500, violations=20)
def formulas(arguments: argparse.Namespace, results: Results) -> None:
    """Evaluate formulas beside other monitors, a thousand at once, in a nodelet, and re-wire.

    The other monitors are reelay and sentil, as far as they are installed.
    """
    _throughput(arguments.states, results)
    _many(results)
    with Session() as session:
        _latency(session, arguments.messages, results)
        _reaction(session, arguments.violations, results)


def _throughput(count: int, results: Results) -> None:
    dice = random.Random(1)
    states = [
        (dice.random() < 0.3, dice.random() < 0.3, dice.random() < 0.3) for _ in range(count)
    ]
    rows: list[Row] = []
    ratios, slower = [], []
    for name, text in PROPERTIES.items():
        found = {}
        for bound in BOUNDS:
            say(f"property '{name}', bound {bound}")
            formula = parse(text.format(bound)).tree
            steppers = {"DyKnow": _dyknow(formula), **dict(_others(formula))}
            times: dict[str, list[float]] = {each: [] for each in steppers}
            for _ in range(3):  # by turns
                for each, make in steppers.items():
                    times[each].append(make(states))
            rates = {each: count / median(some) / 1e6 for each, some in times.items()}
            found[bound] = rates["DyKnow"]
            others = [rate for each, rate in rates.items() if each != "DyKnow"]
            ratio = rates["DyKnow"] / max(others) if others else 0.0
            ratios += [ratio] * bool(others)
            cells = [rates.get(each, 0.0) for each in ("DyKnow", "reelay", "sentil")]
            rows.append((name, bound, *cells, ratio))
        slower.append(found[BOUNDS[0]] / found[BOUNDS[-1]])
    header = ("property", "bound", "dyknow", "reelay", "sentil", "to_fastest")
    results.table("throughput", "million states a second", header, rows)
    of_bound = [[row[2:] for row in rows if row[1] == bound] for bound in BOUNDS]
    medians = [tuple(map(median, zip(*some))) for some in of_bound]
    typical: list[Row] = [(bound, *each) for bound, each in zip(BOUNDS, medians)]
    results.table("bounds", "million states a second, median", header[1:], typical)
    if ratios:
        what = "states a second, to the fastest other monitor, median"
        results.verdict(what, median(ratios), _FASTER, at_least=True)
    results.verdict("time with the bound 1000 to that with 10, median", median(slower), _SLOWER)


def _dyknow(formula: Node) -> Step:
    def run(states: Sequence[State]) -> float:
        evaluator = Evaluator(formula, SECOND)
        places = ["pqr".index(str(each)) for each in evaluator.inputs]
        step = evaluator.step
        return _timed(step, [tuple(s[place] for place in places) for s in states])

    return run


def _others(formula: Node) -> Iterator[tuple[str, Step]]:
    """Yield the other monitors that are installed."""
    with contextlib.suppress(ImportError):
        import reelay

        def run_reelay(states: Sequence[State]) -> float:
            text = written_for_others(formula, "{{{}}}", ":")
            monitor = reelay.discrete_timed_monitor(text, semantics="boolean", condense=False)
            return _timed(monitor.update, [(dict(zip("pqr", state)),) for state in states])

        yield "reelay", run_reelay
    with contextlib.suppress(ImportError):
        import sentil

        def run_sentil(states: Sequence[State]) -> float:
            update = sentil.OnlineMonitor(written_for_others(formula, "{} > 0.5", ",")).update
            inputs = [(float(n), dict(zip("pqr", map(float, s)))) for n, s in enumerate(states)]
            return _timed(update, inputs)

        yield "sentil", run_sentil


def _timed(step: Callable[..., object], inputs: Sequence[Tuple[Any, ...]]) -> float:
    begin = time.process_time()
    for each in inputs:
        step(*each)
    return time.process_time() - begin


def written_for_others(formula: Node, atom: str, separator: str) -> str:
    """Write a formula as reelay and sentil read it: with states as seconds, all in parentheses."""
    if not isinstance(formula, (Unary, Binary)):
        return atom.format(formula)
    parts = [written_for_others(each, atom, separator) for each in children(formula)]
    bounds = formula.interval
    interval = ""
    if bounds.upper is not None or bounds.lower:
        upper = "inf" if bounds.upper is None else bounds.upper // SECOND
        interval = f"[{bounds.lower // SECOND}{separator}{upper}]"
    if isinstance(formula, Unary):
        word = "!" if formula.operator == "not" else f"{formula.operator}{interval}"
        return f"{word}({parts[0]})"
    word = "->" if formula.operator == "implies" else f"{formula.operator}{interval}"
    return f"(({parts[0]}) {word} ({parts[1]}))"


def _many(results: Results) -> None:
    """Feed a thousand formulas 10 messages a second each."""
    formula = "historically[0 s, 5 s] battery.percentage > {:g}"

    def make() -> list[Monitor]:
        return [
            parse(formula.format(0.2 + each * 1e-6)).monitor(0.1, 2.0) for each in range(_MANY)
        ]

    def feed(monitors: Sequence[Monitor], begin: int, end: int) -> None:
        for number in range(begin, end):
            message = SimpleNamespace(percentage=0.5)
            for monitor in monitors:
                monitor.feed("battery", message, number / 10)

    say(f"{_MANY} formulas")
    feed(make(), 0, 60)  # code that they share
    tracemalloc.start()
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    monitors = make()
    feed(monitors, 0, 60)
    gc.collect()
    size = (tracemalloc.get_traced_memory()[0] - before) / _MANY
    tracemalloc.stop()
    begin = time.process_time()
    feed(monitors, 60, 160)
    share = (time.process_time() - begin) / 10
    title = f"{_MANY} formulas, 10 messages a second each"
    header = ("share_of_a_core", "us_a_message", "bytes_each")
    results.table("many", title, header, [(share, share / (10 * _MANY) * 1e6, size)])
    results.verdict(f"{_MANY} formulas at 10 Hz, share of a core", share, _SHARE)
    results.verdict("memory of a formula, bytes", size, _BYTES)


def _latency(session: Session, count: int, results: Results) -> None:
    """Compare a message that decides and its verdict with a message and its relayed self."""
    times: dict[str, list[float]] = {"relay": [], "formula": []}
    period = 0.02
    manager = session.nodelet_manager()
    manager.load("/relay", "dyknow/Relay", {"/in": "/beats", "/out": "/relayed"})
    given = {"formula": "rate(beat, 1 s) > 0", "datatypes": {"beat": "std_msgs/Header"}}
    for name, value in {**given, "period": period, "delay": 10.0}.items():
        rospy.set_param(f"/formula/{name}", value)
    manager.load("/formula", "dyknow/Formula", {"/beat": "/beats", "/holds": "/verdicts"})
    sent = 0.0

    def hear(message: object, what: str) -> None:
        times[what].append(1e3 * (time.monotonic() - sent))

    publisher = rospy.Publisher("/beats", Header, queue_size=1, tcp_nodelay=True)
    rospy.Subscriber("/relayed", Header, hear, "relay", tcp_nodelay=True)
    rospy.Subscriber("/verdicts", Verdict, hear, "formula", tcp_nodelay=True)
    wait_until(lambda: publisher.get_num_connections() > 0, "the nodelets")
    for _ in steps(range(count), "deciding", "message"):
        sent = time.monotonic()
        publisher.publish(Header())
        time.sleep(period)
    rows: list[Row] = [(what, len(some), *Summary.of(some).spread) for what, some in times.items()]
    title = "from a message to the relayed one, and to the verdict that it decides"
    results.table("verdicts", title, ("what", "count", *spread("ms")), rows)
    more = median(times["formula"]) - median(times["relay"])
    results.verdict("verdict after a relayed message, median in ms", more, _LATENCY)


def _reaction(session: Session, count: int, results: Results) -> None:
    """Drain a battery again and again; count from the message to the replacement's first one."""
    times: list[float] = []
    rospy.set_param(f"{MANAGER}/recover", 0.1)
    client = session.dyknow_manager()
    client.add_transformation(_GUARDED)
    level = [0.5]
    heard: list[tuple[float, int]] = []  # when, and the number in the message
    publisher = rospy.Publisher("/battery", BatteryState, queue_size=1, tcp_nodelay=True)
    timer = rospy.Timer(
        rospy.Duration(0.02), lambda _: publisher.publish(BatteryState(percentage=level[0]))
    )
    with dyknow.acquire("Beat(robot)", Header) as stream:

        def hear(message: Header) -> None:
            heard.append((time.monotonic(), int(message.frame_id)))

        rospy.Subscriber(stream.topic, Header, hear, tcp_nodelay=True)

        def is_guarded() -> bool:
            """Whether the guarded source has been used for some time."""
            is_used = any(name.startswith("/guarded") for name in stream.nodelets)
            return is_used and bool(heard) and heard[-1][1] > 50

        for _ in steps(range(count), "violations", "violation"):
            wait_until(is_guarded, "the guarded source")
            heard.clear()
            began, level[0] = time.monotonic(), 0.1
            wait_until(lambda: any(number < 20 for _, number in heard), "the replacement")
            times.append(next(when for when, number in heard if number < 20) - began)
            level[0] = 0.5
            wait_until(lambda: bool(client.replan_stream(stream.claim_id).spawned), "the way back")
            wait_until(lambda: not client.get_model().nodelet(_SPARE), "the end of the spare one")
    timer.shutdown()
    row = (len(times), *Summary.of(times).spread)
    title = "from a message that violates a formula to the first one of the replacement"
    results.table("reaction", title, ("violations", *spread("s")), [row])
    what = "violation to the first message of the replacement, median in s"
    results.verdict(what, median(times), _REACTION)
