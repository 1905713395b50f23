# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""``benchmark footprint``: memory and threads of a nodelet, and of a node that does the same.

Chains are set up and carry a message. Memory is the proportional set size (PSS), which counts a
share of shared memory for each process. For nodelets it is the memory that further ones add to
their nodelet manager.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Iterable, Sequence, Tuple

from dyknow_benchmark import machine, options, progress, tables
from dyknow_benchmark.chains import Chains
from dyknow_benchmark.kinds import KINDS
from dyknow_benchmark.results import Results
from dyknow_benchmark.session import Session

HEADER = ("kind", "parts", "kib_each", "threads_each", "processes")
_NODELETS = ("dyknow", "nodelet", "cpp_nodelet")
_KINDS = (*_NODELETS, "node", "cpp_node")
#: Hops of the chain that is set up first: its nodelets load what all share.
_BEFORE = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--kinds", nargs="+", choices=_KINDS, default=list(_KINDS), help="default: all"
    )
    parser.add_argument(
        "--nodelets", type=options.positive, default=100, help="default: %(default)d"
    )
    parser.add_argument("--nodes", type=options.positive, default=20, help="default: %(default)d")


def run(arguments: argparse.Namespace) -> Results:
    """Measure and put the results together."""
    rows = []
    with Session() as session:
        chains = Chains(session)
        load = machine.Load()
        for kind in progress.steps(arguments.kinds, "footprint", len(arguments.kinds), "kind"):
            parts = arguments.nodelets if kind in _NODELETS else arguments.nodes
            progress.say(f"setting up {parts}: {KINDS[kind]}")
            rows.append(_measure(session, chains, kind, parts))
    results = Results(load.rows())
    results.table("footprint", "what a nodelet or a node takes", HEADER, rows)
    return results


def _measure(session: Session, chains: Chains, kind: str, parts: int) -> Sequence[tables.Cell]:
    """Set up a source and ``parts`` hops; returns a row under ``HEADER``."""
    chains.build(kind, _BEFORE, [_BEFORE], name="_before")
    before = set(session.pids)
    host = []
    if kind in _NODELETS:
        host = [chains.cpp.pid if kind == "cpp_nodelet" else chains.python.pid]
    before_it = held(host)
    chains.build(kind, parts, [parts], name="_counted")
    started = [pid for pid in session.pids if pid not in before]
    kib, threads = (now - then for now, then in zip(held(host + started), before_it))
    return (kind, parts + 1, kib / (parts + 1), threads / (parts + 1), len(started))


def held(pids: Iterable[int]) -> Tuple[int, int]:
    """Memory (KiB) and threads of processes, in all."""
    kib = threads = 0
    for pid in pids:
        process = Path(f"/proc/{pid}")
        for line in (process / "smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                kib += int(line.split()[1])
        threads += len(os.listdir(process / "task"))
    return kib, threads
