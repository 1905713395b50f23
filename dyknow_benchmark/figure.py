# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The paper's figure 4: mean time to arrival over the number of hops."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Tuple

from matplotlib.figure import Figure

from dyknow_benchmark.kinds import KINDS, LABELS

_MARKERS = dict(zip(KINDS, "os^vDXP"))


def draw(means: Dict[Tuple[str, int], float], title: str, path: Path) -> None:
    """Draw a line for each kind.

    Args:
        means: microseconds by kind and number of hops.
        title: says how it was measured.
        path: file to write; its suffix says the format.
    """
    figure = Figure(figsize=(9.0, 4.6))
    axes = figure.subplots()
    ends = {}
    for order, kind in enumerate(KINDS):
        points = sorted((hops, mean) for (each, hops), mean in means.items() if each == kind)
        if points:
            hops = [each for each, _ in points]
            milliseconds = [mean / 1000 for _, mean in points]
            (line,) = axes.plot(
                hops,
                milliseconds,
                label=LABELS[kind],
                marker=_MARKERS[kind],
                markersize=5 + order % 2 * 3,  # so that neighbours that coincide are both seen
                zorder=3 - order / len(KINDS),
            )
            ends[line] = milliseconds[-1]
    axes.set_yscale("log")
    axes.set_xlabel("hops")
    axes.set_ylabel("mean time to arrival (ms)")
    axes.set_title(title)
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(  # beside the lines, in their order
        handles=sorted(ends, key=lambda line: -ends[line]),
        loc="center left",
        bbox_to_anchor=(1.01, 0.5),
        frameon=False,
        fontsize="small",
    )
    figure.savefig(path, dpi=150, bbox_inches="tight")
