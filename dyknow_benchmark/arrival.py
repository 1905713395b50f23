# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Times to arrival over chains of hops, and the memory of their parts."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Callable, Mapping, NamedTuple

import psutil
import rospy

from dyknow.locks import state_lock
from dyknow_benchmark.chains import (
    KINDS,
    MANAGERS,
    PAIR,
    WARM_UP,
    Block,
    Chain,
    ChainPart,
    Order,
    add_part,
    alternating,
    blocks_of,
    build,
    in_turns,
    paired,
)
from dyknow_benchmark.options import measurement
from dyknow_benchmark.parts import payload_of
from dyknow_benchmark.results import ARRIVALS, Results, Row, Summary, median_interval
from dyknow_benchmark.session import Session, say, seconds, steps, wait_until

#: Number of hops that the targets are stated for, and the kinds that they compare.
TARGET_HOPS = 50
_OURS, _PLAIN, _PEER = "dyknow", "nodelet", "cpp_nodelet"
#: The most that DyKnow's mean may be of that of C++ nodelets, by frequency in Hz.
_LIMITS: dict[float, float] = {100.0: 0.25, 5.0: 0.35}
_SIZES = ["320x240", "640x480", "1280x720", "1920x1080"]
#: The paper's kinds, with C++ beside them.
_PAPERS = [kind for kind in KINDS if kind not in ("isolated", "script", "cpp_live")]
_FOOTPRINTS = ["dyknow", "nodelet", "cpp_nodelet", "node", "cpp_node"]
#: Options that ``chain --quick`` stands for; each can be given too.
QUICK = ("--rate", "100", "--messages", "400")
_BEFORE = 3  # parts that are set up first: they load the shared modules


@measurement(
    kinds={
        "nargs": "+",
        "choices": list(KINDS),
        "metavar": "KIND",
        "default": _PAPERS,
        "help": "; ".join(f"{kind}: {text}" for kind, text in KINDS.items())
        + " (default: all but isolated, script, cpp_live)",
    },
    hops=[1, 2, 5, 10, 20, 50],
    rate=5.0,
    messages=1000,
    pairs={"type": int, "default": 20, "help": "differences dyknow - nodelet (default: 20)"},
    quick={"action": "store_true", "help": f"in two minutes: {' '.join(QUICK)}"},
)
def chain(arguments: argparse.Namespace, results: Results) -> None:
    """Time to arrival over a chain of hops, the paper's figure 4.

    A source stamps messages at a fixed frequency, every hop compares the stamp with the time of
    arrival before it forwards the message. One chain of the largest length serves all numbers of
    hops, as in the paper. The kinds take turns in blocks, so that a drift of the machine's speed
    affects them all. The time that the proxy adds is measured separately: the messages of
    DyKnow's chain and of the plain one alternate, and each pair of such blocks yields one
    difference.
    """
    hops, rate = sorted(set(arguments.hops)), arguments.rate
    with Session() as session:
        kinds = [kind for kind in KINDS if kind in arguments.kinds]
        chains = {kind: build(session, kind, max(hops), hops) for kind in kinds}
        runs = {kind: each.run for kind, each in chains.items()}
        blocks = in_turns(runs, blocks_of(arguments.messages, rate))
        compared = {kind: chains[kind] for kind in (_OURS, _PLAIN) if kind in chains}
        pairs = arguments.pairs if len(compared) == 2 else 0
        order = Order(WARM_UP, PAIR, rate)
        differences: dict[int, list[float]] = {each: [] for each in hops}
        for pair in paired(compared, order, pairs):
            for each in hops:
                differences[each].append(pair[_OURS].median(each) - pair[_PLAIN].median(each))
    report_chain(results, rate, blocks, differences)


def report_chain(
    results: Results, rate: float, blocks: dict[str, Block], differences: dict[int, list[float]]
) -> None:
    """Make tables, the figure and the verdicts of the measured blocks; targets are for 50 hops."""
    summaries = {
        (kind, hops): Summary.of(latencies)
        for kind, block in blocks.items()
        for hops, latencies in block.latencies.items()
    }
    means = {key: each.mean for key, each in summaries.items() if each.number}
    ours, peer = (summaries.get((kind, TARGET_HOPS)) for kind in (_OURS, _PEER))
    if ours is not None and peer is not None:
        limit = _LIMITS[max([each for each in _LIMITS if each <= rate], default=min(_LIMITS))]
        what = f"mean of DyKnow / mean of C++ nodelets, {TARGET_HOPS} hops, {rate:g} Hz"
        results.verdict(what, ours.mean / peer.mean, limit)
    added = differences.get(TARGET_HOPS)
    if added:
        what = f"{TARGET_HOPS} hops, median of {len(added)} pairs (ms)"
        results.verdict(f"added by the proxy, {what}", median(added) / 1000, 0.02)
    rows: list[Row] = [
        (*key, *each.arrivals(blocks[key[0]].sent)) for key, each in summaries.items()
    ]
    results.table("figure4", "time to arrival", ("kind", "hops", *ARRIVALS), rows)
    overhead = [
        (hops, len(values), median(values), *median_interval(values))
        for hops, values in differences.items()
        if values
    ]
    if overhead:
        header = ("hops", "pairs", "median_us", "low_us", "high_us")
        results.table("overhead", "what the proxy adds", header, overhead)
    title = f"{max(block.sent for block in blocks.values())} messages at {rate:g} Hz"
    results.pictures.append(("figure4", partial(draw, means, title)))


def draw(means: Mapping[tuple[str, int], float], title: str, path: Path) -> None:
    """Draw the paper's figure 4 into a file: means (us) by kind and hops, a line for each kind."""
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


@measurement(hops=50, sizes=_SIZES, rate=20.0, messages=500)
def images(arguments: argparse.Namespace, results: Results) -> None:
    """The same chain with images of growing size and with time stamps.

    Messages pass by reference, so their size should not matter. All chains run in one nodelet
    manager, and their messages alternate. The source makes every image afresh, before it is
    stamped.
    """
    hops, largest = arguments.hops, _SIZES[-1]
    with Session() as session:
        payloads = dict.fromkeys(("time", *arguments.sizes))
        chains = {each: build(session, "dyknow", hops, (), each) for each in payloads}
        blocks = alternating(chains, blocks_of(arguments.messages, arguments.rate))
    _compare(results, "images", "time to arrival", "payload", blocks)
    if largest in blocks:
        what = f"median with images of {largest} / with time stamps, {hops} hops"
        results.verdict(what, blocks[largest].median(hops) / blocks["time"].median(hops), 1.2)


@measurement(hops=10, rate=20.0, messages=200)
def busy(arguments: argparse.Namespace, results: Results) -> None:
    """Time to arrival over a chain while another nodelet burns CPU.

    The other nodelet computes in Python without a pause: in the chain's own nodelet manager,
    where it takes the interpreter in turns with the chain, or in a nodelet manager of its own, as
    ``isolated`` does. The three cases take turns in blocks.
    """
    with Session() as session:
        chain = build(session, "dyknow", arguments.hops)
        managers = {
            "same manager": session.nodelet_manager(),
            "own manager": session.nodelet_manager("python_beside"),
        }

        def beside(case: str, order: Order) -> Block:
            managers[case].load("/benchmark/burner", "dyknow_benchmark/Burner")
            block = chain.run(order)
            managers[case].unload("/benchmark/burner")
            return block

        cases: dict[str, Callable[[Order], Block]] = {"none": chain.run}
        cases.update({case: partial(beside, case) for case in managers})
        blocks = in_turns(cases, blocks_of(arguments.messages, arguments.rate))
    title = "time to arrival while another nodelet burns CPU"
    _compare(results, "busy", title, "burner", blocks)


@measurement(
    hops=50,
    listened={
        "nargs": "+",
        "type": int,
        "default": [0, 1, 10, 50],
        "metavar": "N",
        "help": "topics heard by another process, all at most, in chains (default: 0 1 10 50)",
    },
    payload="time",
    rate=20.0,
    messages=200,
)
def outside(arguments: argparse.Namespace, results: Results) -> None:
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
            heard = {hops - index * hops // number for index in range(number)}
            _listen(chains[number], heard, arguments.payload)
        blocks = alternating(chains, blocks_of(arguments.messages, arguments.rate))
    title = "time to arrival with subscribers outside"
    _compare(results, "outside", title, "listened", blocks)


def _listen(chain: Chain, numbers: set[int], payload: str) -> None:
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


@measurement(size="720x480", rate=20.0, messages=500, scripts=50)
def scripts(arguments: argparse.Namespace, results: Results) -> None:
    """Unchanged scripts of rospy in one nodelet manager, and as processes.

    The same two nodes, a source and a receiver, pass images. As processes they do it over TCP; as
    scripts in one nodelet manager they get structural copies. Their messages alternate with those
    of two nodelets that are written for DyKnow, which share the images. Then scripts are loaded,
    for the time that a load takes and for the memory that each needs.
    """
    image, count = arguments.size, arguments.scripts
    took = []
    with Session() as session:
        kinds = ("script", "node", "dyknow")
        chains = {kind: build(session, kind, 1, (), image) for kind in kinds}
        blocks = alternating(chains, blocks_of(arguments.messages, arguments.rate))
        say(f"loading {count} scripts")
        for number in range(-_BEFORE, count):
            if number == 0:
                before = _Held.of(session, "script")
            part = ChainPart("/benchmark/loaded", "time", number + _BEFORE + 1)
            took.append(1e3 * seconds(partial(add_part, session, "script", part)))
        each = _Held.of(session, "script").each(before, count)
    loads = Summary.of(took[_BEFORE:])
    rows: list[Row] = [
        (kind, *Summary.of(block.latencies[1]).arrivals(block.sent))
        for kind, block in blocks.items()
    ]
    title = f"{image} from a source to a receiver, time to arrival"
    results.table("scripts", title, ("kind", *ARRIVALS), rows)
    what = f"median of {image} between two scripts / between two rospy processes"
    results.verdict(what, blocks["script"].median(1) / blocks["node"].median(1), 0.2)
    results.verdict("load of a script, median in ms", loads.median, 50.0)
    results.verdict("memory of a script, in MB", each.kib / 1024, 0.5)


@measurement(nodelets=100, nodes=20)
def footprint(arguments: argparse.Namespace, results: Results) -> None:
    """Memory and threads of a nodelet, and of a node that does the same.

    Chains are set up and carry a message. Memory is the proportional set size (PSS), which counts
    a share of shared memory for each process. For nodelets it is the memory that further ones add
    to their nodelet manager.
    """
    rows = []
    with Session() as session:
        for kind in steps(_FOOTPRINTS, "footprint", "kind"):
            build(session, kind, _BEFORE, (), name="_before")
            old = len(session.started)
            before = _Held.of(session, kind)
            parts = (arguments.nodelets if kind in MANAGERS else arguments.nodes) + 1
            build(session, kind, parts - 1, (), name="_counted")
            each = _Held.of(session, kind, old).each(before, parts)
            rows.append((kind, parts, each.kib, each.threads, len(session.started) - old))
    header = ("kind", "parts", "kib_each", "threads_each", "processes")
    results.table("footprint", "what a nodelet or a node takes", header, rows)


class _Held(NamedTuple):
    """Memory (KiB) and threads of processes, in all."""

    kib: float
    threads: float

    @classmethod
    def of(cls, session: Session, kind: str, since: int | None = None) -> _Held:
        """Add up the nodelet manager of a kind and the processes started since then."""
        processes: list[psutil.Process] = [] if since is None else session.started[since:]
        if kind in MANAGERS:
            processes = [session.nodelet_manager(MANAGERS[kind]).process, *processes]
        kib = sum(each.memory_full_info().pss / 1024 for each in processes)
        return cls(kib, sum(each.num_threads() for each in processes))

    def each(self, before: _Held, parts: int) -> _Held:
        """The share of each part in what was added."""
        return _Held(*((now - then) / parts for now, then in zip(self, before)))
