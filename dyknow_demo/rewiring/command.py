# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""What ``demo --rewiring`` takes, and the processes that it needs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, List, Sequence, Tuple

from dyknow.errors import DyKnowError, HostError, Refused
from dyknow_demo.options import positive


def run(arguments: Sequence[str]) -> bool:
    """Run the demonstration; True if no frame was lost, doubled or out of order.

    Raises:
        DyKnowError: something failed.
    """
    return _run(_parse(arguments))


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="rosrun dyknow demo --rewiring",
        description="Runs camera frames through a chain of nodelets, re-wires the chain while it "
        "runs, and counts the frames that were lost or doubled. Uses the ROS master that "
        "ROS_MASTER_URI names, or starts one for itself.",
        epilog="Exit code: 0 if no frame was lost, doubled or out of order, else 1; 130 after "
        "Ctrl-C.",
    )
    parser.add_argument(
        "--frames",
        type=_folder,
        metavar="DIR",
        help="folder of JPEG or PNG files; by default shared/data/robocup_msl beside the "
        "checkout, if it is there",
    )
    parser.add_argument("--rendered", action="store_true", help="render frames, use no files")
    parser.add_argument(
        "--seconds",
        type=positive,
        default=6.0,
        help="time for each of the six wirings (%(default)g)",
    )
    parser.add_argument(
        "--rate", type=positive, default=30.0, help="frames a second of each camera (%(default)g)"
    )
    return parser.parse_args(argv)


def _folder(text: str) -> Path:
    folder = Path(text)
    if not folder.is_dir():
        raise argparse.ArgumentTypeError(f"no folder '{text}'")
    return folder


def _run(options: Any) -> bool:
    # Imported here, so that --help and a wrong usage answer at once.
    from dyknow_demo.processes import (
        MANAGER,
        Processes,
        check_real_time,
        find_master,
        start_nodelet_manager,
    )
    from dyknow_demo.rewiring.graph import HandWiredGraph
    from dyknow_demo.rewiring.story import Story
    from dyknow_demo.rewiring.table import ReportTable

    table = ReportTable()
    sources, told = _frames(options)
    table.line(f"frames: {told}, {options.rate:g} Hz from each of two cameras")
    with Processes() as processes:
        table.line(f"ROS master: {find_master(processes)}")
        graph = HandWiredGraph(MANAGER)
        if graph.is_up():
            raise DyKnowError(
                f"{MANAGER} is registered at this master already: another demonstration runs "
                "there, or was killed ('rosnode cleanup' forgets it)"
            )
        check_real_time()
        pid = start_nodelet_manager(processes, graph.is_up)
        table.line(f"nodelet manager: {MANAGER}, process {pid}")
        table.line()
        try:
            return Story(
                graph, table, processes.check, sources, options.rate, options.seconds
            ).run()
        except (HostError, Refused):
            processes.check(patience=0.5)  # a process that ended is the better explanation
            raise
        finally:
            graph.forget()


def _frames(options: Any) -> Tuple[List[List[Path]], str]:
    """Deal the image files out to two cameras, and say where they come from."""
    from dyknow_demo.images import SHARED_FRAMES, image_files

    folder = options.frames or (SHARED_FRAMES if SHARED_FRAMES.is_dir() else None)
    files = image_files(folder) if folder is not None and not options.rendered else []
    if options.frames and not options.rendered and not files:
        raise DyKnowError(f"no JPEG or PNG files in '{folder}'")
    if not files:
        return [[], []], "rendered, a ball on a field"
    one, two = files[0::2], files[1::2] or files
    return [[file.resolve() for file in each] for each in (one, two)], (
        f"{len(files)} real ones from {folder}"
    )
