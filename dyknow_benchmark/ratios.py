# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The targets for ratios at 50 hops that the chain experiment can check.

Two of them need messages of their own: DyKnow beside C++ nodelets at the frequency that the figure
is not measured at, and images beside time stamps.
"""

from __future__ import annotations

from typing import Dict, List, Mapping

from dyknow_benchmark import images, progress
from dyknow_benchmark.chains import Chains
from dyknow_benchmark.control import WARM_UP, Block, ChainControl, Order
from dyknow_benchmark.summary import Summary, median
from dyknow_benchmark.targets import Verdict

#: Number of hops that the targets are stated for.
HOPS = 50
OURS, PEER = "dyknow", "cpp_nodelet"
#: The most that DyKnow's mean may be of that of C++ nodelets, by frequency in Hz.
LIMITS: Dict[float, float] = {100.0: 0.25, 5.0: 0.35}
#: The most milliseconds that the proxy may add.
ADDED_LIMIT = 0.02
_TURNS = 2


def to_peer(ours: float, peer: float, frequency: float) -> Verdict:
    """Compare two means; at other frequencies the limit is that of the nearest one below."""
    limit = LIMITS[max((each for each in LIMITS if each <= frequency), default=min(LIMITS))]
    what = f"mean of DyKnow / mean of C++ nodelets, {HOPS} hops, {frequency:g} Hz"
    return Verdict(what, ours / peer, limit)


def added(differences: List[float]) -> Verdict:
    """Judge the differences (us) between DyKnow's nodelets and plain ones."""
    what = f"added by the proxy, {HOPS} hops, median of {len(differences)} pairs (ms)"
    return Verdict(what, median(differences) / 1000, ADDED_LIMIT)


def measure(
    chains: Chains, controls: Mapping[str, ChainControl], frequency: float, messages: int
) -> List[Verdict]:
    """Measure what the figure does not show.

    Args:
        chains: where further chains are set up.
        controls: the chains of the figure, by kind.
        frequency: of the figure, in Hz.
        messages: of each chain.
    """
    found = []
    if OURS in controls and PEER in controls:
        for other in LIMITS:
            if other != frequency:
                found += _at(other, controls, messages)
    if OURS in controls:
        blocks = images.measure(chains, ("time", images.LARGEST), HOPS, images.RATE, messages)
        found.append(images.verdict(blocks, images.LARGEST, HOPS))
    return found


def _at(frequency: float, controls: Mapping[str, ChainControl], messages: int) -> List[Verdict]:
    blocks = {OURS: Block(), PEER: Block()}
    order = Order(WARM_UP, max(1, messages // _TURNS), frequency)
    turns = [OURS, PEER, PEER, OURS]
    for kind in progress.steps(turns, f"{frequency:g} Hz", len(turns)):
        blocks[kind].add(controls[kind].finish(order, controls[kind].begin(order)))
    ours, peer = (Summary.of(blocks[kind].latencies[HOPS]) for kind in (OURS, PEER))
    return [to_peer(ours.mean, peer.mean, frequency)] if ours.count and peer.count else []
