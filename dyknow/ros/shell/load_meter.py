# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Measures for a moment what nodelets and their processes take."""

from __future__ import annotations

import contextlib
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Iterable, Mapping, NamedTuple, Sequence

import psutil
from dyknow_msgs.msg import Counts

from dyknow.errors import HostError, PeerTimeout
from dyknow.model.graph import NodeletStatus
from dyknow.model.statistics import NodeletCount, NodeletLoad
from dyknow.ros.wire.addresses import host_of, is_here
from dyknow.ros.wire.master import Master
from dyknow.ros.wire.messages import counts_from
from dyknow.ros.wire.poll_client import PollClient

#: Seconds over which the load is measured.
_MOMENT = 0.3
#: Seconds that a process may take to answer, and processes that are queried at once.
_PATIENCE, _WORKERS = 1.0, 16


class Loads(NamedTuple):
    """What nodelets and their processes take.

    Attributes:
        nodelets: by name; none of those whose process does not answer.
        processes: share of one core, and bytes of resident memory, by node; none of a node on
            another machine, or that does not answer.
    """

    nodelets: Mapping[str, NodeletLoad]
    processes: Mapping[str, tuple[float, int]]


def measure(master: Master, nodelets: Iterable[NodeletStatus]) -> Loads:
    """Watch nodelets and their processes for a moment, all processes at the same time."""
    hosted: dict[str, list[NodeletStatus]] = {}
    for each in nodelets:
        hosted.setdefault(each.node, []).append(each)
    of_nodelets: dict[str, NodeletLoad] = {}
    of_processes: dict[str, tuple[float, int]] = {}

    def watch(node: str) -> None:
        names = [each.name for each in hosted[node]]
        is_node = not hosted[node][0].manager
        with contextlib.closing(PollClient(master, node, is_node)) as client:
            process = _process(master, node)
            before = _counts(client, names)
            time.sleep(_MOMENT if before or process else 0.0)
            for name, count in _counts(client, names if before else ()).items():
                load = count.load_since(before[name]) if name in before else None
                if load is not None:
                    of_nodelets[name] = load
        with contextlib.suppress(psutil.Error):
            if process is not None:
                of_processes[node] = (process.cpu_percent() / 100.0, process.memory_info().rss)

    with ThreadPoolExecutor(max_workers=_WORKERS) as pool:
        list(pool.map(watch, hosted))
    return Loads(of_nodelets, {node: of_processes[node] for node in sorted(of_processes)})


def _process(master: Master, node: str) -> psutil.Process | None:
    """Return the process of a node, measured from now on; None if it is not on this machine."""
    with contextlib.suppress(LookupError, PeerTimeout, OSError, psutil.Error):
        uri = master.node(node)
        if is_here(host_of(uri), _PATIENCE):
            process = psutil.Process(master.pid(node, uri, _PATIENCE))
            process.cpu_percent()
            return process
    return None


def _counts(client: PollClient, nodelets: Sequence[str]) -> dict[str, NodeletCount]:
    """Query a process for the counts of its nodelets; none if it does not answer."""
    with contextlib.suppress(HostError, PeerTimeout):
        if nodelets:
            answer = client.ask(_PATIENCE, counted=nodelets)
            return {each.nodelet: each for each in counts_from(Counts(answer.counts))}
    return {}
