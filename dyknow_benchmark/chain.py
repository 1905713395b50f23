# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark chain``: time to arrival over a chain of hops, the paper's figure 4.

A source stamps messages at a fixed frequency, every hop compares the stamp with the time of
arrival before it forwards the message. One chain of the largest length serves all numbers of hops,
as in the paper. The kinds take turns in blocks, so that a drift of the machine's speed affects
them all. The time that the proxy adds is measured separately: the messages of DyKnow's chain and
of the plain one alternate, and each pair of such blocks yields one difference. The targets' ratios
at the other frequency and with images follow.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Sequence, Tuple

from dyknow_benchmark import figure, machine, options, progress, ratios, tables
from dyknow_benchmark.chains import Chains
from dyknow_benchmark.control import WARM_UP, Block, ChainControl, Order, run_alternating
from dyknow_benchmark.kinds import KINDS, THE_PAPERS
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session
from dyknow_benchmark.summary import ARRIVALS, Summary, median, median_interval
from dyknow_benchmark.targets import Verdict

HEADER = ("kind", "hops", *ARRIVALS)
OVERHEAD_HEADER = ("hops", "pairs", "median_us", "low_us", "high_us")
#: Where the files go without ``--out``: half an hour of measuring is not to be lost.
OUT = Path("figure4")
#: Messages of each chain in one pair.
PAIR_MESSAGES = 25


@dataclass(frozen=True)
class ChainPlan:
    """What is to be measured.

    Attributes:
        kinds: which chains.
        hops: numbers of hops.
        frequency: Hz.
        messages: of each kind, in all.
        repeats: blocks that they are divided into.
        pairs: differences between ``dyknow`` and ``nodelet``.
        pair_messages: messages of each of the two in one pair.
        ratio_messages: messages of each chain for the ratios that the figure does not show.
    """

    kinds: Sequence[str]
    hops: Sequence[int]
    frequency: float
    messages: int
    repeats: int
    pairs: int
    pair_messages: int = PAIR_MESSAGES
    ratio_messages: int = 0

    def orders(self) -> List[Order]:
        """Blocks of nearly the same size that add up to ``messages``."""
        size, rest = divmod(self.messages, self.repeats)
        sizes = [size + (index < rest) for index in range(self.repeats)]
        return [Order(WARM_UP, each, self.frequency) for each in sizes if each]

    @property
    def paired(self) -> bool:
        """Whether differences between ``dyknow`` and ``nodelet`` are measured."""
        return self.pairs > 0 and {"dyknow", "nodelet"} <= set(self.kinds)


_HOPS = (1, 2, 5, 10, 20, 50)
PAPER = ChainPlan(THE_PAPERS, _HOPS, 5.0, 1000, 10, 20, PAIR_MESSAGES, 200)
QUICK = ChainPlan(THE_PAPERS, _HOPS, 100.0, 400, 4, 20, 10, 30)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.set_defaults(out=OUT)
    kinds = "; ".join(f"{kind}: {text}" for kind, text in KINDS.items())
    others = ", ".join(kind for kind in KINDS if kind not in THE_PAPERS)
    parser.add_argument(
        "--kinds",
        nargs="+",
        choices=list(KINDS),
        metavar="KIND",
        help=f"{kinds} (default: all but {others})",
    )
    parser.add_argument("--hops", nargs="+", type=options.positive, help="default: 1 2 5 10 20 50")
    parser.add_argument("--rate", type=options.rate, help="messages per second (default: 5)")
    parser.add_argument("--messages", type=options.positive, help="of each kind (default: 1000)")
    parser.add_argument(
        "--repeats", type=options.positive, help="turns that they come in (default: 10)"
    )
    parser.add_argument(
        "--pairs", type=int, help="differences dyknow - nodelet (default: 20; 0: none)"
    )
    parser.add_argument(
        "--ratio-messages",
        type=int,
        metavar="N",
        help="of each chain, for the ratios at the other frequency and with images "
        f"(default: {PAPER.ratio_messages}; 0: without these)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help=f"a look within two minutes: --rate {QUICK.frequency:g} --messages {QUICK.messages} "
        f"--repeats {QUICK.repeats} --ratio-messages {QUICK.ratio_messages}, and shorter pairs; "
        "each can be given too",
    )


def plan_of(arguments: argparse.Namespace) -> ChainPlan:
    """Fill in what the command line leaves open: the paper's setting, or the quick one."""
    default = QUICK if arguments.quick else PAPER
    given = set(arguments.kinds or default.kinds)
    return ChainPlan(
        kinds=tuple(kind for kind in KINDS if kind in given),
        hops=tuple(sorted(set(arguments.hops or default.hops))),
        frequency=arguments.rate or default.frequency,
        messages=arguments.messages or default.messages,
        repeats=arguments.repeats or default.repeats,
        pairs=default.pairs if arguments.pairs is None else arguments.pairs,
        pair_messages=default.pair_messages,
        ratio_messages=(
            default.ratio_messages
            if arguments.ratio_messages is None
            else arguments.ratio_messages
        ),
    )


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    plan = plan_of(arguments)
    with Session() as session:
        chains = Chains(session)
        controls = {}
        for kind in plan.kinds:
            progress.say(f"setting up {max(plan.hops)} hops: {KINDS[kind]}")
            controls[kind] = chains.build(kind, max(plan.hops), plan.hops)
        load = machine.Load()
        blocks = measure(plan, controls)
        differences = pair(plan, controls) if plan.paired else {}
        further: List[Verdict] = []
        if plan.ratio_messages > 0 and ratios.HOPS in plan.hops:
            further = ratios.measure(chains, controls, plan.frequency, plan.ratio_messages)
    return results_of(plan, blocks, differences, further, load.rows())


def measure(plan: ChainPlan, controls: Dict[str, ChainControl]) -> Dict[str, Block]:
    """Let the kinds take turns; the order is reversed from turn to turn."""
    blocks = {kind: Block() for kind in plan.kinds}
    turns = [
        (order, kind)
        for index, order in enumerate(plan.orders())
        for kind in (list(plan.kinds) if index % 2 == 0 else list(plan.kinds)[::-1])
    ]
    for order, kind in progress.steps(turns, "chains", len(turns)):
        blocks[kind].add(controls[kind].finish(order, controls[kind].begin(order)))
    return blocks


def pair(plan: ChainPlan, controls: Dict[str, ChainControl]) -> Dict[int, List[float]]:
    """Differences of the median times, dyknow minus nodelet, by hops.

    Medians, because one message that the machine delays would outweigh all that is measured.
    """
    differences: Dict[int, List[float]] = {hops: [] for hops in plan.hops}
    order = Order(WARM_UP, plan.pair_messages, plan.frequency)
    for index in progress.steps(range(plan.pairs), "pairs", plan.pairs, "pair"):
        kinds = ["dyknow", "nodelet"] if index % 2 == 0 else ["nodelet", "dyknow"]
        run_blocks = run_alternating([controls[kind] for kind in kinds], order)
        of = dict(zip(kinds, run_blocks))
        for hops in plan.hops:
            ours, plain = (of[kind].latencies[hops] for kind in ("dyknow", "nodelet"))
            if ours and plain:
                differences[hops].append(median(ours) - median(plain))
    return differences


def results_of(
    plan: ChainPlan,
    blocks: Dict[str, Block],
    differences: Dict[int, List[float]],
    further: Sequence[Verdict],
    load: Sequence[Tuple[str, tables.Cell]],
) -> Results:
    """Make tables, the figure and the verdicts of what was measured."""
    summaries = {
        (kind, hops): Summary.of(blocks[kind].latencies.get(hops, []))
        for kind in plan.kinds
        for hops in plan.hops
    }
    rows: List[Sequence[tables.Cell]] = [
        (kind, hops, *summary.arrivals(blocks[kind].sent))
        for (kind, hops), summary in summaries.items()
    ]
    overhead: List[Sequence[tables.Cell]] = [
        (hops, len(values), median(values), *median_interval(values))
        for hops, values in differences.items()
        if values
    ]
    means = {key: summary.mean for key, summary in summaries.items() if summary.count}
    results = Results(load, [*judge(plan, means, differences), *further])
    results.table("figure4", "time to arrival", HEADER, rows)
    if overhead:
        results.table("overhead", "what the proxy adds", OVERHEAD_HEADER, overhead)
    title = f"{plan.messages} messages at {plan.frequency:g} Hz"
    results.draw("figure4", lambda path: figure.draw(means, title, path))
    return results


def judge(
    plan: ChainPlan, means: Dict[Tuple[str, int], float], differences: Dict[int, List[float]]
) -> List[Verdict]:
    """Compare with the targets that apply; they are stated for 50 hops."""
    verdicts = []
    ours, peer = (means.get((kind, ratios.HOPS)) for kind in (ratios.OURS, ratios.PEER))
    if ours and peer:
        verdicts.append(ratios.to_peer(ours, peer, plan.frequency))
    if differences.get(ratios.HOPS):
        verdicts.append(ratios.added(differences[ratios.HOPS]))
    return verdicts
