# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Times to arrival over chains of hops, and the memory of their parts."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from statistics import median
from typing import Any, Mapping, NamedTuple, Sequence

import psutil
import rospy

from dyknow.locks import state_lock
from dyknow_benchmark.chains import (
    KINDS,
    NODELETS,
    WARM_UP,
    Block,
    Chain,
    Order,
    alternating,
    blocks_of,
    build,
    in_turns,
    load_script,
)
from dyknow_benchmark.options import choice, measurement, payload, positive, rate, size
from dyknow_benchmark.parts import payload_of
from dyknow_benchmark.results import ARRIVALS, Results, Row, Summary, median_interval
from dyknow_benchmark.session import MeasurementFailed, Session, say, steps, wait_until

#: Number of hops that the targets are stated for, and the kinds that they compare.
TARGET_HOPS = 50
_OURS, _PLAIN, _PEER = "dyknow", "nodelet", "cpp_nodelet"
#: The most that DyKnow's mean may be of that of C++ nodelets, by frequency in Hz.
_LIMITS: dict[float, float] = {100.0: 0.25, 5.0: 0.35}
_SIZES = ["320x240", "640x480", "1280x720", "1920x1080"]
#: The paper's kinds, with function calls (the floor) and C++ beside them.
_PAPERS = tuple(kind for kind in KINDS if kind not in ("script", "cpp_live"))
_FOOTPRINTS = (*list(NODELETS)[:3], "node", "cpp_node")
#: Parts that are set up first: they load the shared modules.
_BEFORE = 3


class ChainPlan(NamedTuple):
    """The setting of ``chain``.

    Attributes:
        kinds: which chains.
        hops: numbers of hops.
        frequency: Hz.
        messages: of each kind, in all.
        repeats: blocks that they are divided into.
        pairs: differences between ``dyknow`` and ``nodelet``.
        pair_messages: messages of each of the two in one pair.
    """

    kinds: Sequence[str]
    hops: Sequence[int]
    frequency: float
    messages: int
    repeats: int
    pairs: int
    pair_messages: int = 25


_HOPS = (1, 2, 5, 10, 20, 50)
PAPER = ChainPlan(_PAPERS, _HOPS, 5.0, 1000, 10, 20)
QUICK = ChainPlan(_PAPERS, _HOPS, 100.0, 400, 4, 20, 10)


def plan_of(arguments: argparse.Namespace) -> ChainPlan:
    """Fill in the options that are not given: the paper's setting, or the quick one."""
    default = QUICK if arguments.quick else PAPER
    kinds = set(arguments.kinds or default.kinds)
    return default._replace(
        kinds=tuple(kind for kind in KINDS if kind in kinds),
        hops=tuple(sorted(set(arguments.hops or default.hops))),
        frequency=arguments.rate or default.frequency,
        messages=arguments.messages or default.messages,
        repeats=arguments.repeats or default.repeats,
        pairs=default.pairs if arguments.pairs is None else arguments.pairs,
    )


@measurement(
    kinds=choice(
        list(KINDS),
        None,
        "; ".join(f"{kind}: {text}" for kind, text in KINDS.items())
        + f" (default: all but {', '.join(kind for kind in KINDS if kind not in _PAPERS)})",
    ),
    hops={"nargs": "+", "type": positive, "help": "default: 1 2 5 10 20 50"},
    rate={"type": rate, "help": "messages per second (default: 5)"},
    messages={"type": positive, "help": "of each kind (default: 1000)"},
    repeats={"type": positive, "help": "turns that they come in (default: 10)"},
    pairs={"type": int, "help": "differences dyknow - nodelet (default: 20; 0: none)"},
    quick={
        "action": "store_true",
        "help": f"a look within two minutes: --rate {QUICK.frequency:g} --messages "
        f"{QUICK.messages} --repeats {QUICK.repeats}, and shorter pairs; each can be given too",
    },
)
def chain(arguments: argparse.Namespace) -> Results:
    """Time to arrival over a chain of hops, the paper's figure 4.

    A source stamps messages at a fixed frequency, every hop compares the stamp with the time of
    arrival before it forwards the message. One chain of the largest length serves all numbers of
    hops, as in the paper. The kinds take turns in blocks, so that a drift of the machine's speed
    affects them all. The time that the proxy adds is measured separately: the messages of
    DyKnow's chain and of the plain one alternate, and each pair of such blocks yields one
    difference.
    """
    plan = plan_of(arguments)
    with Session() as session:
        chains = {kind: build(session, kind, max(plan.hops), plan.hops) for kind in plan.kinds}
        results = Results()
        orders = blocks_of(plan.messages, plan.frequency, plan.repeats)
        blocks = in_turns({kind: chain.run for kind, chain in chains.items()}, orders)
        differences: dict[int, list[float]] = {hops: [] for hops in plan.hops}
        if {_OURS, _PLAIN} <= set(chains):
            for number in steps(range(plan.pairs), "pairs", "pair"):
                names = (_OURS, _PLAIN) if number % 2 == 0 else (_PLAIN, _OURS)
                order = Order(WARM_UP, plan.pair_messages, plan.frequency)
                pair = alternating({name: chains[name] for name in names}, [order])
                for hops in plan.hops:
                    ours, plain = (pair[name].latencies[hops] for name in (_OURS, _PLAIN))
                    if ours and plain:
                        differences[hops].append(median(ours) - median(plain))
    tell_chain(results, plan, blocks, differences)
    return results


def tell_chain(
    results: Results,
    plan: ChainPlan,
    blocks: Mapping[str, Block],
    differences: Mapping[int, list[float]],
) -> None:
    """Make tables, the figure and the verdicts of the measured blocks; targets are for 50 hops."""
    summaries = {
        (kind, hops): Summary.of(blocks[kind].latencies.get(hops, []))
        for kind in plan.kinds
        for hops in plan.hops
    }
    means = {key: each.mean for key, each in summaries.items() if each.count}
    ours, peer = (means.get((kind, TARGET_HOPS)) for kind in (_OURS, _PEER))
    if ours and peer:
        at = [each for each in _LIMITS if each <= plan.frequency] or [min(_LIMITS)]
        what = f"{TARGET_HOPS} hops, {plan.frequency:g} Hz"
        results.verdict(
            f"mean of DyKnow / mean of C++ nodelets, {what}", ours / peer, _LIMITS[max(at)]
        )
    added = differences.get(TARGET_HOPS)
    if added:
        what = f"{TARGET_HOPS} hops, median of {len(added)} pairs (ms)"
        results.verdict(f"added by the proxy, {what}", median(added) / 1000, 0.02)
    rows: list[Row] = [
        (*key, *each.arrivals(blocks[key[0]].sent)) for key, each in summaries.items()
    ]
    results.table("figure4", "time to arrival", ("kind", "hops", *ARRIVALS), rows)
    header = ("hops", "pairs", "median_us", "low_us", "high_us")
    overhead = [
        (hops, len(values), median(values), *median_interval(values))
        for hops, values in differences.items()
        if values
    ]
    if overhead:
        results.table("overhead", "what the proxy adds", header, overhead)
    title = f"{plan.messages} messages at {plan.frequency:g} Hz"
    results.pictures.append(("figure4", lambda path: draw(means, title, path)))


def draw(means: Mapping[tuple[str, int], float], title: str, path: Path) -> None:
    """Draw the paper's figure 4: a line for each kind.

    Args:
        means: microseconds by kind and number of hops.
        title: says how it was measured.
        path: file to write; its suffix says the format.
    """
    from matplotlib.figure import Figure  # takes a while

    figure = Figure(figsize=(9.0, 4.6))
    axes = figure.subplots()
    for order, (kind, marker) in enumerate(zip(KINDS, "os^vDXP*")):
        points = sorted(
            (hops, mean / 1000) for (each, hops), mean in means.items() if each == kind
        )
        if points:
            axes.plot(
                *zip(*points),
                label=f"{kind}: {KINDS[kind]}",
                marker=marker,
                markersize=5 + order % 2 * 3,  # so that neighbours that coincide are both seen
            )
    axes.set(yscale="log", xlabel="hops", ylabel="mean time to arrival (ms)", title=title)
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), frameon=False, fontsize="small")
    figure.savefig(path, dpi=150, bbox_inches="tight")


def _compare(
    results: Results, name: str, title: str, what: str, blocks: Mapping[Any, Block]
) -> None:
    """Add a table of the arrivals at the last hop of each case."""
    rows: list[Row] = []
    for case, block in blocks.items():
        (hop,) = block.latencies
        rows.append((case, hop, *Summary.of(block.latencies[hop]).arrivals(block.sent)))
    results.table(name, title, (what, "hops", *ARRIVALS), rows)


def _median(block: Block) -> float:
    (latencies,) = block.latencies.values()
    if not latencies:
        raise MeasurementFailed("no message came through the chain")
    return median(latencies)


@measurement(
    hops=50,
    sizes={
        "nargs": "+",
        "type": size,
        "metavar": "WIDTHxHEIGHT",
        "default": _SIZES,
        "help": f"default: {' '.join(_SIZES)}",
    },
    rate=20.0,
    messages=500,
)
def images(arguments: argparse.Namespace) -> Results:
    """The same chain with images of growing size and with time stamps.

    Messages pass by reference, so their size should not matter. All chains run in one nodelet
    manager, and their messages alternate. The source makes every image afresh, before it is
    stamped.
    """
    with Session() as session:
        chains = {
            payload: build(session, "dyknow", arguments.hops, (), payload)
            for payload in ("time", *arguments.sizes)
        }
        results = Results()
        blocks = alternating(chains, blocks_of(arguments.messages, arguments.rate))
    _compare(results, "images", "time to arrival", "payload", blocks)
    largest = _SIZES[-1]
    if largest in blocks:
        what = f"median with images of {largest} / with time stamps, {arguments.hops} hops"
        results.verdict(what, _median(blocks[largest]) / _median(blocks["time"]), 1.2)
    return results


@measurement(hops=10, rate=20.0, messages=200)
def busy(arguments: argparse.Namespace) -> Results:
    """Time to arrival over a chain while another nodelet burns CPU.

    The other nodelet computes in Python without a pause: in the chain's own nodelet manager,
    where it takes the interpreter in turns with the chain, or in a nodelet manager of its own, as
    ``isolated`` does. The three cases take turns in blocks.
    """
    with Session() as session:
        chain = build(session, "dyknow", arguments.hops)
        managers = {
            "same manager": session.nodelet_manager(),
            "own manager": session.nodelet_manager("python", "/manager_of_the_burner"),
        }

        def beside(case: str, order: Order) -> Block:
            managers[case].load("/benchmark/burner", "dyknow_benchmark/Burner")
            block = chain.run(order)
            managers[case].unload("/benchmark/burner")
            return block

        results = Results()
        cases = {"none": chain.run}
        for case in managers:
            cases[case] = lambda order, case=case: beside(case, order)  # type: ignore[misc]
        blocks = in_turns(cases, blocks_of(arguments.messages, arguments.rate))
    title = "time to arrival while another nodelet burns CPU"
    _compare(results, "busy", title, "burner", blocks)
    return results


@measurement(
    hops=50,
    listened={
        "nargs": "+",
        "type": int,
        "default": [0, 1, 10, 50],
        "metavar": "N",
        "help": "topics that another process hears, of as many chains (default: 0 1 10 50)",
    },
    payload={"type": payload, "default": "time", "help": "time, or a size of images"},
    rate=20.0,
    messages=200,
)
def outside(arguments: argparse.Namespace) -> Results:
    """Time to arrival over a chain that another process listens to.

    All chains are in one nodelet manager; another process subscribes to a number of topics of
    each, spread over its length. A message is serialised once for each topic that has subscribers
    outside. The messages of the chains alternate.
    """
    hops = arguments.hops
    with Session() as session:
        chains = {}
        for number in sorted({min(hops, max(0, each)) for each in arguments.listened}):
            name = f"_heard_{number}"
            chains[number] = build(session, "dyknow", hops, (), arguments.payload, name)
            _listen(chains[number], spread(hops, number), arguments.payload)
        results = Results()
        blocks = alternating(chains, blocks_of(arguments.messages, arguments.rate))
    title = "time to arrival with subscribers outside"
    _compare(results, "outside", title, "listened", blocks)
    return results


def spread(hops: int, count: int) -> list[int]:
    """As many of the numbers from 1 to ``hops`` at even distances, the last among them."""
    return [hops - index * hops // count for index in range(count)][::-1]


def _listen(chain: Chain, numbers: Sequence[int], payload: str) -> None:
    """Subscribe, in this process, to the topics of some hops; wait for a message on each."""
    lock, silent = state_lock("arrivals"), set(numbers)

    def hear(message: object, number: int) -> None:
        with lock:
            silent.discard(number)

    for number in numbers:
        topic, datatype = f"{chain.control}/hop_{number}", payload_of(payload).datatype
        rospy.Subscriber(topic, datatype, hear, callback_args=number)

    def is_heard() -> bool:
        chain.run(Order(0, 1, 10.0))
        with lock:
            return not silent

    wait_until(is_heard, f"the messages of {chain.control} outside")


@measurement(
    size={"type": size, "default": "720x480", "help": "default: %(default)s"},
    rate=20.0,
    messages=500,
    scripts=50,
)
def scripts(arguments: argparse.Namespace) -> Results:
    """Unchanged scripts of rospy in one nodelet manager, and as processes.

    The same two nodes, a source and a receiver, pass images. As processes they do it over TCP; as
    scripts in one nodelet manager they get structural copies. Their messages alternate with those
    of two nodelets that are written for DyKnow, which share the images. Then scripts are loaded,
    for the time that a load takes and for the memory that each needs.
    """
    image, count = arguments.size, arguments.scripts
    with Session() as session:
        kinds = ("script", "node", "dyknow")
        chains = {kind: build(session, kind, 1, (), image) for kind in kinds}
        results = Results()
        blocks = alternating(chains, blocks_of(arguments.messages, arguments.rate))
        say(f"loading {count} scripts")
        manager, took = [session.nodelet_manager().process], []
        for number in range(-_BEFORE, count):
            if number == 0:
                before = _held(manager)
            begin = time.monotonic()
            load_script(session, "hop", "/benchmark/loaded", "time", number + _BEFORE + 1, ())
            took.append((time.monotonic() - begin) * 1e3)
        kib, threads = (now - then for now, then in zip(_held(manager), before))
    loads = Summary.of(took[_BEFORE:])
    rows: list[Row] = [
        (kind, *Summary.of(block.latencies[1]).arrivals(block.sent))
        for kind, block in blocks.items()
    ]
    title = f"{image} from a source to a receiver, time to arrival"
    results.table("scripts", title, ("kind", *ARRIVALS), rows)
    results.table(
        "script_loads",
        "loading scripts into a nodelet manager",
        ("scripts", "median_load_ms", "p99_load_ms", "max_load_ms", "kib_each", "threads_each"),
        [(count, loads.median, loads.p99, loads.max, kib / count, threads / count)],
    )
    what = f"median of {image} between two scripts / between two rospy processes"
    results.verdict(what, _median(blocks["script"]) / _median(blocks["node"]), 0.2)
    results.verdict("load of a script, median in ms", loads.median, 50.0)
    results.verdict("memory of a script, in MB", kib / count / 1024, 0.5)
    return results


@measurement(kinds=choice(_FOOTPRINTS, _FOOTPRINTS, "default: all"), nodelets=100, nodes=20)
def footprint(arguments: argparse.Namespace) -> Results:
    """Memory and threads of a nodelet, and of a node that does the same.

    Chains are set up and carry a message. Memory is the proportional set size (PSS), which counts
    a share of shared memory for each process. For nodelets it is the memory that further ones add
    to their nodelet manager.
    """
    rows = []
    with Session() as session:
        results = Results()
        for kind in steps(arguments.kinds, "footprint", "kind"):
            build(session, kind, _BEFORE, (), name="_before")
            there: set[psutil.Process] = set(session.processes)
            host = [session.nodelet_manager(NODELETS[kind][0]).process] if kind in NODELETS else []
            before = _held(host)
            parts = (arguments.nodelets if host else arguments.nodes) + 1
            build(session, kind, parts - 1, (), name="_counted")
            started = [each for each in session.processes if each not in there]
            kib, threads = (now - then for now, then in zip(_held([*host, *started]), before))
            rows.append((kind, parts, kib / parts, threads / parts, len(started)))
    header = ("kind", "parts", "kib_each", "threads_each", "processes")
    results.table("footprint", "what a nodelet or a node takes", header, rows)
    return results


def _held(processes: Sequence[psutil.Process]) -> tuple[float, int]:
    """Memory (KiB) and threads of processes, in all."""
    kib = sum(each.memory_full_info().pss / 1024 for each in processes)
    return kib, sum(each.num_threads() for each in processes)
