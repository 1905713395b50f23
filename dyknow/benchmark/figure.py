"""The paper's figure 4: mean time to arrival over the number of hops."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Tuple

from matplotlib.figure import Figure

from dyknow.benchmark.kinds import KINDS, LABELS

_MARKERS = dict(zip(KINDS, "os^vDXP"))


def draw(means: Dict[Tuple[str, int], float], title: str, path: Path) -> None:
    """Draw a line for each kind.

    Args:
        means: microseconds by kind and number of hops.
        title: says how it was measured.
        path: file to write; its suffix says the format.
    """
    figure = Figure(figsize=(7.0, 4.6))
    axes = figure.subplots()
    for kind in KINDS:
        points = sorted((hops, mean) for (each, hops), mean in means.items() if each == kind)
        if points:
            hops = [each for each, _ in points]
            milliseconds = [mean / 1000 for _, mean in points]
            axes.plot(hops, milliseconds, label=LABELS[kind], marker=_MARKERS[kind])
    axes.set_yscale("log")
    axes.set_xlabel("hops")
    axes.set_ylabel("mean time to arrival (ms)")
    axes.set_title(title)
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize="small")
    figure.tight_layout()
    figure.savefig(path, dpi=150)
