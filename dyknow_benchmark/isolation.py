# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What isolation costs: nodelets in processes of their own beside nodes and shared nodelets."""

from __future__ import annotations

import argparse
from typing import Sequence

import psutil

from dyknow_benchmark.chains import (
    MANAGERS,
    Block,
    Chain,
    ChainPart,
    FanPart,
    Order,
    blocks_of,
    build,
    in_turns,
)
from dyknow_benchmark.options import measurement
from dyknow_benchmark.results import ARRIVALS, Results, Row, Summary
from dyknow_benchmark.session import Session

_ISOLATED, _NODE = "isolated", "node"
_KINDS = (_ISOLATED, _NODE, "cpp_node", "cpp_nodelet")
#: An image of 65,280 bytes, and of 1080p.
_MIDDLE, _LARGE = "160x136", "1920x1080"
_SIZES = [_MIDDLE, "640x480", _LARGE, "3840x2160"]
_RECEIVERS = (1, 2, 4, 8)
_CHAIN = 5
#: The most that the median and the CPU time may be of those of rospy nodes over TCPROS.
_LIMITS = {"time": (1.1,), _MIDDLE: (0.6,), _LARGE: (0.12, 0.15)}


class _Case:
    """A chain or a fan, and the CPU time that its processes take for its messages."""

    def __init__(
        self, session: Session, kind: str, hops: int, payload: str, part: type[ChainPart]
    ) -> None:
        known = len(session.started)
        record = (hops,) if part is ChainPart else range(1, hops + 1)
        self.hops: Sequence[int] = tuple(record)
        name = f"_{hops}_{part.__name__}"
        self._chain: Chain = build(session, kind, hops, self.hops, payload, name, part)
        self._processes: list[psutil.Process] = session.started[known:]
        if kind in MANAGERS:
            own = [f"_{hop}" for hop in range(hops + 1)] if kind == _ISOLATED else [""]
            managers = [session.nodelet_manager(MANAGERS[kind], each) for each in own]
            self._processes = [each.process for each in managers]
        self.seconds = 0.0

    def run(self, order: Order) -> Block:
        before = self._used()
        block = self._chain.run(order)
        self.seconds += self._used() - before
        return block

    def _used(self) -> float:
        times = [each.cpu_times() for each in self._processes]
        return float(sum(each.user + each.system for each in times))


@measurement(sizes=_SIZES, rate=20.0, messages=200)
def shared(arguments: argparse.Namespace, results: Results) -> None:
    """Time to arrival and CPU time between processes that share memory, and that do not.

    One hop from process to process, with time stamps and images; then one image to several
    receivers; then a chain of isolated nodelets at 30 Hz. The cases take turns in blocks. The
    CPU time is that of all processes of a case, for each message, with what the source takes to
    make an image.
    """
    orders = blocks_of(arguments.messages, arguments.rate)
    rows: list[Row] = []
    with Session() as session:
        for payload in dict.fromkeys(("time", *arguments.sizes)):
            cases = {kind: _Case(session, kind, 1, payload, ChainPart) for kind in _KINDS}
            found = _measured(cases, orders)
            rows += [(payload, *row) for row in found.values()]
            _judge(results, payload, found[_ISOLATED], found[_NODE])
        fans = {
            f"{number} receivers": _Case(session, _ISOLATED, number, _LARGE, FanPart)
            for number in _RECEIVERS
        }
        several = _measured(fans, orders)
        chains = {kind: _Case(session, kind, _CHAIN, _LARGE, ChainPart) for kind in _KINDS}
        pipeline = _measured(chains, blocks_of(arguments.messages, 30.0))
    header = (*ARRIVALS, "cpu_ms")
    title = "from process to process"
    results.table("shared", title, ("payload", "kind", *header), rows)
    title = f"{_LARGE} to several nodelets"
    results.table("receivers", title, ("case", *header), list(several.values()))
    one, eight = (several[f"{number} receivers"][_MEDIAN] for number in (1, 8))
    results.verdict(f"median of {_LARGE}, 8 receivers / 1", float(eight) / float(one), 2.0)
    title = f"{_LARGE} at 30 Hz through {_CHAIN} hops"
    results.table("pipeline", title, ("kind", *header), list(pipeline.values()))
    lost = float(pipeline[_ISOLATED][_LOST])
    results.verdict(f"lost by {_CHAIN} isolated nodelets at 30 Hz", lost, 0.0)


#: Columns in a row of ``_measured``.
_LOST, _MEDIAN, _CPU = 1 + ARRIVALS.index("lost"), 1 + ARRIVALS.index("median_us"), -1


def _judge(results: Results, payload: str, ours: Row, theirs: Row) -> None:
    for what, column, most in zip(
        ("median", "CPU time"), (_MEDIAN, _CPU), _LIMITS.get(payload, ())
    ):
        ratio = float(ours[column]) / float(theirs[column])
        results.verdict(f"{what} of {payload}, isolated / rospy nodes", ratio, most)


def _measured(cases: dict[str, _Case], orders: Sequence[Order]) -> dict[str, Row]:
    """Measure cases in turns; returns a row for each."""
    blocks = in_turns({case: each.run for case, each in cases.items()}, orders)
    rows: dict[str, Row] = {}
    for name, block in blocks.items():
        case = cases[name]
        arrived = [latency for hop in case.hops for latency in block.latencies[hop]]
        arrivals = Summary.of(arrived).arrivals(block.sent * len(case.hops))
        rows[name] = (name, *arrivals, 1e3 * case.seconds / block.sent)
    return rows
